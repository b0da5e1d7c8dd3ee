"""Where strands grow. USD has no standard for it: several conventions are tried, and the drawing decides.

A convention names a place on a skin; the drawing says whether that is meant, by how far the drawn root lies from
it. The drawing may lie beside the skin in its bind pose, in its coordinates (a groom exported without the skin's
transform), or in the pose of the first frame; whichever is nearest is taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from plait.pipeline.read import places
from plait.pipeline.read.carriers import GatheredMotion, own_carrier, skinned_to_rest
from plait.pipeline.read.closest import closest_on_triangles
from plait.pipeline.read.curves import Curves, Polylines
from plait.pipeline.read.motions import Anchor, Placement, transform
from plait.pipeline.read.skeletons import SkeletonBinding, read_geom_bind
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Body
from plait.solver.scene import Surface

# A root belongs to a place no further off than this part of its strand's length and, since the drawn surface may
# be smoother than its cage, this part of the triangle's size.
REACH_OF_LENGTH = 0.25
REACH_OF_TRIANGLE = 0.5
# A convention holds if this part of the strands agrees with it.
AGREEMENT = 0.9
# Of its median distance from the places named, what another drawing may have at most to be taken instead.
CLEARLY_NEARER = 0.5


@dataclass(frozen=True)
class Rooted:
    """Where a prim's strands grow.

    surface: the skin itself (one of `Bodies`) or a hidden carrier; triangle, barycentric: as `RootBinding`.
    to_rest: (strand_count, 4, 4), the prim's own space [stage units] to the surface's rest points [m].
    rest_to_world: (4, 4), rest points to scene coordinates where the artist drew them.
    bodies: the skins strands grow on.
    how: for the report.
    """

    surface: Surface
    triangle: np.ndarray
    barycentric: np.ndarray
    to_rest: np.ndarray
    rest_to_world: np.ndarray
    bodies: tuple[Body, ...]
    how: str

    @property
    def hidden(self) -> bool:
        """Whether the surface is a carrier that nobody drew, not one of the skins."""
        return all(body.surface is not self.surface for body in self.bodies)

    def select(self, chosen: np.ndarray) -> Rooted:
        """Of some strands, (strand_count,) bool."""
        return replace(
            self,
            triangle=self.triangle[chosen],
            barycentric=self.barycentric[chosen],
            to_rest=self.to_rest[chosen],
        )


@dataclass(frozen=True)
class Drawing:
    """One way in which a groom may lie beside a skin: both in the same coordinates [m].

    to_rest: (4, 4), curves' own space to those coordinates.  points: (p, 3), the skin in them.
    to_world: (4, 4), those coordinates to scene world.  posed: they are the world, at the first frame.
    """

    label: str
    to_rest: np.ndarray
    points: np.ndarray
    to_world: np.ndarray
    posed: bool

    @property
    def scale(self) -> float:
        """[m per stage unit]"""
        return float(abs(np.linalg.det(self.to_rest[:3, :3])) ** (1.0 / 3.0))


@dataclass
class _Found:
    """Places of all strands on one skin: which agree, under one convention and one drawing."""

    body: Body
    drawing: Drawing
    triangle: np.ndarray
    barycentric: np.ndarray
    distance: np.ndarray
    agrees: np.ndarray
    how: str

    @property
    def share(self) -> float:
        return float(self.agrees.mean())


def find_roots(
    source: Source,
    curves: Curves,
    lines: Polylines,
    binding: SkeletonBinding | None,
    candidates: Sequence[Body],
    explicit: bool,
) -> Rooted:
    """Binds every strand of a prim, by the first convention that holds; the rest to the closest place, and what is
    near no skin to the prim's own motion.

    explicit: the candidates were named by `plait:skin`, so every strand grows on them however far they are.
    """
    search = _Search(source, curves, lines, binding, candidates, explicit)
    found = search.by_convention()
    chosen = [found] if found is not None else []
    owner = np.where(found.agrees, 0, -1) if found is not None else np.full(len(lines.curves), -1)
    left = np.nonzero(owner < 0)[0]
    if len(left):
        for nearest in search.by_distance(left):
            mine = left[nearest.agrees[left]]
            if len(mine):
                owner[mine] = len(chosen)
                chosen.append(nearest)
    return _Assembly(source, curves, lines, binding, chosen, owner, explicit).rooted()


class _Search:
    """Tries conventions on the candidates."""

    def __init__(
        self,
        source: Source,
        curves: Curves,
        lines: Polylines,
        binding: SkeletonBinding | None,
        candidates: Sequence[Body],
        explicit: bool,
    ) -> None:
        self.source, self.curves, self.lines = source, curves, lines
        self.explicit = explicit
        self.options = [(body, list(drawings(source, curves, binding, body))) for body in candidates]
        self.roots = curves.nodes[lines.roots]
        self.lengths = _strand_lengths(curves, lines)

    def by_convention(self) -> _Found | None:
        """The convention of the highest rank that holds on some skin; on several, where it fits best."""
        for label, convention in places.CONVENTIONS:
            asked = convention(self.source, self.curves, self.lines)
            if asked is None:
                continue
            tried = [
                self._measure(
                    body, drawing, triangle, barycentric, named, f"{label}, {detail}" if detail else label
                )
                for body, ways in self.options
                for drawing in ways
                for triangle, barycentric, named, detail in asked(
                    body, transform(drawing.to_rest, self.roots), drawing.points
                )
            ]
            holding = [found for found in tried if found.share >= AGREEMENT]
            if holding:
                return _best(holding)
            best = max(tried, key=lambda found: found.share, default=None)
            where = f"for {best.share:.0%} of the strands at best, on {best.body.path}" if best else "on no mesh"
            self.source.warn(f"agrees with the drawn roots {where}; not used", self.curves.prim, label)
        return None

    def by_distance(self, left: np.ndarray) -> list[_Found]:
        """For each skin the strands of `left` that lie closest to it, and near enough."""
        tried = []
        for body, ways in self.options:
            found = []
            for drawing in ways:
                points = transform(drawing.to_rest, self.roots[left])
                if not self.explicit and self._out_of_reach(body, drawing, points):
                    continue
                triangle = np.zeros(len(self.roots), dtype=np.int64)
                barycentric = np.zeros((len(self.roots), 3))
                triangle[left], barycentric[left], _ = closest_on_triangles(
                    points, drawing.points, body.surface.triangles
                )
                named = np.zeros(len(self.roots), dtype=bool)
                named[left] = True
                found.append(self._measure(body, drawing, triangle, barycentric, named, "closest point"))
            if found:
                share = max(way.share for way in found)
                tried.append(_best([way for way in found if way.share >= AGREEMENT * share]))
        if not tried:
            return []
        winner = np.argmin([np.where(found.agrees, found.distance, np.inf) for found in tried], axis=0)
        for k, found in enumerate(tried):
            found.agrees = found.agrees & (winner == k)
        return tried

    def _out_of_reach(self, body: Body, drawing: Drawing, points: np.ndarray) -> bool:
        """Whether no root can belong to the skin, by their boxes alone."""
        gap = np.maximum(
            drawing.points.min(axis=0) - points.max(axis=0), points.min(axis=0) - drawing.points.max(axis=0)
        ).max()
        size = body.triangle_sizes(drawing.points, body.surface.triangles).max() if gap > 0.0 else 0.0
        return bool(gap > REACH_OF_LENGTH * drawing.scale * self.lengths.max() + REACH_OF_TRIANGLE * size)

    def _measure(
        self,
        body: Body,
        drawing: Drawing,
        triangle: np.ndarray,
        barycentric: np.ndarray,
        named: np.ndarray,
        how: str,
    ) -> _Found:
        corners = drawing.points[body.surface.triangles[triangle]]
        place = np.einsum("sk,skd->sd", barycentric, corners)
        distance = np.linalg.norm(place - transform(drawing.to_rest, self.roots), axis=1)
        size = body.triangle_sizes(drawing.points, body.surface.triangles[triangle])
        reach = REACH_OF_LENGTH * drawing.scale * self.lengths + REACH_OF_TRIANGLE * size
        agrees = named if self.explicit else named & (distance <= reach)
        return _Found(body, drawing, triangle, barycentric, distance, agrees, how)


def _best(ways: list[_Found]) -> _Found:
    """The nearest; but a drawing less likely than another must be clearly nearer."""
    best = ways[0]
    for way in ways[1:]:
        factor = 1.0 if way.drawing.label == best.drawing.label else CLEARLY_NEARER
        if _misfit(way) < factor * _misfit(best):
            best = way
    return best


def _misfit(found: _Found) -> float:
    distances = found.distance[found.agrees]
    if not len(distances):
        return np.inf
    # Rounding must not decide between drawings that are the same place: the first stays.
    return round(float(np.median(distances)), 6)


def drawings(source: Source, curves: Curves, binding: SkeletonBinding | None, body: Body) -> Iterator[Drawing]:
    """The ways in which the groom may lie beside this skin, likeliest first; none if it is scaled to nothing."""
    if not _regular(body.rest_to_world):
        return
    rest = body.surface.points
    world = _own_to_world(source, curves, binding)
    same_skeleton = (
        binding is not None and body.binding is not None and binding.skeleton is body.binding.skeleton
        and binding.query.HasJointInfluences()
    )  # fmt: skip
    if same_skeleton:
        anchor = Anchor.of(binding.skeleton.placement, source)
        beside = skinned_to_rest(source, binding, anchor)
    else:
        beside = np.linalg.solve(body.rest_to_world, world)
    yield Drawing("drawn beside its rest shape", beside, rest, body.rest_to_world, False)
    if binding is not None and binding.query.HasJointInfluences():
        return  # UsdSkel itself says where skinned curves are drawn.
    given = [beside]
    for label, to_rest in (
        ("drawn in the skeleton's coordinates", body.bind_to_rest),
        ("drawn in the skin's own coordinates", body.own_to_rest),
    ):
        if not any(np.allclose(to_rest, other, rtol=1e-6, atol=1e-9) for other in given):
            given.append(to_rest)
            yield Drawing(label, to_rest, rest, body.rest_to_world, False)
    if body.deforms:
        yield Drawing("drawn in the pose of the first frame", world, body.posed, np.eye(4), True)


def _own_to_world(source: Source, curves: Curves, binding: SkeletonBinding | None) -> np.ndarray:
    """(4, 4), the curves' own space [stage units] to scene coordinates, as drawn, at the first frame."""
    scale = np.diag([source.units.meters_per_unit] * 3 + [1.0])
    if binding is not None and binding.query.HasJointInfluences():
        return binding.skeleton.placement.metric(source.start) @ scale @ read_geom_bind(source, binding)
    return Placement(source, curves.prim).metric(source.start) @ scale


