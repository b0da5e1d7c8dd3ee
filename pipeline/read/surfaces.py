"""Meshes and simple shapes as surfaces of the scene: what strands grow on and collide with.

A subdivision surface takes part as its control cage, as authored.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read import shapes, values
from plait.pipeline.read.motions import (
    Anchor,
    BlendedMotion,
    DeformedMotion,
    Placement,
    PointsMotion,
    RigidMotion,
    SkinnedMotion,
    add_shapes,
    is_similarity,
    transform,
)
from plait.pipeline.read.placing import place_points
from plait.pipeline.read.skeletons import (
    SkeletonBinding,
    Skeletons,
    read_blend_shapes,
    read_geom_bind,
    read_influences,
)
from plait.pipeline.read.source import Source
from plait.pipeline.read.triangles import has_area, triangulate, weld
from plait.solver.scene import BlendShapes, Motion, Skinning, Surface


@dataclass(frozen=True)
class Body:
    """A surface with what finding places on it needs.

    surface: as the scene has it (colliding, without contact parameters: the caller's `replace` adds those).
    face_of: (triangle_count,) the face each triangle was cut from; each face's run is contiguous.
    corners: faces' vertices as authored, welded: corner_offsets (face_count + 1,) into corner_points.
    welded: (authored point count,) int32, the surface's point that each authored one is.
    authored_points, authored_corners: (triangle_count, 3), the triangles' points, and their entries in the
        face-vertex lists, as authored: where primvars are found.
    rest_to_world: (4, 4), rest points to scene coordinates at the first frame in the bind pose.
    own_to_rest: (4, 4), the prim's own space [stage units] to rest points [m].
    bind_to_rest: the same from its skeleton's space; from its own where no skeleton moves it.
    subdivided: the drawn surface is smoother than the cage.
    start: [s] time of the first frame.
    """

    prim: Usd.Prim
    surface: Surface
    face_of: np.ndarray
    corner_offsets: np.ndarray
    corner_points: np.ndarray
    welded: np.ndarray
    authored_points: np.ndarray
    authored_corners: np.ndarray
    rest_to_world: np.ndarray
    own_to_rest: np.ndarray
    bind_to_rest: np.ndarray
    subdivided: bool
    binding: SkeletonBinding | None
    start: float

    @property
    def path(self) -> str:
        return str(self.prim.GetPath())

    @property
    def deforms(self) -> bool:
        """Whether its shape at the first frame may differ from that at rest."""
        return self.binding is not None

    @cached_property
    def posed(self) -> np.ndarray:
        """(n, 3), the surface's points at the first frame, scene coordinates."""
        return place_points(self.surface, self.surface.motion.pose(self.start))

    def triangle_sizes(self, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """(k,) for some triangles, with these points: how far the drawn surface may lie from the cage's scale."""
        a, b, c = (points[triangles[:, k]] for k in range(3))
        return np.sqrt(np.linalg.norm(np.cross(b - a, c - a), axis=1)) * self.subdivided

    @cached_property
    def first_triangle(self) -> np.ndarray:
        """(face_count + 1,) each face's run of triangles."""
        return np.searchsorted(self.face_of, np.arange(len(self.corner_offsets)))


class Bodies:
    """Reads each prim once, when it is first asked for."""

    def __init__(self, source: Source, skeletons: Skeletons) -> None:
        self._source, self._skeletons = source, skeletons
        self._read: dict[str, Body | None] = {}

    def get(self, prim: Usd.Prim) -> Body | None:
        """None for a prim without a single triangle."""
        path = str(prim.GetPath())
        if path not in self._read:
            self._read[path] = read_body(self._source, prim, self._skeletons.find(prim))
        return self._read[path]


@dataclass(frozen=True)
class _Polygons:
    """entries: where `indices` stand in the authored list."""

    points: np.ndarray
    counts: np.ndarray
    indices: np.ndarray
    entries: np.ndarray
    left_handed: bool
    subdivided: bool
    animated: bool


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


def read_body(source: Source, prim: Usd.Prim, binding: SkeletonBinding | None) -> Body | None:
    """Raises InputError for meshes whose counts and indices do not fit, or whose values are not finite."""
    polygons = _read_polygons(source, prim)
    points = polygons.points
    triangles, face_of = triangulate(points, polygons.counts, polygons.indices, polygons.left_handed)
    if not len(triangles):
        source.warn("has no triangle with an area; left out", prim, "faceVertexIndices")
        return None
    moved = _bind(source, prim, points, binding, polygons.animated)
    kept, welded = weld(moved.surface.points, triangles, moved.attached)
    surface = _keep(moved, kept, welded[triangles])
    # A triangle may have lost its area by welding; its face keeps its others.
    alive = has_area(surface.points, surface.triangles)
    surface = replace(surface, triangles=np.ascontiguousarray(surface.triangles[alive]))
    triangles, face_of = triangles[alive], face_of[alive]
    offsets = np.concatenate([[0], np.cumsum(polygons.counts)]).astype(np.int64)
    return Body(
        prim=prim,
        surface=surface,
        face_of=face_of,
        corner_offsets=offsets,
        corner_points=welded[polygons.indices],
        welded=welded,
        authored_points=triangles,
        authored_corners=polygons.entries[_corners_of(triangles, face_of, offsets, polygons.indices)],
        rest_to_world=moved.rest_to_world,
        own_to_rest=moved.own_to_rest,
        bind_to_rest=moved.bind_to_rest,
        subdivided=polygons.subdivided,
        binding=binding,
        start=source.start / source.units.time_codes_per_second,
    )


_NO_TRIANGLES = np.zeros((0, 3), np.int32)


@dataclass(frozen=True)
class _Bound:
    """A surface before welding, without its triangles.

    attached: (point_count, k), what moves a point beside where it is.  keep_motion: makes the motion of the points
    that welding keeps, where it depends on them.
    """

    surface: Surface
    attached: np.ndarray
    rest_to_world: np.ndarray
    own_to_rest: np.ndarray
    bind_to_rest: np.ndarray
    keep_motion: Callable[[np.ndarray], Motion] | None = None


def _bind(
    source: Source, prim: Usd.Prim, points: np.ndarray, binding: SkeletonBinding | None, animated: bool
) -> _Bound:
    if binding is not None and binding.query.HasJointInfluences():
        return _bind_to_joints(source, prim, points, binding)
    placement = Placement(source, prim)
    anchor = Anchor.of(placement, source)
    name = str(prim.GetPath())
    rest = anchor.points(points)
    to_world = anchor.undo(placement.metric(source.start))
    own_to_rest = _linear(anchor.linear * anchor.meters_per_unit)
    if binding is not None:
        blended = read_blend_shapes(source, binding, len(points), own_to_rest[:3, :3])
        if blended:
            shapes_, weights = blended
            motion = BlendedMotion(source, placement, anchor, weights)
            surface = Surface(name, rest, _NO_TRIANGLES, motion, blend_shapes=shapes_)
            return _Bound(surface, _shape_rows(shapes_, len(points)), to_world, own_to_rest, own_to_rest)
    if animated:
        attribute = UsdGeom.PointBased(prim).GetPointsAttr()

        def cache(kept: np.ndarray) -> PointsMotion:
            return PointsMotion(source, attribute, placement, len(points), kept)

        return _Bound(
            Surface(name, rest, _NO_TRIANGLES),
            np.zeros((len(points), 0)),
            to_world,
            own_to_rest,
            own_to_rest,
            cache,
        )
    surface = Surface(name, rest, _NO_TRIANGLES, RigidMotion(source, placement, anchor))
    return _Bound(surface, np.zeros((len(points), 0)), to_world, own_to_rest, own_to_rest)


def _bind_to_joints(source: Source, prim: Usd.Prim, points: np.ndarray, binding: SkeletonBinding) -> _Bound:
    skeleton = binding.skeleton
    influences = read_influences(source, binding, len(points))
    anchor = Anchor.of(skeleton.placement, source)
    bind_to_rest = _linear(anchor.linear * anchor.meters_per_unit)
    own_to_rest = bind_to_rest @ read_geom_bind(source, binding)
    name = str(prim.GetPath())
    rest = transform(own_to_rest, points)
    to_world = anchor.undo(skeleton.placement.metric(source.start))
    attached = np.column_stack([influences.indices, influences.weights])
    uneven = influences.method == "dual-quaternion" and not influences.rigid and not is_similarity(anchor.linear)
    if uneven or not influences.normal:

        def deform(kept: np.ndarray) -> DeformedMotion:
            return DeformedMotion(skeleton, binding.query, points, kept, _blended(source, binding, points))

        return _Bound(Surface(name, rest, _NO_TRIANGLES), attached, to_world, own_to_rest, bind_to_rest, deform)
    blended = read_blend_shapes(source, binding, len(points), own_to_rest[:3, :3])
    shapes_, weights = blended if blended else (None, None)
    if shapes_ is not None:
        attached = np.column_stack([attached, _shape_rows(shapes_, len(points))])
    skinning = None
    if not influences.rigid:
        skinning = Skinning(influences.indices, influences.weights, influences.method)
    motion = SkinnedMotion(skeleton, anchor, influences.used, weights)
    surface = Surface(name, rest, _NO_TRIANGLES, motion, skinning, shapes_)
    return _Bound(surface, attached, to_world, own_to_rest, bind_to_rest)


def _blended(source: Source, binding: SkeletonBinding, points: np.ndarray) -> Callable[[float], np.ndarray] | None:
    read = read_blend_shapes(source, binding, len(points), np.eye(3))
    if read is None:
        return None
    held, weights = read
    return lambda code: add_shapes(points, held, weights(code))


def _keep(bound: _Bound, kept: np.ndarray, triangles: np.ndarray) -> Surface:
    """The bound surface with only the points `kept`, and these triangles of them."""
    surface = bound.surface
    skinning = surface.skinning
    if skinning is not None:
        skinning = replace(
            skinning,
            joint_indices=np.ascontiguousarray(skinning.joint_indices[kept]),
            joint_weights=np.ascontiguousarray(skinning.joint_weights[kept]),
        )
    shapes_ = surface.blend_shapes
    if shapes_ is not None:
        shapes_ = _keep_shapes(shapes_, kept, len(surface.points))
    return replace(
        surface,
        points=np.ascontiguousarray(surface.points[kept]),
        triangles=triangles,
        skinning=skinning,
        blend_shapes=shapes_,
        motion=bound.keep_motion(kept) if bound.keep_motion else surface.motion,
    )


def _keep_shapes(held: BlendShapes, kept: np.ndarray, point_count: int) -> BlendShapes:
    number = np.full(point_count, -1)
    number[kept] = np.arange(len(kept))
    entries = number[held.point_indices] >= 0
    runs = np.concatenate([[0], np.cumsum(entries)])[held.shape_offsets]
    return BlendShapes(
        runs.astype(np.int32),
        number[held.point_indices[entries]].astype(np.int32),
        np.ascontiguousarray(held.point_offsets[entries]),
    )


def _shape_rows(held: BlendShapes, point_count: int) -> np.ndarray:
    """(point_count, 3) a sum over shapes that differs where any offset differs: what welding compares."""
    shape_of = np.repeat(np.arange(len(held.shape_offsets) - 1), np.diff(held.shape_offsets))
    rows = np.zeros((point_count, 3))
    # Irrational factors: two points with different offsets have the same sum only by design.
    np.add.at(rows, held.point_indices, held.point_offsets * np.sqrt(2.0 + shape_of)[:, None])
    return rows


def _read_polygons(source: Source, prim: Usd.Prim) -> _Polygons:
    if prim.IsA(UsdGeom.TetMesh):
        return _read_tet_surface(source, prim)
    if not prim.IsA(UsdGeom.Mesh):
        points, counts, indices = shapes.polygons(source, prim)
        return _Polygons(points, counts, indices, np.arange(len(indices)), False, False, False)
    mesh = UsdGeom.Mesh(prim)
    for attribute in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()):
        if attribute.ValueMightBeTimeVarying():
            raise source.error("is animated", prim, attribute.GetName(), "the topology must not change")
    points = values.steady_vectors(source, mesh.GetPointsAttr())
    counts = values.integers(source, mesh.GetFaceVertexCountsAttr())
    indices = values.integers(source, mesh.GetFaceVertexIndicesAttr())
    if len(counts) and counts.min() < 0:
        raise source.error("has a negative count", prim, "faceVertexCounts", "author counts of vertices")
    if counts.sum() != len(indices):
        raise source.error(
            f"has {len(indices)} entries, faceVertexCounts add up to {int(counts.sum())}",
            prim,
            "faceVertexIndices",
            "make the counts fit the indices",
        )
    check_indices(source, mesh.GetFaceVertexIndicesAttr(), indices, len(points))
    holes = values.integers(source, mesh.GetHoleIndicesAttr())
    solid = (counts >= 3) & ~np.isin(np.arange(len(counts)), holes)
    # Faces keep their numbers (skinprim counts them): one that is left out keeps no vertices.
    entries = np.nonzero(np.repeat(solid, counts))[0]
    return _Polygons(
        points,
        np.where(solid, counts, 0),
        indices[entries],
        entries,
        mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded,
        mesh.GetSubdivisionSchemeAttr().Get() not in (UsdGeom.Tokens.none, None),
        mesh.GetPointsAttr().ValueMightBeTimeVarying(),
    )


def _read_tet_surface(source: Source, prim: Usd.Prim) -> _Polygons:
    """The faces of a TetMesh that are its surface: as authored, else as USD finds them."""
    mesh = UsdGeom.TetMesh(prim)
    points = values.steady_vectors(source, mesh.GetPointsAttr())
    faces = values.vectors(source, mesh.GetSurfaceFaceVertexIndicesAttr()).astype(np.int64)
    check_indices(source, mesh.GetSurfaceFaceVertexIndicesAttr(), faces, len(points))
    if not len(faces):
        faces = np.array(UsdGeom.TetMesh.ComputeSurfaceFaces(mesh, source.start), dtype=np.int64).reshape(-1, 3)
    return _Polygons(
        points,
        np.full(len(faces), 3),
        faces.ravel(),
        np.arange(faces.size),
        mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded,
        False,
        mesh.GetPointsAttr().ValueMightBeTimeVarying(),
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


def _corners_of(
    triangles: np.ndarray, face_of: np.ndarray, offsets: np.ndarray, indices: np.ndarray
) -> np.ndarray:
    """Which corner of its face each triangle's vertex is, as an entry of the face-vertex lists."""
    result = np.zeros_like(triangles)
    longest = int(np.diff(offsets).max(initial=0))
    last = len(indices) - 1
    unfound = np.ones(triangles.shape, dtype=bool)
    for k in range(longest):
        entry = np.minimum(offsets[face_of] + k, last)
        here = (offsets[face_of] + k < offsets[face_of + 1])[:, None] & unfound
        match = here & (indices[entry][:, None] == triangles)
        result[match] = np.broadcast_to(entry[:, None], triangles.shape)[match]
        unfound &= ~match
    return result


def _linear(matrix: np.ndarray) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = matrix
    return result
