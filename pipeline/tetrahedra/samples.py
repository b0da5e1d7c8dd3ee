"""The skin cut into pieces by the lattice: which triangles pass through which tets, and what hangs together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.pipeline.tetrahedra.bcc import Grid
from plait.pipeline.tetrahedra.crossings import lines_through, triangles_through
from plait.pipeline.tetrahedra.graphs import chains, components
from plait.pipeline.tetrahedra.skin import Skin

SPACING = 0.25  # of a cell, between places on the skin
SLIVER = 0.1  # area over the longest side squared


@dataclass(frozen=True)
class Pieces:
    """A piece is a triangle within a tet; a sheet is what hangs together of the pieces within one tet.

    places: (n, 3) in cells, all over the skin; piece: (n,) the piece each lies on.
    triangle, tet: (piece_count,) of each piece, sorted by tet, then triangle.
    sheet: (piece_count,), numbered in the order of the tets.
    point_piece: (point_count,) a piece at each point of the skin.
    """

    places: np.ndarray
    piece: np.ndarray
    triangle: np.ndarray
    tet: np.ndarray
    sheet: np.ndarray
    point_piece: np.ndarray
    triangle_count: int

    def find(self, tet: np.ndarray, triangle: np.ndarray) -> np.ndarray:
        """(n,) the piece of each triangle in each tet; -1 for none."""
        key = self.tet * self.triangle_count + self.triangle
        wanted = tet * self.triangle_count + triangle
        place = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        return np.where(key[place] == wanted, place, -1)

    def sheet_tets(self) -> np.ndarray:
        """(sheet_count,) the tet of each sheet."""
        first = np.unique(self.sheet, return_index=True)[1]
        return self.tet[first]


@dataclass(frozen=True)
class _Spots:
    """Places (n, 3), the tet each was found in, and what it lies on: a point, an edge or a triangle."""

    places: np.ndarray
    tet: np.ndarray
    on: np.ndarray


def cut(skin: Skin, places: np.ndarray, grid: Grid) -> Pieces:
    """Every piece, and places on it no further apart than a quarter of a cell. places: the skin's points, in
    cells.

    Places a part of a cell apart find nearly all pieces; the rest follow from those through the faces between tets
    that their triangles cross.
    """
    triangles = skin.triangles.astype(np.int64)
    count = len(triangles)
    at_points = _Spots(places, grid.locate(places), np.arange(len(places)))
    pairs = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    key, edge = np.unique(pairs[:, 0] * len(places) + pairs[:, 1], return_inverse=True)
    ends = np.stack(np.divmod(key, len(places)), axis=1)
    along_edges = _with_missed(_along(places[ends], grid), places[ends], grid, lines_through)
    corner, owner = triangles.ravel(), np.repeat(np.arange(count), 3)
    of_points, of_edges = _incident(at_points, corner, owner), _incident(along_edges, edge, owner)
    known = _joined(of_points[0], of_edges[0], _within(places[triangles], grid))
    spots = _with_missed(known, places[triangles], grid, triangles_through)
    key, piece = np.unique(spots.tet * count + spots.on, return_inverse=True)
    tet, triangle = np.divmod(key, count)
    group = np.concatenate([of_points[1], of_edges[1] + len(places)])
    sheet = components(len(key), chains(group, piece[: len(group)]))
    point_piece = np.empty(len(places), dtype=np.int64)
    point_piece[of_points[1]] = piece[: len(of_points[1])]
    return Pieces(spots.places, piece, triangle, tet, sheet, point_piece, count)


def _incident(spots: _Spots, part: np.ndarray, triangle: np.ndarray) -> tuple[_Spots, np.ndarray]:
    """The spots on points or edges once for each triangle there, and which spot each was.

    part, triangle: (k,), the triangle has that point or edge.
    """
    order = np.argsort(part, kind="stable")
    first = np.searchsorted(part[order], spots.on)
    length = np.searchsorted(part[order], spots.on, side="right") - first
    of = np.repeat(np.arange(len(spots.on)), length)
    nth = np.arange(len(of)) - np.repeat(np.cumsum(length) - length, length)
    return _Spots(spots.places[of], spots.tet[of], triangle[order[first[of] + nth]]), of


def _along(ends: np.ndarray, grid: Grid) -> _Spots:
    """Places along lines (n, 2, 3), their ends among them."""
    parts = np.maximum(np.ceil(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / SPACING), 1).astype(np.int64)
    line = np.repeat(np.arange(len(ends)), parts + 1)
    step = np.arange(len(line)) - np.repeat(np.cumsum(parts + 1) - parts - 1, parts + 1)
    s = (step / parts[line])[:, None]
    places = (1.0 - s) * ends[line, 0] + s * ends[line, 1]
    return _Spots(places, grid.locate(places), line)


def _within(corners: np.ndarray, grid: Grid) -> _Spots:
    """A grid over the inside of each triangle (n, 3, 3), none on its edges and none in slivers."""
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    parts = np.where(SLIVER * sides**2 < area, np.ceil(sides / SPACING), 1).astype(np.int64)
    places, owners = [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
    for n in np.unique(parts[parts > 2]):
        i, j = np.meshgrid(np.arange(1, n), np.arange(1, n), indexing="ij")
        inner = i + j < n
        weights = np.stack([i[inner], j[inner], n - i[inner] - j[inner]], axis=1) / n
        mine = np.flatnonzero(parts == n)
        places.append(np.einsum("sk,tkd->tsd", weights, corners[mine]).reshape(-1, 3))
        owners.append(np.repeat(mine, len(weights)))
    found = np.concatenate(places)
    return _Spots(found, grid.locate(found), np.concatenate(owners))


def _with_missed(spots: _Spots, corners: np.ndarray, grid: Grid, through) -> _Spots:
    """And a spot in each tet more that a line or triangle, (n, k, 3), passes into through a face of one known."""
    count = len(corners)
    known = np.unique(spots.tet * count + spots.on)
    ends = grid.locate(corners.reshape(-1, 3)).reshape(corners.shape[:2])
    fresh = known[(ends != ends[:, :1]).any(axis=1)[known % count]]  # tets are convex
    found = [spots]
    while len(fresh):
        tet, on = np.divmod(fresh, count)
        behind = grid.neighbours(tet)
        face_corners = grid.places_of(grid.nodes_of(tet))
        candidate, face = np.nonzero(~np.isin(behind * count + on[:, None], known))
        keys = behind[candidate, face] * count + on[candidate]
        others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[face]
        meets, where = through(corners[on[candidate]], face_corners[candidate[:, None], others])
        keys, where = keys[meets], where[meets]
        fresh, first = np.unique(keys, return_index=True)
        found.append(_Spots(where[first], fresh // count, fresh % count))
        known = np.union1d(known, fresh)
    return _joined(*found)


def _joined(*spots: _Spots) -> _Spots:
    return _Spots(*(np.concatenate([getattr(s, name) for s in spots]) for name in ("places", "tet", "on")))
