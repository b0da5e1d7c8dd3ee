"""Rigid bodies in the way of flesh, which give way while it is solved: host side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import warp as wp

from plait.solver.model import Interval, Model
from plait.solver.rigid.mobility import mobility, supported
from plait.solver.state import State

# Where the rigid bodies go and where flesh took them to go differ by this part of the distance kept, or both are
# found again.
AGREES = 0.5
# What differs by this much of it after all that asks for a shorter substep.
AT_ODDS = 5.0


class Held(NamedTuple):
    """Of one flesh body.

    push: (body_count, 6) impulse and moment on the rigid bodies.
    stiffness: (body_count, 6, 6), see `RigidCarriers.note`.
    motion: (body_count, 6) velocity [m/s] and spin [1/s] by which it took them to give way.
    """

    push: np.ndarray
    stiffness: np.ndarray
    motion: np.ndarray


class RigidCarriers:
    """What flesh and rigid bodies give each other in a substep: as much as the one loses, the other gains.

    The rigid bodies have stepped before the flesh. While it is solved they give way to it by their mobility, their
    joints and supports holding them; then they take their substep again with what it gave them. Where supports
    turn out to hold otherwise, both are found again from there.

    What lies on something starts the next substep with what flesh gave it in this one, so that its supports bear
    that from the start.

    at_odds: whether flesh and rigid bodies, as last looked at, part by more than they may.
    length: [s] of the substep.  faced: counts how often the bodies were looked at.
    near: rigid bodies with a surface in reach.  root: of each a root (6, 6) of its mobility.  centre: (n, 3) [m]
    of mass.  given: (body_count, 6) impulse and moment about the centre of mass at the substep's start that the
    bodies have taken up in this substep.

    State arrays: obstacles/expected: (body_count, 6) of them at the substep's start; obstacles/push and stiffness:
    what each flesh body felt in the substep before, see `Held`.
    """

    def __init__(self, model: Model, state: State) -> None:
        self._stage, self._kinematics = model.parts["rigid"], model.parts["kinematics"]
        self._count = len(model.scene.rigid_bodies)
        self.body_of = np.array([-1 if s.rigid is None else s.rigid for s in model.scene.surfaces])
        self._expected = wp.zeros((self._count, 6), dtype=wp.float64, device=model.launcher.device)
        state.arrays["obstacles/expected"] = self._expected
        self._begun_with = self.given = np.zeros((self._count, 6))
        flesh = len(model.scene.bodies)
        self._memory = (
            wp.zeros((flesh, self._count, 6), dtype=wp.float64, device=model.launcher.device),
            wp.zeros((flesh, self._count, 6, 6), dtype=wp.float64, device=model.launcher.device),
        )
        state.arrays["obstacles/push"], state.arrays["obstacles/stiffness"] = self._memory
        self._held: list[Held] = []
        self._substep: Interval | None = None
        self.length, self.faced, self.at_odds = 0.0, 0, False
        self._leave_alone()

    def _leave_alone(self) -> None:
        self.near, self.root, self.centre = np.zeros(0, dtype=int), np.zeros((0, 6, 6)), np.zeros((0, 3))

    def begin_substep(self, substep: Interval) -> None:
        self._substep, self.length = substep, substep.length
        self._begun_with = self.given = self._expected.numpy().copy()
        push, stiffness = (array.numpy().copy() for array in self._memory)
        self._held = [Held(*of, np.zeros((self._count, 6))) for of in zip(push, stiffness, strict=True)]
        self._begun_held = self._held
        self._unmoved = np.zeros(0, dtype=int)
        self._leave_alone()

    def face(self, surfaces: list[int]) -> None:
        """Takes these surfaces, by index into `Scene.surfaces`, to be in reach."""
        bodies = self.body_of[np.array(surfaces, dtype=int)]
        self.near = np.unique(bodies[bodies >= 0])
        matrix = mobility(self._stage, self.near)
        matrix[np.isin(self.near, self._unmoved)] = 0.0
        size, basis = np.linalg.eigh(matrix)
        self.root = basis * np.sqrt(np.maximum(size, 0.0))[:, None, :]
        self.centre = self._stage.position.numpy()[self.near]
        self._guess = self._motion()
        self._held = [held._replace(motion=0.0 * held.motion) for held in self._held]
        self.faced += 1

    def aim(self, flesh: int) -> np.ndarray:
        """(near_count, 6) [sqrt J] by how much the bodies are too fast already, with what all but one flesh body
        gives them."""
        others = sum((held.push for held in self._others(flesh)), np.zeros((self._count, 6)))
        return np.einsum("nji,nj->ni", self.root, (others - self.given)[self.near])

    def hold(self, flesh: int) -> tuple[np.ndarray, np.ndarray]:
        """How all but one flesh body hold the bodies where they were felt: (near_count, 6, 6) and (near_count, 6)
        [sqrt J], matrix and force of a quadratic in how far the bodies give way."""
        matrix, force = np.zeros((len(self.near), 6, 6)), np.zeros((len(self.near), 6))
        for held in self._others(flesh):
            stiffness = held.stiffness[self.near]
            matrix += stiffness
            force += np.einsum("nij,nj->ni", stiffness, held.motion[self.near])
        turned = self.root.transpose(0, 2, 1)
        return turned @ matrix @ self.root, np.einsum("nij,nj->ni", turned, force)

    def _others(self, flesh: int) -> list[Held]:
        return [held for b, held in enumerate(self._held) if b != flesh]

    def note(
        self,
        flesh: int,
        bodies: np.ndarray,
        places: np.ndarray,
        forces: np.ndarray,
        way: np.ndarray,
        stiffness: np.ndarray,
    ) -> None:
        """What one flesh body feels in the substep, and how it took the rigid bodies to give way.

        bodies (n,), places (n, 3) [m] and forces (n, 3) [N] of its planes.  way: (near_count, 6) [sqrt J].
        stiffness: (near_count, 6, 6) impulse and moment by velocity and spin that it answers with, about.
        """
        impulse = -self.length * forces
        push = np.zeros((self._count, 6))
        np.add.at(push[:, :3], bodies, impulse)
        np.add.at(push[:, 3:], bodies, np.cross(places - self._stage.start_position[bodies], impulse))
        motion, everywhere = np.zeros((self._count, 6)), np.zeros((self._count, 6, 6))
        motion[self.near], everywhere[self.near] = np.einsum("nij,nj->ni", self.root, way), stiffness
        self._held[flesh] = Held(push, everywhere, motion)

    def lasts(self, reach: float) -> bool:
        """Whether flesh bodies that push the same rigid one, each solved by itself, take it to go to one place.

        reach: [m] the distance that flesh keeps.
        """
        pushers = sum((held.push.any(axis=1).astype(int) for held in self._held), np.zeros(self._count, int))
        if pushers.max(initial=0) < 2:
            return True
        given = (self._total() - self.given)[self.near]
        moved = np.einsum("nij,nkj,nk->ni", self.root, self.root, given)
        return self._apart(moved) <= AGREES * reach

    def _apart(self, moved: np.ndarray) -> float:
        """[m] by how much the bodies' ways in the substep differ from where flesh that pushes them took them."""
        off, size = 0.0, self._stage.contact.reach[self.near]
        for held in self._held:
            pushed = held.push[self.near].any(axis=1)
            apart, reach = (moved - held.motion[self.near])[pushed], size[pushed]
            speed = np.linalg.norm(apart[:, :3], axis=1) + reach * np.linalg.norm(apart[:, 3:], axis=1)
            off = max(off, self.length * float(speed.max(initial=0.0)))
        return off

    def _total(self) -> np.ndarray:
        return sum((held.push for held in self._held), np.zeros((self._count, 6)))

    def agree(self, reach: float) -> bool:
        """Lets the rigid bodies take their substep again; whether they go where flesh took them to go.

        reach: [m] the distance that flesh keeps.
        """
        self.at_odds = False
        if not self._take():
            return True
        moved = self._motion() - self._guess
        # What takes no notice of impulses, because something else says where it goes, does not give way.
        pushed = self.given[self.near].any(axis=1)
        self._unmoved = np.union1d(self._unmoved, self.near[pushed & ~moved.any(axis=1)])
        off = self._apart(moved)
        self.at_odds = off > AT_ODDS * reach
        return off <= AGREES * reach

    def finish(self) -> None:
        """Ends the substep: the rigid bodies have been given what flesh felt."""
        if not len(self.near):
            self._held = [Held(*(0.0 * array for array in held)) for held in self._held]
        self._take()
        self._remember(self._held)
        expected = np.zeros((self._count, 6))
        pushed = np.flatnonzero(self.given.any(axis=1))
        if len(pushed):
            held = pushed[supported(self._stage, pushed)]
            expected[held] = self.given[held]
            stage = self._stage
            stage.impulse.assign(stage.impulse.numpy() + expected[:, :3])
            stage.angular_impulse.assign(stage.angular_impulse.numpy() + expected[:, 3:])
        self._expected.assign(expected)

    def retract(self, substep: Interval) -> None:
        """As before `begin_substep`, if that was called for this substep."""
        if substep is self._substep:
            self._expected.assign(self._begun_with)
            self._remember(self._begun_held)
            self._substep = None

    def _remember(self, held: list[Held]) -> None:
        for array, values in zip(self._memory, zip(*held, strict=True), strict=False):
            array.assign(np.array(values))

    def _take(self) -> bool:
        """Whether that changed anything."""
        total = self._total()
        if np.array_equal(total, self.given):
            return False
        change = total - self._begun_with
        self._stage.redo(self._substep, change[:, :3], change[:, 3:])
        self.given = total
        return True

    def _motion(self) -> np.ndarray:
        """(near_count, 6) velocity [m/s] and spin [1/s]."""
        return self._stage.speeds()[self.near]


def links_of(surface: np.ndarray, carriers: RigidCarriers) -> tuple[np.ndarray, np.ndarray]:
    """Places of planes, by surface (slot_count,), that near rigid bodies hold, and which; body by body."""
    bodies = np.append(carriers.body_of, -1)[surface]
    slots = np.flatnonzero(np.isin(bodies, carriers.near) & (bodies >= 0))
    entry = np.searchsorted(carriers.near, bodies[slots])
    order = np.argsort(entry, kind="stable")
    return slots[order], entry[order]
