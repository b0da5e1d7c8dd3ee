"""Bars of tets: what the cases and benchmarks of elastic bodies bend and shake."""

from __future__ import annotations

import numpy as np

from plait.solver.scene import Embedding, Scene, Surface, TetBody


def bar_lattice(cells: tuple[int, int, int], length: float) -> tuple[np.ndarray, np.ndarray]:
    """A bar from zero along x, its cells cubes: nodes (node_count, 3) [m] and tets (tet_count, 4) int32.

    The middles of two cells and an edge of the face between them are a tet; a middle and half an outer face too.
    """
    counts = np.array(cells)
    corner = np.arange(np.prod(counts + 1)).reshape(counts + 1)
    middle = corner.size + np.arange(np.prod(counts)).reshape(counts)
    tets = []
    for axis in range(3):
        across, up = (axis + 1) % 3, (axis + 2) % 3
        by_face = np.moveaxis(corner, (axis, across, up), (0, 1, 2))
        ring = [by_face[:, :-1, :-1], by_face[:, 1:, :-1], by_face[:, 1:, 1:], by_face[:, :-1, 1:]]
        cell = np.moveaxis(middle, (axis, across, up), (0, 1, 2))
        for k in range(4):
            ends = ring[k][1:-1], ring[(k + 1) % 4][1:-1]
            tets.append(np.stack([*ends, cell[:-1], cell[1:]], axis=-1).reshape(-1, 4))
        for face in (0, -1):
            for half in ((0, 1, 2), (0, 2, 3)):
                outer = [ring[k][face] for k in half]
                tets.append(np.stack([*outer, cell[face]], axis=-1).reshape(-1, 4))
    corners = np.stack(np.meshgrid(*[np.arange(n + 1.0) for n in counts], indexing="ij"), -1).reshape(-1, 3)
    middles = np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in counts], indexing="ij"), -1).reshape(-1, 3)
    nodes = np.concatenate([corners, middles]) * length / counts[0]
    tets = np.concatenate(tets)
    # Neighbours in space are neighbours in memory, as in the lattices that fill a character.
    order = np.argsort(nodes[:, 0] + 1e-3 * nodes[:, 1] + 1e-6 * nodes[:, 2], kind="stable")
    number = np.empty(len(nodes), dtype=np.int64)
    number[order] = np.arange(len(nodes))
    nodes, tets = nodes[order], number[tets]
    tets = tets[np.argsort(tets.min(axis=1), kind="stable")]
    x = nodes[tets]
    negative = np.linalg.det(x[:, 1:] - x[:, :1]) < 0.0
    tets[negative, 2:] = tets[negative, :1:-1]
    return nodes, tets.astype(np.int32)


def bar_scene(
    nodes: np.ndarray,
    tets: np.ndarray,
    *,
    youngs_modulus: float,
    poissons_ratio: float,
    density: float = 1000.0,
    clamped: bool = True,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Scene:
    """A bar of `bar_lattice`, held where x is zero if clamped."""
    faces = tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outer = faces[first[count == 1]]
    used, triangles = np.unique(outer, return_inverse=True)
    corners, place = np.unique(tets.ravel(), return_index=True)
    place = place[np.searchsorted(corners, used)]
    skin = Surface("skin", nodes[used], triangles.reshape(-1, 3).astype(np.int32), body=0)
    bar = TetBody(
        "bar",
        nodes,
        tets,
        0,
        Embedding((place // 4).astype(np.int32), np.eye(4)[place % 4]),
        np.full(len(tets), density),
        np.full(len(tets), youngs_modulus),
        np.full(len(tets), poissons_ratio),
        np.isclose(nodes[:, 0], 0.0) & clamped,
        np.zeros(len(nodes)),
    )
    return Scene(surfaces=(skin,), bodies=(bar,), gravity=np.array(gravity))
