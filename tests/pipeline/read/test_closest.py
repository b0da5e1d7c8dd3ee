"""Closest points on triangles, against every triangle tried one by one."""

from __future__ import annotations

import numpy as np

from plait.pipeline.read.closest import GROUP, closest_on_triangles, nearest_points


def _brute_force(query: np.ndarray, corners: np.ndarray) -> float:
    """Least distance to any triangle, each on its own."""
    best = np.inf
    for a, b, c in corners:
        basis = np.column_stack([b - a, c - a])
        # Candidates of a convex quadratic on a triangle: the free minimum if inside, and those of the three edges.
        solution = np.linalg.lstsq(basis, query - a, rcond=None)[0]
        if min(solution[0], solution[1], 1.0 - solution.sum()) >= 0.0:
            best = min(best, np.linalg.norm(a + basis @ solution - query))
        for start, end in ((a, b), (b, c), (c, a)):
            s = np.clip(np.dot(query - start, end - start) / np.dot(end - start, end - start), 0.0, 1.0)
            best = min(best, np.linalg.norm(start + s * (end - start) - query))
    return best


def test_matches_every_triangle_tried() -> None:
    random = np.random.default_rng(3)
    points = random.normal(size=(60, 3))
    triangles = random.permutation(60)[:57].reshape(-1, 3)
    queries = random.normal(size=(2 * GROUP + 7, 3)) * 2.0
    triangle, place, distance = closest_on_triangles(queries, points, triangles)
    for k, query in enumerate(queries):
        expected = _brute_force(query, points[triangles])
        np.testing.assert_allclose(distance[k], expected, rtol=1e-9)
        spot = place[k] @ points[triangles[triangle[k]]]
        np.testing.assert_allclose(np.linalg.norm(spot - query), distance[k], rtol=1e-9)
    assert np.all(place >= 0.0)
    np.testing.assert_allclose(place.sum(axis=1), 1.0, rtol=1e-12)


def test_far_from_the_origin() -> None:
    """A place 10 km away is found as well as at the origin, to float64 rounding of the coordinates."""
    shift = np.array([1e4, -2e4, 5e3])
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], float) + shift
    _, place, distance = closest_on_triangles(np.array([[0.25, 0.25, 0.5]]) + shift, points, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(place[0], [0.5, 0.25, 0.25], atol=1e-10)
    np.testing.assert_allclose(distance[0], 0.5, rtol=1e-11)


def test_nearest_points_match_every_point_tried() -> None:
    """In clusters and with points that coincide, in order; of points equally near the first."""
    random = np.random.default_rng(4)
    points = np.concatenate([random.normal(size=(50, 3)), 1e-3 * random.normal(size=(50, 3)) + 2.0])
    points = np.concatenate([points, points[:10]])
    queries = np.concatenate([random.normal(size=(40, 3)), points[::7]])
    nearest, distance = nearest_points(queries, points, 5)
    every = np.linalg.norm(queries[:, None] - points[None], axis=2)
    expected = np.argsort(every, axis=1, kind="stable")[:, :5]
    np.testing.assert_array_equal(nearest, expected)
    np.testing.assert_allclose(distance, np.take_along_axis(every, expected, 1), rtol=1e-12)
    assert nearest_points(queries, points[:3], 5)[0].shape == (len(queries), 3)
