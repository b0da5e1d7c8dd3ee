"""Grains against elastic bodies: host side."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.granular.exchange import Expectation
from plait.solver.granular.exchange_kernels import follow_kernels
from plait.solver.granular.flesh_exchange_kernels import Contacts, Nodes, Touched, flesh_exchange_kernels
from plait.solver.granular.impulses import Memory
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

    And by that of what is behind these, as far as stresses reach in a substep of the implicit solve.

    What stresses took up of the last substep's impulses they are expected to take up again (`Expectation`): a skin
    gives way by the difference alone, so that a pile at rest on it stays at rest.
    """

    def __init__(self, model: Model, state: State, matter: Matter, surfaces: NearSurfaces, real: type) -> None:
        self._launcher, self._matter, self._surfaces = model.launcher, matter, surfaces
        self._follow = follow_kernels(real).follow
        self._kernels, self._tets = flesh_exchange_kernels(real), model.parts["tets"]
        layout, device = self._tets.layout, model.launcher.device
        inverse_mass = wp.array(np.where(layout.pinned, 0.0, 1.0 / layout.mass), dtype=wp.float64, device=device)
        self._bears = bears = Expectation(inverse_mass, model.scene.gravity, self._launcher, state, "flesh")
        self._nodes = Nodes()
        self._nodes.inverse_mass = wp.clone(inverse_mass)
        self._nodes.given, self._nodes.expected = bears.given, bears.expected
        self.speed = 0.0
        self._hold_corners(surfaces)
        self._hold_stiffness()
        self.begin_frame()

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

    def begin_frame(self) -> None:
        self._memory, self._count = Memory(), 0

    def _hold_stiffness(self) -> None:
        """Of each node K / M [1/s2] of its tets, and the most times its mass that may answer: all of its body."""
        layout, flat = self._tets.layout, np.concatenate
        ratio = flat([np.asarray(body.poissons_ratio) for body in layout.bodies])
        modulus = flat([np.asarray(body.youngs_modulus) for body in layout.bodies])
        modulus = modulus * (1.0 - ratio) / ((1.0 + ratio) * (1.0 - 2.0 * ratio))
        density = flat([np.broadcast_to(body.density, len(body.tets)) for body in layout.bodies])
        corners = layout.tets.ravel()
        rate = np.bincount(corners, np.repeat(modulus / density, 4)) / np.bincount(corners)
        self._rate, self._most = rate, np.full(layout.node_count, np.inf)
        for b in range(layout.body_count):
            nodes = layout.nodes(b)
            rate[nodes] /= layout.edge[b] ** 2
            if not layout.pinned[nodes].any():
                skin = np.unique(layout.skin_nodes(b))
                self._most[nodes] = layout.mass[nodes].sum() / layout.mass[skin].sum()

    def begin_substep(self, substep: Interval) -> None:
        self.speed = self._surfaces.speed("flesh")
        # Of a chain of masses with springs between, implicit in time, the first answers as so many of it.
        heavier = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * self._rate * substep.length**2))
        inverse_mass = self._bears.inverse_mass.numpy() / np.minimum(heavier, self._most)
        self._nodes.inverse_mass.assign(inverse_mass)
        self._bears.begin_substep(self._tets.velocity, substep.length)

    def find(self, since: float) -> None:
        if self._count:
            self._memory.keep(self._cells, self._on, self._contacts.impulse.numpy())
        found, device = self._surfaces.carried("flesh"), self._launcher.device
        self._count, self._on = len(found.node), found.surface
        self._cells = self._matter.grid.node_cells(found.node)
        corners = self._triangles[found.triangle]
        nodes = self._corners[corners].reshape(-1, 12)
        weights = (found.weights[:, :, None] * self._weights[corners]).reshape(-1, 12)
        grid_nodes, first = np.unique(found.node, return_index=True)
        touched, local = np.unique(nodes, return_inverse=True)
        values = {"first": np.append(first, self._count), "node": grid_nodes, "of": found.node}
        values |= {"friction": found.friction, "tet_node": local.reshape(-1, 12), "weight": weights}
        values |= {"impulse": self._memory.recall(self._cells, self._on), "change": np.zeros((self._count, 3))}
        contacts = Contacts()
        for name, held in Contacts.vars.items():
            setattr(contacts, name, wp.array(values[name], dtype=held.type.dtype, device=device))
        self._contacts, self._touched = contacts, self._lay_out_touched(touched, local.ravel(), weights.ravel())
        self._heights = found.heights(device)

    def _lay_out_touched(self, touched: np.ndarray, local: np.ndarray, weights: np.ndarray) -> Touched:
        order = np.argsort(local, kind="stable")
        first = np.searchsorted(local[order], np.arange(len(touched) + 1))
        held, device = Touched(), self._launcher.device
        held.node = wp.array(touched, dtype=wp.int32, device=device)
        held.first = wp.array(first, dtype=wp.int32, device=device)
        held.contact = wp.array(order // 12, dtype=wp.int32, device=device)
        held.weight = wp.array(weights[order], dtype=wp.float64, device=device)
        held.shares = wp.zeros(len(touched), dtype=wp.float64, device=device)
        return held

    def act(self, moment: wp.array, passes: int) -> None:
        contacts, touched, nodes, kernels = self._contacts, self._touched, self._nodes, self._kernels
        heights = self._heights
        velocity, prepare = self._matter.grid.velocity, self._launcher.prepare
        grid_nodes, tet_nodes = len(contacts.node), len(touched.node)
        collect = prepare(kernels.collect, tet_nodes, [contacts, touched, nodes], work_per_item=TOUCHED_WORK)
        given = [contacts, heights, touched, nodes, moment, velocity]
        exchange = prepare(kernels.exchange, grid_nodes, given, work_per_item=CONTACT_WORK)
        launch = self._launcher.launch
        launch(kernels.begin, grid_nodes, [contacts, heights, moment, velocity], work_per_item=CONTACT_WORK)
        launch(
            kernels.share, tet_nodes, [contacts, heights, touched, moment, velocity], work_per_item=TOUCHED_WORK
        )
        collect()
        for _ in range(passes):
            exchange()
            collect()
        launch(self._follow, self._count, [heights, contacts.of, moment, velocity])

    def end_substep(self) -> None:
        given = self._bears.given.numpy()
        if given.any():
            self._tets.external_impulse.assign(self._tets.external_impulse.numpy() + given)
