"""Faces of meshes, tet meshes' surfaces and simple shapes, as authored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read import shapes, values
from plait.pipeline.read.source import Source


@dataclass(frozen=True)
class Polygons:
    """entries: where `indices` stand in the authored list, which has `corner_count`."""

    points: np.ndarray
    counts: np.ndarray
    indices: np.ndarray
    entries: np.ndarray
    corner_count: int
    left_handed: bool
    subdivided: bool


def mesh_sizes(prim: Usd.Prim, source: Source) -> dict[str, int]:
    """Counts for a report."""
    if prim.IsA(UsdGeom.TetMesh):
        tets = UsdGeom.TetMesh(prim)
        held = tets.GetTetVertexIndicesAttr().Get(source.start), tets.GetPointsAttr().Get(source.start)
        return {"tets": len(held[0] or []), "points": len(held[1] or [])}
    if not prim.IsA(UsdGeom.Mesh):
        return {}
    mesh = UsdGeom.Mesh(prim)
    points = mesh.GetPointsAttr().Get(source.start)
    counts = mesh.GetFaceVertexCountsAttr().Get(source.start)
    return {"faces": len(counts or []), "points": len(points or [])}


def read_polygons(source: Source, prim: Usd.Prim) -> Polygons:
    """Raises InputError for counts and indices that do not fit, or values that are not finite."""
    if prim.IsA(UsdGeom.TetMesh):
        return _read_tet_surface(source, prim)
    if not prim.IsA(UsdGeom.Mesh):
        points, counts, indices = shapes.polygons(source, prim)
        return Polygons(points, counts, indices, np.arange(len(indices)), len(indices), False, False)
    mesh = UsdGeom.Mesh(prim)
    counts_attribute, indices_attribute = mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()
    for attribute in (counts_attribute, indices_attribute):
        if attribute.ValueMightBeTimeVarying():
            raise source.error("is animated", prim, attribute.GetName(), "the topology must not change")
    points = values.steady_vectors(source, mesh.GetPointsAttr())
    counts = values.integers(source, counts_attribute)
    indices = values.integers(source, indices_attribute)
    values.check_sizes(source, counts_attribute, counts, indices_attribute, len(indices))
    check_indices(source, indices_attribute, indices, len(points))
    holes = values.integers(source, mesh.GetHoleIndicesAttr())
    solid = (counts >= 3) & ~np.isin(np.arange(len(counts)), holes)
    # Faces keep their numbers (skinprim counts them): one that is left out keeps no vertices.
    entries = np.nonzero(np.repeat(solid, counts))[0]
    return Polygons(
        points,
        np.where(solid, counts, 0),
        indices[entries],
        entries,
        len(indices),
        mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded,
        mesh.GetSubdivisionSchemeAttr().Get() not in (UsdGeom.Tokens.none, None),
    )


def _read_tet_surface(source: Source, prim: Usd.Prim) -> Polygons:
    """The faces of a TetMesh that are its surface: as authored, else as USD finds them."""
    mesh = UsdGeom.TetMesh(prim)
    points = values.steady_vectors(source, mesh.GetPointsAttr())
    faces = values.vectors(source, mesh.GetSurfaceFaceVertexIndicesAttr()).astype(np.int64)
    check_indices(source, mesh.GetSurfaceFaceVertexIndicesAttr(), faces, len(points))
    if not len(faces):
        faces = np.array(UsdGeom.TetMesh.ComputeSurfaceFaces(mesh, source.start), dtype=np.int64).reshape(-1, 3)
    return Polygons(
        points,
        np.full(len(faces), 3),
        faces.ravel(),
        np.arange(faces.size),
        faces.size,
        mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded,
        False,
    )


def check_indices(source: Source, attribute: Usd.Attribute, indices: np.ndarray, point_count: int) -> None:
    """Raises InputError for an index that names no point, or that is animated."""
    if attribute.ValueMightBeTimeVarying():
        raise source.error("is animated", attribute.GetPrim(), attribute.GetName(), "the topology must not change")
    if indices.size and (indices.min() < 0 or indices.max() >= point_count):
        raise source.error(
            f"names point {int(indices.min() if indices.min() < 0 else indices.max())} of {point_count}",
            attribute.GetPrim(),
            attribute.GetName(),
            f"use 0 to {point_count - 1}",
        )
