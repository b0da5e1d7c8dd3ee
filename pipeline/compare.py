"""One cache against another, prim by prim, in metres."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline import layers
from plait.pipeline.errors import UsageError
from plait.pipeline.read import shapes

# A tenth of a millimetre: no wider than a hair, far below a pixel where a character fills the picture, and far
# above what float32 rounding alone moves hair by.
DEFAULT_TOLERANCE = 1e-4


@dataclass(frozen=True)
class PrimComparison:
    """How far one prim's points are from the reference's, in world space.

    codes: (n,) time codes that both have; one for a prim whose points are not animated.
    largest, mean: (n,) [m], over the prim's points.  worst_point: (n,) the point that `largest` is of.
    length_change: (n,) curves only, else None: the relative change of length, new / reference - 1, of the strand
        that changed most.
    first_beyond: the first code at which `largest` is beyond the tolerance, or None.
    problems: what makes the prims different whatever the distances: missing, counts, frames, values not finite.
    """

    path: str
    type_name: str
    points: int
    codes: np.ndarray
    largest: np.ndarray
    mean: np.ndarray
    worst_point: np.ndarray
    length_change: np.ndarray | None = None
    first_beyond: float | None = None
    problems: tuple[str, ...] = ()

    @property
    def same(self) -> bool:
        return not self.problems and self.first_beyond is None

    @property
    def worst(self) -> int:
        """Index into `codes` of the largest distance; there is one whenever `codes` is not empty."""
        return int(np.argmax(self.largest))


@dataclass(frozen=True)
class Comparison:
    """The judgement. `problems`: what differs between the stages themselves."""

    reference: Path
    new: Path
    tolerance: float
    prims: tuple[PrimComparison, ...]
    problems: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        return not self.problems and all(prim.same for prim in self.prims)

    def to_dict(self) -> dict[str, Any]:
        """As `--json` prints it."""
        return {
            "same": self.ok,
            "reference": str(self.reference),
            "new": str(self.new),
            "tolerance": self.tolerance,
            "problems": list(self.problems),
            "prims": [_prim_dict(prim) for prim in self.prims],
        }

    def lines(self) -> list[str]:
        """As the console prints it, a line a prim, differences last, then the judgement."""
        ordered = sorted(self.prims, key=lambda prim: not prim.same)
        verdict = "same" if self.ok else "different"
        return [
            *map(_prim_line, ordered),
            *self.problems,
            f"{verdict}: {sum(prim.same for prim in self.prims)} of {len(self.prims)} prims within "
            f"{self.tolerance:g} m",
        ]


def compare(reference: Path, new: Path, tolerance: float = DEFAULT_TOLERANCE) -> Comparison:
    """Compares all curves, meshes, points and simple shapes (by the corners of their boxes) of two stages.

    At every time sample that both have: of the points, else of the transforms that move them.
    Different units are converted; different rates or up axes are a difference. Missing prims, different point or
    strand counts, different sample times and values that are not finite count as different at any tolerance; a
    prim is compared up to the first such sample. Points that have ids are matched by them.

    Raises UsageError for a tolerance that is negative or not a number, InputError for a file that does not open or
    of which chunks, layers or references are missing.
    """
    if not tolerance >= 0.0:
        raise UsageError(f"--tolerance {tolerance}: give metres, 0 or more")
    stages = layers.open_whole(reference), layers.open_whole(new)
    found = [_point_prims(stage) for stage in stages]
    prims = [
        _compare_prim(path, stages, tolerance)
        if path in found[0] and path in found[1]
        else _missing(path, "new" if path in found[0] else "reference")
        for path in sorted({*found[0], *found[1]})
    ]
    return Comparison(reference, new, tolerance, tuple(prims), tuple(_stage_problems(*stages)))


def show(
    reference: Path,
    new: Path,
    *,
    tolerance: float | None = None,
    as_json: bool = False,
    report: Path | None = None,
) -> bool:
    """The command: prints the judgement, writes the page if asked; True when the two are the same."""
    result = compare(reference, new, DEFAULT_TOLERANCE if tolerance is None else tolerance)
    print(json.dumps(result.to_dict(), indent=1) if as_json else "\n".join(result.lines()))
    if report is not None:
        from plait.pipeline.report import write_report

        write_report(result, report)
    return result.ok


def _stage_problems(reference: Usd.Stage, new: Usd.Stage) -> Iterable[str]:
    if not _point_prims(reference):
        yield "the reference has nothing to compare with"
    for name, get in (
        ("time codes per second", Usd.Stage.GetTimeCodesPerSecond),
        ("up axis", UsdGeom.GetStageUpAxis),
    ):
        if get(reference) != get(new):
            yield f"{name}: {get(reference)} in the reference, {get(new)} in the new"


def _point_prims(stage: Usd.Stage) -> set[str]:
    """Paths of all prims that have points, and of shapes; those in instances too."""
    prims = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    return {str(prim.GetPath()) for prim in prims if prim.IsA(UsdGeom.PointBased) or shapes.is_shape(prim)}


def _missing(path: str, where: str) -> PrimComparison:
    none = np.zeros(0)
    return PrimComparison(path, "", 0, none, none, none, none, problems=(f"missing in the {where}",))


class _Prim:
    """A prim's points and topology over time, in world metres."""

    def __init__(self, stage: Usd.Stage, path: str) -> None:
        self.prim = stage.GetPrimAtPath(path)
        self._meters = UsdGeom.GetStageMetersPerUnit(stage)
        self._points = UsdGeom.PointBased(self.prim).GetPointsAttr()
        self._curves = UsdGeom.Curves(self.prim)
        self.codes = tuple(self._points.GetTimeSamples() if self._points else ()) or _moves(self.prim)

    def points(self, code: Usd.TimeCode) -> np.ndarray:
        """(n, 3) float64 [m]; values that are not finite stay so, and are the caller's to judge."""
        held = self._points.Get(code) if self._points else _corners(self.prim, code)
        local = np.array(held, np.float64).reshape(-1, 3) if held is not None else np.zeros((0, 3))
        matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(self.prim))
        with np.errstate(invalid="ignore"):
            return (local @ matrix[:3, :3] + matrix[3, :3]) * self._meters

    def ids(self, code: Usd.TimeCode) -> np.ndarray | None:
        """(n,) of Points, by which they are matched; None where there are none."""
        points = UsdGeom.Points(self.prim)
        held = points.GetIdsAttr().Get(code) if points else None
        return np.array(held, np.int64) if held is not None and len(held) else None

    def strand_counts(self, code: Usd.TimeCode) -> tuple[int, ...] | None:
        """Points of each curve, or None for what is no curves."""
        if not self._curves:
            return None
        return tuple(self._curves.GetCurveVertexCountsAttr().Get(code) or ())


