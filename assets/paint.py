"""Colours a mesh by regions with clean borders: triangles that a border crosses are split along it."""

from __future__ import annotations

import numpy as np

from plait.assets.implicit import Distance

SNAP = 0.25  # part of an edge within which a border takes the edge's end along instead of splitting the edge


def split_along(level: Distance, points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same surface with the zero level of `level` along its edges; a closed mesh stays closed.

    points (n, 3), triangles (m, 3) give (n', 3) and (m', 3), new points last. Where the border passes close to a
    point, the point moves there.
    """
    points = points.copy()
    values = level(points)
    edges, place = _crossings(level, points, triangles, values)
    share = np.linalg.norm(place - points[edges[:, 0]], axis=1) / np.linalg.norm(
        points[edges[:, 1]] - points[edges[:, 0]], axis=1
    )
    ends = np.where(share < 0.5, edges[:, 0], edges[:, 1])
    nearness = np.minimum(share, 1.0 - share)
    near = np.argsort(-nearness, kind="stable")  # the nearest crossing is written last
    near = near[nearness[near] < SNAP]
    points[ends[near]] = place[near]
    values[ends[near]] = 0.0
    edges, place = _crossings(level, points, triangles, values)
    new = {(int(a), int(b)): len(points) + k for k, (a, b) in enumerate(edges)}
    return np.concatenate([points, place]), _split(triangles, values, new)


def _crossings(
    level: Distance, points: np.ndarray, triangles: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Edges (k, 2), lower index first, with ends on different sides, and where (k, 3) the border meets them."""
    edges = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    edges = edges[values[edges[:, 0]] * values[edges[:, 1]] < 0.0]
    inner = np.where(values[edges[:, 0]] < 0.0, edges[:, 0], edges[:, 1])
    low, high = points[inner], points[edges.sum(axis=1) - inner]
    for _ in range(24):  # bisection
        middle = 0.5 * (low + high)
        below = (level(middle) < 0.0)[:, None]
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return edges, 0.5 * (low + high)


def _split(triangles: np.ndarray, values: np.ndarray, new: dict[tuple[int, int], int]) -> np.ndarray:
    result = []
    for corners in triangles.tolist():
        ring = []  # the triangle's outline with the new points, each with its side
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            ring.append(a)
            if (min(a, b), max(a, b)) in new:
                ring.append(new[min(a, b), max(a, b)])
        # A border goes between new points, or from one to the corner that lies on it: fans do not cross it
        # if they start at a new point, or at the corner it ends in.
        added = [k for k, vertex in enumerate(ring) if vertex >= len(values)]
        start = added[0] if added else 0
        if len(added) == 2 and added[1] - added[0] != 2:
            start = added[1]  # so that the corner that is alone on its side comes second
        ring = ring[start:] + ring[:start]
        result += [(ring[0], ring[k], ring[k + 1]) for k in range(1, len(ring) - 1)]
    return np.array(result)
