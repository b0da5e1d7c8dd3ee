"""Where points lie in a mesh of tets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from plait.pipeline.tetrahedra.kernels import holding_tet
from plait.pipeline.tetrahedra.mesh import Lattice, barycentric, boundary_faces
from plait.pipeline.tetrahedra.skin import Inside
from plait.solver.scene import Embedding

# A barycentric coordinate below this is told of: the point lies outside its tet by half the tet's height.
STRONG = -0.5


@dataclass(frozen=True)
class Extrapolation:
    """Points outside every tet: how many, how many strongly, and the most negative barycentric coordinate."""

    count: int
    strong: int
    largest: float


def embed(points: np.ndarray, lattice: Lattice) -> tuple[Embedding, Extrapolation]:
    """A tet and barycentric coordinates for each point (point_count, 3), float64.

    The points the lattice was filled from are in the tets the filling gave them. Others are in the tet that holds
    them, or behind the closest face of the boundary, and then extrapolated, which the report counts.
    """
    points = np.asarray(points, dtype=np.float64)
    tet = np.full(len(points), -1, dtype=np.int32)
    if lattice.skin_tet is not None and len(lattice.skin_tet) == len(points):
        tet = lattice.skin_tet.copy()
    unknown = np.flatnonzero(tet < 0)
    if len(unknown):
        tet[unknown] = locate(points[unknown], lattice)
    weights = barycentric(lattice, tet, points)
    least = weights.min(axis=1, initial=0.0)
    outside = least < -1e-9
    report = Extrapolation(int(outside.sum()), int((least < STRONG).sum()), float(-least.min(initial=0.0)))
    return Embedding(np.asarray(tet, dtype=np.int32), weights), report


def locate(points: np.ndarray, lattice: Lattice) -> np.ndarray:
    """(n,) int32, the tet that holds each point best; for points outside all, one at the closest boundary face."""
    faces, behind = boundary_faces(lattice)
    surface = Inside(lattice.nodes, faces)
    corners = surface.unit(lattice.nodes)[lattice.tets]
    slack = np.float32(1e-6)
    tree = wp.Bvh(
        wp.array(corners.min(axis=1) - slack, dtype=wp.vec3, device="cpu"),
        wp.array(corners.max(axis=1) + slack, dtype=wp.vec3, device="cpu"),
    )
    tet = wp.empty(len(points), dtype=wp.int32, device="cpu")
    wp.launch(
        holding_tet,
        dim=len(points),
        inputs=[
            tree.id,
            wp.array(corners.reshape(-1, 3), dtype=wp.vec3, device="cpu"),
            wp.array(surface.unit(points), dtype=wp.vec3, device="cpu"),
        ],
        outputs=[tet],
        device="cpu",
    )
    found = tet.numpy()
    lost = found < 0
    if lost.any():
        found[lost] = behind[surface.query(points[lost])[1]]
    return found