def _moves(prim: Usd.Prim) -> tuple[float, ...]:
    """Time codes at which the place of a prim is authored, by its own transform or those above."""
    codes: set[float] = set()
    while prim and not prim.IsPseudoRoot():
        xformable = UsdGeom.Xformable(prim)
        codes |= {*xformable.GetTimeSamples()} if xformable else set()
        prim = prim.GetParent() if not (xformable and xformable.GetResetXformStack()) else None
    return tuple(sorted(codes))


def _corners(shape: Usd.Prim, code: Usd.TimeCode) -> list[tuple[float, ...]]:
    """Those of a shape's box: where they are, the shape is."""
    box = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(shape), code) or []
    return list(itertools.product(*zip(*box, strict=True)))


def _compare_prim(path: str, stages: tuple[Usd.Stage, Usd.Stage], tolerance: float) -> PrimComparison:
    reference, new = (_Prim(stage, path) for stage in stages)
    problems = []
    if reference.codes != new.codes:
        problems.append(f"sample times differ: {_range(reference.codes)} in the reference, {_range(new.codes)}")
    shared = sorted({*reference.codes} & {*new.codes}) or reference.codes or new.codes
    rows, codes, count = [], [], 0
    for code in shared or [stages[0].GetStartTimeCode()]:
        row, problem, count = _compare_sample(reference, new, Usd.TimeCode(code))
        if problem:
            problems.append(f"{problem}, from frame {code:g}")
            break
        codes.append(code)
        rows.append(row)
    largest, mean, worst, length = np.array(rows, np.float64).reshape(-1, 4).T
    beyond = np.flatnonzero(largest > tolerance)
    return PrimComparison(
        path,
        reference.prim.GetTypeName(),
        count,
        np.array(codes),
        largest,
        mean,
        worst.astype(int),
        None if reference.strand_counts(Usd.TimeCode.EarliestTime()) is None else length,
        codes[beyond[0]] if len(beyond) else None,
        tuple(problems),
    )


