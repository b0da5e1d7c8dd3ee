"""What a stage shows, at any time code, in metres: surfaces, curves and points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline import layers
from plait.pipeline.errors import InputError
from plait.pipeline.pictures import colours
from plait.pipeline.pictures.curves import Refinement, refinement
from plait.pipeline.read import roles
from plait.pipeline.read.carriers import place_points
from plait.pipeline.read.motions import Placement, transform
from plait.pipeline.read.skeletons import SkeletonBinding, Skeletons
from plait.pipeline.read.source import PREDICATE, Source
from plait.pipeline.read.surfaces import Bodies, Body
from plait.pipeline.read.triangles import triangulate

Points = Callable[[float], np.ndarray]


@dataclass(frozen=True)
class Drawable:
    """One prim. points: time code -> (n, 3) [m]. animated: they depend on the time code."""

    source: Source
    prim: Usd.Prim
    points: Points
    animated: bool

    def visible(self, code: float) -> bool:
        return UsdGeom.Imageable(self.prim).ComputeVisibility(code) != UsdGeom.Tokens.invisible


@dataclass(frozen=True)
class Shell(Drawable):
    """A mesh, a tet mesh's surface or a simple shape. opacity: 0 to 1."""

    body: Body
    opacity: float = 1.0

    @property
    def triangles(self) -> np.ndarray:
        """(m, 3) int32 into `points`."""
        return self.body.surface.triangles

    def corner_colours(self, code: float) -> np.ndarray:
        """(m, 3, 3) linear RGB."""
        return colours.of_corners(self.body, code)


@dataclass(frozen=True)
class Changing(Drawable):
    """A mesh whose faces change from sample to sample: the surface about grains."""

    def triangles(self, code: float) -> np.ndarray:
        """(m, 3) int32 into `points`."""
        mesh = UsdGeom.Mesh(self.prim)
        counts, indices = (
            np.array(attribute.Get(code) or [], np.int64)
            for attribute in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
        )
        if len(indices) != counts.sum() or indices.max(initial=-1) >= len(self.points(code)):
            raise self.source.error(f"do not fit its points at time code {code:g}", self.prim, "faceVertexIndices")
        left_handed = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
        return triangulate(self.points(code), counts, indices, left_handed)[0]

    def point_colours(self, code: float) -> np.ndarray:
        """(n, 3) linear RGB."""
        count = len(self.points(code))
        return colours.of_points(self.prim, code, count, np.arange(count))


@dataclass(frozen=True)
class Lines(Drawable):
    """Curves, already refined: `points` are those to draw."""

    refined: Callable[[float], Refinement]

    def counts(self, code: float) -> np.ndarray:
        """(line_count,) points to draw of each line that has any."""
        drawn = self.refined(code).drawn_counts
        return drawn[drawn > 0]

    def point_colours(self, code: float) -> np.ndarray:
        """(n, 3) linear RGB."""
        refined = self.refined(code)
        owner = np.repeat(np.arange(len(refined.counts)), refined.counts)
        return refined(colours.of_points(self.prim, code, len(owner), owner))

    def width(self, code: float) -> float:
        """Typical diameter [m]; 0 where none is authored."""
        return _width(self.source, self.prim, UsdGeom.Curves(self.prim).GetWidthsAttr(), code)


@dataclass(frozen=True)
class Dots(Drawable):
    """Points."""

    def point_colours(self, code: float) -> np.ndarray:
        """(n, 3) linear RGB."""
        count = len(self.points(code))
        return colours.of_points(self.prim, code, count, np.arange(count))

    def width(self, code: float) -> float:
        """Typical diameter [m]; 0 where none is authored."""
        return _width(self.source, self.prim, UsdGeom.Points(self.prim).GetWidthsAttr(), code)


