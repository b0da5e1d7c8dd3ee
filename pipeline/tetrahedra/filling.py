"""Fills a skin with tets of the body-centred cubic lattice."""

from __future__ import annotations

import numpy as np

from plait.pipeline.tetrahedra import bcc, samples, splitting
from plait.pipeline.tetrahedra.cover import Cover, lay
from plait.pipeline.tetrahedra.fractions import cut_fractions
from plait.pipeline.tetrahedra.graphs import components
from plait.pipeline.tetrahedra.joining import joined_nodes
from plait.pipeline.tetrahedra.mesh import Lattice
from plait.pipeline.tetrahedra.skin import Inside, Skin, prepare

BUDGET = 20_000
# A budget is met within this part below; the edge is searched for at most so often.
BUDGET_SLACK = 0.04
SEARCHES = 12
# Of a cell: from its middle to the nodes of its tets.
CELL_REACH = 1.0
BLOCK = 4  # cells a side are asked about at once


def fill(points: np.ndarray, triangles: np.ndarray, *, edge: float | None = None, budget: int = BUDGET) -> Lattice:
    """Tets over the inside of a skin and all of the skin itself.

    points: (point_count, 3); triangles: (triangle_count, 3), outward. The skin may be open, of many shells, and
    shells may overlap; those that are inside out are turned (`skin.prepare`). Inside is where the winding number
    exceeds one half. Parts that come near one another without touching share no nodes (`splitting`).
    edge: mean edge of the tets, in the units of the points; None lets `budget`, the most tets wanted, decide.
    """
    skin = prepare(points, triangles)
    inside = Inside.of(skin)
    if edge is None:
        cover, pieces, names = _within_budget(skin, inside, budget)
    else:
        cover, pieces, names = _covered(skin, inside, edge / bcc.MEAN_EDGE)
    copies = splitting.copies(skin, inside, cover, pieces, names)
    return _lattice(skin, inside, cover, pieces, names, copies)


def _covered(skin: Skin, inside: Inside, cell: float) -> tuple[Cover, samples.Pieces, np.ndarray]:
    """A lattice laid over the skin, the skin cut by it, and the sorted names of the tets kept."""
    cover = lay(skin.points, cell)
    pieces = samples.cut(skin, cover.places(skin.points), cover.grid)
    return cover, pieces, np.unique(np.concatenate([pieces.tet, _middle_inside(inside, cover)]))


def _within_budget(skin: Skin, inside: Inside, budget: int) -> tuple[Cover, samples.Pieces, np.ndarray]:
    """`_covered` with the smallest cell found that takes at most `budget` tets.

    The count goes as volume / cell³ + area / cell²: each count made tells the area for the next guess.
    """
    volume = skin.volume / bcc.TET_VOLUME
    cell = skin.diagonal / 20.0
    best, least, most = None, 0.0, np.inf
    for _ in range(SEARCHES):
        found = _covered(skin, inside, cell)
        count = len(found[2])
        if count > budget:
            least = cell
        else:
            best, most = found, cell
            if count >= (1.0 - BUDGET_SLACK) * budget:
                break
        filled = min(volume, 0.95 * count * cell**3)
        guess = _cell_for((1.0 - 0.5 * BUDGET_SLACK) * budget, filled, count * cell**2 - filled / cell)
        cell = guess if least < guess < most else 0.5 * (least + min(most, 4.0 * least))
    return best if best is not None else _covered(skin, inside, 4.0 * cell)


def _cell_for(count: float, volume: float, area: float) -> float:
    """Where volume / cell³ + area / cell² = count."""
    roots = np.roots([count, 0.0, -area, -volume])
    return float(roots[np.abs(roots.imag) <= 1e-9 * np.abs(roots)].real.max())


def _lattice(
    skin: Skin, inside: Inside, cover: Cover, pieces: samples.Pieces, names: np.ndarray, copies: splitting.Copies
) -> Lattice:
    """Tets and nodes in the order of the lattice's cells."""
    node = joined_nodes(inside, cover, pieces, names, copies)
    covering = _pieces_with(node, copies.of_sheet)
    # Copies whose corners have all become one and the same are one tet.
    corners, first, of_copy = np.unique(node[covering], axis=0, return_index=True, return_inverse=True)
    used, tets = np.unique(corners, return_inverse=True)
    place = np.empty(int(node.max()) + 1, dtype=np.int64)
    place[node] = cover.grid.nodes_of(names)[copies.tet]
    nodes, tets = cover.points(cover.grid.places_of(place[used])), tets.reshape(-1, 4)
    own = copies.share[covering]
    share = np.bincount(of_copy.ravel(), np.nan_to_num(own))
    whole = np.isnan(own[first])
    share[whole] = cut_fractions(inside, nodes, tets[whole])
    tet_of = np.empty(len(node), dtype=np.int32)
    tet_of[covering] = of_copy.ravel()
    skin_tet = tet_of[copies.of_sheet[pieces.sheet[pieces.point_piece]]]
    return Lattice(nodes, tets.astype(np.int32), np.where(skin.welded < 0, -1, skin_tet[skin.welded]), share)


def _pieces_with(node: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The tets (n, 4) that hang together with a chosen one; beyond a hole in the skin lie some that do not."""
    piece = components(int(node.max()) + 1, np.concatenate([node[:, [0, k]] for k in (1, 2, 3)]))[node[:, 0]]
    return np.flatnonzero(np.isin(piece, piece[chosen]))


def _middle_inside(inside: Inside, cover: Cover) -> np.ndarray:
    """Cells far from the skin are settled in blocks, those near it by each tet's centroid."""
    grid = cover.grid
    blocks = _box(-(-grid.cells // BLOCK))
    distance, _ = inside.query(cover.points(BLOCK * (blocks + 0.5)))
    reach = cover.cell * (np.sqrt(0.75) * BLOCK + CELL_REACH)
    blocks = blocks[distance < reach]
    cells = (BLOCK * blocks[:, None] + _box(np.full(3, BLOCK))).reshape(-1, 3)
    cells = cells[np.all(cells < grid.cells - 1, axis=1)]
    distance, _ = inside.query(cover.points(cells + 0.5))
    reach = cover.cell * CELL_REACH
    whole = grid.tets_of_cells(cells[distance <= -reach]).ravel()
    near = grid.tets_of_cells(cells[np.abs(distance) < reach]).ravel()
    distance, _ = inside.query(cover.points(grid.centroids(near)))
    return np.concatenate([whole, near[distance < 0.0]])


def _box(sides: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(*(np.arange(n) for n in sides), indexing="ij"), axis=-1).reshape(-1, 3)
