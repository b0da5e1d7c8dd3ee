"""Where collision particles lie: a lattice on the triangles of a skin, and the tets it lies in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

# Triangle edges, as pairs of corners.
EDGES = np.array([[0, 1], [1, 2], [2, 0]])
# No triangle's side is divided more often: a lattice so fine beside its mesh serves nothing.
MAX_DIVISIONS = 64


@dataclass(frozen=True)
class SkinLattice:
    """Points on a triangle surface: first all of its own points in their order, then those on edges, then inside.

    corner: (count, 3) int32 points of the surface, and weight: (count, 3) float64, each row's sum one: where.
    area: (count,) float64 [m2], each one's share of the triangles around it; zero for points of no triangle.
    triangle_offsets: (count + 1,), triangles: the triangles that each particle lies on.
    """

    corner: np.ndarray
    weight: np.ndarray
    area: np.ndarray
    triangle_offsets: np.ndarray
    triangles: np.ndarray

    @property
    def count(self) -> int:
        return len(self.corner)


def lay_lattice(points: np.ndarray, triangles: np.ndarray, spacing: float) -> SkinLattice:
    """A lattice whose neighbours on one triangle are no further than `spacing` [m] apart.

    points: (n, 3) float64 [m].  triangles: (m, 3). Neighbouring triangles share the particles on their edge.
    """
    triangles = np.asarray(triangles).reshape(-1, 3)
    if not len(triangles):
        none = np.zeros(0, dtype=np.int32)
        corner = np.tile(np.arange(len(points), dtype=np.int32)[:, None], (1, 3))
        return SkinLattice(
            corner, _unit(len(points)), np.zeros(len(points)), np.zeros(len(points) + 1, dtype=np.int32), none
        )
    pairs = np.sort(triangles[:, EDGES], axis=2).reshape(-1, 2)
    edges, edge_of = np.unique(pairs, axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1, 3)
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    divisions = np.clip(np.ceil(length / spacing - 1e-9), 1, MAX_DIVISIONS).astype(np.int64)
    inside = divisions[edge_of].max(axis=1)
    corner_share, edge_share, inside_share = _shares(inside, divisions[edge_of])
    lies_on = np.repeat(np.arange(len(triangles)), 3)
    own = np.tile(np.arange(len(points))[:, None], (1, 3))
    parts = [_Part(own, _unit(len(points)), triangles.ravel(), lies_on, corner_share.ravel())]
    parts += _on_edges(len(points), edges, edge_of, divisions, edge_share)
    parts += _within(sum(len(part.corner) for part in parts), triangles, inside, inside_share)
    corner, weight, owner, triangle, share = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.lexsort((triangle, owner))
    offsets = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(corner)))])
    x = points[triangles]
    triangle_area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    return SkinLattice(
        corner.astype(np.int32),
        weight,
        np.bincount(owner, share * triangle_area[triangle], minlength=len(corner)),
        offsets.astype(np.int32),
        triangle[order].astype(np.int32),
    )


class _Part(NamedTuple):
    """Some particles, and on which triangles they lie.

    corner, weight: as in `SkinLattice`.  owner, triangle, share: pairs of a particle, by its number among all, and
    a triangle it lies on, and the part of that one's area that it gets for it.
    """

    corner: np.ndarray
    weight: np.ndarray
    owner: np.ndarray
    triangle: np.ndarray
    share: np.ndarray


def _on_edges(
    count: int, edges: np.ndarray, edge_of: np.ndarray, divisions: np.ndarray, share: np.ndarray
) -> Iterator[_Part]:
    """The particles on edges, numbered from `count` on.

    edges: (edge_count, 2) points.  edge_of, share: (triangle_count, 3) by side.  divisions: (edge_count,).
    """
    for n in np.unique(divisions[divisions > 1]):
        chosen = np.flatnonzero(divisions == n)
        first = np.full(len(edges), -1)
        first[chosen] = count + np.arange(len(chosen)) * (n - 1)
        part = np.tile(np.arange(1, n) / n, len(chosen))
        ends = np.repeat(edges[chosen], n - 1, axis=0)
        at, side = np.nonzero(first[edge_of] >= 0)
        yield _Part(
            np.stack([ends[:, 0], ends[:, 1], ends[:, 1]], axis=1),
            np.stack([1.0 - part, part, np.zeros_like(part)], axis=1),
            (first[edge_of[at, side]][:, None] + np.arange(n - 1)).ravel(),
            np.repeat(at, n - 1),
            np.repeat(share[at, side], n - 1),
        )
        count += len(part)


def _within(count: int, triangles: np.ndarray, inside: np.ndarray, share: np.ndarray) -> Iterator[_Part]:
    """The particles within triangles, numbered from `count` on; inside, share: (triangle_count,)."""
    for n in np.unique(inside[inside > 2]):
        chosen = np.flatnonzero(inside == n)
        steps = np.array([(i, j, n - i - j) for i in range(1, n) for j in range(1, n - i)]) / n
        yield _Part(
            np.repeat(triangles[chosen], len(steps), axis=0),
            np.tile(steps, (len(chosen), 1)),
            count + np.arange(len(chosen) * len(steps)),
            np.repeat(chosen, len(steps)),
            np.repeat(share[chosen], len(steps)),
        )
        count += len(chosen) * len(steps)


def _unit(count: int) -> np.ndarray:
    return np.tile([1.0, 0.0, 0.0], (count, 1))


def _shares(inside: np.ndarray, sides: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of a triangle's area: (m, 3) of each corner, (m, 3) of each particle on a side, (m,) of each inside.

    inside: (m,) divisions of the triangle.  sides: (m, 3) those of its sides, no more. Each third of each of the
    n^2 little triangles goes to one of its corners; what a side with fewer divisions lacks goes to its ends.
    """
    n2 = inside[:, None].astype(np.float64) ** 2
    side_total = (inside[:, None] - 1.0) / n2
    held = np.where(sides > 1, side_total, 0.0)
    edge = held / np.maximum(sides - 1, 1)
    to_ends = 0.5 * (side_total - held)
    corner = 1.0 / (3.0 * n2) + to_ends + to_ends[:, [2, 0, 1]]
    return corner, edge, (2.0 / n2)[:, 0]


