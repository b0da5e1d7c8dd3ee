"""Nested regular grids laid over scattered points, and the trilinear weights between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Node (i, j, k) of a cell, corner by corner.
CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
# The neighbours a node shares cells with, itself among them, in the order of their numbers.
STENCIL = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
NEGLIGIBLE = 1e-9


@dataclass(frozen=True)
class Grid:
    """The nodes of one grid that some point of the finer level depends on.

    spacing: [m].  index: (count, 3) int64, nodes' places in units of it from `origin`, (3,) [m].
    number: dense array of node numbers, -1 for absent nodes, padded by one all around.
    parent, weight: (finer_count, 8) int32 and float64: a finer point's value is the sum of weight times the value
        at parent; absent parents are node 0 with weight 0.
    """

    spacing: float
    origin: np.ndarray
    index: np.ndarray
    number: np.ndarray
    parent: np.ndarray
    weight: np.ndarray

    @property
    def count(self) -> int:
        return len(self.index)

    def find(self, index: np.ndarray) -> np.ndarray:
        """(...) node numbers at (..., 3) places within the grid or one beyond, -1 for absent ones."""
        return self.number[tuple(np.moveaxis(index + 1, -1, 0))]

    def pattern(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """first_block (count + 1,), column (block_count,), slot (count, 27): the rows of the 27-point stencil.

        slot: which block of the matrix belongs to a neighbour in the order of `STENCIL`, or -1.
        """
        neighbour = self.find(self.index[:, None] + STENCIL)
        there = neighbour >= 0
        first = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
        slot = np.where(there, np.cumsum(there.ravel()).reshape(there.shape) - 1, -1)
        return first.astype(np.int32), neighbour[there].astype(np.int32), slot.astype(np.int32)

    def coarsen(self) -> Grid:
        """The grid of twice the spacing, nodes on nodes of this one."""
        return _lay(self.index / 2.0, 2.0 * self.spacing, self.origin)


def lay_grid(points: np.ndarray, spacing: float) -> Grid:
    """Over (count, 3) points [m]."""
    origin = points.min(axis=0)
    return _lay((points - origin) / spacing, spacing, origin)


def transpose(parent: np.ndarray, weight: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of parents and weights, (finer_count, 8): first (count + 1,), child and weight of each parent."""
    kept = weight.ravel() > 0.0
    flat = parent.ravel()[kept]
    order = np.argsort(flat, kind="stable")
    child = np.repeat(np.arange(len(parent)), parent.shape[1])[kept][order]
    first = np.searchsorted(flat[order], np.arange(count + 1))
    return first.astype(np.int32), child.astype(np.int32), weight.ravel()[kept][order]


def _lay(place: np.ndarray, spacing: float, origin: np.ndarray) -> Grid:
    """place: (finer_count, 3) in units of the spacing."""
    cell = np.floor(place + NEGLIGIBLE).astype(np.int64)
    inside = place - cell
    factor = np.where(CORNERS[None] == 1, inside[:, None], 1.0 - inside[:, None])
    weight = factor.prod(axis=2)
    weight[weight < NEGLIGIBLE] = 0.0
    corner = cell[:, None] + CORNERS
    size = cell.max(axis=0) + 4
    flat = np.ravel_multi_index(tuple(np.moveaxis(corner + 1, -1, 0)), size)
    used = np.unique(flat[weight > 0.0])
    number = np.full(int(np.prod(size)), -1, dtype=np.int64)
    number[used] = np.arange(len(used))
    index = np.stack(np.unravel_index(used, size), axis=1) - 1
    parent = np.where(weight > 0.0, number[flat], 0).astype(np.int32)
    return Grid(spacing, origin, index, number.reshape(size), parent, weight)
