"""Which copies of tets share nodes: those between which the flesh goes on."""

from __future__ import annotations

import numpy as np

from plait.pipeline.tetrahedra.cover import Cover
from plait.pipeline.tetrahedra.graphs import components
from plait.pipeline.tetrahedra.samples import Pieces
from plait.pipeline.tetrahedra.skin import Inside
from plait.pipeline.tetrahedra.splitting import Copies

CRUMB = 2.0  # cells: pieces of flesh no larger than this are held by what they lie beside


def joined_nodes(inside: Inside, cover: Cover, pieces: Pieces, names: np.ndarray, copies: Copies) -> np.ndarray:
    """(copy_count, 4) a number for each corner of each copy, alike where corners are one node.

    names: sorted, of all tets kept. Two copies of neighbouring tets are one flesh where a triangle of the skin
    goes on from one to the other, or where all of the face between them is inside. A crumb of flesh that touches
    nothing (a button, an eyebrow) shares the tets that it lies in with what is larger there."""
    corners = cover.grid.nodes_of(names)
    behind = cover.grid.neighbours(names)
    along = _along_skin(pieces, names, behind, copies)
    within = _within(inside, cover, names, corners, behind, copies, along)
    one, corner, other = np.concatenate([along, within], axis=1)
    place = corners[copies.tet]
    pairs = []
    for k in range(1, 4):
        mine = (corner + k) % 4
        twin = np.argmax(place[other] == place[one, mine][:, None], axis=1)
        pairs.append(np.stack([4 * one + mine, 4 * other + twin], axis=1))
    joined = np.concatenate(pairs)
    node = components(4 * len(copies.tet), joined).reshape(-1, 4)
    crumbs = _crumbs(cover, copies, node, place)
    if not len(crumbs):
        return node
    corner = np.arange(4)
    held = (4 * crumbs[:, :, None] + corner).transpose(0, 2, 1).reshape(-1, 2)
    return components(4 * len(copies.tet), np.concatenate([joined, held])).reshape(-1, 4)


def _along_skin(pieces: Pieces, names: np.ndarray, behind: np.ndarray, copies: Copies) -> np.ndarray:
    """(3, n): a copy, its corner opposite the face that a triangle of the skin crosses, and the copy behind."""
    piece, corner = np.repeat(np.arange(len(pieces.tet)), 4), np.tile(np.arange(4), len(pieces.tet))
    twin = pieces.find(behind[np.searchsorted(names, pieces.tet)].ravel(), pieces.triangle[piece])
    met = twin >= 0
    one, other = (copies.of_sheet[pieces.sheet[p[met]]] for p in (piece, twin))
    return np.unique(np.stack([one, corner[met], other]), axis=1)


def _within(
    inside: Inside,
    cover: Cover,
    names: np.ndarray,
    corners: np.ndarray,
    behind: np.ndarray,
    copies: Copies,
    along: np.ndarray,
) -> np.ndarray:
    """As `_along_skin`, for faces that no skin crosses and that are inside."""
    tet, corner = np.nonzero(np.isin(behind, names))
    other = np.searchsorted(names, behind[tet, corner])
    crossed = np.isin(4 * tet + corner, 4 * copies.tet[along[0]] + along[1])
    kept = (tet < other) & ~crossed
    tet, corner, other = tet[kept], corner[kept], other[kept]
    places = cover.grid.places_of(corners[tet])
    rows = np.arange(len(tet))
    middle = (places.sum(axis=1) - places[rows, corner]) / 3.0
    skinned = np.zeros(len(names), dtype=bool)
    skinned[copies.tet[copies.of_sheet]] = True
    asked = np.flatnonzero(skinned[tet] & skinned[other])
    fleshy = np.ones(len(tet), dtype=bool)
    fleshy[asked] = inside.query(cover.points(middle[asked]))[0] < 0.0
    tet, corner, other, middle = tet[fleshy], corner[fleshy], other[fleshy], middle[fleshy]
    return np.stack([_copy_at(middle, tet, copies), corner, _copy_at(middle, other, copies)])


def _copy_at(places: np.ndarray, tet: np.ndarray, copies: Copies) -> np.ndarray:
    """The copy of each tet (n,) that a place inside it (n, 3) belongs to."""
    result = np.searchsorted(copies.tet, tet)
    several = np.flatnonzero(np.searchsorted(copies.tet, tet, side="right") - result > 1)
    result[several] = copies.of_sheet[copies.on.nearest_sheet(places[several], tet[several])]
    return result


def _crumbs(cover: Cover, copies: Copies, node: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(n, 2) pairs of copies of one tet: of a crumb, and of the largest flesh there."""
    flesh = components(int(node.max()) + 1, np.concatenate([node[:, [0, k]] for k in (1, 2, 3)]))[node[:, 0]]
    count = int(flesh.max()) + 1
    if count == 1:
        return np.zeros((0, 2), dtype=np.int64)
    where = cover.grid.places_of(place)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, flesh, where.min(axis=1))
    np.maximum.at(high, flesh, where.max(axis=1))
    size = np.bincount(flesh)
    crumb = (high - low).max(axis=1) <= CRUMB + 1.0
    # The copies of each tet, largest flesh first: the crumbs behind it hold on to it.
    order = np.lexsort((-size[flesh], copies.tet))
    first = np.searchsorted(copies.tet, copies.tet[order])
    largest = order[first]
    held = crumb[flesh[order]] & (flesh[order] != flesh[largest])
    return np.stack([order[held], largest[held]], axis=1)
