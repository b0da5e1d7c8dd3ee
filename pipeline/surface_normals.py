"""Normals that turn with the skin they are drawn on, creases and all."""

from __future__ import annotations

import numpy as np

from plait.pipeline.shot import MeshNormals


class SurfaceNormals:
    """One mesh's normals through a run.

    A normal goes as the triangles about it deform: by the cofactor of each one's deformation gradient, which keeps
    it across what it was across (Nanson's formula), weighed by their area at rest.
    """

    def __init__(self, normals: MeshNormals) -> None:
        self._held = normals
        edges = _edges(normals.rest[normals.triangles])
        # cof(F) n A = cof(D) Dr^T n / 2, with D = F Dr the triangle's edges and its unit normal.
        shown = normals.values[normals.groups]
        self._parts = np.einsum("kji,kj->ki", edges[normals.carriers], shown)

    def at(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) float64, unit, scene world. points: (point count, 3) as authored, where they are now.

        A normal that no triangle carries, or only triangles without area, stays as authored.
        """
        held = self._held
        edges = _edges(points[held.triangles])
        first, second, normal = (edges[:, :, k] for k in range(3))
        cofactors = np.stack([np.cross(second, normal), np.cross(normal, first), np.cross(first, second)], axis=2)
        turned = np.einsum("kij,kj->ki", cofactors[held.carriers], self._parts)
        count = len(held.values)
        total = np.stack([np.bincount(held.groups, turned[:, k], minlength=count) for k in range(3)], axis=1)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        unit = np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), held.values)
        return unit[held.group_of]


def _edges(corners: np.ndarray) -> np.ndarray:
    """(m, 3, 3), columns: two edges of each triangle and its unit normal. corners: (m, 3, 3)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([first, second, normal / np.where(length > 0.0, length, 1.0)], axis=2)
