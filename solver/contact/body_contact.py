"""Contact of elastic bodies: with each other, with themselves, and with what the animation moves."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import warp as wp

from plait.solver.contact.answers import Answers
from plait.solver.contact.body_contact_kernels import take_up
from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.grid_rule import PaperRule
from plait.solver.contact.obstacles import build_obstacles
from plait.solver.contact.skin_contact import SkinContact
from plait.solver.model import Interval, Model
from plait.solver.state import State
from plait.solver.tets.layout import TetLayout


class ContactPart(Protocol):
    """One kind of contact. All parts see the same nodes, and take turns in every sweep.

    too_fast: in this substep something that meets moves by more than the settings' `cfl` cells.
    """

    too_fast: bool

    def begin_substep(self, start: wp.array, position: wp.array, base: wp.array, lying: np.ndarray) -> bool:
        """Finds what may touch while nodes go from `start` to `position`; False if nothing does.

        base, lying: see `BodyContact.begin_substep`.
        """

    def begin_pass(
        self, position: wp.array, velocity: wp.array, displacement_per_velocity: float, inverse_mass: wp.array
    ) -> None:
        """Takes up where an elastic solve took the nodes: what is broken there is what sweeps put right.

        inverse_mass: (node_count,) float64 [1/kg], how nodes answer to impulses in this pass.
        """

    def sweep(self, velocity: wp.array) -> None:
        """Changes the nodes' velocities, (node_count,) vec3d [m/s], in place, by impulses."""

    def add_impulses(self, on_nodes: wp.array) -> None:
        """Adds the nodes' impulses [kg m/s] in this substep so far."""

    def separate(self, position: wp.array) -> None:
        """Moves nodes apart that still overlap, in place, without a change of velocity; the substep ends here."""

    def retract(self) -> None:
        """All as it was before `begin_substep`."""

    def end_frame(self) -> dict[str, Any]:
        """This frame's metrics."""


