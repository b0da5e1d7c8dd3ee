"""Rotations on the host: quaternions x, y, z, w."""

from __future__ import annotations

import numpy as np


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(3, 3) rotation to (4,) unit quaternion x, y, z, w: the eigenvector of Bar-Itzhack (2000)."""
    m = rotation
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
            [0.0, m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
            [0.0, 0.0, m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
            [0.0, 0.0, 0.0, np.trace(m)],
        ]
    )
    _, vectors = np.linalg.eigh(k, UPLO="U")
    q = vectors[:, -1]
    return q if q[3] >= 0.0 else -q


def rotation_matrix(q: np.ndarray) -> np.ndarray:
    """(4,) unit quaternion x, y, z, w to (3, 3)."""
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def turned_by(vector: np.ndarray) -> np.ndarray:
    """(3, 3), exp of a rotation vector (3,) [rad]."""
    angle = np.linalg.norm(vector)
    half = 0.5 * np.sinc(0.5 * angle / np.pi) * vector
    return rotation_matrix(np.append(half, np.cos(0.5 * angle)))
