"""Closest points on triangles and among points, for a groom's roots. Plain numpy: nothing is compiled for it."""

from __future__ import annotations

import numpy as np

GROUP = 64
LEAF = 4


def closest_on_triangles(
    queries: np.ndarray, points: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each query the closest triangle, the barycentric place on it, and the distance.

    queries: (q, 3).  points: (p, 3).  triangles: (t, 3), one or more.
    Returns (q,) int, (q, 3) and (q,). Queries are halved until a few lie together; on the way down, triangles that
    the bounding sphere of the queries left rules out are dropped.
    """
    corners = points[triangles]
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    nearest = np.zeros(len(queries), dtype=np.int64)
    places = np.zeros((len(queries), 3))
    distances = np.zeros(len(queries))
    todo = [(np.arange(len(queries)), np.arange(len(triangles)))] if len(queries) else []
    while todo:
        group, near = todo.pop()
        members = queries[group]
        middle = 0.5 * (members.min(axis=0) + members.max(axis=0))
        reach = np.linalg.norm(members - middle, axis=1).max()
        away = np.linalg.norm(centres[near] - middle, axis=1)
        # Every member is within reach of the middle, the middle within min(away) of the surface.
        near = near[away - radii[near] <= away.min() + 2.0 * reach]
        if len(group) > LEAF:
            todo += [(half, near) for half in _halves(queries, group)]
            continue
        place, squared = closest_on_each(members[:, None], corners[None, near])
        best = np.argmin(squared, axis=1)
        rows = np.arange(len(group))
        nearest[group], places[group] = near[best], place[rows, best]
        distances[group] = np.sqrt(squared[rows, best])
    return nearest, places, distances


def nearest_points(queries: np.ndarray, points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """For each query the `count` nearest of some points, nearest first, and their distances.

    queries: (q, 3).  points: (p, 3), one or more.  Returns (q, k) int and (q, k), k = min(count, p). Of points
    that are equally near those that come first are taken.
    """
    count = min(count, len(points))
    nearest = np.zeros((len(queries), count), dtype=np.int64)
    distances = np.zeros((len(queries), count))
    todo = [(np.arange(len(queries)), np.arange(len(points)))] if len(queries) else []
    while todo:
        group, near = todo.pop()
        members = queries[group]
        middle = 0.5 * (members.min(axis=0) + members.max(axis=0))
        reach = np.linalg.norm(members - middle, axis=1).max()
        away = np.linalg.norm(points[near] - middle, axis=1)
        # So many points lie no further than this from every member; rounding must not drop the last of them.
        furthest = (np.partition(away, count - 1)[count - 1] + 2.0 * reach) * (1.0 + 1e-12)
        near = near[away <= furthest]
        if len(group) > LEAF:
            todo += [(half, near) for half in _halves(queries, group)]
            continue
        squared = _dot(members[:, None] - points[None, near], members[:, None] - points[None, near])
        order = np.argsort(squared, axis=1, kind="stable")[:, :count]
        nearest[group] = near[order]
        distances[group] = np.sqrt(np.take_along_axis(squared, order, axis=1))
    return nearest, distances


def groups_of(queries: np.ndarray) -> list[np.ndarray]:
    """Indices of queries in groups of at most GROUP that lie together: halved across the longest side."""
    todo, done = [np.arange(len(queries))] if len(queries) else [], []
    while todo:
        group = todo.pop()
        if len(group) <= GROUP:
            done.append(group)
        else:
            todo += _halves(queries, group)
    return done


def _halves(queries: np.ndarray, group: np.ndarray) -> list[np.ndarray]:
    members = queries[group]
    order = np.argsort(members[:, np.argmax(np.ptp(members, axis=0))], kind="stable")
    half = len(group) // 2
    return [group[order[:half]], group[order[half:]]]


def closest_on_each(queries: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric place closest to each query on each triangle (..., 3), and the squared distance (...,).

    queries: (..., 3).  corners: (..., 3, 3), broadcast against them. The plane's own closest place where that lies
    inside, else the closest of the three edges' (Ericson 2005, 5.1.5, without its branches).
    """
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    ab, ac, aq = b - a, c - a, queries - a
    d00, d01, d11 = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    d20, d21 = _dot(aq, ab), _dot(aq, ac)
    determinant = d00 * d11 - d01 * d01
    safe = np.where(determinant > 0.0, determinant, 1.0)
    v, w = (d11 * d20 - d01 * d21) / safe, (d00 * d21 - d01 * d20) / safe
    inside = (determinant > 0.0) & (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0)
    best = np.stack(np.broadcast_arrays(1.0 - v - w, v, w), axis=-1)
    squared = np.where(inside, _squared_distance(best, corners, queries), np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, along = corners[..., i, :], corners[..., j, :] - corners[..., i, :]
        length = _dot(along, along)
        s = np.clip(_dot(queries - start, along) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
        place = np.zeros((*s.shape, 3))
        place[..., i], place[..., j] = 1.0 - s, s
        candidate = _squared_distance(place, corners, queries)
        closer = candidate < squared
        best = np.where(closer[..., None], place, best)
        squared = np.where(closer, candidate, squared)
    return best, squared


def _squared_distance(place: np.ndarray, corners: np.ndarray, queries: np.ndarray) -> np.ndarray:
    difference = np.einsum("...k,...kd->...d", place, corners) - queries
    return _dot(difference, difference)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=-1)
