"""Ties and clamps: points of strands held to meshes, to whatever moves, or to other strands.

    rel plait:attach:NAME = </Target>               the nearest place on it; of several targets, on the nearest
    int[] plait:attach:NAME:points = [4, 9]         which of the prim's points; the tips where there are none
    float plait:attach:NAME:stiffness = 200         of a spring at each; held exactly where there is none
    bool plait:attach:NAME:enabled.timeSamples = .. whether it holds; may be animated

NAME tells a prim's attachments apart, as instances of USD's multiple-apply schemas are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from plait.pipeline.errors import InputError
from plait.pipeline.read import values
from plait.pipeline.read.closest import closest_on_triangles, nearest_points
from plait.pipeline.read.motions import Anchor, Placement, RigidMotion, transform
from plait.pipeline.read.roles import is_solid
from plait.pipeline.read.roots import CLEARLY_NEARER
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Bodies, Body
from plait.pipeline.shot import as_drawn
from plait.solver.scene import AlwaysOn, Attachment, Strands, Surface, Switch

NAMESPACE = "plait:attach"
NAME_OTHERS = "name a Mesh, other strands, or any prim that moves"
PARTS = ("points", "stiffness", "enabled")
# [N/m] above it no spring is meant.
STIFFEST = 1e15


@dataclass(frozen=True)
class Tied:
    """A strands prim whose points may be held, or hold others'.

    strands: its part of the scene, the one of this index.  point_map: (drawn point count,) the scene's point that
    each drawn one is; -1 for one that is not simulated.
    """

    prim: Usd.Prim
    index: int
    strands: Strands
    point_map: np.ndarray

    @property
    def drawn(self) -> np.ndarray:
        """(point_count, 3) scene coordinates, where the artist drew them."""
        return as_drawn(self.strands)

    @property
    def strand_of_point(self) -> np.ndarray:
        return np.repeat(np.arange(self.strands.strand_count), np.diff(self.strands.offsets))


@dataclass(frozen=True)
class Attached:
    """What one prim's attachments are in the scene, and in words."""

    attachments: tuple[Attachment, ...]
    words: tuple[str, ...]


@dataclass(frozen=True)
class EnabledSwitch:
    """On where the attribute is true; as USD does with all that is no number, it holds between samples."""

    source: Source
    attribute: Usd.Attribute

    def on(self, time: float) -> bool:
        return bool(self.attribute.Get(self.source.code(time)))


@dataclass(frozen=True)
class _Near:
    """Where each of n points would be held on one target. distance: (n,) [m]; the rest as `Attachment`."""

    path: str
    distance: np.ndarray
    surface: int | None = None
    triangle: np.ndarray | None = None
    barycentric: np.ndarray | None = None
    other: int | None = None
    other_point: np.ndarray | None = None


