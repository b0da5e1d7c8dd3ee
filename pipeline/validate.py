"""Is a written stage sound? USD's own validators against those of its source, and what they do not look at."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel, UsdValidation

from plait.pipeline import layers

# Own checks compare float32 sums with float32 bounds: a few units in the last place.
_ROUNDING = 4.0 * float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Finding:
    """One thing wrong: which check says so, at which prim or property ('' for the stage), and its words."""

    check: str
    place: str
    message: str

    def __str__(self) -> str:
        return f"<{self.place}> {self.message} ({self.check})"


def validate(result: Path, source: Path | None = None) -> list[Finding]:
    """What is wrong with `result`: validator findings that `source` does not have, and all of the own checks.

    source: by default the weakest sublayer of `result`. A flattened result has none, and answers for everything.
    Raises InputError for a file that does not open.
    """
    stage = layers.open_stage(result)
    source = source or layers.source_path(stage.GetRootLayer())
    inherited = Counter(map(_key, validator_findings(layers.open_stage(source)))) if source else Counter()
    new = []
    for finding in validator_findings(stage):
        if inherited[_key(finding)] > 0:
            inherited[_key(finding)] -= 1
        else:
            new.append(finding)
    return [*new, *own_findings(stage)]


def validator_findings(stage: Usd.Stage) -> list[Finding]:
    """What every validator that this USD has says of `stage`: errors, warnings and remarks alike."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    return [Finding(str(error.GetIdentifier()), _place(error), error.GetMessage()) for error in errors]


def _place(error: UsdValidation.ValidationError) -> str:
    paths = []
    for site in error.GetSites():
        if site.IsProperty():
            paths.append(str(site.GetProperty().GetPath()))
        elif site.IsPrim():
            paths.append(str(site.GetPrim().GetPath()))
    return " ".join(sorted(paths))


def _key(finding: Finding) -> tuple[str, str]:
    """Findings are the same in source and result when the check and the place are: messages name files."""
    return finding.check, finding.place


def own_findings(stage: Usd.Stage) -> list[Finding]:
    """Of the simulated prims: skinned a second time, not finite, changing counts, extents that are too small."""
    prims = layers.simulated_prims(stage.GetRootLayer())
    missing = layers.missing_chunks(stage)
    if missing:
        return [Finding("plait:Missing", "", f"{name} is not there") for name in missing]
    skinned = skinned_prims(stage)
    found = [Finding("plait:SkinnedTwice", path, "is skinned again") for path in prims if path in skinned]
    for path in prims:
        prim = stage.GetPrimAtPath(path)
        if not prim:
            found.append(Finding("plait:Missing", path, "is not on the stage"))
        elif UsdGeom.PointBased(prim):
            found.extend(_sample_findings(UsdGeom.PointBased(prim)))
    return found


def skinned_prims(stage: Usd.Stage) -> set[str]:
    """Paths of all prims that UsdSkel skins."""
    skinned = set()
    predicate = Usd.TraverseInstanceProxies()
    for prim in Usd.PrimRange.Stage(stage, predicate):
        if prim.IsA(UsdSkel.Root):
            cache = UsdSkel.Cache()
            cache.Populate(UsdSkel.Root(prim), predicate)
            for binding in cache.ComputeSkelBindings(UsdSkel.Root(prim), predicate):
                skinned.update(str(query.GetPrim().GetPath()) for query in binding.GetSkinningTargets())
    return skinned


# What is looked at in every sample of a prim's points.
_WATCHED = ("points", "velocities", "extent", "normals", "ids", "widths")


def _sample_findings(prim: UsdGeom.PointBased) -> Iterator[Finding]:
    path, points = str(prim.GetPath()), prim.GetPointsAttr()
    changing = _changes(prim)
    count = None if changing else _expected_count(prim)
    attributes = [found for found in map(prim.GetPrim().GetAttribute, _WATCHED) if found.HasAuthoredValue()]
    for code in points.GetTimeSamples():
        place = f"at frame {code:g}"
        values = {
            attribute.GetName(): np.array(attribute.Get(code))
            for attribute in attributes
            if attribute.Get(code) is not None
        }
        for name, value in values.items():
            if not np.isfinite(value).all():
                yield Finding("plait:NotFinite", f"{path}.{name}", f"has values that are not finite {place}")
        each = ("points", "velocities", "ids", "widths") if changing else ("points", "velocities")
        sizes = {name: len(values[name]) for name in each if name in values}
        count = sizes["points"] if count is None or changing else count
        for name, size in sizes.items():
            if size != count:
                yield Finding("plait:Count", f"{path}.{name}", f"has {size} values, not {count}, {place}")
        named = _named_points(prim, code)
        if sizes["points"] < named:
            yield Finding(
                "plait:Count", f"{path}.points", f"has {sizes['points']} values, faces use {named}, {place}"
            )
        if "extent" not in values or not _contains(values["extent"], values["points"], prim, code):
            yield Finding("plait:Extent", f"{path}.extent", f"does not hold all points {place}")


def _changes(prim: UsdGeom.PointBased) -> bool:
    """Whether the number of points may change: of grains, which are poured in, and of the surface about them."""
    if prim.GetPrim().IsA(UsdGeom.Points):
        return True
    faces = UsdGeom.Mesh(prim)
    return bool(faces) and faces.GetFaceVertexIndicesAttr().ValueMightBeTimeVarying()


def _expected_count(prim: UsdGeom.PointBased) -> int | None:
    """How many points the topology asks for; None where it does not tell."""
    curves = UsdGeom.Curves(prim)
    counts = curves.GetCurveVertexCountsAttr().Get(Usd.TimeCode.EarliestTime()) if curves else None
    return None if counts is None else int(sum(counts))


def _named_points(prim: UsdGeom.PointBased, code: float) -> int:
    """How many points the faces or tets of a mesh need at least."""
    names = {UsdGeom.Mesh: "faceVertexIndices", UsdGeom.TetMesh: "tetVertexIndices"}
    for schema, name in names.items():
        if prim.GetPrim().IsA(schema):
            indices = np.array(prim.GetPrim().GetAttribute(name).Get(code) or [])
            return int(indices.max(initial=-1)) + 1
    return 0


def _contains(extent: np.ndarray, points: np.ndarray, prim: UsdGeom.PointBased, code: float) -> bool:
    """Whether the points are inside, each widened by half its own width where widths are per point or constant."""
    half = np.zeros((1, 1), np.float32)
    widened = UsdGeom.Curves(prim) or UsdGeom.Points(prim)
    widths = widened.GetWidthsAttr().Get(code) if widened else None
    if widths is not None and len(widths) in (1, len(points)):
        half = 0.5 * np.array(widths, np.float32)[:, None]
    slack = _ROUNDING * float(np.abs(extent).max())
    if not len(points):
        return True
    inside = (points - half >= extent[0] - slack) & (points + half <= extent[1] + slack)
    return bool(inside.all())