def _compare_sample(
    reference: _Prim, new: _Prim, code: Usd.TimeCode
) -> tuple[tuple[float, float, int, float], str, int]:
    """((largest, mean, worst point, length change), problem, count) at one time; distances only if no problem."""
    nothing = (0.0, 0.0, 0, 0.0)
    expected, found = reference.points(code), new.points(code)
    counts, count = reference.strand_counts(code), len(expected)
    if len(found) != count:
        return nothing, f"{len(found)} points, not {count}", count
    if counts != new.strand_counts(code):
        return nothing, "other numbers of points on its curves", count
    if counts is not None and sum(counts) != count:
        return nothing, f"{count} points for curves of {sum(counts)}", count
    order = _matching(reference.ids(code), new.ids(code), count)
    if order is None:
        return nothing, "other ids", count
    found = found[order]
    for name, points in (("reference", expected), ("new", found)):
        if not np.isfinite(points).all():
            return nothing, f"points of the {name} are not finite", count
    if count == 0:
        return nothing, "", 0
    distances = np.linalg.norm(found - expected, axis=1)
    worst = int(np.argmax(distances))
    change = _length_change(expected, found, counts) if counts else 0.0
    return (float(distances[worst]), float(distances.mean()), worst, change), "", count


def _matching(expected: np.ndarray | None, found: np.ndarray | None, count: int) -> np.ndarray | None:
    """(count,) which of the new points each of the reference's is, by ids where both have them; None: no match."""
    if expected is None or found is None or len(expected) != count or len(found) != count:
        return np.arange(count)
    order = np.argsort(found, kind="stable")[np.argsort(np.argsort(expected, kind="stable"), kind="stable")]
    return order if np.array_equal(found[order], expected) else None


def _length_change(expected: np.ndarray, found: np.ndarray, counts: tuple[int, ...]) -> float:
    before, after = strand_lengths(expected, counts), strand_lengths(found, counts)
    change = np.divide(after, before, out=np.ones_like(after), where=before > 0.0) - 1.0
    return float(change[np.argmax(np.abs(change))])


def strand_lengths(points: np.ndarray, counts: tuple[int, ...]) -> np.ndarray:
    """(strand count,): length along the points of each curve, of (n, 3) points in order."""
    ends = np.cumsum(counts)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    firsts = np.minimum(ends - np.array(counts), len(points) - 1)
    return np.where(np.array(counts) > 0, along[ends - 1] - along[firsts], 0.0)


def _range(codes: tuple[float, ...]) -> str:
    return f"{len(codes)} samples, {codes[0]:g} to {codes[-1]:g}," if codes else "none"


def _prim_dict(prim: PrimComparison) -> dict[str, Any]:
    held: dict[str, Any] = {"path": prim.path, "type": prim.type_name, "points": prim.points, "same": prim.same}
    held["problems"] = list(prim.problems)
    if len(prim.codes):
        worst = prim.worst
        held |= {
            "frames": len(prim.codes),
            "largest": float(prim.largest[worst]),
            "largest_frame": float(prim.codes[worst]),
            "largest_point": int(prim.worst_point[worst]),
            "mean": float(prim.mean.mean()),
            "first_beyond": prim.first_beyond,
        }
        if prim.length_change is not None:
            held["length_change"] = _extreme(prim.length_change)
    return held


def _prim_line(prim: PrimComparison) -> str:
    parts = []
    if len(prim.codes):
        worst = prim.worst
        place = f"frame {prim.codes[worst]:g}, point {prim.worst_point[worst]}"
        parts.append(f"largest {prim.largest[worst]:.3g} m at {place}; mean {prim.mean.mean():.3g} m")
        if prim.length_change is not None:
            parts.append(f"length {100.0 * _extreme(prim.length_change):+.3g} %")
    if prim.first_beyond is not None:
        parts.append(f"beyond tolerance from frame {prim.first_beyond:g}")
    return f"{'  ' if prim.same else '! '}{prim.path}: " + "; ".join([*parts, *prim.problems])


def _extreme(values: np.ndarray) -> float:
    return float(values[np.argmax(np.abs(values))])
