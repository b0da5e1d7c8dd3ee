"""Whether lines and triangles pass through triangles, many at once."""

from __future__ import annotations

import numpy as np


def lines_through(lines: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which lines (n, 2, 3) cross their face (n, 3, 3), (n,) bool, and where, (n, 3)."""
    a, b = lines[:, 0], lines[:, 1]
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    height_a = np.einsum("ni,ni->n", a - faces[:, 0], normal)
    height_b = np.einsum("ni,ni->n", b - faces[:, 0], normal)
    crossing = height_a * height_b <= 0.0
    crossing &= height_a != height_b
    share = height_a / np.where(crossing, height_a - height_b, 1.0)
    where = a + share[:, None] * (b - a)
    for k in range(3):
        side = np.cross(faces[:, (k + 1) % 3] - faces[:, k], where - faces[:, k])
        crossing &= np.einsum("ni,ni->n", side, normal) >= 0.0
    return crossing, where


def triangles_through(triangles: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which triangles (n, 3, 3) cross their face (n, 3, 3), (n,) bool, and somewhere they do, (n, 3).

    Two triangles cross where an edge of one passes through the other.
    """
    meets = np.zeros(len(triangles), dtype=bool)
    where = np.zeros((len(triangles), 3))
    apart = np.any(triangles.max(axis=1) < faces.min(axis=1), axis=1)
    apart |= np.any(faces.max(axis=1) < triangles.min(axis=1), axis=1)
    left = np.flatnonzero(~apart)
    for first, second in ((triangles, faces), (faces, triangles)):
        for k in range(3):
            crossing, place = lines_through(first[left][:, [k, (k + 1) % 3]], second[left])
            meets[left[crossing]] = True
            where[left[crossing]] = place[crossing]
            left = left[~crossing]
    return meets, where
