"""Fills a skin with tets of the body-centred cubic lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.pipeline.tetrahedra import bcc
from plait.pipeline.tetrahedra.mesh import Lattice
from plait.pipeline.tetrahedra.skin import Inside, Skin, prepare

BUDGET = 20_000
FINER = 3  # samples a tet: this cubed
# A budget is met within this part below; the edge is searched for so often.
BUDGET_SLACK = 0.05
SEARCHES = 12


@dataclass(frozen=True)
class Cover:
    """The lattice laid over a skin: places are (points - origin) / cell in its units."""

    grid: bcc.Grid
    origin: np.ndarray
    cell: float

    def places(self, points: np.ndarray) -> np.ndarray:
        return (points - self.origin) / self.cell

    def points(self, places: np.ndarray) -> np.ndarray:
        return self.origin + self.cell * places


def fill(points: np.ndarray, triangles: np.ndarray, *, edge: float | None = None, budget: int = BUDGET) -> Lattice:
    """Tets over the inside of a skin and all of the skin itself.

    points: (point_count, 3); triangles: (triangle_count, 3), outward. The skin may be open, of many shells, and
    shells may overlap; those that are inside out are turned. Inside is where the winding number exceeds one half
    (Jacobson 2013).
    edge: mean edge of the tets, in the units of the points; None lets `budget`, the most tets wanted, decide.
    """
    skin = prepare(points, triangles)
    inside = Inside(skin.points, skin.triangles)
    if edge is None:
        edge = _edge_for(skin, inside, budget)
    cover = lay(skin, edge / bcc.MEAN_EDGE)
    names = _covering(skin, inside, cover)
    corners = cover.grid.nodes_of(names)
    used, tets = np.unique(corners, return_inverse=True)
    located = cover.grid.locate(cover.places(skin.points))
    return Lattice(
        cover.points(cover.grid.places_of(used)),
        tets.reshape(-1, 4).astype(np.int32),
        np.searchsorted(names, located)[skin.welded].astype(np.int32),
    )


def lay(skin: Skin, cell: float) -> Cover:
    low, high = skin.points.min(axis=0), skin.points.max(axis=0)
    cells = np.ceil((high - low) / cell).astype(np.int64) + 3
    return Cover(bcc.Grid(cells), 0.5 * (low + high) - 0.5 * cell * cells, cell)


def _covering(skin: Skin, inside: Inside, cover: Cover) -> np.ndarray:
    """Sorted names of the tets that hold some of the skin or of the inside."""
    names = cover.grid.locate(cover.places(_on_skin(skin, cover.cell / FINER)))
    return np.unique(np.concatenate([np.unique(names), _holding_inside(inside, cover)]))


def _on_skin(skin: Skin, spacing: float) -> np.ndarray:
    """Points all over the skin, its own among them, no further apart than `spacing`."""
    corners = skin.points[skin.triangles]
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    parts = np.maximum(np.ceil(sides / spacing), 1).astype(np.int64)
    found = [skin.points]
    for n in np.unique(parts):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        kept = i + j <= n
        weights = np.stack([i[kept], j[kept], n - i[kept] - j[kept]], axis=1) / n
        found.append(np.einsum("sk,tkd->tsd", weights, corners[parts == n]).reshape(-1, 3))
    return np.concatenate(found)


def _holding_inside(inside: Inside, cover: Cover) -> np.ndarray:
    """Tets with a sample inside: whole cells where the skin is far, finer tets' middles where it is near."""
    cells = np.stack(np.meshgrid(*(np.arange(n - 1) for n in cover.grid.cells), indexing="ij"), axis=-1)
    tets = np.unique(cover.grid.tets_of_cells(cells.reshape(-1, 3)))
    distance, _ = inside.query(cover.points(cover.grid.centroids(tets)))
    reach = cover.cell * np.sqrt(5.0) / 4.0  # from a tet's centroid to its nodes
    whole = tets[distance < -reach]
    near = tets[np.abs(distance) <= reach]
    places, owners = fine_samples(cover, near)
    distance, _ = inside.query(cover.points(places))
    return np.concatenate([whole, np.unique(owners[distance < 0.0])])


def fine_samples(cover: Cover, names: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the FINER³ equal parts of each tet: places (n, 3), and the tet each lies in (n,)."""
    corners = cover.grid.places_of(cover.grid.nodes_of(names))
    weights = part_middles(FINER)
    places = np.einsum("sk,tkd->tsd", weights, corners)
    return places.reshape(-1, 3), np.repeat(names, len(weights))


def part_middles(factor: int) -> np.ndarray:
    """(factor³, 4) barycentric middles of the parts a tet of the lattice has in one `factor` times finer."""
    grid = bcc.Grid(np.array([3, 3, 3]))
    name = np.array([grid.locate(np.array([[1.6, 1.55, 1.9]]))[0]])
    corners = grid.places_of(grid.nodes_of(name))[0]
    fine = grid.refined(factor)
    cells = np.stack(np.meshgrid(*[np.arange(3 * factor - 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    middles = fine.centroids(np.unique(fine.tets_of_cells(cells))) / factor
    middles = middles[np.all((middles > 1.0) & (middles < 2.5), axis=1)]
    middles = middles[grid.locate(middles) == name]
    edges = (corners[1:] - corners[0]).T
    inner = np.linalg.solve(edges, (middles - corners[0]).T).T
    return np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)


def _edge_for(skin: Skin, inside: Inside, budget: int) -> float:
    """The mean edge at which the skin takes at most `budget` tets, and hardly fewer."""
    edge = skin.diagonal / 20.0
    low, high = 0.0, np.inf  # an edge with too many tets, one with few enough
    best = None
    for _ in range(SEARCHES):
        count = len(_covering(skin, inside, lay(skin, edge / bcc.MEAN_EDGE)))
        if count > budget:
            low = edge
        else:
            high, best = edge, edge
            if count >= (1.0 - BUDGET_SLACK) * budget:
                break
        wanted = edge * (count / ((1.0 - 0.4 * BUDGET_SLACK) * budget)) ** (1.0 / 2.6)
        edge = wanted if low < wanted < high else 0.5 * (low + min(high, 4.0 * low))
    return best if best is not None else high