def locate(points: np.ndarray, nodes: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The tet that holds each point, or the one it lies least outside of, and its barycentric weights there.

    points: (n, 3) float64 [m].  nodes: (k, 3).  tets: (m, 4) of positive volume. Returns (n,) int64 and (n, 4)
    float64 whose rows sum to one. Tets are looked up in cells of their own size, in the cells around a point's
    own where that holds none.
    """
    corners = nodes[tets]
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    size = float((upper - lower).max())
    origin = lower.min(axis=0)
    inverse = np.linalg.inv(np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2))

    def key(cell: np.ndarray) -> np.ndarray:
        return ((cell[..., 0] + 1) << 42) + ((cell[..., 1] + 1) << 21) + cell[..., 2] + 1

    # A tet is no larger than a cell, so it meets at most two in each direction.
    at = np.floor((lower - origin) / size).astype(np.int64)[:, None] + np.indices((2, 2, 2)).reshape(3, -1).T
    meets = (at * size + origin <= upper[:, None] + 1e-9 * size).all(axis=2)
    owner = np.nonzero(meets)[0]
    keys = key(at[meets])
    order = np.lexsort((owner, keys))
    owner, keys = owner[order], keys[order]
    best = np.full(len(points), -np.inf)
    tet, weights = np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 4))
    cell = np.floor((points - origin) / size).astype(np.int64)
    neighbours = np.indices((3, 3, 3)).reshape(3, -1).T - 1
    for shift in sorted(neighbours.tolist(), key=lambda s: np.abs(s).sum()):
        # The points that no tet holds so far, beyond rounding.
        left = np.flatnonzero(best < -1e-9)
        if not len(left):
            break
        wanted = key(np.maximum(cell[left] + shift, -1))
        begin, end = np.searchsorted(keys, wanted), np.searchsorted(keys, wanted, side="right")
        for some in np.array_split(np.arange(len(left)), 1 + int((end - begin).sum()) // 2_000_000):
            _best_of(points, left[some], owner, begin[some], end[some], corners, inverse, best, tet, weights)
    return tet, weights


def _best_of(
    points: np.ndarray,
    chosen: np.ndarray,
    owner: np.ndarray,
    begin: np.ndarray,
    end: np.ndarray,
    corners: np.ndarray,
    inverse: np.ndarray,
    best: np.ndarray,
    tet: np.ndarray,
    weights: np.ndarray,
) -> None:
    """Compares the tets owner[begin:end] of each chosen point; keeps the one with the largest least weight."""
    counts = end - begin
    point = np.repeat(chosen, counts)
    if not len(point):
        return
    within = np.arange(len(point)) - np.repeat(np.cumsum(counts) - counts, counts)
    candidate = owner[np.repeat(begin, counts) + within]
    w = np.einsum("nij,nj->ni", inverse[candidate], points[point] - corners[candidate, 0])
    w = np.concatenate([1.0 - w.sum(axis=1, keepdims=True), w], axis=1)
    least = w.min(axis=1)
    order = np.lexsort((-candidate, least, point))
    last = order[np.flatnonzero(np.diff(point[order], append=-1))]
    better = last[least[last] > best[point[last]]]
    best[point[better]], tet[point[better]], weights[point[better]] = least[better], candidate[better], w[better]
