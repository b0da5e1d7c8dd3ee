"""Normals of ribbons, and the segments that carry them."""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read import values
from plait.pipeline.read.curves import Curves, Polylines, varying_positions
from plait.pipeline.read.roots import Rooted
from plait.pipeline.read.source import Source
from plait.pipeline.shot import Normals

# Below it a normal has no direction.
LEAST = 1e-12


def read_normals(source: Source, curves: Curves, lines: Polylines, rooted: Rooted) -> Normals | None:
    """Authored normals in the space of the strands' points, as many as authored; None, with a warning, if unfit.

    `primvars:normals` comes before `normals`. Normals that fit no interpolation, have no direction, or are one for
    several curves cannot turn with the hair, and the result has none.
    """
    name, interpolation, given = authored_normals(source, curves.prim)
    if not len(given):
        return None
    drawn = _drawn_points(curves, interpolation)
    if drawn is None or len(drawn) != len(given):
        problem = f"{len(given)} values, interpolation {interpolation}, do not follow the curves"
        source.warn(f"{problem}; the result has none", curves.prim, name)
        return None
    points = lines.point_map[drawn].astype(np.int64)
    strand = np.searchsorted(lines.offsets, points, side="right") - 1
    # The inverse transpose keeps normals across what they are normal to under uneven scale.
    turned = np.einsum("nji,nj->ni", np.linalg.inv(rooted.to_rest[strand, :3, :3]), given)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    if length.min() <= LEAST:
        source.warn("some have no direction; the result has none", curves.prim, name)
        return None
    last = lines.offsets[strand + 1] - 2
    return Normals(turned / length, np.minimum(points, last))


def authored_normals(source: Source, prim: Usd.Prim) -> tuple[str, str, np.ndarray]:
    """(attribute, interpolation, (n, 3) values); no values where none are authored."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if primvar and primvar.HasAuthoredValue():
        held = primvar.ComputeFlattened(source.start)
        if held is None:
            raise source.error("its indices do not fit its values", prim, primvar.GetName(), "mend the indices")
        given = values.checked(source, prim, primvar.GetName(), held)
        return primvar.GetName(), str(primvar.GetInterpolation()), given.reshape(len(given), -1)
    schema = UsdGeom.PointBased(prim)
    attribute = schema.GetNormalsAttr()
    given = values.vectors(source, attribute) if attribute.HasAuthoredValue() else np.zeros((0, 3))
    return attribute.GetName(), str(schema.GetNormalsInterpolation()), given


def _drawn_points(curves: Curves, interpolation: str) -> np.ndarray | None:
    """The drawn point that each normal is at; a normal for a whole curve is at its middle."""
    starts = curves.starts
    if interpolation == "vertex":
        return np.arange(len(curves.points))
    if interpolation == "varying":
        spans = varying_positions(curves)
        return np.concatenate([start + span for start, span in zip(starts, spans, strict=False)]).astype(np.int64)
    if interpolation == "uniform" or len(curves.counts) == 1:
        return (starts[:-1] + curves.counts // 2).astype(np.int64)
    return None