class BodyContact:
    """All contact of a scene's elastic bodies, as impulses on their nodes after the elastic solve.

    impulse: (node_count,) vec3d [kg m/s], what contact has given each node so far in this substep.
    cell_size: [m] of the grid; particles on the skins lie at most so far apart.
    particles: those.  passes: how often an elastic solve and contact alternate in a substep.
    obstacles: contact with surfaces that no body carries, part of the elastic solve; None without such.
    holds_still: whether bodies that lie on others may be left out of it.
    pairs: (pair_count, 2), the bodies that may touch in this substep, not both of them lying; a body that may
        touch itself with itself.
    """

    def __init__(self, model: Model, state: State, layout: TetLayout) -> None:
        self.model, self.layout, self._launcher = model, layout, model.launcher
        self.settings = model.settings.grid
        self.cell_size = self.settings.cell_size or mean_cell_size(layout)
        self.particles = CollisionParticles(model.scene, layout, self.cell_size, model.launcher)
        device = model.launcher.device
        self.impulse, self._velocity, self._free_velocity = (
            wp.zeros(layout.node_count, dtype=wp.vec3d, device=device) for _ in range(3)
        )
        self._first_pass = True
        self._answers = Answers(layout, self.particles)
        self._at_once = wp.array(self._answers.at_once, dtype=wp.float64, device=device)
        if self.settings.rule == "paper":
            self.parts: list[ContactPart] = [PaperRule(model, self.particles, self._answers.mobile)]
        else:
            self.parts = [SkinContact(model, state, self.particles, self._answers.mobile)]
        self.holds_still = self.settings.rule == "pairwise"
        self.passes = 1 if self.settings.rule == "paper" else self.settings.passes
        self._active: list[ContactPart] = []
        self._substep: Interval | None = None
        self.obstacles = build_obstacles(model, state, self.particles)

    def begin_substep(
        self,
        substep: Interval,
        start: wp.array,
        position: wp.array,
        base: wp.array | None = None,
        lying: np.ndarray | None = None,
    ) -> bool:
        """Whether anything may touch in this substep; if not, nothing has been changed or need be called.

        start, position: (node_count,) vec3d [m], the nodes where the substep starts and after the elastic solve.
        base: [m] where impulses act: what positions at the substep's end are reckoned from, x = base + t v. With
            impulses in one point there, angular momentum is conserved. By default the start.
        lying: (body_count,) bool, bodies that stay where they are; what lies on each other is left alone. None by
            default.
        """
        lying = np.zeros(self.layout.body_count, dtype=bool) if lying is None else lying
        self._substep, base = substep, start if base is None else base
        self._first_pass = True
        self._active = [part for part in self.parts if part.begin_substep(start, position, base, lying)]
        return bool(self._active)

    @property
    def pairs(self) -> np.ndarray:
        found = [part.pairs for part in self._active if isinstance(part, SkinContact)]
        return np.concatenate(found) if found else np.zeros((0, 2), dtype=np.int64)

    @property
    def too_fast(self) -> bool:
        """Whether something that meets in the substep moves by more than the settings' `cfl` cells."""
        return any(part.too_fast for part in self._active)

    def retract(self, substep: Interval) -> None:
        """All as it was before `begin_substep`, if that was called for this substep."""
        for part in self.parts if self._substep == substep else ():
            part.retract()
        self._substep = None

    def resolve(
        self,
        start: wp.array,
        position: wp.array,
        velocity: wp.array,
        displacement_per_velocity: float,
        forecast: bool = False,
    ) -> None:
        """Impulses that keep what touches apart, onto `velocity` and `position`, in place, and into `impulse`.

        displacement_per_velocity: [s] how far a node ends up further for each m/s added to its velocity.
        forecast: another elastic solve follows, with `impulse`. The impulses are then those that stop as much of
            the bodies as that solve will move, not their skins alone: by an estimate in a substep's first pass,
            and then as the solve before has shown it. What is left for the last pass, which is no forecast, bends
            skins alone; being far stiffer over a substep than heavy, they take up much energy with little impulse.
        """
        if self._first_pass:
            wp.copy(self._free_velocity, velocity)
        wp.copy(self._velocity, velocity)
        inverse_mass = self._forecast(velocity, displacement_per_velocity) if forecast else self._at_once
        self._first_pass = False
        for part in self._active:
            part.begin_pass(position, velocity, displacement_per_velocity, inverse_mass)
        for _ in range(self.settings.iterations):
            for part in self._active:
                part.sweep(velocity)
        self.impulse.zero_()
        for part in self._active:
            part.add_impulses(self.impulse)
        inputs = [self._velocity, velocity, wp.float64(displacement_per_velocity)]
        self._launcher.launch(take_up, self.layout.node_count, inputs, [position])

    def changes(self, velocity: wp.array) -> tuple[np.ndarray, np.ndarray]:
        """(node_count, 3) [m/s] each: what `velocity` was changed by in the last `resolve`, and in the substep."""
        after = velocity.numpy()
        return after - self._velocity.numpy(), after - self._free_velocity.numpy()

    def _forecast(self, velocity: wp.array, displacement_per_velocity: float) -> wp.array:
        """Inverse masses before an elastic solve."""
        if self._first_pass:
            answer = self._answers.after_solve(displacement_per_velocity)
        else:
            change = velocity.numpy() - self._free_velocity.numpy()
            answer = self._answers.as_shown(displacement_per_velocity, self.impulse.numpy(), change)
        return wp.array(answer, dtype=wp.float64, device=self._launcher.device)

    def separate(self, position: wp.array) -> None:
        """Moves what still overlaps apart by a part of the overlap, velocities untouched."""
        for part in self._active:
            part.separate(position)

    def end_frame(self) -> dict[str, Any]:
        """What each part has counted."""
        parts = [*self.parts, self.obstacles] if self.obstacles is not None else self.parts
        return {key: value for part in parts for key, value in part.end_frame().items()}


def mean_cell_size(layout: TetLayout) -> float:
    """[m] The mean edge of all bodies' tets."""
    return float(np.average(layout.edge, weights=np.diff(layout.first_tet)))


def build_contact(model: Model, state: State, layout: TetLayout) -> BodyContact | None:
    """The contact of a scene's bodies; None where nothing can ever touch: no skin of theirs collides."""
    colliding = any(model.scene.surfaces[body.surface].collides for body in layout.bodies)
    return BodyContact(model, state, layout) if colliding else None