class Attachments:
    """Reads attachments; surfaces that only they need are added to the scene's."""

    def __init__(
        self, source: Source, bodies: Bodies, surfaces: list[Surface], tied: list[Tied], hosts: Mapping[str, str]
    ) -> None:
        """surfaces: the scene's, to which others are appended.  hosts: of meshes that are drawn in the tets of a
        TetMesh, that one's path."""
        self._source, self._bodies, self._surfaces, self._hosts = source, bodies, surfaces, hosts
        self._tied = {str(each.prim.GetPath()): each for each in tied}

    def read(self, prim: Usd.Prim) -> Attached:
        """Of a simulated prim. Raises InputError for what cannot be right."""
        tied = self._tied[str(prim.GetPath())]
        found: list[Attachment] = []
        words: list[str] = []
        for relationship in _relationships(self._source, prim):
            name = relationship.GetName().split(":")[-1]
            point, stiffness = self._points(tied, relationship), self._stiffness(relationship)
            switch = self._switch(relationship)
            targets = self._targets(tied, relationship, point)
            if switch is None:
                words.append(f"{name}: disabled")
                continue
            spring = "" if math.isinf(stiffness) else f" by {stiffness:.3g} N/m each"
            spring += "" if isinstance(switch, AlwaysOn) else ", where enabled"
            for near, mine in _nearest(targets):
                held = Attachment(
                    f"{prim.GetPath()} {name} to {near.path}",
                    tied.index,
                    point[mine].astype(np.int32),
                    near.surface,
                    _some(near.triangle, mine),
                    _some(near.barycentric, mine),
                    near.other,
                    _some(near.other_point, mine),
                    stiffness,
                    switch,
                )
                held = _each_pair_once(held)
                found.append(held)
                words.append(f"{name}: {len(held.point)} points to {near.path}{spring}")
        return Attached(tuple(found), tuple(words))

    # --- one attachment ---------------------------------------------------------------------------------------

    def _points(self, tied: Tied, relationship: Usd.Relationship) -> np.ndarray:
        """The scene's points of those named, each once; the tips where none are."""
        strands, attribute = tied.strands, self._part(relationship, "points", Sdf.ValueTypeNames.IntArray)
        if attribute is None:
            return strands.offsets[1:].astype(np.int64) - 1
        given = values.integers(self._source, attribute)
        count = len(tied.point_map)
        mend = f"author points of this prim, from 0 to {count - 1}"
        if not len(given):
            raise self._wrong(attribute, "names no point", mend)
        wrong = (given < 0) | (given >= count)
        if wrong.any():
            raise self._wrong(attribute, f"names point {given[np.argmax(wrong)]} of {count}", mend)
        point = tied.point_map[given].astype(np.int64)
        if point.min() < 0:
            first = given[np.argmin(point)]
            raise self._wrong(attribute, f"names point {first}, whose curve follows guides", "attach the guides")
        held = strands.offsets[:-1] if strands.free is None else strands.offsets[:-1][~strands.free]
        rooted = np.isin(point, held)
        if rooted.any():
            first = given[np.argmax(rooted)]
            mend = "leave roots out, or author plait:free: an attachment then is all that holds them"
            raise self._wrong(attribute, f"names point {first}, which is held as a root", mend)
        return np.unique(point)

    def _stiffness(self, relationship: Usd.Relationship) -> float:
        """[N/m], infinity where none is authored."""
        attribute = self._part(relationship, "stiffness", Sdf.ValueTypeNames.Float, Sdf.ValueTypeNames.Double)
        if attribute is None:
            return math.inf
        value, unit = attribute.Get(self._source.start), self._source.units.kilograms_per_unit
        if not 0.0 < value * unit <= STIFFEST:
            mend = f"author a number above 0 to {STIFFEST / unit:g}, or none to hold exactly"
            raise self._wrong(attribute, f"is {value:g}", mend)
        return float(value * unit)

    def _switch(self, relationship: Usd.Relationship) -> Switch | None:
        """None for what is never on."""
        attribute = self._part(relationship, "enabled", Sdf.ValueTypeNames.Bool)
        if attribute is None:
            return AlwaysOn()
        if attribute.ValueMightBeTimeVarying():
            return EnabledSwitch(self._source, attribute)
        return AlwaysOn() if attribute.Get(self._source.start) else None

    def _part(self, relationship: Usd.Relationship, part: str, *types: Sdf.ValueTypeName) -> Usd.Attribute | None:
        """An attribute of the attachment, of one of these types; None where it has no value."""
        attribute = relationship.GetPrim().GetAttribute(f"{relationship.GetName()}:{part}")
        if not attribute or not attribute.HasAuthoredValue():
            return None
        if attribute.GetTypeName() not in types:
            mend = f"author {types[0]}"
            raise self._wrong(attribute, f"is {attribute.GetTypeName()}, not {types[0]}", mend)
        return attribute

    def _wrong(self, named: Usd.Property, problem: str, mend: str) -> InputError:
        return self._source.error(problem, named.GetPrim(), named.GetName(), mend)

    # --- what is held to --------------------------------------------------------------------------------------

    def _targets(self, tied: Tied, relationship: Usd.Relationship, point: np.ndarray) -> list[_Near]:
        paths = relationship.GetForwardedTargets()
        if not paths:
            raise self._wrong(relationship, "names nothing", NAME_OTHERS)
        found = []
        for path in dict.fromkeys(paths):
            target = self._source.stage.GetPrimAtPath(path)
            if not target:
                raise self._wrong(relationship, f"names <{path}>, which is not there", NAME_OTHERS)
            found.append(self._near(tied, relationship, point, target))
        return found

    def _near(self, tied: Tied, relationship: Usd.Relationship, point: np.ndarray, target: Usd.Prim) -> _Near:
        path, drawn = str(target.GetPath()), tied.drawn[point]
        if target.IsA(UsdGeom.Curves):
            return self._on_strands(tied, relationship, point, path)
        if is_solid(target):
            body = self._bodies.get(self._source.stage.GetPrimAtPath(self._hosts.get(path, path)))
            if body is None:
                raise self._wrong(relationship, f"names <{path}>, which has no triangles", NAME_OTHERS)
            return self._on_body(body, path, drawn)
        if target.IsA(UsdGeom.Imageable):
            return self._on_frame(target, drawn)
        kind = target.GetTypeName() or "prim without a type"
        raise self._wrong(relationship, f"names <{path}>, a {kind}, which has no place in space", NAME_OTHERS)

    def _on_strands(self, tied: Tied, relationship: Usd.Relationship, point: np.ndarray, path: str) -> _Near:
        """The nearest point of other strands, be they of the same prim."""
        other = self._tied.get(path)
        if other is None:
            mend = "name strands that are, or their guides"
            raise self._wrong(relationship, f"names <{path}>, which is not simulated", mend)
        own = other is tied
        if own and tied.strands.strand_count == 1:
            raise self._wrong(relationship, "names its own prim, of one strand", "name another prim")
        # A strand's own points may all be nearer than any other's.
        count = 1 + (int(np.diff(tied.strands.offsets).max()) if own else 0)
        nearest, distance = nearest_points(tied.drawn[point], other.drawn, count)
        if own:
            strand = tied.strand_of_point
            foreign = strand[nearest] != strand[point][:, None]
            first = np.argmax(foreign, axis=1)[:, None]
            nearest, distance = np.take_along_axis(nearest, first, 1), np.take_along_axis(distance, first, 1)
        return _Near(path, distance[:, 0], other=other.index, other_point=nearest[:, 0].astype(np.int32))

    def _on_body(self, body: Body, path: str, drawn: np.ndarray) -> _Near:
        """The nearest place on the mesh as it lies beside the strands: at rest, or posed at the first frame."""
        triangles = body.surface.triangles
        rest = transform(body.rest_to_world, body.surface.points)
        triangle, barycentric, distance = closest_on_triangles(drawn, rest, triangles)
        if body.deforms:
            posed = closest_on_triangles(drawn, body.posed, triangles)
            if np.median(posed[2]) < CLEARLY_NEARER * np.median(distance):
                triangle, barycentric, distance = posed
        index = self._index_of(replace(body.surface, collides=False))
        return _Near(path, distance, index, triangle.astype(np.int32), barycentric)

    def _on_frame(self, target: Usd.Prim, drawn: np.ndarray) -> _Near:
        """A triangle at the prim's origin, which moves as the prim does."""
        placement = Placement(self._source, target)
        anchor = Anchor.of(placement, self._source)
        corners = anchor.points(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
        surface = Surface(
            f"{target.GetPath()} (attachments)",
            corners,
            np.array([[0, 1, 2]], dtype=np.int32),
            RigidMotion(self._source, placement, anchor),
            collides=False,
        )
        index = self._index_of(surface)
        distance = np.linalg.norm(drawn - placement.metric(self._source.start)[:3, 3], axis=1)
        count = len(drawn)
        barycentric = np.tile([1.0, 0.0, 0.0], (count, 1))
        return _Near(str(target.GetPath()), distance, index, np.zeros(count, dtype=np.int32), barycentric)

    def _index_of(self, surface: Surface) -> int:
        """Of the scene's surface of that name, added if it is not there."""
        for index, held in enumerate(self._surfaces):
            if held.name == surface.name:
                return index
        self._surfaces.append(surface)
        return len(self._surfaces) - 1


def has_attachments(prim: Usd.Prim) -> bool:
    return bool(prim.GetAuthoredPropertiesInNamespace(NAMESPACE))


def _relationships(source: Source, prim: Usd.Prim) -> Iterator[Usd.Relationship]:
    """The prim's attachments by name; raises InputError for properties that belong to none."""
    if prim.HasProperty(NAMESPACE):
        raise source.error("has no name", prim, NAMESPACE, f"author rel {NAMESPACE}:NAME")
    for each in prim.GetAuthoredPropertiesInNamespace(NAMESPACE):
        path = each.GetName()
        name, *part = path.removeprefix(f"{NAMESPACE}:").split(":")
        relationship = prim.GetRelationship(f"{NAMESPACE}:{name}")
        if not part and not relationship:
            raise source.error("is no relationship", prim, path, f"author rel {path}")
        if part and (len(part) > 1 or part[0] not in PARTS):
            known = ", ".join(f"{NAMESPACE}:{name}:{known}" for known in PARTS)
            raise source.error("means nothing to an attachment", prim, path, f"known are {known}")
        if part and not relationship:
            raise source.error(
                f"belongs to {NAMESPACE}:{name}, which is not there", prim, path, f"author rel {NAMESPACE}:{name}"
            )
        if not part:
            yield relationship


def _nearest(targets: list[_Near]) -> Iterator[tuple[_Near, np.ndarray]]:
    """Each target with the points, (n,) bool, that are nearer to it than to any other."""
    winner = np.argmin([near.distance for near in targets], axis=0)
    for k, near in enumerate(targets):
        if np.any(winner == k):
            yield near, winner == k


def _some(held: np.ndarray | None, mine: np.ndarray) -> np.ndarray | None:
    return None if held is None else np.ascontiguousarray(held[mine])


def _each_pair_once(attachment: Attachment) -> Attachment:
    """Points of one prim that are each other's nearest are one pair."""
    if attachment.other != attachment.strands:
        return attachment
    pairs = np.sort(np.stack([attachment.point, attachment.other_point], axis=1), axis=1)
    first = np.sort(np.unique(pairs, axis=0, return_index=True)[1])
    return replace(attachment, point=attachment.point[first], other_point=attachment.other_point[first])
