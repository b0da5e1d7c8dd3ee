"""What UsdPhysicsMeshCollisionAPI would have touch in the place of a mesh."""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics

from plait.pipeline.read.solids import shape_in
from plait.pipeline.read.source import Source
from plait.solver.scene import Shape, Surface

ATTRIBUTE = "physics:approximation"
# A point may lie so far out of the plane of a convex mesh's face, in sizes of the mesh: float32.
ROUNDING = 1e-5
PLANES = 256


def bounding_shape(source: Source, prim: Usd.Prim, points: np.ndarray, placed: np.ndarray) -> Shape | None:
    """The box or ball about points (n, 3) of the mesh [stage units, its own space], if that is to touch.

    placed: (4, 4), from there to metres. None, told of in a warning, where it is scaled or sheared into neither.
    """
    kind = {"boundingCube": "box", "boundingSphere": "sphere"}.get(_approximation(prim))
    if kind is None:
        return None
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    if kind == "box":
        size = 0.5 * np.ptp(points, axis=0)
    else:
        size = np.full(3, np.linalg.norm(points - center, axis=1).max())
    middle = np.eye(4)
    middle[:3, 3] = center
    return shape_in(source, prim, kind, size, placed @ middle)


def tell_of_approximation(source: Source, prim: Usd.Prim, surface: Surface) -> None:
    """Says where another surface than the mesh is asked for, and touching is as drawn all the same."""
    if prim.IsA(UsdGeom.Plane):
        source.warn("ends where it is drawn; others take a Plane that collides as endless", prim, "width, length")
    kind = _approximation(prim)
    if kind in ("convexHull", "convexDecomposition") and not _is_convex(surface):
        source.warn(f"is {kind}; the mesh touches as it is drawn, with its hollows", prim, ATTRIBUTE)
    if kind in ("boundingCube", "boundingSphere") and surface.shape is None:
        source.warn(f"is {kind}; the mesh touches as it is drawn", prim, ATTRIBUTE)


def _approximation(prim: Usd.Prim) -> str:
    if not prim.HasAPI(UsdPhysics.MeshCollisionAPI):
        return "none"
    return str(UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get())


def _is_convex(surface: Surface) -> bool:
    """Whether no edge goes in, and, of pieces that lie apart, no point is outside the planes of some faces."""
    import trimesh  # here: it takes long to load

    size = np.ptp(surface.points, axis=0).max()
    mesh = trimesh.Trimesh(surface.points, surface.triangles, process=False)
    if mesh.face_adjacency_projections.max(initial=0.0) > ROUNDING * size:
        return False
    corners = surface.points[surface.triangles[:: max(1, len(surface.triangles) // PLANES)]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    outside = (
        ((surface.points - corner) @ normal).max() for corner, normal in zip(corners[:, 0], normals, strict=True)
    )
    return max(outside) <= ROUNDING * size
