"""Tets through which the skin passes more than once: each part of the inside gets a copy of its own.

Two fingers may run through one tet without touching. Each then has a copy of it, with nodes of its own where no
path within the flesh leads from the one to the other (virtual nodes: Molino 2004; connected as by Nesme 2009). A
tet with a single sheet of skin has one inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.pipeline.tetrahedra.cover import Cover, adjacent_parts, part_middles
from plait.pipeline.tetrahedra.graphs import chains, components
from plait.pipeline.tetrahedra.samples import Pieces
from plait.pipeline.tetrahedra.skin import Inside, Skin

PARTS = 3  # a tet between sheets is looked at in this many parts cubed
THINNED = 0.125  # of a cell
OFF_EDGE = 0.02  # of a cell, and of the way to a triangle's middle
APART = 0.125  # of a cell: the lines along which its flesh is measured
# Of the skin's size: a step off the skin, to see which side is inside.
STEP = 2e-5
# Turns the grid of lines out of line with flat walls, which would all fall between two lines or none.
_ASKEW = np.array([[np.cos(0.6), -np.sin(0.6), 0.0], [np.sin(0.6), np.cos(0.6), 0.0], [0.0, 0.0, 1.0]])
FOLD = np.radians(25.0)  # from the mean normal in a tet: more is no plane
TURNED_AWAY = 1e3  # cells squared: what faces away comes after all that does not
GROUP = 20_000  # places whose closest skin is sought at once


@dataclass(frozen=True)
class Copies:
    """tet: (copy_count,) ascending, into the lattice's tets.  of_sheet: (sheet_count,) the copy each sheet is in.

    share: (copy_count,) the part of its tet that is inside and its own; NaN in tets of one nearly flat sheet or
    none. on: the skin within the other tets."""

    tet: np.ndarray
    of_sheet: np.ndarray
    share: np.ndarray
    on: OnSkin


@dataclass(frozen=True)
class OnSkin:
    """Places on the skin, ascending by tet, with which of its sides is inside.

    places: (n, 3) in cells.  normals: (n, 3), unit, outward.  sheet, tet: (n,).
    below, above: (n,) bool, whether inside is against the normal, and along it.
    """

    inside: Inside
    cover: Cover
    places: np.ndarray
    normals: np.ndarray
    sheet: np.ndarray
    tet: np.ndarray
    below: np.ndarray
    above: np.ndarray

    def nearest_sheet(self, places: np.ndarray, tets: np.ndarray) -> np.ndarray:
        """(n,) the sheet, within its tet, closest to each place inside and in sight of it, and so joined to it.

        Of a sheet, what is closest is seen if anything is; where no sheet is seen, the closest is told.
        """
        found = [self._nearest(places[k : k + GROUP], tets[k : k + GROUP]) for k in range(0, len(places), GROUP)]
        return np.concatenate([np.zeros(0, dtype=np.int64), *found])

    def _nearest(self, places: np.ndarray, tets: np.ndarray) -> np.ndarray:
        first = np.searchsorted(self.tet, tets)
        length = np.searchsorted(self.tet, tets, side="right") - first
        row = np.repeat(np.arange(len(places)), length)
        candidate = first[row] + np.arange(len(row)) - np.repeat(np.cumsum(length) - length, length)
        away = places[row] - self.places[candidate]
        under = np.einsum("ni,ni->n", away, self.normals[candidate]) < 0.0
        turned = np.where(under, self.below[candidate], self.above[candidate])
        distance = np.einsum("ni,ni->n", away, away) + np.where(turned, 0.0, TURNED_AWAY)
        order = np.lexsort((distance, row))
        row, candidate, under = row[order], candidate[order], under[order]
        result = self.sheet[candidate[np.cumsum(length) - length]]
        while len(row):
            closest = np.flatnonzero(np.diff(row, prepend=-1))
            of, place = row[closest], candidate[closest]
            side = np.where(under[closest], -STEP, STEP) * self.inside.scale
            end = self.cover.points(self.places[place]) + side[:, None] * self.normals[place]
            seen = self.inside.stays(self.cover.points(places[of]), end, STEP)
            result[of[seen]] = self.sheet[place[seen]]
            tried = np.full(len(places), -1)
            tried[of] = self.sheet[place]
            done = np.zeros(len(places), dtype=bool)
            done[of[seen]] = True
            left = ~done[row] & (self.sheet[candidate] != tried[row])
            row, candidate, under = row[left], candidate[left], under[left]
        return result


def copies(skin: Skin, inside: Inside, cover: Cover, pieces: Pieces, names: np.ndarray) -> Copies:
    """names: sorted, of all tets kept; those with no sheet lie within."""
    sheet_tet = np.searchsorted(names, pieces.sheet_tets())
    doubtful = np.flatnonzero(np.bincount(sheet_tet, minlength=len(names)) > 1)
    measured = np.union1d(doubtful, _folded(skin, pieces, names))
    on = _on_skin(skin, inside, cover, pieces, sheet_tet, measured)
    label = _insides(inside, cover, pieces, names, sheet_tet, doubtful, on)
    whole = np.setdiff1d(np.arange(len(names)), sheet_tet)
    tet = np.concatenate([sheet_tet, whole])
    label = np.concatenate([label, np.full(len(whole), len(label))])
    order = np.lexsort((label, tet))
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(tet[order]) != 0) | (np.diff(label[order]) != 0)
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    of, of_sheet = tet[order][new], number[: len(sheet_tet)]
    share = np.full(len(of), np.nan)
    share[np.isin(of, measured)] = 0.0
    sheet, part = _shares(inside, cover, names, measured, on)
    share += np.bincount(of_sheet[sheet], part, len(of))
    return Copies(of, of_sheet, share, on)


def _folded(skin: Skin, pieces: Pieces, names: np.ndarray) -> np.ndarray:
    """The tets in which the skin turns by more than FOLD."""
    tet = np.searchsorted(names, pieces.tet)
    normal = skin.normals[pieces.triangle]
    mean = np.stack([np.bincount(tet, n, len(names)) for n in normal.T], axis=1)[tet]
    return np.unique(tet[np.einsum("ni,ni->n", normal, mean) < np.cos(FOLD) * np.linalg.norm(mean, axis=1)])


def _on_skin(
    skin: Skin, inside: Inside, cover: Cover, pieces: Pieces, sheet_tet: np.ndarray, tets: np.ndarray
) -> OnSkin:
    """Of places on one sheet closer together than THINNED that face alike, one is taken."""
    sheet = pieces.sheet[pieces.piece]
    kept = np.flatnonzero(np.isin(sheet_tet[sheet], tets))
    facing = (skin.normals[pieces.triangle[pieces.piece[kept]]] > 0.0) @ [1, 2, 4]
    box = np.floor(pieces.places[kept] / THINNED).astype(np.int64)
    sides = (cover.grid.cells / THINNED).astype(np.int64) + 1
    key = np.ravel_multi_index((sheet[kept], *box.T, facing), (len(sheet_tet), *sides, 8))
    kept = kept[np.unique(key, return_index=True)[1]]  # by sheet, and so by tet
    places, triangle = pieces.places[kept], pieces.triangle[pieces.piece[kept]]
    normals = skin.normals[triangle]
    # Off the edges, where a step along one side's normal runs along the other side.
    inward = cover.places(skin.points[skin.triangles[triangle]].mean(axis=1)) - places
    way = np.linalg.norm(inward, axis=1, keepdims=True)
    places = places + inward * (OFF_EDGE / np.maximum(way, 1.0))
    step = STEP * inside.scale * normals
    points = cover.points(places)
    below, above = (inside.query(points + sign * step)[0] < 0.0 for sign in (-1.0, 1.0))
    return OnSkin(inside, cover, places, normals, sheet[kept], sheet_tet[sheet[kept]], below, above)


def _insides(
    inside: Inside,
    cover: Cover,
    pieces: Pieces,
    names: np.ndarray,
    sheet_tet: np.ndarray,
    tets: np.ndarray,
    on: OnSkin,
) -> np.ndarray:
    """A label for each sheet, alike where one inside within its tet joins them."""
    corners = cover.grid.places_of(cover.grid.nodes_of(names[tets]))
    middles = np.einsum("sk,tkd->tsd", part_middles(PARTS), corners)
    points = cover.points(middles)
    within = (inside.query(points.reshape(-1, 3))[0] < 0.0).reshape(middles.shape[:2])
    row, part = np.nonzero(within)
    number = np.zeros(within.shape, dtype=np.int64)
    number[row, part] = len(sheet_tet) + np.arange(len(row))
    to_sheet = np.stack([number[row, part], on.nearest_sheet(middles[row, part], tets[row])], axis=1)
    adjacent = adjacent_parts(PARTS)
    row_of, pair = np.nonzero(within[:, adjacent[:, 0]] & within[:, adjacent[:, 1]])
    a, b = adjacent[pair].T
    clear = inside.stays(points[row_of, a], points[row_of, b], STEP)
    between = np.stack([number[row_of, a], number[row_of, b]], axis=1)[clear]
    across = _across(inside, cover, pieces, names, on)
    bare = np.setdiff1d(
        on.sheet, on.sheet[on.below | on.above]
    )  # sheets with no inside of their own stay together
    together = chains(sheet_tet[bare], bare)
    label = components(len(sheet_tet) + len(row), np.concatenate([across, to_sheet, between, together]))
    return label[: len(sheet_tet)]


def _shares(
    inside: Inside, cover: Cover, names: np.ndarray, tets: np.ndarray, on: OnSkin
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) sheets, and the parts of their tets (n,) that are inside and joined to them.

    Measured along lines in the direction that the skin faces most, on a grid the same in all tets, so that of
    flesh thinner than the lines are apart none is missed."""
    # The sides of a plate face opposite ways: the direction that the squares of the normals have most of.
    spread = np.zeros((len(tets), 3, 3))
    np.add.at(spread, np.searchsorted(tets, on.tet), on.normals[:, :, None] * on.normals[:, None, :])
    frame = np.linalg.eigh(spread)[1] @ _ASKEW
    row, start, end = _lines(cover.grid.places_of(cover.grid.nodes_of(names[tets])), frame)
    share, where = inside.share(cover.points(start), cover.points(end), STEP)
    some = np.flatnonzero(share > 0.0)
    sheet = on.nearest_sheet(cover.places(where[some]), tets[row[some]])
    length = np.linalg.norm(end - start, axis=1)
    total = np.bincount(row, length, len(tets))
    return sheet, (share * length)[some] / total[row[some]]


