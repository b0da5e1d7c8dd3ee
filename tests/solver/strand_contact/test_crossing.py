"""Closest points and first touch of two edges against their definitions and TightInclusion."""

from __future__ import annotations

import ipctk
import numpy as np
import pytest
import warp as wp

from plait.solver.strand_contact.crossing_kernels import (
    PARALLEL,
    closest_on_edges,
    distance_of_edges,
    first_touch,
    may_cross,
)
from plait.solver.warp_start import start_warp

from .pairs_of_edges import random_motions, tight_inclusion

start_warp()
wp.set_module_options({"enable_backward": False})
EPSILON = float(PARALLEL)


@wp.kernel(enable_backward=False)
def measure(
    p: wp.array2d(dtype=wp.vec3d),
    q: wp.array2d(dtype=wp.vec3d),
    least: wp.float64,
    closest: wp.array(dtype=wp.vec2d),
    distance: wp.array(dtype=wp.float64),
    crossing: wp.array(dtype=wp.int32),
    touch: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    closest[i] = closest_on_edges(p[i, 0], p[i, 1], p[i, 2], p[i, 3])
    distance[i] = distance_of_edges(p[i, 0], p[i, 1], p[i, 2], p[i, 3])
    crosses = may_cross(p[i, 0], p[i, 1], p[i, 2], p[i, 3], q[i, 0], q[i, 1], q[i, 2], q[i, 3])
    crossing[i] = wp.where(crosses, 1, 0)
    touch[i] = first_touch(p[i, 0], p[i, 1], p[i, 2], p[i, 3], q[i, 0], q[i, 1], q[i, 2], q[i, 3], least)


def run(p: np.ndarray, q: np.ndarray | None = None, least: float = 1e-5) -> tuple[np.ndarray, ...]:
    """Closest parameters, distance at the start, `may_cross`, first touch."""
    q = p if q is None else q
    outputs = [wp.zeros(len(p), dtype=t) for t in (wp.vec2d, wp.float64, wp.int32, wp.float64)]
    inputs = [wp.array(p, dtype=wp.vec3d), wp.array(q, dtype=wp.vec3d), wp.float64(least)]
    wp.launch(measure, len(p), [*inputs, *outputs], device="cpu")
    return tuple(out.numpy() for out in outputs)


def resting_pairs() -> np.ndarray:
    """Random, nearly parallel, parallel, and shrunk to points."""
    p, _ = random_motions(2000, seed=1)
    p[:200, 3] = p[:200, 2] + (p[:200, 1] - p[:200, 0]) * np.linspace(-2, 2, 200)[:, None]
    p[200:220, 1] = p[200:220, 0]
    p[220:240, 3] = p[220:240, 2]
    p[230:240, 1] = p[230:240, 0]
    return p


def test_closest_points_minimise_the_weighted_distance():
    """The projected gradient of |d|^2 / 2 + eps / 2 (|u|^2 (s - 1/2)^2 + |v|^2 (t - 1/2)^2) over [0, 1]^2 is 0."""
    p = resting_pairs()
    s, t = run(p)[0].T
    u, v = p[:, 1] - p[:, 0], p[:, 3] - p[:, 2]
    d = p[:, 2] + t[:, None] * v - p[:, 0] - s[:, None] * u
    for x, edge, slope in ((s, u, -np.sum(d * u, axis=1)), (t, v, np.sum(d * v, axis=1))):
        slope = slope + EPSILON * np.sum(edge**2, axis=1) * (x - 0.5)
        step = np.clip(x - slope, 0.0, 1.0) - x
        # Solving a system whose condition is 1 / eps costs as many digits.
        assert np.abs(step).max() < 1e-15 / EPSILON * 10.0


def test_closest_points_are_almost_the_closest():
    """Their squared distance is at most eps (|u|^2 + |v|^2) / 4 above the edges' own."""
    p = resting_pairs()
    closest, distance, _, _ = run(p)
    s, t = closest[:, :1], closest[:, 1:]
    u, v = p[:, 1] - p[:, 0], p[:, 3] - p[:, 2]
    squared = np.sum((p[:, 2] + t * v - p[:, 0] - s * u) ** 2, axis=1)
    above = squared - distance**2
    assert above.min() > -1e-12
    assert np.all(above <= 0.25 * EPSILON * np.sum(u**2 + v**2, axis=1) + 1e-12)


def test_parallel_edges_meet_in_the_middle_of_their_overlap():
    """Two unit edges one of which is ahead by h overlap from h to 1: s = (1 + h) / 2, but for eps."""
    ahead = np.linspace(-0.9, 0.9, 19)
    p = np.zeros((len(ahead), 4, 3))
    p[:, 1, 0] = 1.0
    p[:, 2:, 0] = ahead[:, None] + [0.0, 1.0]
    p[:, 2:, 1] = 0.1
    s, t = run(p)[0].T
    np.testing.assert_allclose(s, 0.5 * (1.0 + ahead), atol=EPSILON)
    np.testing.assert_allclose(t, 0.5 * (1.0 - ahead), atol=EPSILON)


def test_closest_points_turn_smoothly_through_parallel():
    """An edge at distance d turned by phi about its middle moves them by d phi / (2 eps), no faster."""
    angle, d = np.linspace(-1e-3, 1e-3, 401), 0.1
    p = np.zeros((len(angle), 4, 3))
    p[:, 0, 0], p[:, 1, 0] = -0.5, 0.5
    way = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    p[:, 2], p[:, 3] = [0.0, d, 0.0] - 0.5 * way, [0.0, d, 0.0] + 0.5 * way
    s, t = run(p)[0].T
    fastest = d / (2.0 * EPSILON) * (angle[1] - angle[0])
    assert np.abs(np.diff(s)).max() <= 1.01 * fastest and np.abs(np.diff(t)).max() <= 1.01 * fastest
    assert s[0] > 0.7 and s[-1] < 0.3


def test_distance_is_exact():
    """As ipctk has it: of edges, and of a point and an edge, which it tells apart."""
    p = resting_pairs()
    expected = np.sqrt([ipctk.edge_edge_distance(*pair) for pair in p])
    expected[200:220] = np.sqrt([ipctk.point_edge_distance(pair[0], *pair[2:]) for pair in p[200:220]])
    expected[220:240] = np.sqrt([ipctk.point_edge_distance(pair[2], *pair[:2]) for pair in p[220:240]])
    np.testing.assert_allclose(run(p)[1], expected, atol=1e-12)


@pytest.mark.parametrize("origin, scale", [(0.0, 1.0), (100.0, 5e-3)])
def test_first_touch_is_never_late_nor_missed(origin, scale):
    """Where TightInclusion says the edges touch, so do both tests here; up to the time told, it finds nothing.

    100 m away the coordinates of a segment of 5 mm are rounded by 3e-12 of its length, far below TightInclusion's
    tolerance, 1e-6, and the distance asked for, 1e-5 of a segment.
    """
    least = 1e-5
    start, end = (origin + scale * x for x in random_motions(1000, seed=2))
    truth = tight_inclusion((start - origin) / scale, (end - origin) / scale)
    _, distance, crossing, touch = run(start, end, least * scale)
    assert truth.sum() > 100 and np.all(touch[truth] <= 1.0) and np.all(crossing[truth] == 1)
    kept = start + np.minimum(touch, 1.0)[:, None, None] * (end - start)
    floor = np.minimum(least * scale, 0.5 * distance)
    assert np.all(run(kept)[1] >= floor * (1.0 - 1e-6))
    assert not tight_inclusion((start - origin) / scale, (kept - origin) / scale).any()


def test_first_touch_is_told_where_the_edges_are_near():
    """A time in [0, 1] is one at which they are within 1.1 of the distance asked for; not just anywhere before."""
    start, end = random_motions(4000, seed=3)
    _, distance, _, touch = run(start, end, 1e-3)
    hit = touch <= 1.0
    there = run((start + touch[:, None, None] * (end - start))[hit])[1]
    assert hit.sum() > 200 and np.all(there <= 1.1 * np.minimum(1e-3, 0.5 * distance[hit]) + 1e-9)


def test_sliding_edges_do_not_touch():
    """Edges that slide over each other at a distance just above the least one, however fast, do not touch."""
    p = np.array([[[0, 0, 0], [1, 0, 0], [0.3, -0.5, 1.01e-3], [0.3, 0.5, 1.01e-3]]], dtype=float)
    q = p + np.array([0, 0, 0, 0])[:, None]
    q[0, 2:] += [0.0, 30.0, 0.0]
    assert run(p, q, 1e-3)[3][0] > 1.0


def test_edges_that_touch_at_the_start_touch_at_once():
    p = np.array([[[0, 0, 0], [1, 0, 0], [0.5, -1, 0], [0.5, 1, 0]]], dtype=float)
    q = p + np.array([0, 0, 1, 1])[:, None]
    _, distance, crossing, touch = run(p, q)
    assert distance[0] == 0.0 and crossing[0] == 1 and touch[0] == 0.0


def test_what_stays_apart_is_excluded():
    """Edges whose boxes are apart all the while, or that stay on one side of each other, cannot cross."""
    p = np.array([[[0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 2, 0]], [[0, 0, 0], [1, 0, 0], [0.5, -1, 1], [0.5, 1, 1]]])
    p = p.astype(float)
    q = p + 0.1 * np.random.default_rng(0).standard_normal(p.shape) + 20.0
    assert not run(p, q)[2].any()
