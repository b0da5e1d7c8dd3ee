"""The lattice laid over a skin, and the equal parts its tets come in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from plait.pipeline.tetrahedra.bcc import Grid


@dataclass(frozen=True)
class Cover:
    """Places are (points - origin) / cell in `grid`."""

    grid: Grid
    origin: np.ndarray
    cell: float

    def places(self, points: np.ndarray) -> np.ndarray:
        return (points - self.origin) / self.cell

    def points(self, places: np.ndarray) -> np.ndarray:
        return self.origin + self.cell * places


# In cells: no plane of symmetry, floor or wall of what people model lies in a plane of the lattice, where skin
# would pass between tets rather than through them.
ASIDE = np.array([0.0913, 0.1571, 0.2237])


def lay(points: np.ndarray, cell: float) -> Cover:
    """A lattice about the points' bounding box, with more than a cell to spare all round."""
    low, high = points.min(axis=0), points.max(axis=0)
    cells = np.ceil((high - low) / cell).astype(np.int64) + 3
    return Cover(Grid(cells), 0.5 * (low + high) - cell * (0.5 * cells + ASIDE), cell)


@cache
def part_middles(factor: int) -> np.ndarray:
    """(factor³, 4) barycentric middles of the parts a tet has in a lattice `factor` times finer."""
    return _parts(factor)[0]


@cache
def adjacent_parts(factor: int) -> np.ndarray:
    """(n, 2) the pairs of `part_middles` whose parts share a face."""
    return _parts(factor)[1]


def _parts(factor: int) -> tuple[np.ndarray, np.ndarray]:
    grid = Grid(np.array([4, 4, 4]))
    fine = grid.refined(factor)
    tet = grid.locate(np.array([[1.6, 1.55, 1.9]]))
    corners = grid.places_of(grid.nodes_of(tet))[0]
    low, high = (corners.min(axis=0) * factor - 1).astype(int), (corners.max(axis=0) * factor + 1).astype(int)
    cells = np.stack(
        np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)), indexing="ij"), axis=-1
    )
    names = np.unique(fine.tets_of_cells(cells.reshape(-1, 3)))
    names = names[grid.locate(fine.centroids(names) / factor) == tet]
    middles = fine.centroids(names) / factor
    inner = np.linalg.solve((corners[1:] - corners[0]).T, (middles - corners[0]).T).T
    behind = fine.neighbours(names)
    pairs = np.argwhere(np.isin(behind, names))
    other = np.searchsorted(names, behind[pairs[:, 0], pairs[:, 1]])
    pairs = np.stack([pairs[:, 0], other], axis=1)
    weights = np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
    return weights, pairs[pairs[:, 0] < pairs[:, 1]]
