"""The body-centred cubic lattice: which tet a place lies in, by arithmetic alone.

In units of the cell, with nodes at the corners of the unit cells and at their centres. Two neighbouring centres
and an edge of the face between them make a tet: four tets a face, twelve a cell, all alike. Its faces lie in the
planes x_i ± x_j = integer, so a lattice n times finer nests in it exactly: each tet is n³ of the finer ones.
(Labelle & Shewchuk 2007, section 3.)"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TET_VOLUME = 1.0 / 12.0
MEAN_EDGE = (2.0 + 4.0 * np.sqrt(0.75)) / 6.0
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


@dataclass(frozen=True)
class Grid:
    """The cells 0 .. cells - 1 on each axis; a tet is named by one integer.

    cells: (3,) int64. Places from 1 to cells - 1 are sure to lie in tets whose nodes exist.
    """

    cells: np.ndarray

    def refined(self, factor: int) -> Grid:
        return Grid(self.cells * factor)

    def locate(self, places: np.ndarray) -> np.ndarray:
        """(n,) int64, the tet each place (n, 3) lies in; on a face, one of those beside it, always the same."""
        cell = np.floor(places).astype(np.int64)
        inside = places - cell - 0.5
        rows = np.arange(len(places))
        axis = np.argmax(np.abs(inside), axis=1)
        # The cell below the face that the place is seen through from the centre of its cell.
        cell[rows, axis] -= inside[rows, axis] < 0.0
        across = (axis + 1) % 3, (axis + 2) % 3
        u, v = inside[rows, across[0]], inside[rows, across[1]]
        second = np.abs(v) > np.abs(u)
        side = np.where(second, v, u) >= 0.0
        return self._names(cell, axis, 2 * second + side)

    def nodes_of(self, names: np.ndarray) -> np.ndarray:
        """(n, 4) int64: the nodes of tets, positive volume."""
        cell, axis, quarter = self._parts(names)
        doubled = 2 * cell[:, None] + _CORNERS[axis, quarter]  # in half cells
        return self._node_names(doubled)

    def centroids(self, names: np.ndarray) -> np.ndarray:
        cell, axis, quarter = self._parts(names)
        return cell + 0.5 * _CORNERS[axis, quarter].mean(axis=1)

    def neighbours(self, names: np.ndarray) -> np.ndarray:
        """(n, 4) int64: the tet behind the face opposite each node."""
        cell, axis, quarter = self._parts(names)
        corners = 0.5 * _CORNERS[axis, quarter]
        centroid = corners.mean(axis=1)
        # Beyond a face by twice the way from the centroid to it is well inside the tet behind.
        face = (4.0 * centroid[:, None] - corners) / 3.0
        beyond = cell[:, None] + 2.0 * face - centroid[:, None]
        return self.locate(beyond.reshape(-1, 3)).reshape(-1, 4)

    def places_of(self, nodes: np.ndarray) -> np.ndarray:
        """(n, 3) float64: where nodes lie."""
        return 0.5 * np.stack(np.unravel_index(nodes, self._node_shape), axis=-1)

    def tets_of_cells(self, cells: np.ndarray) -> np.ndarray:
        """The tets of cells (n, 3), each between a cell and the next on each axis: (n, 12) int64."""
        flat = np.ravel_multi_index(tuple(cells.T), tuple(self.cells))
        return 12 * flat[:, None] + np.arange(12)

    def _names(self, cell: np.ndarray, axis: np.ndarray, quarter: np.ndarray) -> np.ndarray:
        return (np.ravel_multi_index(tuple(cell.T), tuple(self.cells)) * 3 + axis) * 4 + quarter

    def _parts(self, names: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rest, quarter = np.divmod(names, 4)
        flat, axis = np.divmod(rest, 3)
        return np.stack(np.unravel_index(flat, tuple(self.cells)), axis=1), axis, quarter

    @property
    def _node_shape(self) -> tuple[int, ...]:
        return tuple(int(2 * n + 2) for n in self.cells)

    def _node_names(self, doubled: np.ndarray) -> np.ndarray:
        return np.ravel_multi_index(tuple(np.moveaxis(doubled, -1, 0)), self._node_shape)


def _corner_table() -> np.ndarray:
    """(axis, quarter, 4, 3) in half cells: both centres, then the ends of an edge of the face between them."""
    table = np.zeros((3, 4, 4, 3), dtype=np.int64)
    for axis in range(3):
        for quarter in range(4):
            second, side = divmod(quarter, 2)
            along = (axis + 1 + (1 - second)) % 3
            across = (axis + 1 + second) % 3
            corners = np.ones((4, 3), dtype=np.int64)
            corners[1, axis] = 3
            corners[2:, axis] = 2
            corners[2:, across] = 2 * side
            corners[2:, along] = (0, 2)
            x = corners - corners[0]
            if np.dot(x[1], np.cross(x[2], x[3])) < 0:
                corners[2:] = corners[3:1:-1].copy()
            table[axis, quarter] = corners
    return table


_CORNERS = _corner_table()
