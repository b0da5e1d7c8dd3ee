"""Surfaces that nobody drew: one triangle a strand, for strands that grow on no skin or on several."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd

from plait.pipeline.read import values
from plait.pipeline.read.curves import Curves, Polylines
from plait.pipeline.read.motions import (
    Anchor,
    Placement,
    RigidMotion,
    SkinnedMotion,
    transform,
)
from plait.pipeline.read.placing import place_points
from plait.pipeline.read.skeletons import SkeletonBinding, read_geom_bind, read_influences
from plait.pipeline.read.source import Source
from plait.solver.scene import Pose, Skinning, Surface


@dataclass(frozen=True)
class Carrier:
    """A hidden surface whose triangle s carries strand s, at its first corner.

    to_rest: (4, 4), the curves' own space [stage units] to its rest points [m].
    rest_to_world: (4, 4), rest points to scene coordinates where the artist drew them.
    """

    surface: Surface
    to_rest: np.ndarray
    rest_to_world: np.ndarray
    how: str


def own_carrier(source: Source, curves: Curves, lines: Polylines, binding: SkeletonBinding | None) -> Carrier:
    """Roots that move as the curves prim itself does: by its skeleton, its animated points, or its transform."""
    corners = _root_triangles(curves, lines)
    triangles = np.arange(3 * len(lines.curves), dtype=np.int32).reshape(-1, 3)
    name = f"{curves.path} (roots)"
    if binding is not None and binding.query.HasJointInfluences():
        return _skinned_carrier(source, curves, lines, binding, corners, triangles, name)
    placement = Placement(source, curves.prim)
    anchor = Anchor.of(placement, source)
    to_rest = np.eye(4)
    to_rest[:3, :3] = anchor.linear * anchor.meters_per_unit
    to_world = anchor.undo(placement.metric(source.start))
    rest = anchor.points(corners)
    if curves.animated:
        motion, how = FollowingMotion.of(source, curves, lines, placement, transform(to_world, rest)), "points"
    else:
        motion, how = RigidMotion(source, placement, anchor), "transform"
    surface = Surface(name, rest, triangles, motion, collides=False)
    moving = "animated " if motion.animated else ""
    return Carrier(surface, to_rest, to_world, f"no skin near: the prim's own {moving}{how}")


def _skinned_carrier(
    source: Source,
    curves: Curves,
    lines: Polylines,
    binding: SkeletonBinding,
    corners: np.ndarray,
    triangles: np.ndarray,
    name: str,
) -> Carrier:
    influences = read_influences(source, binding, len(curves.points))
    skeleton = binding.skeleton
    anchor = Anchor.of(skeleton.placement, source)
    to_rest = skinned_to_rest(source, binding, anchor)
    rows = np.repeat(lines.roots, 3)
    skinning = None
    if not influences.rigid:
        skinning = Skinning(influences.indices[rows], influences.weights[rows], influences.method)
    surface = Surface(
        name,
        transform(to_rest, corners),
        triangles,
        SkinnedMotion(skeleton, anchor, influences.used),
        skinning,
        collides=False,
    )
    to_world = anchor.undo(skeleton.placement.metric(source.start))
    return Carrier(surface, to_rest, to_world, "no skin near: the prim's own skeleton binding")


def skinned_to_rest(source: Source, binding: SkeletonBinding, anchor: Anchor) -> np.ndarray:
    """(4, 4), a skinned prim's own space [stage units] to rest points [m] beside those of its skeleton's skins."""
    linear = np.eye(4)
    linear[:3, :3] = anchor.linear * anchor.meters_per_unit
    return linear @ read_geom_bind(source, binding)


def _root_triangles(curves: Curves, lines: Polylines) -> np.ndarray:
    """(3 strand_count, 3) [stage units]: root, and two corners a first segment away across the strand."""
    roots = curves.nodes[lines.roots]
    along = curves.nodes[lines.source_points[lines.offsets[:-1] + 1]] - roots
    length = np.linalg.norm(along, axis=1, keepdims=True)
    stub = length[:, 0] == 0.0
    length[stub] = np.median(length[~stub])
    along[stub] = [0.0, 0.0, 1.0]
    first, second = perpendiculars(along)
    return np.stack([roots, roots + length * first, roots + length * second], axis=1).reshape(-1, 3)


def perpendiculars(along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across each of (n, 3) directions, right-handed with it."""
    axis = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    first = np.cross(along, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    return first, second / np.linalg.norm(second, axis=1, keepdims=True)


@dataclass
class FollowingMotion:
    """Root triangles that follow animated curve points.

    Position from the root; rotation from the whole prim's best fit (Kabsch 1976), then from the root segment by
    the shortest arc.

    roots, seconds: (strand_count,) points of the prim.  rest_points: (n, 3) world at the first frame.
    offsets: (strand_count, 3, 3), corners from their root, world at the first frame.
    """

    source: Source
    attribute: Usd.Attribute
    placement: Placement
    roots: np.ndarray
    seconds: np.ndarray
    rest_points: np.ndarray
    offsets: np.ndarray
    animated: bool = True

    @staticmethod
    def of(
        source: Source, curves: Curves, lines: Polylines, placement: Placement, corners: np.ndarray
    ) -> FollowingMotion:
        corners = corners.reshape(-1, 3, 3)
        meters = curves.points * source.units.meters_per_unit
        return FollowingMotion(
            source,
            curves.prim.GetAttribute("points"),
            placement,
            lines.roots,
            lines.source_points[lines.offsets[:-1] + 1],
            transform(placement.metric(source.start), meters),
            corners - corners[:, :1],
        )

    def pose(self, time: float) -> Pose:
        code = self.source.code(time)
        points = values.vectors(self.source, self.attribute, code)
        values.check_count(self.source, self.attribute, code, points, len(self.rest_points))
        points = transform(self.placement.metric(code), points * self.source.units.meters_per_unit)
        whole = _best_rotation(self.rest_points, points)
        before = (self.rest_points[self.seconds] - self.rest_points[self.roots]) @ whole.T
        turns = _shortest_arcs(before, points[self.seconds] - points[self.roots])
        corners = np.einsum("sij,jk,sck->sci", turns, whole, self.offsets)
        return Pose(np.eye(4)[None], points=(points[self.roots, None] + corners).reshape(-1, 3))


def _best_rotation(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    covariance = (after - after.mean(axis=0)).T @ (before - before.mean(axis=0))
    u, sizes, vt = np.linalg.svd(covariance)
    if sizes[1] <= 1e-6 * sizes[0]:
        return np.eye(3)  # All points on one line: their rotation about it is unknown.
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return u @ flip @ vt


def _shortest_arcs(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rotations between directions; the identity where one has no length or they are opposite."""
    a = before / np.maximum(np.linalg.norm(before, axis=1, keepdims=True), 1e-300)
    b = after / np.maximum(np.linalg.norm(after, axis=1, keepdims=True), 1e-300)
    cosine = np.sum(a * b, axis=1)
    axis = np.cross(a, b)
    skew = np.zeros((len(a), 3, 3))
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    skew -= skew.transpose(0, 2, 1)
    usable = cosine > -1.0 + 1e-12
    factor = np.where(usable, 1.0 / np.where(usable, 1.0 + cosine, 1.0), 0.0)
    turns = cosine[:, None, None] * np.eye(3) + skew + factor[:, None, None] * axis[:, :, None] * axis[:, None, :]
    lost = ~usable | (np.sum(a * a, axis=1) < 0.5) | (np.sum(b * b, axis=1) < 0.5)
    turns[lost] = np.eye(3)
    return turns


@dataclass
class GatheredMotion:
    """Triangles gathered from several surfaces, placed on the host: `parts` are (surface, its points wanted)."""

    parts: tuple[tuple[Surface, np.ndarray], ...]

    @property
    def animated(self) -> bool:
        return any(surface.motion.animated for surface, _ in self.parts)

    def pose(self, time: float) -> Pose:
        placed = [place_points(surface, surface.motion.pose(time), wanted) for surface, wanted in self.parts]
        return Pose(np.eye(4)[None], points=np.concatenate(placed))
