"""Guides: strands that are simulated for others. The artist marks them, or names them on what follows.

A prim's curves follow the prims that its `plait:guides` names. Else, where `primvars:groom_guide` marks some of
its own curves, the rest follows those. Else it follows the prims that are guides as a whole, by `groom_guide` or
by purpose `guide`, and grow on the same skin, or lie beside it where neither grows on any. Nothing follows
unasked: without marks all strands are simulated, and so are those of a prim whose `plait:guides` is authored
empty.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read import values
from plait.pipeline.read.closest import nearest_points
from plait.pipeline.read.curves import GUIDES, Curves, names_guides
from plait.pipeline.read.groom import Groom
from plait.pipeline.read.source import Source

# How many guides a curve follows.
NEAREST = 3
MARK = "groom_guide"


def read_marks(source: Source, curves: Curves) -> tuple[np.ndarray, str]:
    """Which curves are marked as guides, (curve_count,) bool, and by what.

    `groom_guide` comes before the prim's purpose, which marks all of its curves or none.
    """
    prim, count = curves.prim, len(curves.counts)
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(MARK)
    if not primvar or not primvar.HasAuthoredValue():
        marked = UsdGeom.Imageable(prim).ComputePurpose() == UsdGeom.Tokens.guide
        return np.full(count, marked), "purpose guide" if marked else ""
    held = primvar.ComputeFlattened(source.start)
    given = values.checked(
        source, prim, primvar.GetName(), [held] if isinstance(held, bool | int | float) else held
    )
    if len(given) not in (1, count):
        mend = f"author a value a curve, or one for all: interpolation uniform, {count} values"
        raise source.error(f"has {len(given)} values for {count} curves", prim, primvar.GetName(), mend)
    marked = np.broadcast_to(given.ravel()[:count] > 0.0, count)
    return marked, MARK if marked.any() else ""


def choose_leaders(source: Source, grooms: Sequence[Groom]) -> None:
    """Sets the `leaders` of each groom whose curves follow guides, and what is said of them all.

    Raises InputError for guides that are named and cannot lead, and for free strands that would lead or follow.
    """
    marked = [groom for groom in grooms if groom.marked.all() and not names_guides(groom.prim)]
    reasons = {}
    for groom in grooms:
        groom.leaders, reasons[groom.path] = _leaders(source, groom, grooms, marked)
    for groom in grooms:
        for leader in groom.leaders:
            if leader is not groom and leader.follows:
                problem = f"names <{leader.path}>, whose curves follow guides themselves"
                raise source.error(problem, groom.prim, GUIDES, "name strands that are simulated")
    leading = {leader.path for groom in grooms for leader in groom.leaders}
    for groom in grooms:
        if (groom.leaders or groom.path in leading) and groom.free.any():
            mend = f"simulate all of them: take the marks off, or author an empty {GUIDES}"
            raise source.error("free strands neither lead nor follow", groom.prim, "plait:free", mend)
        groom.guides = _in_words(groom, grooms, reasons[groom.path])
        if groom.mark and not groom.leaders and groom.path not in leading:
            mend = f"author {GUIDES} on the curves that should"
            source.warn(f"marked as guides ({groom.mark}), which nothing follows; {mend}", groom.prim)


def _leaders(
    source: Source, groom: Groom, grooms: Sequence[Groom], marked: Sequence[Groom]
) -> tuple[tuple[Groom, ...], str]:
    relationship = groom.prim.GetRelationship(GUIDES)
    if relationship and relationship.HasAuthoredTargets():
        return _named(source, groom, relationship, grooms), GUIDES
    if groom.marked.any():
        return (() if groom.marked.all() else (groom,)), groom.mark
    if groom.free.any():
        return (), ""
    skins = {body.path for body in groom.rooted.bodies}
    same = tuple(other for other in marked if skins & {body.path for body in other.rooted.bodies})
    if same or skins:
        return same, "on the same skin"
    parent = groom.prim.GetParent()
    beside = [other for other in marked if not other.rooted.bodies and other.prim.GetParent() == parent]
    return tuple(beside), "beside it"


def _named(
    source: Source, groom: Groom, relationship: Usd.Relationship, grooms: Sequence[Groom]
) -> tuple[Groom, ...]:
    by_path = {other.path: other for other in grooms if other is not groom}
    paths = list(dict.fromkeys(str(path) for path in relationship.GetForwardedTargets()))
    for path in paths:
        if path not in by_path:
            problem = f"names <{path}>, which are no other strands that are simulated"
            raise source.error(problem, groom.prim, GUIDES, "name BasisCurves that are strands")
    return tuple(by_path[path] for path in paths)


def _in_words(groom: Groom, grooms: Sequence[Groom], reason: str) -> str:
    if groom.follows:
        count = sum(int(leader.simulated.sum()) for leader in groom.leaders)
        paths = ", ".join(leader.path for leader in groom.leaders)
        return f"{len(groom.simulated)} strands follow the nearest of {count} guides in {paths} ({reason})"
    following = [other.path for other in grooms if other is not groom and groom in other.leaders]
    parts = []
    if groom.leaders:
        count, total = int(groom.simulated.sum()), len(groom.simulated)
        parts.append(f"{count} of {total} strands, by {groom.mark}; the others follow")
    if following:
        mark = f"by {groom.mark}; " if groom.mark and not groom.leaders else ""
        parts.append(f"{mark}followed by {', '.join(following)}")
    return "; ".join(parts)


def bind(roots: np.ndarray, guides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The guides (n, 3) nearest to each root, heaviest first, and their weights (n, 3), rows sum to one.

    roots: (n, 3) and guides: (m, 3), one or more, roots where the artist drew them.

    With d the distances and D that of the next guide further off, weights go as ((D - d) / (D d))² (Franke and
    Nielson 1980): continuous where one guide takes the place of another, and all on a guide that is met. Of three
    or fewer guides there is none further off, and they go as 1/d².
    """
    found, distance = nearest_points(roots, guides, NEAREST + 1)
    kept = min(NEAREST, found.shape[1])
    beyond = distance[:, NEAREST:] if found.shape[1] > NEAREST else np.full((len(roots), 1), np.inf)
    near = distance[:, :kept]
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = (1.0 / near - 1.0 / beyond) ** 2
    met = near == 0.0
    weights = np.where(met.any(axis=1, keepdims=True), met.astype(float), weights)
    total = weights.sum(axis=1, keepdims=True)
    # All as far as the next one: none comes first.
    weights = np.where(total > 0.0, weights / np.where(total > 0.0, total, 1.0), 1.0 / kept)
    order = np.argsort(-weights, axis=1, kind="stable")
    result, share = np.zeros((len(roots), NEAREST), dtype=np.int32), np.zeros((len(roots), NEAREST))
    result[:, :kept] = np.take_along_axis(found[:, :kept], order, axis=1)
    share[:, :kept] = np.take_along_axis(weights, order, axis=1)
    return result, share
