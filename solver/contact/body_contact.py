"""Contact of elastic bodies: with each other, with themselves, and with what the animation moves."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import warp as wp

from plait.solver.contact.body_contact_kernels import take_up
from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.obstacles import build_obstacles
from plait.solver.contact.skin_contact import SkinContact
from plait.solver.model import Interval, Model
from plait.solver.state import State
from plait.solver.tets.layout import TetLayout


class ContactPart(Protocol):
    """One kind of contact. All parts see the same nodes, and take turns in every sweep."""

    def begin_substep(self, substep: Interval, start: wp.array, position: wp.array) -> bool:
        """Finds what may touch while nodes go from `start` to `position`; False if nothing does."""

    def begin_pass(self, position: wp.array, velocity: wp.array, displacement_per_velocity: float) -> None:
        """Takes up where an elastic solve took the nodes: what is broken there is what sweeps put right."""

    def sweep(self, velocity: wp.array) -> None:
        """Changes the nodes' velocities, (node_count,) vec3d [m/s], in place, by impulses."""

    def separate(self, position: wp.array) -> None:
        """Moves nodes apart that still overlap, in place, without a change of velocity."""

    def end_frame(self) -> dict[str, Any]:
        """This frame's metrics."""


class BodyContact:
    """All contact of a scene's elastic bodies, as impulses on their nodes after the elastic solve.

    impulse: (node_count,) vec3d [kg m/s], what contact has given each node so far in this substep.
    cell_size: [m] of the grid; particles on the skins lie at most so far apart.
    particles: those.  inverse_mass: (node_count,) float64 [1/kg], zero for pinned nodes.
    obstacles: contact with surfaces that no body carries, part of the elastic solve; None without such.
    """

    def __init__(self, model: Model, state: State, layout: TetLayout) -> None:
        self.model, self.layout, self._launcher = model, layout, model.launcher
        self.settings = model.settings.grid
        self.cell_size = self.settings.cell_size or mean_cell_size(layout)
        self.particles = CollisionParticles(model.scene, layout, self.cell_size, model.launcher)
        device = model.launcher.device
        self._mass = wp.array(layout.mass, dtype=wp.float64, device=device)
        free = ~layout.pinned & (layout.mass > 0.0)
        inverse_mass = np.divide(1.0, layout.mass, out=np.zeros(layout.node_count), where=free)
        self.inverse_mass = wp.array(inverse_mass, dtype=wp.float64, device=device)
        self.impulse = wp.zeros(layout.node_count, dtype=wp.vec3d, device=device)
        self._velocity = wp.zeros_like(self.impulse)
        self.parts: list[ContactPart] = [SkinContact(model, state, self.particles, self.inverse_mass)]
        self._active: list[ContactPart] = []
        self.obstacles = build_obstacles(model, state, self.particles)

    def begin_substep(self, substep: Interval, start: wp.array, position: wp.array) -> bool:
        """Whether anything may touch in this substep; if not, nothing has been changed or need be called.

        start, position: (node_count,) vec3d [m], the nodes where the substep starts and after the elastic solve.
        """
        self._active = [part for part in self.parts if part.begin_substep(substep, start, position)]
        if self._active:
            self.impulse.zero_()
        return bool(self._active)

    def resolve(
        self, start: wp.array, position: wp.array, velocity: wp.array, displacement_per_velocity: float
    ) -> None:
        """Impulses that keep what touches apart, onto `velocity` and `position`, in place, and into `impulse`.

        displacement_per_velocity: [s] how far a node ends up further for each m/s added to its velocity.
        """
        wp.copy(self._velocity, velocity)
        for part in self._active:
            part.begin_pass(position, velocity, displacement_per_velocity)
        for _ in range(self.settings.iterations):
            for part in self._active:
                part.sweep(velocity)
        inputs = [self._mass, self._velocity, velocity, wp.float64(displacement_per_velocity)]
        self._launcher.launch(take_up, self.layout.node_count, inputs, [position, self.impulse])

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
    """The contact of a scene's bodies; None where nothing can ever touch."""
    contact = BodyContact(model, state, layout)
    return contact if contact.parts else None