class _Assembly:
    """From places on skins to one surface that carries the prim's strands."""

    def __init__(
        self,
        source: Source,
        curves: Curves,
        lines: Polylines,
        binding: SkeletonBinding | None,
        chosen: list[_Found],
        owner: np.ndarray,
        explicit: bool,
    ) -> None:
        self.source, self.curves, self.lines, self.binding = source, curves, lines, binding
        self.chosen, self.owner, self.explicit = chosen, owner, explicit
        self.count = len(lines.curves)

    def rooted(self) -> Rooted:
        """On the skin itself where all strands grow on one, drawn at its rest; else on triangles gathered."""
        used = [self.chosen[k] for k in np.unique(self.owner[self.owner >= 0])]
        if not used:
            return self._on_own()
        together = {(found.body.path, found.drawing.label) for found in used}
        if len(together) == 1 and np.all(self.owner >= 0) and not used[0].drawing.posed:
            return self._on_skin(used)
        return self._gathered()

    def _on_own(self) -> Rooted:
        carrier = own_carrier(self.source, self.curves, self.lines, self.binding)
        return Rooted(
            carrier.surface,
            np.arange(self.count, dtype=np.int32),
            np.tile([1.0, 0.0, 0.0], (self.count, 1)),
            np.broadcast_to(carrier.to_rest, (self.count, 4, 4)),
            carrier.rest_to_world,
            (),
            carrier.how,
        )

    def _on_skin(self, used: list[_Found]) -> Rooted:
        body, drawing = used[0].body, used[0].drawing
        triangle, barycentric = self._chosen_places()
        return Rooted(
            body.surface,
            triangle.astype(np.int32),
            barycentric,
            np.broadcast_to(drawing.to_rest, (self.count, 4, 4)),
            drawing.to_world,
            (body,),
            self._in_words(),
        )

    def _gathered(self) -> Rooted:
        triangle, barycentric = self._chosen_places()
        to_world = np.zeros((self.count, 4, 4))
        number = np.zeros(self.count, dtype=np.int32)
        parts, rest, bodies = [], [], []
        for k in np.unique(self.owner):
            mine = np.nonzero(self.owner == k)[0]
            number[mine] = sum(len(wanted) for _, wanted in parts) // 3 + np.arange(len(mine))
            if k < 0:
                carrier = own_carrier(self.source, self.curves, self.lines, self.binding)
                surface, placed = carrier.surface, transform(carrier.rest_to_world, carrier.surface.points)
                to_world[mine] = carrier.rest_to_world @ carrier.to_rest
                triangle[mine], barycentric[mine] = mine, [1.0, 0.0, 0.0]
            else:
                found = self.chosen[k]
                surface, placed = found.body.surface, transform(found.drawing.to_world, found.drawing.points)
                to_world[mine] = found.drawing.to_world @ found.drawing.to_rest
                bodies.append(found.body)
            wanted = surface.triangles[triangle[mine]].ravel()
            parts.append((surface, wanted))
            rest.append(placed[wanted])
        surface = Surface(
            f"{self.curves.path} (roots)",
            np.concatenate(rest),
            np.arange(3 * self.count, dtype=np.int32).reshape(-1, 3),
            GatheredMotion(tuple(parts)),
            collides=False,
        )
        return Rooted(surface, number, barycentric, to_world, np.eye(4), tuple(bodies), self._in_words())

    def _chosen_places(self) -> tuple[np.ndarray, np.ndarray]:
        triangle, barycentric = np.zeros(self.count, dtype=np.int64), np.zeros((self.count, 3))
        for k, found in enumerate(self.chosen):
            mine = self.owner == k
            triangle[mine], barycentric[mine] = found.triangle[mine], found.barycentric[mine]
        return triangle, barycentric

    def _in_words(self) -> str:
        parts = []
        for k in np.unique(self.owner)[::-1]:
            number = int(np.sum(self.owner == k))
            if k < 0:
                text = "no skin near: the prim's own motion"
            else:
                found = self.chosen[k]
                text = f"{found.how} on {found.body.path}, {found.drawing.label}"
            parts.append(text if number == self.count else f"{text} ({number} of {self.count} strands)")
        return ("plait:skin; " if self.explicit else "") + "; ".join(parts)


def _strand_lengths(curves: Curves, lines: Polylines) -> np.ndarray:
    """(strand_count,) [stage units, the prim's own space]"""
    points = curves.nodes[lines.source_points]
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    step[lines.offsets[1:-1] - 1] = 0.0
    return np.add.reduceat(np.append(step, 0.0), lines.offsets[:-1])


def _regular(matrix: np.ndarray) -> bool:
    return bool(np.linalg.cond(matrix[:3, :3]) < 1e8)
