"""Granular matter against all that is in its way: host side."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from plait.solver.granular.exchange_kernels import Moment
from plait.solver.granular.matter import Matter
from plait.solver.granular.near_surfaces import NearSurfaces
from plait.solver.model import Interval, Model
from plait.solver.state import State

if TYPE_CHECKING:
    from plait.solver.granular.exchange import Exchange
    from plait.solver.scene import Surface

# Passes over the contacts of a step that begins with what they bore in the last, and of one that does not know.
PASSES, FIRST_PASSES = 4, 24


class GrainContact:
    """All contact of grains with what is not grains.

    In each substep of the simulation `begin_substep`; in each step of the matter `act` on `grid.velocity`; then
    `end_substep`. What the scene lacks is not built.

    State arrays: those of the exchanges.
    """

    def __init__(self, model: Model, state: State, matter: Matter, real: type) -> None:
        scene, folder = model.scene, "plait.solver.granular"
        self._matter = matter
        surfaces = NearSurfaces(model, matter) if model.parts["kinematics"].colliders is not None else None
        kinds = (
            ("flesh_exchange", surfaces is not None and bool(scene.bodies)),
            ("strand_exchange", bool(scene.strands)),
            ("rigid_exchange", surfaces is not None and bool(scene.rigid_bodies)),
            ("animated_exchange", surfaces is not None and any(map(_animated, scene.surfaces))),
        )
        self._surfaces = surfaces
        self._exchanges: dict[str, Exchange] = {
            name: import_module(f"{folder}.{name}").build(model, state, matter, surfaces, real)
            for name, needed in kinds
            if needed
        }
        self._moment = wp.array([Moment()], dtype=Moment, device=model.launcher.device)
        self._sorts, self._past = -1, 0.0

    @property
    def speed(self) -> float:
        """[m/s] the fastest that comes near."""
        return max((exchange.speed for exchange in self._exchanges.values()), default=0.0)

    @property
    def impulse(self) -> dict[int, np.ndarray]:
        """{index into Scene.surfaces: (3,) [kg m/s] on the grains in this frame}, of those no body carries."""
        animated = self._exchanges.get("animated_exchange")
        return animated.impulse if animated is not None else {}

    def begin_frame(self) -> None:
        """Forgets all that is not state, so that a run goes on from a frame's state as from its own."""
        self._past = 0.0
        for exchange in self._exchanges.values():
            exchange.begin_frame()

    def begin_substep(self, substep: Interval, margin: float) -> None:
        """Takes up what is within `margin` [m] of the matter."""
        self._substep = substep
        if self._surfaces is None or self._surfaces.begin_substep(substep, margin):
            self._sorts = -1
        for exchange in self._exchanges.values():
            exchange.begin_substep(substep)

    def act(self, time: float, length: float) -> None:
        """On `grid.velocity`, in a step from `time` [s] on of `length` [s]."""
        if not self._exchanges:
            return
        since = time - self._substep.start
        if self._sorts != self._matter.sorts:
            self._sorts = self._matter.sorts
            if self._surfaces is not None:
                self._surfaces.find(since)
            for exchange in self._exchanges.values():
                exchange.find(since)
        moment = Moment()
        moment.since, moment.length = since, length
        moment.part = (since + length) / self._substep.length
        moment.ratio = length / self._past if self._past > 0.0 else 0.0
        self._moment.assign([moment])
        for exchange in self._exchanges.values():
            exchange.act(self._moment, PASSES if self._past > 0.0 else FIRST_PASSES)
        self._past = length

    def lead_out(self) -> None:
        """After the particles have moved."""
        if self._surfaces is not None:
            self._surfaces.lead_out()

    def end_substep(self) -> None:
        for exchange in self._exchanges.values():
            exchange.end_substep()


def _animated(surface: Surface) -> bool:
    return surface.collides and surface.body is None and surface.rigid is None
