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


class Held(NamedTuple):
    """Of one flesh body.

    push: (body_count, 6) impulse and moment on the rigid bodies.  motion: (near_count, 6) velocity [m/s] and spin
    [1/s] by which it took them to give way.  stiffness: (near_count, 6, 6), see `RigidCarriers.note`.
    """

    push: np.ndarray
    motion: np.ndarray
    stiffness: np.ndarray


class RigidCarriers:
    """What flesh and rigid bodies give each other in a substep: as much as the one loses, the other gains.

    The rigid bodies have stepped before the flesh. While it is solved they give way to it by their mobility, their
    joints and supports holding them; then they take their substep again with what it gave them. Where supports
    turn out to hold otherwise, both are found again from there.

    What lies on something starts the next substep with what flesh gave it in this one, so that its supports bear
    that from the start.

    length: [s] of the substep.  faced: counts how often the bodies were looked at.
    near: rigid bodies with a surface in reach.  root: of each a root (6, 6) of its mobility.  centre: (n, 3) [m]
    of mass.  given: (body_count, 6) impulse and moment about the centre of mass at the substep's start that the
    bodies have taken up in this substep.

    State array: obstacles/expected: (body_count, 6) of them at the substep's start.
    """

    def __init__(self, model: Model, state: State) -> None:
        self._stage, self._kinematics = model.parts["rigid"], model.parts["kinematics"]
        self._count = len(model.scene.rigid_bodies)
        self.body_of = np.array([-1 if s.rigid is None else s.rigid for s in model.scene.surfaces])
        self._expected = wp.zeros((self._count, 6), dtype=wp.float64, device=model.launcher.device)
        state.arrays["obstacles/expected"] = self._expected
        self._begun_with = self.given = np.zeros((self._count, 6))
        self._held: dict[int, Held] = {}
        self._substep: Interval | None = None
        self.length, self.faced = 0.0, 0
        self._leave_alone()

    def _leave_alone(self) -> None:
        self.near, self.root, self.centre = np.zeros(0, dtype=int), np.zeros((0, 6, 6)), np.zeros((0, 3))

    def begin_substep(self, substep: Interval) -> None:
        self._substep, self.length = substep, substep.length
        self._begun_with = self.given = self._expected.numpy().copy()
        self._held = {}
        self._leave_alone()

    def face(self, surfaces: list[int]) -> None:
        """Takes these surfaces, by index into `Scene.surfaces`, to be in reach."""
        bodies = self.body_of[np.array(surfaces, dtype=int)]
        self.near = np.unique(bodies[bodies >= 0])
        matrix = mobility(self._stage, self.near)
        size, basis = np.linalg.eigh(matrix)
        self.root = basis * np.sqrt(np.maximum(size, 0.0))[:, None, :]
        self.centre = self._stage.position.numpy()[self.near]
        self._guess = self._motion()
        self._held = {b: held._replace(motion=0.0 * held.motion) for b, held in self._held.items()}
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
            matrix += held.stiffness
            force += np.einsum("nij,nj->ni", held.stiffness, held.motion)
        turned = self.root.transpose(0, 2, 1)
        return turned @ matrix @ self.root, np.einsum("nij,nj->ni", turned, force)

    def _others(self, flesh: int) -> list[Held]:
        return [held for b, held in self._held.items() if b != flesh]

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
        self._held[flesh] = Held(push, np.einsum("nij,nj->ni", self.root, way), stiffness)

    def lasts(self, reach: float) -> bool:
        """Whether flesh bodies that push the same rigid one, each solved by itself, take it to go to one place.

        reach: [m] the distance that flesh keeps.
        """
        pushers = sum(
            (held.push.any(axis=1).astype(int) for held in self._held.values()), np.zeros(self._count, int)
        )
        if pushers.max(initial=0) < 2:
            return True
        given = (self._total() - self.given)[self.near]
        moved = np.einsum("nij,nkj,nk->ni", self.root, self.root, given)
        return self._apart(moved) <= AGREES * reach

    def _apart(self, moved: np.ndarray) -> float:
        """[m] by how much the bodies' ways in the substep differ from where flesh that pushes them took them."""
        off, size = 0.0, self._stage.contact.reach[self.near]
        for held in self._held.values():
            apart = (moved - held.motion)[held.push[self.near].any(axis=1)]
            reach = size[held.push[self.near].any(axis=1)]
            speed = np.linalg.norm(apart[:, :3], axis=1) + reach * np.linalg.norm(apart[:, 3:], axis=1)
            off = max(off, self.length * float(speed.max(initial=0.0)))
        return off

    def _total(self) -> np.ndarray:
        return sum((held.push for held in self._held.values()), np.zeros((self._count, 6)))

    def agree(self, reach: float) -> bool:
        """Lets the rigid bodies take their substep again; whether they go where flesh took them to go.

        reach: [m] the distance that flesh keeps.
        """
        if not self._take():
            return True
        return self._apart(self._motion() - self._guess) <= AGREES * reach

    def finish(self) -> None:
        """Ends the substep: the rigid bodies have been given what flesh felt."""
        self._take()
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
            self._substep = None

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
