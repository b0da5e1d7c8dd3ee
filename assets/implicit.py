"""Implicit surfaces: signed distances, smooth blends, and a watertight triangle mesh of the zero level.

All functions take points (n, 3) float64 and give (n,) float64 signed distances, negative inside.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Distance = Callable[[np.ndarray], np.ndarray]

COARSE = 6  # fine cells a coarse cell spans, where the surface is looked for first


def ellipsoid(points: np.ndarray, center, radii, rotation: np.ndarray | None = None) -> np.ndarray:
    """First-order distance to an ellipsoid: exact on the surface, near enough to blend with off it.

    rotation: (3, 3), columns the axes that `radii` lie along.
    """
    local = points - np.asarray(center, float)
    if rotation is not None:
        local = local @ rotation
    radii = np.asarray(radii, float)
    scaled = np.linalg.norm(local / radii, axis=1)
    gradient = np.linalg.norm(local / radii**2, axis=1)
    return np.where(gradient > 1e-9, scaled * (scaled - 1.0) / np.maximum(gradient, 1e-9), -radii.min())


def round_cone(points: np.ndarray, start, end, start_radius: float, end_radius: float) -> np.ndarray:
    """Distance to a segment whose radius goes linearly from one end to the other."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = end - start
    along = np.clip((points - start) @ axis / (axis @ axis), 0.0, 1.0)
    nearest = start + along[:, None] * axis
    return np.linalg.norm(points - nearest, axis=1) - (start_radius + along * (end_radius - start_radius))


def rotation_z(angle: float) -> np.ndarray:
    """(3, 3): turns -Y towards +X by `angle`."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def blend(first: np.ndarray, second: np.ndarray, width: float) -> np.ndarray:
    """Smooth union: the minimum, rounded where the two differ by less than `width` (polynomial, C1)."""
    overlap = np.maximum(width - np.abs(first - second), 0.0) / width
    return np.minimum(first, second) - 0.25 * width * overlap**2


def carve(body: np.ndarray, tool: np.ndarray, width: float) -> np.ndarray:
    """Smooth difference: `body` without `tool`."""
    return -blend(-body, tool, width)


def gradient(distance: Distance, points: np.ndarray, step: float = 1e-3) -> np.ndarray:
    """(n, 3) central differences of a distance."""
    result = np.empty_like(points)
    for axis in range(3):
        offset = np.zeros(3)
        offset[axis] = step
        result[:, axis] = (distance(points + offset) - distance(points - offset)) / (2.0 * step)
    return result


def project(distance: Distance, points: np.ndarray, level: float | np.ndarray = 0.0, steps: int = 3) -> np.ndarray:
    """Points moved along the gradient to where the distance is `level` (Newton)."""
    for _ in range(steps):
        slope = gradient(distance, points)
        error = distance(points) - level
        points = points - slope * (error / np.maximum((slope**2).sum(axis=1), 1e-2))[:, None]
    return points


def sample_grid(distance: Distance, low: np.ndarray, cell: float, shape: tuple[int, int, int]) -> np.ndarray:
    """Distances at the nodes of a grid; far from the surface a coarse cell's middle stands in for it."""
    coarse_shape = tuple(-(-n // COARSE) for n in shape)
    middles = np.stack(np.meshgrid(*(np.arange(n) for n in coarse_shape), indexing="ij"), axis=-1)
    middles = low + (middles.reshape(-1, 3) + 0.5 - 0.5 / COARSE) * cell * COARSE
    coarse = distance(middles).reshape(coarse_shape)
    for axis in range(3):
        coarse = coarse.repeat(COARSE, axis=axis)
    values = coarse[tuple(slice(n) for n in shape)].copy()
    near = np.argwhere(np.abs(values) < 2.5 * cell * COARSE)
    values[tuple(near.T)] = distance(low + near * cell)
    return values


def polygonise(distance: Distance, low, high, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """The zero level as points (n, 3) and triangles (m, 3), counter-clockwise seen from outside."""
    import pyvista as pv

    low, high = np.asarray(low, float), np.asarray(high, float)
    shape = tuple(int(n) for n in np.ceil((high - low) / cell) + 1)
    grid = pv.ImageData(dimensions=shape, spacing=(cell,) * 3, origin=low)
    grid.point_data["distance"] = sample_grid(distance, low, cell, shape).ravel(order="F")
    surface = grid.contour([0.0], scalars="distance", method="flying_edges")
    return oriented(np.asarray(surface.points, float), surface.faces.reshape(-1, 4)[:, 1:])


def oriented(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same triangles, turned over if their normals look inwards."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c))
    return points, np.ascontiguousarray(triangles if volume > 0.0 else triangles[:, ::-1])


def simplify(points: np.ndarray, triangles: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """About `target` triangles, by quadric edge collapse."""
    import pyvista as pv

    mesh = pv.PolyData.from_regular_faces(points, triangles)
    smaller = mesh.decimate(1.0 - target / len(triangles), volume_preservation=True)
    return np.asarray(smaller.points, float), smaller.faces.reshape(-1, 4)[:, 1:]


def relax(distance: Distance, points: np.ndarray, triangles: np.ndarray, rounds: int) -> np.ndarray:
    """Evens out triangles: each point goes half way to its neighbours' mean, then back onto the surface."""
    for _ in range(rounds):
        points = project(distance, 0.5 * (points + neighbour_mean(points, triangles)), steps=2)
    return points


def neighbour_mean(values: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n, k) mean of each vertex's neighbours over the edges of a closed mesh."""
    total = np.zeros_like(values)
    count = np.zeros(len(values))
    for first, second in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
        np.add.at(total, triangles[:, first], values[triangles[:, second]])
        np.add.at(count, triangles[:, first], 1.0)
    return total / count[:, None]
