"""A baseline after McAdams et al. 2009, Detail preserving continuum simulation of straight hair.

After each free step of the strands their velocities are made incompressible on a grid where hair is dense, blended
as PIC and FLIP, and what is still about to touch is pushed apart by geometric impulses in a few Jacobi passes
(Bridson et al. 2002). It stands around the strands' stage, which it calls and whose result it moves.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import linalg
from scipy.spatial import cKDTree

from plait.solver.model import Interval
from plait.solver.state import State
from plait.solver.step import Simulation
from tests.solver.strand_contact.referee import edges_of

FLIP = 0.95
PASSES = 5
# Cells are so many contact distances wide; those less full than FULL of the densest packing resist no approach.
CELL, FULL = 4.0, 0.5
PROJECTION_TOLERANCE = 1e-4


class McAdams:
    """Takes the place of the strands' contact in a simulation that was built without."""

    def __init__(self, simulation: Simulation) -> None:
        stage = simulation.model.parts["strands"]
        layout, prims = stage.layout, simulation.model.scene.strands
        thickness = np.repeat([prim.thickness for prim in prims], [prim.strand_count for prim in prims])
        self._step, self._layout, self._state = stage.step, layout, simulation.state
        self._reach = layout.radius + 0.5 * thickness[layout.node_strand]
        self._friction = layout.friction[layout.node_strand]
        held = np.zeros(layout.node_count, dtype=bool)
        held[layout.first_node[:-1]] = held[layout.first_node[:-1] + 1] = True
        self._weight = np.where(held, 0.0, 1.0 / np.where(held, 1.0, layout.mass))
        self._edges = edges_of(layout.first_node)
        self._cell = CELL * 2.0 * float(self._reach.max())
        stage.step = self.step

    def step(self, state: State, substep: Interval, last_resort: bool = False) -> bool:
        positions, velocities = (state.arrays[f"strands/{name}"] for name in ("position", "velocity"))
        start = positions.numpy().copy()
        if not self._step(state, substep, last_resort):
            return False
        free = positions.numpy().copy()
        way = (free - start) / substep.length
        moved = way + self._incompressible(start, way)
        moved = self._push_apart(start, moved, substep.length)
        change = moved - way
        positions.assign(free + substep.length * change)
        velocities.assign(velocities.numpy() + change)
        return True

    # -- incompressible on the grid -----------------------------------------------------------------------

    def _incompressible(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(node_count, 3) [m/s] the change of velocity; zero for what is held."""
        low = x.min(axis=0) - 2.0 * self._cell
        shape = np.ceil((x.max(axis=0) - low) / self._cell).astype(int) + 3
        length = self._segment_lengths(x)
        volume = np.pi * self._reach**2 * length  # of hair at each node
        faces = [_Faces((x - low) / self._cell, shape, axis) for axis in range(3)]
        before = [face.average(v[:, axis], self._layout.mass) for axis, face in enumerate(faces)]
        cells = _Faces((x - low) / self._cell, shape, None)
        fill = cells.gather(volume).reshape(shape) / self._cell**3
        after = _project(before, fill > FULL * np.pi / np.sqrt(12.0), shape)
        change = np.empty_like(v)
        for axis, face in enumerate(faces):
            there = face.spread(after[axis])
            pic, flip = there - v[:, axis], there - face.spread(before[axis])
            # Where the projection does nothing the velocity stays: no filter for hair that is loose.
            touched = face.spread((after[axis] != before[axis]).astype(float))
            change[:, axis] = FLIP * flip + (1.0 - FLIP) * touched * pic
        return np.where(self._weight[:, None] > 0.0, change, 0.0)

    def _segment_lengths(self, x: np.ndarray) -> np.ndarray:
        edges = self._edges
        size = np.linalg.norm(x[edges + 1] - x[edges], axis=1)
        half = np.zeros(len(x))
        np.add.at(half, edges, 0.5 * size)
        np.add.at(half, edges + 1, 0.5 * size)
        return half

    # -- geometric impulses -------------------------------------------------------------------------------

    def _push_apart(self, x: np.ndarray, v: np.ndarray, step: float) -> np.ndarray:
        """Velocities after Jacobi passes of impulses between edges that end closer than they may."""
        corners = self._near(x, v, step)
        for _ in range(PASSES):
            impulses, touched = self._impulses(corners, x, v, step)
            nodes = corners[touched].ravel()
            number = np.bincount(nodes, minlength=len(v))
            total = np.stack([np.bincount(nodes, impulses[..., c].ravel(), len(v)) for c in range(3)], axis=1)
            v = v + total / np.maximum(number, 1.0)[:, None]
        return v

    def _near(self, x: np.ndarray, v: np.ndarray, step: float) -> np.ndarray:
        """(pair_count, 4) corners of the pairs of edges that may come within their distance in the step."""
        edges, end = self._edges, x + step * v
        middle = 0.25 * (x[edges] + x[edges + 1] + end[edges] + end[edges + 1])
        half = 0.5 * np.linalg.norm(x[edges + 1] - x[edges], axis=1).max()
        swept = 0.5 * step * np.linalg.norm(v - v.mean(axis=0), axis=1).max()
        reach = 2.0 * (half + float(self._reach.max())) + 2.0 * min(swept, half)
        pairs = edges[cKDTree(middle).query_pairs(reach, output_type="ndarray")]
        pairs = pairs[np.abs(pairs[:, 0] - pairs[:, 1]) > 1]
        corners = pairs[:, [0, 0, 1, 1]] + [0, 1, 0, 1]
        distance = np.linalg.norm(_closest(*(x[corners[:, i]] for i in range(4)))[2], axis=1)
        relative = [np.linalg.norm(v[corners[:, i]] - v[corners[:, j]], axis=1) for i in (0, 1) for j in (2, 3)]
        kept = self._reach[corners[:, 0]] + self._reach[corners[:, 2]]
        return corners[distance - step * np.max(relative, axis=0) < kept]

    def _impulses(
        self, corners: np.ndarray, x: np.ndarray, v: np.ndarray, step: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n, 4, 3) [m/s] changes of velocity of pairs' corners; which pairs, (pair_count,) bool, they are of.

        The distance is that at the start, along whose direction the approach is stopped, and a tenth of what is
        missing of the contact distance given back a step (Bridson et al. 2002, section 7.2).
        """
        s, t, between = _closest(*(x[corners[:, i]] for i in range(4)))
        distance = np.linalg.norm(between, axis=1)
        n = between / np.maximum(distance, np.finfo(float).tiny)[:, None]
        shares = np.stack([s - 1.0, -s, 1.0 - t, t], axis=1)
        relative = np.einsum("pi,pic->pc", shares, v[corners])
        approach = np.einsum("pc,pc->p", relative, n)
        kept = self._reach[corners[:, 0]] + self._reach[corners[:, 2]]
        missing = kept - distance
        weight = np.einsum("pi,pi->p", shares**2, self._weight[corners])
        touched = (distance + step * approach < kept) & (distance > 0.0) & (weight > 0.0)
        spring = np.where(missing > 0.0, np.maximum(0.1 * missing / step - approach, 0.0), 0.0)
        stop = np.maximum(-approach - np.maximum(-missing, 0.0) / step, 0.0)
        push = np.where(missing > 0.0, np.maximum(spring, stop), stop)[touched]
        across = (relative - approach[:, None] * n)[touched]
        slide = np.linalg.norm(across, axis=1)
        rub = np.minimum(self._friction[corners[touched, 0]] * push, slide) / np.maximum(
            slide, np.finfo(float).tiny
        )
        wanted = push[:, None] * n[touched] - rub[:, None] * across
        size = (shares * self._weight[corners])[touched] / weight[touched, None]
        return size[..., None] * wanted[:, None], touched


def _closest(
    a: np.ndarray, b: np.ndarray, p: np.ndarray, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) parameters of the closest points of segments a b and p q, and (n, 3) the way between them."""
    u, w, between = b - a, q - p, p - a
    uu, uw, ww = ((one * other).sum(axis=1) for one, other in ((u, u), (u, w), (w, w)))
    du, dw = (u * between).sum(axis=1), (w * between).sum(axis=1)
    determinant = uu * ww - uw * uw
    skew = determinant > 1e-12 * uu * ww
    s = np.where(skew, np.clip((du * ww - dw * uw) / np.where(skew, determinant, 1.0), 0.0, 1.0), 0.5)
    t = np.clip((s * uw - dw) / ww, 0.0, 1.0)
    s = np.clip((t * uw + du) / uu, 0.0, 1.0)
    return s, t, between + t[:, None] * w - s[:, None] * u


class _Faces:
    """Trilinear weights between nodes and the faces across an axis of a grid, or its cells (None)."""

    def __init__(self, places: np.ndarray, shape: np.ndarray, axis: int | None) -> None:
        offset = np.full(3, 0.5)
        if axis is not None:
            offset[axis] = 0.0
        base = np.floor(places - offset).astype(int)
        part = places - offset - base
        self._count = int(np.prod(shape))
        self._index, self._weights = [], []
        for corner in np.ndindex(2, 2, 2):
            at = np.clip(base + corner, 0, shape - 1)
            self._index.append(np.ravel_multi_index(tuple(at.T), tuple(shape)))
            self._weights.append(np.prod(np.where(corner, part, 1.0 - part), axis=1))

    def gather(self, values: np.ndarray) -> np.ndarray:
        total = np.zeros(self._count)
        for index, weight in zip(self._index, self._weights, strict=True):
            total += np.bincount(index, weight * values, self._count)
        return total

    def average(self, values: np.ndarray, mass: np.ndarray) -> np.ndarray:
        there = self.gather(mass)
        return np.divide(self.gather(mass * values), there, out=np.zeros(self._count), where=there > 0.0)

    def spread(self, values: np.ndarray) -> np.ndarray:
        return sum(weight * values[index] for index, weight in zip(self._index, self._weights, strict=True))


def _project(velocity: list[np.ndarray], full: np.ndarray, shape: np.ndarray) -> list[np.ndarray]:
    """Face velocities (cells' lower faces, flat) made free of convergence in the `full` cells; p = 0 elsewhere."""
    index = np.full(full.shape, -1)
    index[full] = np.arange(int(full.sum()))
    count = int(full.sum())
    if count == 0:
        return velocity
    faces = [one.reshape(shape).copy() for one in velocity]
    divergence = sum(np.roll(face, -1, axis=axis) - face for axis, face in enumerate(faces))[full]
    rows, columns = [], []
    for axis in range(3):
        neighbour = np.roll(index, -1, axis=axis)
        both = (index >= 0) & (neighbour >= 0)
        rows += [index[both], neighbour[both]]
        columns += [neighbour[both], index[both]]
    rows, columns = np.concatenate(rows), np.concatenate(columns)
    matrix = sparse.coo_matrix((-np.ones(len(rows)), (rows, columns)), (count, count)).tocsr()
    matrix += 6.0 * sparse.identity(count)
    # Hair may spread but not be compressed: only convergence is taken away.
    pressure, _ = linalg.cg(matrix, -np.minimum(divergence, 0.0), rtol=PROJECTION_TOLERANCE)
    field = np.zeros(full.shape)
    field[full] = pressure
    return [(face - (field - np.roll(field, 1, axis=axis))).ravel() for axis, face in enumerate(faces)]
