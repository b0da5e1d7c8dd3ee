"""BasisCurves: what is drawn, and the polylines that are simulated for it.

Rods run through the control points, which then are the result as they stand: they lie on linear and Catmull-Rom
curves, and a b-spline smooths its own polygon, whatever shape that takes. Only Bezier handles are replaced, by
points of the curve (see `bezier`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read import bezier, values
from plait.pipeline.read.source import Source

# On curves that follow guides, whose.
GUIDES = "plait:guides"
# A segment below this part of its strand's length is a repeated point.
REPEATED = 1e-6
# A strand without length follows its root as a stub of this part of the prim's median length.
STUB = 0.01


@dataclass(frozen=True)
class Curves:
    """What is drawn: points (n, 3) float64 [stage units, the prim's own space] and counts (curve_count,).

    nodes: (n, 3), what is simulated for each drawn point: itself, or for a Bezier handle a point of the curve.
    """

    prim: Usd.Prim
    points: np.ndarray
    nodes: np.ndarray
    counts: np.ndarray
    animated: bool

    @property
    def path(self) -> str:
        return str(self.prim.GetPath())

    @property
    def starts(self) -> np.ndarray:
        """(curve_count + 1,) first point of each curve, and the end."""
        return np.concatenate([[0], np.cumsum(self.counts)]).astype(np.int64)

    @property
    def curve_of_point(self) -> np.ndarray:
        return np.repeat(np.arange(len(self.counts)), self.counts)


@dataclass(frozen=True)
class Polylines:
    """What is simulated. One strand a curve that has points, in their order.

    curves: (strand_count,) the curve of each strand.  offsets: (strand_count + 1,) int32.
    source_points: (point_count,) the drawn point of each simulated one; a stub's tip has its root's.
    stub_tips: (stub_count,) simulated points that nothing was drawn for.
    point_map: (drawn point count,) int32.
    """

    curves: np.ndarray
    offsets: np.ndarray
    source_points: np.ndarray
    stub_tips: np.ndarray
    point_map: np.ndarray

    @property
    def roots(self) -> np.ndarray:
        """(strand_count,) the drawn point of each root."""
        return self.source_points[self.offsets[:-1]]

    def select(self, chosen: np.ndarray) -> tuple[Polylines, np.ndarray]:
        """Some strands, (strand_count,) bool, and which points they have; `point_map` is -1 at others'."""
        count = np.diff(self.offsets)
        points = np.nonzero(np.repeat(chosen, count))[0]
        number = np.full(int(self.offsets[-1]), -1, dtype=np.int32)
        number[points] = np.arange(len(points))
        tips = number[self.stub_tips]
        return Polylines(
            self.curves[chosen],
            np.concatenate([[0], np.cumsum(count[chosen])]).astype(np.int32),
            self.source_points[points],
            tips[tips >= 0],
            number[self.point_map],
        ), points


def refusal(prim: Usd.Prim) -> str:
    """Why a curves prim cannot be simulated whatever its values are; '' if it can."""
    if not prim.IsA(UsdGeom.BasisCurves):
        return f"{prim.GetTypeName()} are not simulated; convert them to BasisCurves"
    if UsdGeom.BasisCurves(prim).GetWrapAttr().Get() == UsdGeom.Tokens.periodic:
        return "closed loops (wrap periodic) have no root and no tip; make them nonperiodic or pinned"
    return ""


def names_guides(prim: Usd.Prim) -> bool:
    """Whether the prim says which guides its curves follow."""
    relationship = prim.GetRelationship(GUIDES)
    return bool(relationship) and bool(relationship.GetForwardedTargets())


def sizes(prim: Usd.Prim, source: Source) -> dict[str, int]:
    """Counts for a report."""
    curves = UsdGeom.Curves(prim)
    counts = curves.GetCurveVertexCountsAttr().Get(source.start)
    return {"strands": len(counts or []), "points": int(np.sum(counts)) if counts else 0}


def is_empty(prim: Usd.Prim, source: Source) -> bool:
    """Whether neither counts nor points are there; one without the other is a mistake."""
    schema = UsdGeom.Curves(prim)
    attributes = schema.GetCurveVertexCountsAttr(), schema.GetPointsAttr()
    return not any(attribute.Get(source.start) for attribute in attributes)


def topology_change(source: Source, prim: Usd.Prim) -> float | None:
    """The first time code at which the counts differ from the first frame's; None if they never do."""
    attribute = UsdGeom.Curves(prim).GetCurveVertexCountsAttr()
    codes = attribute.GetTimeSamples()
    if len(codes) < 2:
        return None
    counts = values.integers(source, attribute)
    return next((c for c in codes if not np.array_equal(values.integers(source, attribute, c), counts)), None)


def read_curves(source: Source, prim: Usd.Prim) -> Curves:
    """Raises InputError for counts that do not fit, values that are not finite, topology that changes."""
    curves = UsdGeom.BasisCurves(prim)
    points_attribute, counts_attribute = curves.GetPointsAttr(), curves.GetCurveVertexCountsAttr()
    counts = values.integers(source, counts_attribute)
    points = values.steady_vectors(source, points_attribute)
    values.check_sizes(source, counts_attribute, counts, points_attribute, len(points))
    if not len(points):
        raise source.error(
            "is empty", prim, "points", "author points, deactivate the prim, or plait:role = 'none'"
        )
    change = topology_change(source, prim)
    if change is not None:
        raise source.error(
            f"changes at time code {change:g}", prim, "curveVertexCounts", "the topology must not change"
        )
    nodes = bezier.on_curve(points, counts) if is_bezier(prim) else points
    return Curves(prim, points, nodes, counts, points_attribute.ValueMightBeTimeVarying())


def is_bezier(prim: Usd.Prim) -> bool:
    schema = UsdGeom.BasisCurves(prim)
    cubic = schema.GetTypeAttr().Get() == UsdGeom.Tokens.cubic
    return cubic and schema.GetBasisAttr().Get() == UsdGeom.Tokens.bezier


def polylines(curves: Curves) -> Polylines | None:
    """Repeated points collapsed to one; None if no curve of the prim has any length."""
    owner, step = curves.curve_of_point, _steps(curves)
    first = np.concatenate([[True], owner[1:] != owner[:-1]])
    lengths = np.bincount(owner, step, minlength=len(curves.counts))
    kept = first | (step > REPEATED * lengths[owner])
    simulated = np.bincount(owner, kept, minlength=len(curves.counts)).astype(np.int64)
    if simulated.max(initial=0) < 2:
        return None
    strands = np.nonzero(simulated)[0]
    # A strand of one point gets a second, its stub.
    offsets = np.concatenate([[0], np.cumsum(np.maximum(simulated[strands], 2))])
    strand_of_curve = np.cumsum(simulated > 0) - 1
    rank = np.cumsum(kept) - 1
    rank_of_root = np.zeros(len(curves.counts), dtype=np.int64)
    rank_of_root[owner[first]] = rank[first]
    point_map = offsets[:-1][strand_of_curve[owner]] + rank - rank_of_root[owner]
    stubs = np.nonzero(simulated[strands] < 2)[0]
    tips = offsets[stubs] + 1
    source_points = np.zeros(offsets[-1], dtype=np.int64)
    source_points[point_map[kept]] = np.nonzero(kept)[0]
    source_points[tips] = source_points[offsets[stubs]]
    return Polylines(strands, offsets.astype(np.int32), source_points, tips, point_map.astype(np.int32))


def stub_length(curves: Curves) -> float:
    """[stage units]"""
    lengths = np.bincount(curves.curve_of_point, _steps(curves))
    return STUB * float(np.median(lengths[lengths > 0.0]))


def _steps(curves: Curves) -> np.ndarray:
    """(n,) the distance of each node from the one before it on its curve; zero for the first."""
    owner = curves.curve_of_point
    step = np.linalg.norm(np.diff(curves.nodes, axis=0, prepend=curves.nodes[:1]), axis=1)
    step[np.concatenate([[True], owner[1:] != owner[:-1]])] = 0.0
    return step


def read_widths(source: Source, curves: Curves) -> np.ndarray | None:
    """Diameters at the drawn points, (n,) [stage units], or None where none are drawn.

    `primvars:widths` comes before `widths`. Raises InputError for counts that fit no interpolation, and for
    negative or infinite values.
    """
    schema = UsdGeom.BasisCurves(curves.prim)
    primvar = UsdGeom.PrimvarsAPI(curves.prim).GetPrimvar("widths")
    if primvar and primvar.HasAuthoredValue():
        name, interpolation = primvar.GetName(), primvar.GetInterpolation()
        given = primvar.ComputeFlattened(source.start)
        widths = values.checked(source, curves.prim, name, given) if given is not None else np.zeros(0)
    else:
        attribute = schema.GetWidthsAttr()
        name, interpolation = attribute.GetName(), schema.GetWidthsInterpolation()
        widths = values.scalars(source, attribute)
    if not len(widths):
        return None
    if widths.min() < 0.0:
        raise source.error("is negative", curves.prim, name, "author diameters")
    return _to_points(source, curves, name, str(interpolation), widths)


def _to_points(source: Source, curves: Curves, name: str, interpolation: str, data: np.ndarray) -> np.ndarray:
    spans = varying_positions(curves)
    wanted = {
        "constant": 1,
        "uniform": len(curves.counts),
        "varying": sum(len(span) for span in spans),
        "vertex": len(curves.points),
    }
    # One value is meant for all, and one a point as such, whatever interpolation a writer left at its default.
    if len(data) != wanted.get(interpolation, -1):
        fitting = [key for key in ("constant", "vertex", "uniform") if wanted[key] == len(data)]
        needed = wanted.get(interpolation, "another kind of prim")
        if not fitting:
            raise source.error(
                f"has {len(data)} values, interpolation {interpolation} needs {needed}",
                curves.prim,
                name,
                "author a value for each, or one with interpolation constant",
            )
        source.warn(
            f"has {len(data)} values, interpolation {interpolation} needs {needed}; taken as {fitting[0]}",
            curves.prim,
            name,
        )
        interpolation = fitting[0]
    if interpolation == "constant":
        return np.full(len(curves.points), data[0])
    if interpolation == "uniform":
        return data[curves.curve_of_point]
    if interpolation == "vertex":
        return data
    result, first = np.zeros(len(curves.points)), 0
    for start, count, span in zip(curves.starts, curves.counts, spans, strict=False):
        own = data[first : first + len(span)]
        first += len(span)
        if count:
            result[start : start + count] = np.interp(np.arange(count), span, own) if len(span) else 0.0
    return result


def varying_positions(curves: Curves) -> list[np.ndarray]:
    """For each curve, the control points beside which its segments begin and end: where `varying` values sit."""
    schema = UsdGeom.BasisCurves(curves.prim)
    cubic = schema.GetTypeAttr().Get() == UsdGeom.Tokens.cubic
    pinned = schema.GetWrapAttr().Get() == UsdGeom.Tokens.pinned
    bezier = schema.GetBasisAttr().Get() == UsdGeom.Tokens.bezier
    spans = []
    for count in curves.counts:
        if not cubic or count < 2 or (pinned and not bezier):
            spans.append(np.arange(count))
        elif bezier:
            spans.append(np.arange(0, count, 3))
        else:
            spans.append(np.arange(1, count - 1))
    return spans
