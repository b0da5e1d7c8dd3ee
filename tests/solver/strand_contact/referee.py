"""Judges of strands in contact, independent of the solver: missed collisions, links, sections, strains.

Missed collisions are those of edges on the straight way from the start to the end of every substep that was
committed, found by the Tight Inclusion test (Wang et al. 2021, A Large-scale Benchmark and an Inclusion-based
Algorithm for Continuous Collision Detection), after a broad phase of this file's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import ipctk
import numpy as np
import warp as wp
from scipy.spatial import ConvexHull

from plait.solver.model import Interval
from plait.solver.step import Simulation

from . import referee_kernels as kernels

# Rounding of the float32 boxes of the broad phase, over the size of the coordinates.
BOX_ROUNDING = 1.0e-6
# Beyond it the Tight Inclusion test calls a pair collided: edges that come together parallel would take for ever.
MOST_ITERATIONS = 1_000_000


def watch(simulation: Simulation, see: Callable[[Interval, np.ndarray, np.ndarray], None]) -> None:
    """Calls `see(substep, start, end)` for every substep committed, halves and all.

    start, end: (node_count, 3) float64 [m], the strands' nodes.
    """
    positions = simulation.state.arrays["strands/position"]
    committed = simulation._advance
    held, calls = positions.numpy().copy(), 0

    def advance(substep: Interval, halvings: int) -> int:
        nonlocal held, calls
        calls += 1
        here = calls
        taken = committed(substep, halvings)
        if calls == here:  # it was not taken in halves, which have been seen already
            end = positions.numpy().copy()
            see(substep, held, end)
            held = end
        return taken

    simulation._advance = advance


@dataclass
class Referee:
    """Watches a simulation and counts what its strands do.

    missed: (pair, substep) with a collision; by_frame: those of each frame so far, of `frame` [s] each.
    largest_strain: of any edge at the end of any substep.  substeps: committed.
    ignored: pairs of strands (i, j), i < j, that are not judged, as they started within each other.
    """

    simulation: Simulation
    frame: float = 1.0 / 24.0
    missed: int = 0
    substeps: int = 0
    largest_strain: float = 0.0
    by_frame: dict[int, int] = field(default_factory=dict)
    pairs: set[tuple[int, int]] = field(default_factory=set)
    ignored: frozenset[tuple[int, int]] = frozenset()

    def __post_init__(self) -> None:
        stage = self.simulation.model.parts["strands"]
        self._edges = edges_of(stage.layout.first_node)
        self._rest = stage.rods.rest_length.numpy()[self._edges].astype(np.float64)
        self._judge = MissedCollisions(self._edges, stage.layout.node_strand, self.ignored)
        watch(self.simulation, self._see)

    def _see(self, substep: Interval, start: np.ndarray, end: np.ndarray) -> None:
        found = self._judge(start, end)
        number = int(substep.start / self.frame + 1e-6)
        self.by_frame[number] = self.by_frame.get(number, 0) + len(found)
        self.missed += len(found)
        self.substeps += 1
        self.pairs.update(map(tuple, found.tolist()))
        self.largest_strain = max(self.largest_strain, float(np.abs(self._strains(end)).max()))

    def strains(self) -> np.ndarray:
        """(edge_count,) of the strands' edges now, signed."""
        return self._strains(self.simulation.state.arrays["strands/position"].numpy())

    def _strains(self, positions: np.ndarray) -> np.ndarray:
        edges = self._edges
        return np.linalg.norm(positions[edges + 1] - positions[edges], axis=1) / self._rest - 1.0


def edges_of(first_node: np.ndarray) -> np.ndarray:
    """(edge_count,) int32: the edges k of all strands, those of the ghosts apart."""
    taken = np.ones(int(first_node[-1]), dtype=bool)
    taken[first_node[:-1]] = taken[first_node[1:] - 1] = False
    return np.flatnonzero(taken).astype(np.int32)


