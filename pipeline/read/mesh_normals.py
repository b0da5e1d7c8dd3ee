"""Normals of meshes, and the triangles that carry each."""

from __future__ import annotations

import numpy as np

from plait.pipeline.read.normals import LEAST, authored_normals
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Body
from plait.pipeline.shot import MeshNormals

# Normals closer than this at one place are one, on either side of a seam of the texture.
SAME = 1e-3


def read_mesh_normals(source: Source, body: Body) -> MeshNormals | None:
    """Authored normals in the space of the body's rest points; None, with a warning, if unfit.

    A normal is carried by the triangles about its point that are shaded with it: on either side of a crease those
    of that side. Normals that fit no interpolation or have no direction are dropped from the result.
    """
    name, interpolation, given = authored_normals(source, body.prim)
    if not len(given):
        return None
    corners = {
        "vertex": body.authored_points,
        "varying": body.authored_points,
        "faceVarying": body.authored_corners,
        "uniform": np.repeat(body.face_of[:, None], 3, axis=1),
    }.get(interpolation)
    if corners is None or not _fits(body, interpolation, len(given)):
        problem = f"{len(given)} values, interpolation {interpolation}, do not follow the mesh"
        source.warn(f"{problem}; the result has none", body.prim, name)
        return None
    # The inverse transpose keeps normals across what they are normal to under uneven scale.
    turned = given @ np.linalg.inv(body.own_to_rest[:3, :3])
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    if length[corners].min() <= LEAST:
        source.warn("some have no direction; the result has none", body.prim, name)
        return None
    values = turned / np.maximum(length, LEAST)
    places = corners if interpolation == "uniform" else body.surface.triangles
    keys = np.column_stack([places.ravel(), np.rint(values[corners.ravel()] / SAME)]).astype(np.int64)
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    group = group.ravel()
    # Normals that no triangle shows have a group of their own, and stay.
    group_of = np.full(len(given), -1)
    group_of[corners.ravel()] = group
    hidden = np.flatnonzero(group_of < 0)
    group_of[hidden] = len(first) + np.arange(len(hidden))
    pairs = np.unique(np.column_stack([group, np.repeat(np.arange(len(corners)), 3)]), axis=0)
    return MeshNormals(
        values=np.concatenate([values[corners.ravel()[first]], values[hidden]]),
        group_of=group_of,
        triangles=body.authored_points,
        rest=body.surface.points[body.welded],
        groups=pairs[:, 0],
        carriers=pairs[:, 1],
    )


def _fits(body: Body, interpolation: str, count: int) -> bool:
    return count == {
        "vertex": len(body.welded),
        "varying": len(body.welded),
        "faceVarying": body.corner_count,
        "uniform": len(body.corner_offsets) - 1,
    }.get(interpolation)