def collect(source: Source) -> tuple[list[Drawable], list[str]]:
    """All with purpose default or render, and simulated guides; and why what cannot be drawn is left out."""
    skeletons, left_out = Skeletons(source), []
    bodies = Bodies(source, skeletons)
    simulated = layers.simulated_prims(source.stage.GetRootLayer())
    found = []
    for prim in source.stage.Traverse(PREDICATE):
        if not prim.IsA(UsdGeom.Gprim) or not _has_purpose(prim, str(prim.GetPath()) in simulated):
            continue
        try:
            found.extend(_drawable(source, prim, bodies, skeletons))
        except InputError as error:
            left_out.append(str(error))
    return found, left_out


def _has_purpose(prim: Usd.Prim, simulated: bool) -> bool:
    purpose = UsdGeom.Imageable(prim).ComputePurpose()
    shown = purpose in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
    return shown or (simulated and purpose == UsdGeom.Tokens.guide)


def _drawable(source: Source, prim: Usd.Prim, bodies: Bodies, skeletons: Skeletons) -> Iterator[Drawable]:
    if prim.IsA(UsdGeom.Mesh) and UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().ValueMightBeTimeVarying():
        yield Changing(source, prim, *_points_of(source, prim, None))
    elif roles.is_solid(prim):
        body = bodies.get(prim)
        if body is not None:
            surface, rate = body.surface, source.units.time_codes_per_second
            yield Shell(
                source,
                prim,
                lambda code: place_points(surface, surface.motion.pose(code / rate)),
                surface.motion.animated,
                body,
            )
    elif prim.IsA(UsdGeom.Curves):
        yield _lines(source, prim, skeletons.find(prim))
    elif prim.IsA(UsdGeom.Points):
        yield Dots(source, prim, *_points_of(source, prim, skeletons.find(prim)))


def _lines(source: Source, prim: Usd.Prim, binding: SkeletonBinding | None) -> Lines:
    attribute = UsdGeom.Curves(prim).GetCurveVertexCountsAttr()

    def at(code: float) -> Refinement:
        return refinement(prim, np.array(attribute.Get(code) or [], np.int64))

    steady = None if attribute.ValueMightBeTimeVarying() else at(source.start)
    refined = (lambda _: steady) if steady else at
    points, animated = _points_of(source, prim, binding)

    def drawn(code: float) -> np.ndarray:
        authored, counts = points(code), refined(code).counts
        if len(authored) != counts.sum():
            raise source.error(f"has {len(authored)} at time code {code:g}, not {counts.sum()}", prim, "points")
        return refined(code)(authored)

    drawn(source.start)  # so that what cannot be drawn is known at once
    return Lines(source, prim, drawn, animated or steady is None, refined)


def _points_of(source: Source, prim: Usd.Prim, binding: SkeletonBinding | None) -> tuple[Points, bool]:
    """Where the points of curves or points are, skinned as UsdSkel does it, and whether they move."""
    attribute, placement = UsdGeom.PointBased(prim).GetPointsAttr(), Placement(source, prim)

    def points(code: float) -> np.ndarray:
        held = attribute.Get(code)
        if held is None or not len(held):
            return np.zeros((0, 3))
        matrix = placement.matrix(code)
        if binding is not None and binding.query.HasJointInfluences():
            joints = binding.skeleton.query.ComputeSkinningTransforms(code)
            matrix = binding.skeleton.placement.matrix(code)
            if binding.query.IsRigidlyDeformed():
                matrix = matrix @ np.array(binding.query.ComputeSkinnedTransform(joints, code)).T
            else:
                binding.query.ComputeSkinnedPoints(joints, held, code)
        return source.units.meters_per_unit * transform(matrix, np.array(held, dtype=np.float64).reshape(-1, 3))

    moved = placement.animated or (binding is not None and binding.skeleton.animated)
    return points, moved or attribute.ValueMightBeTimeVarying()


def _width(source: Source, prim: Usd.Prim, attribute: Usd.Attribute, code: float) -> float:
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("widths")
    held = primvar.Get(code) if primvar and primvar.HasAuthoredValue() else attribute.Get(code)
    if held is None or not len(held):
        return 0.0
    scale = np.cbrt(abs(np.linalg.det(source.local_to_world(prim, code)[:3, :3])))
    return float(np.median(np.array(held)) * scale) * source.units.meters_per_unit
