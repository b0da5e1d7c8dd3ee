"""Grains against what the animation moves, or nothing does: it takes any impulse."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.granular.contact_kernels import contact_kernels
from plait.solver.granular.exchange_kernels import follow_kernels
from plait.solver.granular.matter import Matter
from plait.solver.granular.near_surfaces import NearSurfaces
from plait.solver.model import Interval, Model
from plait.solver.state import State

# Cost in units of `Launcher.launch`.
CONTACT_WORK = 2


def build(model: Model, state: State, matter: Matter, surfaces: NearSurfaces, real: type) -> AnimatedExchange:
    return AnimatedExchange(model, matter, surfaces, real)


class AnimatedExchange:
    """An `Exchange` with surfaces that no body carries.

    impulse: {index into Scene.surfaces: (3,) [kg m/s] on the matter since `begin_frame`}.
    """

    def __init__(self, model: Model, matter: Matter, surfaces: NearSurfaces, real: type) -> None:
        self._launcher, self._matter, self._surfaces = model.launcher, matter, surfaces
        self._kernels, self._follow = contact_kernels(real), follow_kernels(real).follow
        self._count, self.speed = 0, 0.0
        self.impulse: dict[int, np.ndarray] = {}

    def begin_frame(self) -> None:
        self.impulse = {}

    def begin_substep(self, substep: Interval) -> None:
        self.speed = self._surfaces.speed(None)

    def find(self, since: float) -> None:
        self._collect()
        found = self._surfaces.carried(None)
        self._surface = found.surface
        contacts, device = self._kernels.Contacts(), self._launcher.device
        nodes, first = np.unique(found.node, return_index=True)
        values = {"first": np.append(first, len(found.node)), "node": nodes, "friction": found.friction}
        values["impulse"] = np.zeros((len(found.node), 3))
        for name, held in self._kernels.Contacts.vars.items():
            setattr(contacts, name, wp.array(values[name], dtype=held.type.dtype, device=device))
        self._contacts, self._count = contacts, len(nodes)
        self._heights = found.heights(device)
        self._of = wp.array(found.node, dtype=wp.int32, device=device)

    def act(self, moment: wp.array, passes: int) -> None:
        """At once: what the animation moves does not give way."""
        launch, velocity = self._launcher.launch, self._matter.grid.velocity
        inputs = [self._contacts, self._heights, moment, velocity]
        launch(self._kernels.act, self._count, inputs, work_per_item=CONTACT_WORK)
        launch(self._follow, len(self._of), [self._heights, self._of, moment, velocity])

    def end_substep(self) -> None:
        """Nothing is owed."""
        self._collect()

    def _collect(self) -> None:
        """Adds up `impulse`."""
        if self._count:
            given = self._contacts.impulse.numpy()
            for surface in np.unique(self._surface):
                total = given[self._surface == surface].sum(axis=0)
                self.impulse[int(surface)] = self.impulse.get(int(surface), np.zeros(3)) + total
            self._contacts.impulse.zero_()
