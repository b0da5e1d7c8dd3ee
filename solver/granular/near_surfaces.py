"""Which nodes of the grains' grid come to lie behind which surface."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import warp as wp

from plait.solver.contact.bodies import rim_features
from plait.solver.granular.contact_kernels import APART, AT_SURFACE, MovingSurface, find_depths
from plait.solver.granular.exchange_kernels import Heights
from plait.solver.granular.matter import Matter
from plait.solver.granular.types import BLOCK, BLOCK_NODES
from plait.solver.kinematics.colliders import Collider
from plait.solver.model import Interval, Model

# Nodes are looked at that are no further [cells] from a surface, on either side: so deep matter is still led out.
REACH = 3.0
# Nodes above a surface take part that are no further [cells] from it: the nearest always is among them.
NEAREST = 0.5
# What hangs together touches that is no further [cells] from where it would lie: else it would come and go.
TOUCHING = 0.02
# What is deeper behind a surface than this part of a cell is led out, within so many substeps.
SUNK, SETTLING = 0.1, 2.0
# Cost in units of `Launcher.launch`.
QUERY_WORK = 60


@dataclass(frozen=True)
class Found:
    """Nodes that may be behind a surface in the substep, ascending; entries for one node stand together.

    node: (n,) into the nodes of `BlockGrid`.  surface: (n,) into Scene.surfaces.
    height: (n,) [m] above the surface at the substep's start, less the distance that it keeps; where `by_matter`,
        of the matter at the node now, above where it would lie at rest on the surface.
    by_matter: (n,) bool.
    normal: (n, 3) unit, out of the surface.  velocity: (n, 3) [m/s] of the surface there.  friction: (n,).
    triangle: (n,) of `Colliders`, and weights: (n, 3), where on it the nearest point is.
    """

    node: np.ndarray
    surface: np.ndarray
    height: np.ndarray
    by_matter: np.ndarray
    normal: np.ndarray
    velocity: np.ndarray
    friction: np.ndarray
    triangle: np.ndarray
    weights: np.ndarray

    def heights(self, device: wp.Device) -> Heights:
        heights = Heights()
        for name, held in Heights.vars.items():
            setattr(heights, name, wp.array(getattr(self, name), dtype=held.type.dtype, device=device))
        return heights

    def of(self, chosen: np.ndarray) -> Found:
        """The entries (n,) bool."""
        return Found(*(getattr(self, field.name)[chosen] for field in fields(self)))


class NearSurfaces:
    """Nodes against the surfaces that collide, by their nearest points.

    A closed surface keeps matter out of it, an open one on the side that it faces. Nothing thinner than a cell
    keeps matter on both its sides apart: they share nodes.

    found: by `find`, for the particles' present order.  near: surfaces in reach in this substep.
    """

    def __init__(self, model: Model, matter: Matter) -> None:
        self.kinematics, self._launcher, self._matter = model.parts["kinematics"], model.launcher, matter
        self._friction = np.array(
            [
                model.scene.granular[0].friction if surface.friction is None else surface.friction
                for surface in model.scene.surfaces
            ]
        )
        self._exit_speed = model.settings.contact.exit_speed
        self.near: list[Collider] = []
        self._led: tuple[wp.array, float, wp.array] | None = None
        self._sorts, self._standing = -1, dict[int, tuple[np.ndarray, list[np.ndarray]]]()
        self._rim = self._find_rims()

    def begin_substep(self, substep: Interval, margin: float) -> bool:
        """Takes up the surfaces within `margin` [m] of the matter; whether nodes must be found again."""
        lower, upper = self._matter.grid.bounds()
        box = lower - margin, upper + margin
        near = [*self.kinematics.colliders_near(*box, substep), *self.kinematics.followed_near(*box)]
        unmoved = [c.index for c in near] == [c.index for c in self.near] and not any(c.moves for c in near)
        self.near, self._substep = near, substep
        return not unmoved

    def speed(self, carried_by: str | None) -> float:
        """[m/s] the largest part along an axis, of any point near in the substep; see `carried_by`."""
        return max((self._speed_of(c) for c in self.near if c.moves and _carrier(c) == carried_by), default=0.0)

    def _speed_of(self, collider: Collider) -> float:
        start, end = self._ends(collider)
        return float(np.abs(end - start).max() / self._substep.length)

    def _ends(self, collider: Collider) -> list[np.ndarray]:
        """Points at the substep's start and end."""
        points, kinematics = self.kinematics.colliders.points, self.kinematics
        return [points[k][collider.points].numpy() for k in (kinematics.start, kinematics.end)]

    def find(self, since: float) -> None:
        """Fills `found`, so long [s] after the substep's start."""
        if self._sorts != self._matter.sorts:
            self._sorts, self._standing = self._matter.sorts, {}
        self._middles: np.ndarray | None = None
        self._sunk: list[tuple[np.ndarray, np.ndarray]] = []
        every = [self._find_on(collider, since) for collider in self.near]
        columns = [np.concatenate(x) for x in zip(*every, strict=True)] if every else _nothing()
        order = np.argsort(columns[0], kind="stable")
        self.found = Found(*(column[order] for column in columns))
        self._gather_sunk()

    def carried(self, by: str | None) -> Found:
        """Of `found`, what is on surfaces that 'flesh' or a 'rigid' body carries, or none (None)."""
        kinds = {collider.index: _carrier(collider) for collider in self.near}
        of_kind = [index for index, kind in kinds.items() if kind == by]
        return self.found.of(np.isin(self.found.surface, of_kind))

    def _find_on(self, collider: Collider, since: float) -> tuple[np.ndarray, ...]:
        """The columns of `Found` of one surface.

        Of the nodes above it those up to half a cell away take part too, once the matter that they carry has come
        down to where it would lie if it filled all above the surface. Else what rests on a surface between nodes
        would sink until those behind it feel enough of its weight. With matter that hangs together those behind
        wait as long: they feel it, by its splines, from further off, and would hold it up there. Sand falls on by
        itself, and rubs the better on what always touches it.
        """
        size = self._matter.grid.cell_size
        node, held = self._nodes_near(collider)
        of_matter = self._face_matter(collider, node, held)
        height, normal, velocity, triangle, weights = held
        approach = np.einsum("na,na->n", velocity, normal)
        # Both are distances at the substep's start.
        behind = height - self._substep.length * np.maximum(approach, 0.0) <= 0.0
        now, of_matter = height - since * approach, of_matter - since * approach
        of_matter -= size * filled_height(now / size)
        by_matter = np.isfinite(of_matter) & (now < NEAREST * size) & (self._matter.cohesive | ~behind)
        height = np.where(by_matter, of_matter - TOUCHING * size * self._matter.cohesive, height)
        self._note_sunk(node, normal, of_matter)
        surface = np.full(len(node), collider.index)
        columns = (node, surface, height, by_matter, normal, velocity, self._friction[surface], triangle, weights)
        return tuple(column[behind | by_matter] for column in columns)

    def _nodes_near(self, collider: Collider) -> tuple[np.ndarray, list[np.ndarray]]:
        """Nodes behind a surface, or less than half a cell above it or what it sweeps; what `_measure` tells.

        Told again for a surface that stays where it is, until nodes are others.
        """
        if not collider.moves and collider.index in self._standing:
            node, held = self._standing[collider.index]
            return node, [column.copy() for column in held]
        node, held = self._look_for_nodes(collider)
        if not collider.moves:
            self._standing[collider.index] = node, [column.copy() for column in held]
        return node, held

    def _look_for_nodes(self, collider: Collider) -> tuple[np.ndarray, list[np.ndarray]]:
        grid = self._matter.grid
        ends = np.concatenate(self._ends(collider))
        origin = grid.data.node_origin.numpy()[: grid.node_block_count]
        margin = REACH * grid.cell_size + collider.surface.thickness
        lower, upper = origin * grid.cell_size, (origin + BLOCK - 1) * grid.cell_size
        touched = (lower <= ends.max(axis=0) + margin) & (upper >= ends.min(axis=0) - margin)
        chosen = np.flatnonzero(touched.all(axis=1))
        node = (chosen[:, None] * BLOCK_NODES + np.arange(BLOCK_NODES)).ravel()
        held = self._measure(collider, grid.node_cells(node) * grid.cell_size)
        swept = self._substep.length * np.maximum(np.einsum("na,na->n", held[2], held[1]), 0.0)
        near = held[0] - swept < NEAREST * grid.cell_size
        return node[near], [column[near] for column in held]

    def _face_matter(self, collider: Collider, node: np.ndarray, held: list[np.ndarray]) -> np.ndarray:
        """(n,) [m] how far the middle of the matter at nodes is above the surface; not a number without any.

        `held`, of the nodes, is made that of the face that the matter has before it: behind the foot of a wall the
        nearest may be a hidden one. Of a sheet that stays where it is, with no node before it, nothing is asked.
        """
        apart = np.full(len(node), np.nan)
        asked = self._matter.cohesive or collider.moves or collider.closed
        if not len(node) or not (asked or (held[0] > 0.0).any()):
            return apart
        if self._middles is None:
            self._middles = self._matter.middles()
        middle, grid = self._middles[node], self._matter.grid
        own = np.flatnonzero(np.isfinite(middle[:, 0]))
        at = self._measure(collider, grid.node_cells(node[own]) * grid.cell_size + middle[own])
        faced = at[0] < float(APART)
        own, at = own[faced], [column[faced] for column in at]
        apart[own] = at[0]
        at[0] = at[0] - np.einsum("na,na->n", at[1], middle[own])
        for column, new in zip(held, at, strict=True):
            column[own] = new
        return apart

    def _measure(self, collider: Collider, points: np.ndarray) -> list[np.ndarray]:
        """Of (n, 3) points [m] at the substep's start height, normal, velocity, triangle and weights there."""
        device, size = self._launcher.device, self._matter.grid.cell_size
        rounding, margin = float(AT_SURFACE) * size, REACH * size + collider.surface.thickness
        dtypes = (wp.float64, wp.vec3d, wp.vec3d, wp.int32, wp.vec3d)
        outputs = [wp.zeros(len(points), dtype=dtype, device=device) for dtype in dtypes]
        inputs = [self._posed(collider), wp.array(points, dtype=wp.vec3d, device=device), rounding, margin]
        self._launcher.launch(find_depths, len(points), inputs, outputs, work_per_item=QUERY_WORK)
        told = [output.numpy() for output in outputs]
        # A point on the surface, but for rounding, is behind it.
        told[0] = np.where(told[0] < float(APART), told[0] - collider.surface.thickness - rounding, told[0])
        return told

    def _note_sunk(self, node: np.ndarray, normal: np.ndarray, of_matter: np.ndarray) -> None:
        """Nodes whose matter is to be led out, and how fast."""
        depth = -of_matter - SUNK * self._matter.grid.cell_size
        sunk = np.flatnonzero(depth > 0.0)
        speed = np.minimum(depth[sunk] / (SETTLING * self._substep.length), self._exit_speed)
        self._sunk.append((node[sunk], speed[:, None] * normal[sunk]))

    def _gather_sunk(self) -> None:
        nodes, speeds = (np.concatenate(x) for x in zip(*self._sunk, strict=True)) if self._sunk else ((), ())
        self._led = None
        if not len(nodes):
            return
        grid, device = self._matter.grid, self._launcher.device
        speed = np.zeros((grid.node_block_count * BLOCK_NODES, 3))
        speed[nodes] = speeds
        chosen = np.isin(grid.data.corner.numpy(), np.unique(nodes // BLOCK_NODES)).any(axis=1)
        blocks = wp.array(np.flatnonzero(chosen).astype(np.int32), dtype=wp.int32, device=device)
        self._led = wp.array(speed, dtype=wp.vec3d, device=device), float(np.abs(speeds).max()), blocks

    def lead_out(self) -> None:
        """After the particles have moved: what lies behind a surface goes out of it a little."""
        if self._led is not None:
            self._matter.lead_out(*self._led)

    def _find_rims(self) -> wp.array:
        """(triangle_count,) bits of the features of each triangle that lie on an open border."""
        colliders = self.kinematics.colliders
        held = colliders.triangles.numpy()
        rims = [
            rim_features(held[c.first_triangle :][: c.triangle_count] - c.first_point) for c in colliders.items
        ]
        return wp.array(np.concatenate(rims), dtype=wp.int32, device=self._launcher.device)

    def _posed(self, collider: Collider) -> MovingSurface:
        kinematics, colliders = self.kinematics, self.kinematics.colliders
        surface = MovingSurface()
        surface.mesh = collider.meshes[kinematics.start].id
        surface.first_triangle, surface.triangles = collider.first_triangle, colliders.triangles
        surface.points_start = colliders.points[kinematics.start]
        surface.points_end = colliders.points[kinematics.end]
        surface.length = self._substep.length
        surface.rim = self._rim
        return surface


def filled_height(height: np.ndarray) -> np.ndarray:
    """Of the matter that a node carries, (n,) [cells] above a plane, when it fills all above it evenly.

    height: (n,) of the node, up to 1/2. With B the quadratic B-spline, h + int z B / int B over z > -h.
    """
    h = np.maximum(height, -0.5)
    weight = 0.5 + 0.75 * h - h**3 / 3.0
    about = h + (13.0 / 64.0 - 0.375 * h**2 + 0.25 * h**4) / weight
    return np.where(height > -0.5, about, 0.25 * np.maximum(1.5 + height, 0.0))


def _carrier(collider: Collider) -> str | None:
    if collider.surface.body is not None:
        return "flesh"
    return "rigid" if collider.surface.rigid is not None else None


def _nothing() -> list[np.ndarray]:
    """Columns of an empty `Found`."""
    index, number, vector = np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 3))
    return [index, index, number, index.astype(bool), vector, vector, number, index, vector]
