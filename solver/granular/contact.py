"""Granular matter against all that is in its way: host side."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Protocol

import numpy as np

from plait.solver.granular.matter import Matter
from plait.solver.granular.near_surfaces import NearSurfaces
from plait.solver.model import Interval, Model
from plait.solver.state import State

if TYPE_CHECKING:
    from plait.solver.scene import Surface


class Exchange(Protocol):
    """Momentum that passes between grains and one kind of what they meet, node by node (Han 2019 (46)-(50)).

    Read with the friction impulse as one vector of opposite signs, which the printed (49) and (50) are not where
    it sticks. What is met has moved already in this substep of the simulation; the grains then take many steps in
    it. Within these it gives way as its mass lets it, and takes up what the grains gave it in its next substep.
    """

    speed: float  # [m/s] no part of what is met goes faster along an axis

    def begin_substep(self, substep: Interval) -> None:
        """Nothing has been given yet."""

    def find(self, time: float) -> None:
        """Takes up the nodes in contact, whenever particles have been sorted or the surfaces are others."""

    def act(self, since: float, part: float) -> None:
        """On `grid.velocity`, so long [s] after the substep's start, which is that part of it."""

    def end_substep(self) -> None:
        """Hands over what has been given."""


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
        self._sorts = -1

    @property
    def speed(self) -> float:
        """[m/s] the fastest that comes near."""
        return max((exchange.speed for exchange in self._exchanges.values()), default=0.0)

    @property
    def impulse(self) -> dict[int, np.ndarray]:
        """{index into Scene.surfaces: (3,) [kg m/s] on the grains since `begin_frame`}, of those no body carries."""
        animated = self._exchanges.get("animated_exchange")
        return animated.impulse if animated is not None else {}

    def begin_frame(self) -> None:
        animated = self._exchanges.get("animated_exchange")
        if animated is not None:
            animated.begin_frame()

    def begin_substep(self, substep: Interval, margin: float) -> None:
        """Takes up what is within `margin` [m] of the matter."""
        self._substep = substep
        if self._surfaces is None or self._surfaces.begin_substep(substep, margin):
            self._sorts = -1
        for exchange in self._exchanges.values():
            exchange.begin_substep(substep)

    def act(self, time: float) -> None:
        """On `grid.velocity`, in a step that starts at `time` [s]."""
        since = time - self._substep.start
        if self._sorts != self._matter.sorts:
            self._sorts = self._matter.sorts
            if self._surfaces is not None:
                self._surfaces.find()
            for exchange in self._exchanges.values():
                exchange.find(since)
        for exchange in self._exchanges.values():
            exchange.act(since, since / self._substep.length)

    def end_substep(self) -> None:
        for exchange in self._exchanges.values():
            exchange.end_substep()


def _animated(surface: Surface) -> bool:
    return surface.collides and surface.body is None and surface.rigid is None
