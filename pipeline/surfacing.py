"""A surface about grains: where the matter, spread about them, fills half of the space.

Grains are spread over a grid by quadratic B-splines, as the solver does (Jiang et al. 2016, (123)), and the level
one half is found in the cells it passes by VTK's marching cubes. Memory and time follow the grains, not their box.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from plait.pipeline.errors import PlaitError

# The part of the space that is filled where the surface is.
LEVEL = 0.5
# Nodes that a B-spline reaches, from that before the nearest; corners of a cell as VTK_HEXAHEDRON numbers them.
STENCIL = np.indices((3, 3, 3)).reshape(3, -1).T
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
VTK_HEXAHEDRON = 12


@dataclass(frozen=True)
class GrainSurface:
    """points: (n, 3) float64 [m].  triangles: (m, 3) int32, counter-clockwise seen from outside, closed.
    normals: (n, 3), unit.  velocities: (n, 3) [m/s], of the matter there.
    """

    points: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    velocities: np.ndarray


def surface_of(positions: np.ndarray, velocities: np.ndarray, volume: float, cell: float) -> GrainSurface:
    """The surface about grains at (n, 3) positions [m], each of which fills `volume` [m3], on cells of `cell` [m].

    Grains that fly alone fill no half of any cell, and have no surface. Raises PlaitError for grains that lie
    further apart than cells can be numbered.
    """
    none = np.zeros((0, 3))
    if not len(positions):
        return GrainSurface(none, none.astype(np.int32), none, none)
    lower = np.floor(positions.min(axis=0) / cell).astype(np.int64) - 2
    nodes = _Nodes(positions / cell - lower, velocities, volume / cell**3)
    points, triangles, momentum = _contour(nodes)
    if not len(triangles):
        return GrainSurface(none, none.astype(np.int32), none, none)
    return GrainSurface((points + lower) * cell, triangles, _normals(points, triangles), momentum / LEVEL)


class _Nodes:
    """The nodes of a grid of unit cells that grains reach, in the order of their keys.

    filled: (node_count,) part of the space about each.  momentum: (node_count, 3) that times the velocity.
    """

    def __init__(self, places: np.ndarray, velocities: np.ndarray, part: float) -> None:
        """places: (n, 3) [cells], above 1.  part: of a cell, that each grain fills."""
        first = np.floor(places - 0.5).astype(np.int64)
        self.shape = first.max(axis=0) + 5
        if np.prod(self.shape, dtype=object) > np.iinfo(np.int64).max:
            wide = float(self.shape.max())
            raise PlaitError(f"grains lie {wide:.3g} cells of their surface apart, too many to number")
        keys, of_grain = np.unique(self.key(first), return_inverse=True)
        reach = self.key(STENCIL)
        self.keys = np.unique(keys[:, None] + reach)
        count = len(self.keys)
        self.filled, self.momentum = np.zeros(count), np.zeros((count, 3))
        weights = _weights(places - first)
        for offset, away in zip(STENCIL, reach, strict=True):
            node = np.searchsorted(self.keys, keys + away)[of_grain]
            shares = part * np.prod(weights[offset, :, range(3)], axis=0)
            self.filled += np.bincount(node, shares, minlength=count)
            for axis in range(3):
                self.momentum[:, axis] += np.bincount(node, shares * velocities[:, axis], minlength=count)

    def key(self, nodes: np.ndarray) -> np.ndarray:
        """(n,) int64 of (n, 3) nodes."""
        return (nodes[:, 0] * self.shape[1] + nodes[:, 1]) * self.shape[2] + nodes[:, 2]

    def place(self, keys: np.ndarray) -> np.ndarray:
        """(n, 3) nodes of (n,) keys."""
        return np.stack(np.unravel_index(keys, self.shape), axis=1)

    def at(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What `filled` and `momentum` are at nodes with these keys; zero at those that no grain reaches."""
        node = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        there = self.keys[node] == keys
        return np.where(there, self.filled[node], 0.0), np.where(there[:, None], self.momentum[node], 0.0)


def _weights(beyond: np.ndarray) -> np.ndarray:
    """(3, n, 3) of quadratic B-splines: of each axis' three nodes, `beyond` (n, 3) [cells] from the first."""
    return np.stack([0.5 * (1.5 - beyond) ** 2, 0.75 - (beyond - 1.0) ** 2, 0.5 * (beyond - 0.5) ** 2])


def _contour(nodes: _Nodes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 3) [cells], triangles (m, 3) and momentum (n, 3) at the points of the level's surface."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid
    from vtkmodules.vtkFiltersCore import vtkContour3DLinearGrid

    cells, corners = _cells(nodes)
    filled, momentum = nodes.at(corners)
    cells = cells[(filled[cells] <= LEVEL).any(axis=1)]
    if not len(cells):
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3))
    grid, places, held = vtkUnstructuredGrid(), vtkPoints(), vtkCellArray()
    places.SetData(numpy_to_vtk(nodes.place(corners).astype(np.float64), deep=True))
    grid.SetPoints(places)
    offsets = numpy_to_vtkIdTypeArray(8 * np.arange(len(cells) + 1), deep=True)
    held.SetData(offsets, numpy_to_vtkIdTypeArray(cells.astype(np.int64).ravel(), deep=True))
    grid.SetCells(VTK_HEXAHEDRON, held)
    for name, array in (("filled", filled), ("momentum", momentum)):
        values = numpy_to_vtk(array, deep=True)
        values.SetName(name)
        grid.GetPointData().AddArray(values)
    grid.GetPointData().SetActiveScalars("filled")
    contour = vtkContour3DLinearGrid()
    contour.SetInputData(grid)
    contour.SetValue(0, LEVEL)
    with warnings.catch_warnings():  # newer VTK merges them always, and says so
        warnings.simplefilter("ignore", DeprecationWarning)
        contour.SetMergePoints(True)
    contour.SetInterpolateAttributes(True)
    contour.SetSequentialProcessing(True)  # in one order, so that a run gives the same bits every time
    contour.SetOutputPointsPrecision(1)  # float64
    contour.Update()
    found = contour.GetOutput()
    points = vtk_to_numpy(found.GetPoints().GetData()).astype(np.float64)
    triangles = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int32)
    return points, triangles, vtk_to_numpy(found.GetPointData().GetArray("momentum")).astype(np.float64)


def _cells(nodes: _Nodes) -> tuple[np.ndarray, np.ndarray]:
    """Cells that have a node above the level: their corners (n, 8) as indices into the keys that come second."""
    solid = nodes.keys[nodes.filled > LEVEL]
    offsets = nodes.key(CORNERS)
    first = np.unique(solid[:, None] - offsets)
    corners, cells = np.unique(first[:, None] + offsets, return_inverse=True)
    return cells.reshape(-1, 8), corners


def _normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n, 3) unit, the mean of the triangles' about each point by area; up where they cancel."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    each = np.repeat(across, 3, axis=0).T
    total = np.stack([np.bincount(triangles.ravel(), part, minlength=len(points)) for part in each], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 1.0))
