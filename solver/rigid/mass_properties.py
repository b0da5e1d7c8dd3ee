"""Mass, centre of mass and inertia of bodies of one density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.solver.scene import Shape


@dataclass(frozen=True)
class MassProperties:
    """mass: [kg].  center: (3,) [m].  inertia: (3, 3) [kg m2] about the centre, along the points' axes."""

    mass: float
    center: np.ndarray
    inertia: np.ndarray


def of_mesh(points: np.ndarray, triangles: np.ndarray, density: float) -> MassProperties:
    """Of what a closed surface encloses: points (n, 3) [m], triangles (m, 3) facing out, density [kg/m3].

    Exact for the polyhedron: the sum over the tetrahedra between its faces and a point of the integrals of 1, x
    and x x^T, which are those of polynomials. Raises ValueError for one that encloses no volume.
    """
    points = np.asarray(points, dtype=np.float64)
    origin = 0.5 * (points.min(axis=0) + points.max(axis=0))
    corners = points[np.asarray(triangles)] - origin
    six_volumes = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    volume = six_volumes.sum() / 6.0
    size = np.ptp(points, axis=0).max()
    if volume <= 1e-12 * size**3:
        raise ValueError("the surface encloses no volume")
    sums = corners.sum(axis=1)
    center = six_volumes @ sums / (24.0 * volume)
    second = np.einsum("n,ni,nj->ij", six_volumes, sums, sums)
    second += np.einsum("n,nki,nkj->ij", six_volumes, corners, corners)
    second = second / 120.0 - volume * np.outer(center, center)
    return MassProperties(density * volume, origin + center, density * _inertia(second))


def of_shape(shape: Shape, density: float) -> MassProperties:
    """Of a solid shape of `density` [kg/m3], in the space its `frame` leads to."""
    size = np.asarray(shape.size, dtype=np.float64)
    radius, half = float(size[0]), float(size[1])
    offset = 0.0  # [m] of the centre along z
    if shape.kind == "sphere":
        volume = 4.0 / 3.0 * np.pi * radius**3
        second = volume * radius**2 / 5.0 * np.ones(3)
    elif shape.kind == "box":
        volume = 8.0 * size.prod()
        second = volume * size**2 / 3.0
    elif shape.kind == "cylinder":
        volume = 2.0 * np.pi * radius**2 * half
        second = volume * np.array([radius**2 / 4.0, radius**2 / 4.0, half**2 / 3.0])
    elif shape.kind == "cone":
        volume = 2.0 / 3.0 * np.pi * radius**2 * half
        offset = -0.5 * half
        across = 3.0 * radius**2 / 20.0
        second = volume * np.array([across, across, 3.0 * (2.0 * half) ** 2 / 80.0])
    else:
        volume, second = _capsule(radius, half)
    frame = np.asarray(shape.frame, dtype=np.float64)
    inertia = frame[:3, :3] @ _inertia(np.diag(second)) @ frame[:3, :3].T
    return MassProperties(density * volume, frame[:3] @ [0.0, 0.0, offset, 1.0], density * inertia)


def _capsule(radius: float, half: float) -> tuple[float, np.ndarray]:
    """Volume and second moments of a cylinder with two half balls."""
    barrel, ball = 2.0 * np.pi * radius**2 * half, 4.0 / 3.0 * np.pi * radius**3
    across = barrel * radius**2 / 4.0 + ball * radius**2 / 5.0
    # Of a half ball about the centre of its flat side, moved by `half`: its centroid is 3/8 r from there.
    along = barrel * half**2 / 3.0 + ball * (radius**2 / 5.0 + 0.75 * radius * half + half**2)
    return barrel + ball, np.array([across, across, along])


def _inertia(second: np.ndarray) -> np.ndarray:
    """From the integral of x x^T, (3, 3), to that of |x|^2 1 - x x^T."""
    return np.trace(second) * np.eye(3) - second
