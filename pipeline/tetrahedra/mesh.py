"""A mesh of tets, and what follows from its connectivity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# The face opposite each node, counter-clockwise seen from outside a tet of positive volume.
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


@dataclass(frozen=True)
class Lattice:
    """Tets that cover a skin.

    nodes: (node_count, 3) float64.  tets: (tet_count, 4) int32, positive volume.
    skin_tet: (point_count,) int32, a tet that each point of the skin filled lies in, -1 for points of no triangle.
    share: (tet_count,) the part of each tet that is inside that skin, and its own. None for tets from elsewhere.
    """

    nodes: np.ndarray
    tets: np.ndarray
    skin_tet: np.ndarray | None = None
    share: np.ndarray | None = None


def volumes(lattice: Lattice) -> np.ndarray:
    """(tet_count,), negative for tets of the wrong orientation."""
    x = lattice.nodes[lattice.tets]
    a, b, c = (x[:, k] - x[:, 0] for k in (1, 2, 3))
    return np.einsum("ni,ni->n", a, np.cross(b, c)) / 6.0


def boundary(lattice: Lattice) -> np.ndarray:
    """(triangle_count, 3) int32 into the nodes, counter-clockwise seen from outside: faces of one tet alone."""
    return boundary_faces(lattice)[0]


def boundary_faces(lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """`boundary`, and (triangle_count,) int32 the tet behind each."""
    faces = lattice.tets[:, FACES].reshape(-1, 3)
    ordered = np.sort(faces, axis=1).astype(np.int64)
    count = len(lattice.nodes)
    key = (ordered[:, 0] * count + ordered[:, 1]) * count + ordered[:, 2]
    _, inverse, times = np.unique(key, return_inverse=True, return_counts=True)
    alone = np.flatnonzero(times[inverse] == 1)
    return faces[alone].astype(np.int32), (alone // 4).astype(np.int32)


def barycentric(lattice: Lattice, tet: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(n, 4) float64, of places (n, 3) in tets (n,); rows sum to one."""
    x = lattice.nodes[lattice.tets[tet]]
    edges = np.stack([x[:, k] - x[:, 0] for k in (1, 2, 3)], axis=2)
    inner = np.linalg.solve(edges, (places - x[:, 0])[..., None])[..., 0]
    return np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
