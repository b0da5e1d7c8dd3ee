"""Grains against elastic bodies: host side."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.granular.flesh_exchange_kernels import Contacts, Nodes, Touched, flesh_exchange_kernels
from plait.solver.granular.matter import Matter
from plait.solver.granular.near_surfaces import NearSurfaces
from plait.solver.model import Interval, Model
from plait.solver.state import State

# Costs in units of `Launcher.launch`.
CONTACT_WORK, TOUCHED_WORK = 10, 4


def build(model: Model, state: State, matter: Matter, surfaces: NearSurfaces, real: type) -> FleshExchange:
    return FleshExchange(model, state, matter, surfaces, real)


class FleshExchange:
    """An `Exchange` with elastic bodies, whose skins give way by the mass of the nodes about the contact.

    A skin's motion has in it what the grains gave it in the substep before, and the stresses that took it up: it
    gives way by the difference alone, so that a pile at rest on it stays at rest.

    State array: granular/given_flesh: (node_count,) vec3d, impulses of the last substep.
    """

    def __init__(self, model: Model, state: State, matter: Matter, surfaces: NearSurfaces, real: type) -> None:
        self._launcher, self._matter, self._surfaces = model.launcher, matter, surfaces
        self._kernels, self._tets = flesh_exchange_kernels(real), model.parts["tets"]
        layout, device = self._tets.layout, model.launcher.device
        nodes = Nodes()
        inverse_mass = np.where(layout.pinned, 0.0, 1.0 / layout.mass)
        nodes.inverse_mass = wp.array(inverse_mass, dtype=wp.float64, device=device)
        nodes.given, nodes.expected = (wp.zeros(layout.node_count, dtype=wp.vec3d, device=device) for _ in range(2))
        state.arrays["granular/given_flesh"] = nodes.given
        self._nodes, self._count, self.speed = nodes, 0, 0.0
        self._hold_corners(surfaces)

    def _hold_corners(self, surfaces: NearSurfaces) -> None:
        """Of each point of the colliders, if a body carries it, the four nodes of its tet and their weights."""
        colliders, layout = surfaces.kinematics.colliders, self._tets.layout
        count = len(colliders.points[0])
        self._corners, self._weights = np.zeros((count, 4), dtype=np.int64), np.zeros((count, 4))
        self._triangles = colliders.triangles.numpy()
        for collider in colliders.items:
            body = collider.surface.body
            if body is not None:
                self._corners[collider.points] = layout.skin_nodes(body)
                self._weights[collider.points] = layout.bodies[body].embedding.barycentric

    def begin_substep(self, substep: Interval) -> None:
        self.speed = self._surfaces.speed("flesh")
        wp.copy(self._nodes.expected, self._nodes.given)
        self._nodes.given.zero_()

    def find(self, since: float) -> None:
        found, device = self._surfaces.carried("flesh"), self._launcher.device
        count = len(found.node)
        corners = self._triangles[found.triangle]
        nodes = self._corners[corners].reshape(count, 12)
        weights = (found.weights[:, :, None] * self._weights[corners]).reshape(count, 12)
        grid_nodes, first = np.unique(found.node, return_index=True)
        touched, local = np.unique(nodes, return_inverse=True)
        values = {"first": np.append(first, count), "node": grid_nodes, "of": found.node, "height": found.height}
        values |= {"normal": found.normal, "velocity": found.velocity, "friction": found.friction}
        values |= {"tet_node": local.reshape(count, 12), "weight": weights}
        contacts = Contacts()
        for name, held in Contacts.vars.items():
            setattr(contacts, name, wp.array(values[name], dtype=held.type.dtype, device=device))
        self._contacts, self._count, self._node_count = contacts, count, len(grid_nodes)
        self._touched = self._lay_out_touched(touched, local.ravel(), weights.ravel())
        self._touched_count = len(touched)
        self._drawn = wp.zeros(len(touched), dtype=wp.float64, device=device)
        self._impulse = wp.zeros(count, dtype=wp.vec3d, device=device)

    def _lay_out_touched(self, touched: np.ndarray, local: np.ndarray, weights: np.ndarray) -> Touched:
        order = np.argsort(local, kind="stable")
        first = np.searchsorted(local[order], np.arange(len(touched) + 1))
        held, device = Touched(), self._launcher.device
        held.node = wp.array(touched, dtype=wp.int32, device=device)
        held.first = wp.array(first, dtype=wp.int32, device=device)
        held.contact = wp.array(order // 12, dtype=wp.int32, device=device)
        held.weight = wp.array(weights[order], dtype=wp.float64, device=device)
        return held

    def act(self, since: float, part: float) -> None:
        launch, velocity, touched = self._launcher.launch, self._matter.grid.velocity, self._touched
        contacts, nodes = self._contacts, self._nodes
        shares = [contacts, touched, since, velocity]
        launch(
            self._kernels.count_shares, self._touched_count, shares, [self._drawn], work_per_item=TOUCHED_WORK
        )
        given = [contacts, touched, nodes, self._drawn, since, part]
        outputs = [velocity, self._impulse]
        launch(self._kernels.exchange, self._node_count, given, outputs, work_per_item=CONTACT_WORK)
        inputs = [touched, self._impulse]
        launch(self._kernels.collect, self._touched_count, inputs, [nodes], work_per_item=TOUCHED_WORK)

    def end_substep(self) -> None:
        given = self._nodes.given.numpy()
        if given.any():
            self._tets.external_impulse.assign(self._tets.external_impulse.numpy() + given)
