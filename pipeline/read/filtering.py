"""Which surfaces of rigid bodies do not touch, by what UsdPhysics says of pairs, groups and joints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from pxr import Usd, UsdPhysics

from plait.pipeline.read import values
from plait.pipeline.read.source import PREDICATE, Source
from plait.solver.scene import Surface

Indices = Sequence[int]


def read_filtered(source: Source, surfaces: Sequence[Surface]) -> tuple[tuple[int, int], ...]:
    """Pairs of surfaces, one of them of a rigid body at least, that are kept apart: of `Scene.filtered`."""
    rigid = [surface.rigid for surface in surfaces]
    if all(body is None for body in rigid):
        return ()
    filters = (*_of_pairs(source, surfaces), *_of_joints(source, surfaces), *_of_groups(source, surfaces))
    pairs = {(min(a, b), max(a, b)) for own, others in filters for a in own for b in others}
    return tuple(sorted((a, b) for a, b in pairs if rigid[a] != rigid[b]))


def _beneath(surfaces: Sequence[Surface], path: str) -> list[int]:
    return [i for i, s in enumerate(surfaces) if s.collides and (s.name == path or s.name.startswith(f"{path}/"))]


def _of_pairs(source: Source, surfaces: Sequence[Surface]) -> Iterator[tuple[Indices, Indices]]:
    for prim in source.stage.Traverse(PREDICATE):
        if prim.HasAPI(UsdPhysics.FilteredPairsAPI):
            own = _beneath(surfaces, str(prim.GetPath()))
            pairs = UsdPhysics.FilteredPairsAPI(prim).GetFilteredPairsRel()
            for target in pairs.GetTargets():
                if not source.stage.GetPrimAtPath(target):
                    source.warn(f"names <{target}>, which is not there", prim, pairs.GetName())
                yield own, _beneath(surfaces, str(target))


def _of_joints(source: Source, surfaces: Sequence[Surface]) -> Iterator[tuple[Indices, Indices]]:
    """What a joint holds together, unless it says otherwise; the world as a whole is none of it."""
    for prim in source.stage.Traverse(PREDICATE):
        joint = UsdPhysics.Joint(prim)
        if not joint or values.flag(source, joint.GetCollisionEnabledAttr()):
            continue
        if not values.flag(source, joint.GetJointEnabledAttr()):
            continue
        sides = [relation.GetTargets() for relation in (joint.GetBody0Rel(), joint.GetBody1Rel())]
        if all(sides):
            first, second = (_beneath(surfaces, str(targets[0])) for targets in sides)
            yield first, second


def _of_groups(source: Source, surfaces: Sequence[Surface]) -> Iterator[tuple[Indices, Indices]]:
    table = UsdPhysics.CollisionGroup.ComputeCollisionGroupTable(source.stage)
    groups = list(table.GetGroups())
    members = [_members(source.stage.GetPrimAtPath(path), surfaces) for path in groups]
    for k, path in enumerate(groups):
        if not table.IsCollisionEnabled(path, path):
            yield members[k], members[k]
    for (path, own), (other, others) in combinations(zip(groups, members, strict=True), 2):
        if not table.IsCollisionEnabled(path, other):
            yield own, others


def _members(group: Usd.Prim, surfaces: Sequence[Surface]) -> list[int]:
    query = UsdPhysics.CollisionGroup(group).GetCollidersCollectionAPI().ComputeMembershipQuery()
    return [i for i, surface in enumerate(surfaces) if surface.collides and query.IsPathIncluded(surface.name)]
