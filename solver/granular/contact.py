"""Granular matter against the surfaces of the scene that no body carries: host side."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.contact.bodies import rim_features
from plait.solver.granular.contact_kernels import AT_SURFACE, MovingSurface, contact_kernels, find_depths
from plait.solver.granular.matter import Matter
from plait.solver.granular.types import BLOCK, BLOCK_NODES
from plait.solver.kinematics.colliders import Collider
from plait.solver.model import Interval, Model

# Nodes are looked at that are no further [cells] from a surface, on either side: so deep matter is still led out.
REACH = 3.0
# Costs in units of `Launcher.launch`.
QUERY_WORK, CONTACT_WORK = 60, 2


class SurfaceContact:
    """Contact of the grid's nodes with moving triangle surfaces, by their nearest points.

    In each substep of the simulation `begin_substep`, and in each step of the matter `act` on `grid.velocity`.
    A closed surface keeps matter out of it, an open one on the side that it faces. Nothing thinner than a cell
    keeps matter on both its sides apart: they share nodes.

    speed: [m/s] the fastest of the surfaces near.
    impulse: {index into Scene.surfaces: (3,) [kg m/s] on the matter since `begin_frame`}.
    """

    def __init__(self, model: Model, matter: Matter, real: type) -> None:
        self._kinematics, self._launcher = model.parts["kinematics"], model.launcher
        self._matter, self._kernels = matter, contact_kernels(real)
        self._friction = {
            index: model.scene.granular[0].friction if surface.friction is None else surface.friction
            for index, surface in enumerate(model.scene.surfaces)
        }
        self._near: list[Collider] = []
        self._rim = self._find_rims()
        self._sorts, self._count, self.speed = -1, 0, 0.0
        self._surface = np.zeros(0, dtype=np.int64)
        self.impulse: dict[int, np.ndarray] = {}

    def begin_frame(self) -> None:
        self.collect()
        self.impulse = {}

    def begin_substep(self, substep: Interval, margin: float) -> None:
        """Takes up the surfaces within `margin` [m] of the matter."""
        self.collect()
        lower, upper = self._matter.grid.bounds()
        near = self._kinematics.colliders_near(lower - margin, upper + margin, substep)
        unmoved = near == self._near and not any(collider.moves for collider in near)
        self._near, self._substep = near, substep
        self.speed = max((self._speed_of(collider) for collider in near if collider.moves), default=0.0)
        if not unmoved:
            self._sorts, self._count = -1, 0

    def _speed_of(self, collider: Collider) -> float:
        """[m/s] the largest part along an axis, of any point in the substep."""
        points, kinematics = self._kinematics.colliders.points, self._kinematics
        start, end = (points[k][collider.points].numpy() for k in (kinematics.start, kinematics.end))
        return float(np.abs(end - start).max() / self._substep.length)

    def act(self, time: float) -> None:
        """On `grid.velocity`, in a step that starts at `time` [s]."""
        if not self._near:
            return
        if self._sorts != self._matter.sorts:
            self.collect()
            self._find()
            self._sorts = self._matter.sorts
        since = time - self._substep.start
        inputs = [self._contacts, since]
        grid = self._matter.grid
        self._launcher.launch(self._kernels.act, self._count, inputs, [grid.velocity], work_per_item=CONTACT_WORK)

    def collect(self) -> None:
        """Adds up `impulse`."""
        if self._count:
            impulse = self._contacts.impulse.numpy()
            for surface in np.unique(self._surface):
                total = impulse[self._surface == surface].sum(axis=0)
                self.impulse[int(surface)] = self.impulse.get(int(surface), np.zeros(3)) + total
            self._contacts.impulse.zero_()

    def _find(self) -> None:
        """The contacts that nodes may have in this substep."""
        found = [self._find_on(collider) for collider in self._near]
        node, height, normal, velocity = (np.concatenate(x) for x in zip(*found, strict=True))
        counts = [len(x[0]) for x in found]
        surface = np.repeat([c.index for c in self._near], counts)
        order = np.argsort(node, kind="stable")
        nodes, first = np.unique(node[order], return_index=True)
        self._count, self._surface = len(nodes), surface[order]
        contacts, device = self._kernels.Contacts(), self._launcher.device
        friction = np.array([self._friction[s] for s in self._surface])
        values = {"first": np.append(first, len(node)), "node": nodes, "friction": friction}
        values |= {"height": height[order], "normal": normal[order], "velocity": velocity[order]}
        values["impulse"] = np.zeros((len(node), 3))
        for name, held in self._kernels.Contacts.vars.items():
            setattr(contacts, name, wp.array(values[name], dtype=held.type.dtype, device=device))
        self._contacts = contacts

    def _find_on(self, collider: Collider) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Nodes that may come behind one surface, their heights, its normals and velocities there."""
        grid, device, kinematics = self._matter.grid, self._launcher.device, self._kinematics
        reach, substep = REACH * grid.cell_size, self._substep
        box = kinematics.box(collider, [substep.start, substep.end])
        origin = grid.data.node_origin.numpy()
        margin = reach + collider.surface.thickness
        lower, upper = origin * grid.cell_size, (origin + BLOCK - 1) * grid.cell_size
        chosen = np.flatnonzero(((lower <= box[1] + margin) & (upper >= box[0] - margin)).all(axis=1))
        count = len(chosen) * BLOCK_NODES
        height = wp.zeros(count, dtype=wp.float64, device=device)
        normal, velocity = (wp.zeros(count, dtype=wp.vec3d, device=device) for _ in range(2))
        inputs = [self._posed(collider), wp.array(chosen.astype(np.int32), dtype=wp.int32, device=device)]
        inputs += [grid.data.node_origin, grid.cell_size, margin]
        launch = self._launcher.launch
        launch(find_depths, count, inputs, [height, normal, velocity], work_per_item=QUERY_WORK)
        node = (chosen[:, None] * BLOCK_NODES + np.arange(BLOCK_NODES)).ravel()
        # A node on the surface, but for rounding, is behind it.
        above = height.numpy() - collider.surface.thickness - float(AT_SURFACE) * grid.cell_size
        least = above - substep.length * np.maximum(np.einsum("na,na->n", velocity.numpy(), normal.numpy()), 0.0)
        kept = least <= 0.0
        return node[kept], above[kept], normal.numpy()[kept], velocity.numpy()[kept]

    def _find_rims(self) -> wp.array:
        """(triangle_count,) bits of the features of each triangle that lie on an open border."""
        colliders = self._kinematics.colliders
        held = colliders.triangles.numpy()
        rims = [
            rim_features(held[c.first_triangle :][: c.triangle_count] - c.first_point) for c in colliders.items
        ]
        return wp.array(np.concatenate(rims), dtype=wp.int32, device=self._launcher.device)

    def _posed(self, collider: Collider) -> MovingSurface:
        kinematics, colliders = self._kinematics, self._kinematics.colliders
        surface = MovingSurface()
        surface.mesh = collider.meshes[kinematics.start].id
        surface.first_triangle, surface.triangles = collider.first_triangle, colliders.triangles
        surface.points_start = colliders.points[kinematics.start]
        surface.points_end = colliders.points[kinematics.end]
        surface.length = self._substep.length
        surface.rim = self._rim
        return surface