class MissedCollisions:
    """The pairs of edges that pass through each other on the straight way between two states."""

    def __init__(
        self,
        edges: np.ndarray,
        node_strand: np.ndarray | None = None,
        ignored: frozenset[tuple[int, int]] = frozenset(),
    ) -> None:
        """edges: (edge_count,) int32, edge k from node k to k + 1; edges that share a node are no pair.

        ignored: pairs of strands (i, j), i < j, by the strand of each node, (node_count,), that are none either.
        """
        self._node_strand, self._ignored = node_strand, np.array(sorted(ignored)).reshape(-1, 2)
        self._edges = wp.array(edges, dtype=wp.int32, device="cpu")
        self._counts = wp.zeros(len(edges), dtype=wp.int32, device="cpu")
        self._test = ipctk.TightInclusionCCD(max_iterations=MOST_ITERATIONS)

    def __call__(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(n, 2) int, the pairs of edges that collide between two states (node_count, 3) [m]."""
        pairs = self.candidates(start, end)
        if len(self._ignored):
            strands = np.sort(self._node_strand[pairs], axis=1)
            pairs = pairs[~(strands[:, None] == self._ignored).all(axis=2).any(axis=1)]
        corners = pairs[:, [0, 0, 1, 1]] + [0, 1, 0, 1]
        places = np.stack([start[corners], end[corners]], axis=1)  # (n, 2 times, 4 corners, 3)
        # About the pair's middle, which may move linearly, and with segments about one long.
        places -= places.mean(axis=2, keepdims=True)
        size = np.linalg.norm(places[:, 0, 1] - places[:, 0, 0], axis=1)
        places /= size[:, None, None, None]
        hits = [self._test.edge_edge_ccd(*place[0], *place[1])[0] for place in places]
        return pairs[np.array(hits, dtype=bool)]

    def candidates(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(n, 2) int: pairs whose swept boxes meet, that may become coplanar, with no plane found between them."""
        count = len(self._edges)
        before, after = (wp.array(x, dtype=wp.vec3d, device="cpu") for x in (start, end))
        lower, upper = (wp.empty(count, dtype=wp.vec3, device="cpu") for _ in range(2))
        rounding = BOX_ROUNDING * float(max(np.abs(start).max(), np.abs(end).max()))
        wp.launch(kernels.box, count, [self._edges, before, after, rounding], [lower, upper], device="cpu")
        tree = wp.Bvh(lower, upper)
        inputs = [tree.id, lower, upper, self._edges, before, after]
        none = wp.empty(0, dtype=wp.vec2i, device="cpu")
        wp.launch(kernels.find, count, [*inputs, False, none], [self._counts], device="cpu")
        ends = np.cumsum(self._counts.numpy())
        found = wp.empty(int(ends[-1]), dtype=wp.vec2i, device="cpu")
        self._counts.assign(np.concatenate([[0], ends[:-1]]).astype(np.int32))
        wp.launch(kernels.find, count, [*inputs, True, found], [self._counts], device="cpu")
        return found.numpy().reshape(-1, 2)


# -- how strands are linked ------------------------------------------------------------------------------------


def linking_number(a: np.ndarray, b: np.ndarray) -> float:
    """Gauss integral of two closed polygons, (n, 3) and (m, 3) corners each, that do not meet: an integer.

    Exactly, by the solid angle of each pair of sides (Klenin and Langowski 2000, method 1a).
    """
    a0, b0 = a[:, None], b[None]
    a1, b1 = np.roll(a, -1, axis=0)[:, None], np.roll(b, -1, axis=0)[None]
    r13, r14, r23, r24 = b0 - a0, b1 - a0, b0 - a1, b1 - a1
    sides = [np.cross(r13, r14), np.cross(r14, r24), np.cross(r24, r23), np.cross(r23, r13)]
    for side in sides:
        side /= np.maximum(np.linalg.norm(side, axis=-1, keepdims=True), np.finfo(float).tiny)
    angle = sum(
        np.arcsin(np.clip((one * other).sum(axis=-1), -1.0, 1.0))
        for one, other in zip(sides, [*sides[1:], sides[0]], strict=True)
    )
    sign = np.sign((np.cross(b1 - b0, a1 - a0) * r13).sum(axis=-1))
    return float((angle * sign).sum() / (4.0 * np.pi))


def closed_up(strands: np.ndarray, away: np.ndarray, far: float) -> list[np.ndarray]:
    """(point_count + 3, 3) each: strands that run down y from root to tip, (strand_count, point_count, 3), closed.

    From each tip `far` along its own `away`, (strand_count, 3), down and outwards, and up and back over its root,
    at a height of its own: the closing sides of two strands never meet as long as tips stay apart across `away`.
    """
    closed = []
    for i, (strand, direction) in enumerate(zip(strands, away, strict=True)):
        end, top = strand[-1] + far * direction, far * (1.0 + 0.5 * i) * np.array([0.0, 1.0, 0.0])
        aside = end * (1.0, 0.0, 1.0) + top
        closed.append(np.vstack([strand, end, aside, strand[0] + top]))
    return closed


def linking_matrix(strands: np.ndarray, away: np.ndarray, far: float = 10.0) -> np.ndarray:
    """(strand_count, strand_count) int linking numbers of strands `closed_up`: passing through changes them."""
    closed = closed_up(strands, away, far)
    count = len(closed)
    found = np.zeros((count, count), dtype=int)
    for i in range(count):
        for j in range(i):
            found[i, j] = found[j, i] = round(linking_number(closed[i], closed[j]))
    return found


def braid_invariant(strands: np.ndarray) -> tuple[int, tuple[int, ...]]:
    """What tells two braids of three strands apart: (3, n, 3) points [m], each running down y from root to tip.

    Their crossings seen along z, from the top down, give a product of the generators in SL(2, Z) (Burau's
    representation at t = -1) and their sum of signs; together they are equal for equal braids only, as the
    representation's kernel is generated by four half twists. Raises ValueError where a strand turns back up.
    """
    levels = np.unique(strands[:, :, 1])[::-1]
    tracks = []
    for strand in strands:
        if (np.diff(strand[:, 1]) >= 0.0).any():
            raise ValueError("a strand turns back up: its crossings have no order")
        y = strand[::-1, 1]
        tracks.append([np.interp(levels, y, strand[::-1, axis]) for axis in (0, 2)])
    x, z = np.array(tracks).transpose(1, 0, 2)
    crossings = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        gap = x[i] - x[j]
        for k in np.flatnonzero(gap[:-1] * gap[1:] < 0.0):
            part = gap[k] / (gap[k] - gap[k + 1])
            depth = (1.0 - part) * (z[i] - z[j])[k] + part * (z[i] - z[j])[k + 1]
            crossings.append((levels[k] + part * (levels[k + 1] - levels[k]), i, j, depth))
    order = list(np.argsort(x[:, 0]))
    generators = (np.array([[1, 1], [0, 1]]), np.array([[1, 0], [-1, 1]]))
    inverses = (np.array([[1, -1], [0, 1]]), np.array([[1, 0], [1, 1]]))
    product, total = np.eye(2, dtype=int), 0
    for _, i, j, depth in sorted(crossings, reverse=True):
        place = min(order.index(i), order.index(j))
        sign = 1 if (depth > 0.0) == (order[place] == i) else -1
        product = product @ (generators if sign > 0 else inverses)[place]
        total += sign
        order[place], order[place + 1] = order[place + 1], order[place]
    return total, tuple(int(value) for value in product.ravel())


# -- shapes ----------------------------------------------------------------------------------------------------


def section(strands: np.ndarray, place: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n, 2) [m]: where strands, (strand_count, point_count, 3), first pass through a plane; in its own axes."""
    normal = normal / np.linalg.norm(normal)
    across = np.linalg.qr(np.column_stack([normal, np.eye(3)]))[0][:, 1:3]
    found = []
    for strand in strands:
        height = (strand - place) @ normal
        passed = np.flatnonzero(height[:-1] * height[1:] <= 0.0)
        if len(passed):
            k = passed[0]
            part = height[k] / (height[k] - height[k + 1])
            found.append(((1.0 - part) * strand[k] + part * strand[k + 1] - place) @ across)
    return np.array(found)


def section_area(places: np.ndarray, radius: float) -> float:
    """[m2] of the convex hull of discs of `radius` about (n, 2) places; their own is n pi radius^2."""
    hull = ConvexHull(places)
    # A convex shape grown by r gains its perimeter (scipy's area in the plane) times r, and a disc.
    return float(hull.volume + hull.area * radius + np.pi * radius**2)


def inside_convex(points: np.ndarray, corners: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) bool: which points, (n, 3), are inside a convex surface that faces out."""
    tips = corners[triangles]
    normals = np.cross(tips[:, 1] - tips[:, 0], tips[:, 2] - tips[:, 0])
    centre = corners.mean(axis=0)
    reach = np.linalg.norm(corners - centre, axis=1).max()
    near = np.flatnonzero(np.linalg.norm(points - centre, axis=1) < reach)
    heights = points[near] @ normals.T - (tips[:, 0] * normals).sum(axis=1)
    found = np.zeros(len(points), dtype=bool)
    found[near] = (heights < 0.0).all(axis=1)
    return found