def _lines(corners: np.ndarray, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines along frame[:, :, 2] (n, 3, 3) through tets (n, 4, 3): the tet of each, where it enters and leaves."""
    flat = np.einsum("tkd,tdi->tki", corners, frame)
    first = np.ceil(flat[:, :, :2].min(axis=1) / APART).astype(np.int64)
    count = np.floor(flat[:, :, :2].max(axis=1) / APART).astype(np.int64) - first + 1
    total = count.prod(axis=1)
    row = np.repeat(np.arange(len(corners)), total)
    nth = np.arange(len(row)) - np.repeat(np.cumsum(total) - total, total)
    i, j = np.divmod(nth, count[row, 1])
    across = APART * (first[row] + np.stack([i, j], axis=1))
    # Barycentric coordinates along a line are linear in the height on it: all are positive between two heights.
    edges = np.linalg.inv(np.swapaxes(flat[:, 1:] - flat[:, :1], 1, 2))
    slope = np.concatenate([-edges[:, :, 2].sum(axis=1, keepdims=True), edges[:, :, 2]], axis=1)[row]
    at = np.concatenate([across, np.zeros((len(row), 1))], axis=1) - flat[row, 0]
    inner = np.einsum("nij,nj->ni", edges[row], at)
    level = np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = -level / slope
    low = np.where(slope > 0.0, height, -np.inf).max(axis=1)
    high = np.where(slope < 0.0, height, np.inf).min(axis=1)
    kept = (high - low > STEP) & np.all((slope != 0.0) | (level >= 0.0), axis=1)
    ends = (np.concatenate([across[kept], h[kept, None]], axis=1) for h in (low, high))
    start, end = (np.einsum("ni,ndi->nd", e, frame[row[kept]]) for e in ends)
    return row[kept], start, end


def _across(inside: Inside, cover: Cover, pieces: Pieces, names: np.ndarray, on: OnSkin) -> np.ndarray:
    """Pairs of sheets with nothing but inside between them, within one tet, seen straight off the skin."""
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for sign, open_side in ((-1.0, on.below), (1.0, on.above)):
        ray = np.flatnonzero(open_side)
        direction = sign * on.normals[ray]
        start = cover.points(on.places[ray]) + STEP * inside.scale * direction
        triangle, distance = inside.first_hit(start, direction)
        hit = np.flatnonzero(triangle >= 0)
        end = cover.places(start[hit] + distance[hit, None] * direction[hit])
        tet = cover.grid.locate(end)
        same = tet == names[on.tet[ray[hit]]]
        piece = pieces.find(tet[same], triangle[hit][same])
        known = piece >= 0
        pairs.append(np.stack([on.sheet[ray[hit]][same][known], pieces.sheet[piece[known]]], axis=1))
    return np.concatenate(pairs)
