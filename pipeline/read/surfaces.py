"""Meshes and simple shapes as surfaces of the scene: what strands grow on and collide with.

A subdivision surface takes part as its control cage, as authored.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pxr import Usd, UsdGeom

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
from plait.pipeline.read.polygons import read_polygons
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
    corner_count: entries of the faces' lists as authored, those of faces left out too.
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
    corner_count: int
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
        self._place: Callable[[Body], Body] = lambda body: body

    def get(self, prim: Usd.Prim) -> Body | None:
        """None for a prim without a single triangle."""
        path = str(prim.GetPath())
        if path not in self._read:
            body = read_body(self._source, prim, self._skeletons.find(prim))
            self._read[path] = body and self._place(body)
        return self._read[path]

    def place_by(self, place: Callable[[Body], Body]) -> None:
        """From now on a prim that is read is what `place` makes of it: what moves it may not be the shot."""
        self._place = place

    def replace(self, body: Body) -> None:
        """From now on `body` is what `get` gives for its prim."""
        self._read[body.path] = body


def read_body(source: Source, prim: Usd.Prim, binding: SkeletonBinding | None) -> Body | None:
    """Raises InputError for meshes whose counts and indices do not fit, or whose values are not finite."""
    polygons = read_polygons(source, prim)
    points = polygons.points
    moved = bind(source, prim, points, binding)
    # What mirrors turns faces inside out.
    turned = polygons.left_handed != (np.linalg.det(moved.own_to_rest[:3, :3]) < 0.0)
    triangles, face_of = triangulate(points, polygons.counts, polygons.indices, turned)
    if not len(triangles):
        source.warn("has no triangle with an area; left out", prim, "faceVertexIndices")
        return None
    kept, welded = weld(moved.surface.points, triangles, moved.attached)
    surface = moved.keep(kept, welded[triangles])
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
        corner_count=polygons.corner_count,
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


NO_TRIANGLES = np.zeros((0, 3), np.int32)


@dataclass(frozen=True)
class Bound:
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

    def keep(self, kept: np.ndarray, triangles: np.ndarray) -> Surface:
        """The surface with only the points `kept`, and these triangles of them."""
        motion = self.keep_motion(kept) if self.keep_motion else self.surface.motion
        return keep_points(self.surface, kept, triangles, motion)


def bind(source: Source, prim: Usd.Prim, points: np.ndarray, binding: SkeletonBinding | None) -> Bound:
    """How the animation moves the points (n, 3) [stage units] of a prim. Raises InputError for unfit bindings."""
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
            surface = Surface(name, rest, NO_TRIANGLES, motion, blend_shapes=shapes_)
            return Bound(surface, _shape_rows(shapes_, len(points)), to_world, own_to_rest, own_to_rest)
    attribute = UsdGeom.PointBased(prim).GetPointsAttr() if prim.IsA(UsdGeom.PointBased) else None
    if attribute and attribute.ValueMightBeTimeVarying():

        def cache(kept: np.ndarray) -> PointsMotion:
            return PointsMotion(source, attribute, placement, len(points), kept)

        return Bound(
            Surface(name, rest, NO_TRIANGLES),
            np.zeros((len(points), 0)),
            to_world,
            own_to_rest,
            own_to_rest,
            cache,
        )
    surface = Surface(name, rest, NO_TRIANGLES, RigidMotion(source, placement, anchor))
    return Bound(surface, np.zeros((len(points), 0)), to_world, own_to_rest, own_to_rest)


def _bind_to_joints(source: Source, prim: Usd.Prim, points: np.ndarray, binding: SkeletonBinding) -> Bound:
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

        return Bound(Surface(name, rest, NO_TRIANGLES), attached, to_world, own_to_rest, bind_to_rest, deform)
    blended = read_blend_shapes(source, binding, len(points), own_to_rest[:3, :3])
    shapes_, weights = blended if blended else (None, None)
    if shapes_ is not None:
        attached = np.column_stack([attached, _shape_rows(shapes_, len(points))])
    skinning = None
    if not influences.rigid:
        skinning = Skinning(influences.indices, influences.weights, influences.method)
    motion = SkinnedMotion(skeleton, anchor, influences.used, weights)
    surface = Surface(name, rest, NO_TRIANGLES, motion, skinning, shapes_)
    return Bound(surface, attached, to_world, own_to_rest, bind_to_rest)


def _blended(source: Source, binding: SkeletonBinding, points: np.ndarray) -> Callable[[float], np.ndarray] | None:
    read = read_blend_shapes(source, binding, len(points), np.eye(3))
    if read is None:
        return None
    held, weights = read
    return lambda code: add_shapes(points, held, weights(code))


def keep_points(surface: Surface, kept: np.ndarray, triangles: np.ndarray, motion: Motion) -> Surface:
    """The surface with only the points `kept`, these triangles of them, and the motion that moves those."""
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
        motion=motion,
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
