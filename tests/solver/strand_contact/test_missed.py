"""The count of strands that pass through each other, against TightInclusion and motions known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.strand_contact.missed import MissedCollisions
from plait.solver.strand_contact.missed_kernels import find_missed

from .pairs_of_edges import layout_of, random_motions, tight_inclusion
from .referee import edges_of

LAUNCHER = Launcher("cpu", threads=1)
# Into a frame along no axis.
ROTATION = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]


def touches(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(count,) bool: what the kernel says of pairs (count, 4, 3)."""
    first = 4 * np.arange(len(start))
    pairs = wp.array(np.stack([first, first + 2], axis=1), dtype=wp.vec2i)
    poses = [wp.array(x.reshape(-1, 3), dtype=wp.vec3d) for x in (start, end)]
    missed = wp.zeros(len(start), dtype=wp.int32)
    thin = wp.zeros(4 * len(start), dtype=wp.float64)
    LAUNCHER.launch(find_missed, len(start), [pairs, poses[0], thin, *poses], [missed])
    return missed.numpy() == 1


@pytest.mark.parametrize("origin, scale", [(0.0, 1.0), (100.0, 5e-3)])
def test_agrees_with_tight_inclusion(origin, scale):
    """Wherever one says that edges touch so does the other, but for those TightInclusion leaves within 1e-5."""
    start, end = random_motions(1500, seed=4)
    truth = tight_inclusion(start, end)
    found = touches(origin + scale * start, origin + scale * end)
    assert truth.sum() > 150 and not np.any(found & ~truth)
    # Its answers are conservative to its tolerance: there the edges pass within about 1e-6 of their way.
    assert np.sum(truth & ~found) <= 1


def test_parallel_edges_meet_in_their_plane():
    """An edge carried by the part `way` of its distance to a parallel one of its length: they touch from 1 on."""
    random = np.random.default_rng(6)
    way = np.concatenate([random.uniform(0.2, 0.999, 200), random.uniform(1.001, 30.0, 200)])
    u, a, apart = (random.standard_normal((400, 3)) for _ in range(3))
    start = np.stack([a, a + u, a + apart, a + apart + u], axis=1)
    end = start.copy()
    end[:, 2:] -= (way[:, None] * apart)[:, None]
    # Carried beyond, not just up to it: the edges' own plane is kept, whatever the rounding.
    np.testing.assert_array_equal(touches(start, end), way >= 1.0)


def test_edges_in_one_plane():
    """Two edges that stay in a plane, along the axes or along none, against 2001 poses on the way."""
    random = np.random.default_rng(7)
    start = random.uniform(-1.0, 1.0, (200, 4, 3)) * [1.0, 1.0, 0.0]
    end = start + 0.5 * random.standard_normal(start.shape) * [1.0, 1.0, 0.0]
    gaps = np.min([_gap_in_plane((1.0 - t) * start + t * end) for t in np.linspace(0.0, 1.0, 2001)], axis=0)
    clear = (gaps == 0.0) | (gaps > 2e-3)  # between two poses no point moves more than 1e-3
    assert clear.mean() > 0.95 and 50 < np.sum(gaps == 0.0) < 150
    for turn in (np.eye(3), ROTATION):
        np.testing.assert_array_equal(touches(start @ turn, end @ turn)[clear], gaps[clear] == 0.0)


def _gap_in_plane(x: np.ndarray) -> np.ndarray:
    """(count,) distances of edges (count, 4, 3) in the plane z = 0; 0 where they cross."""

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        return np.cross(q - p, r - p)[:, 2]

    a, b, c, d = np.swapaxes(x, 0, 1)
    crossing = (side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0)
    gaps = []
    for point, p, q in ((a, c, d), (b, c, d), (c, a, b), (d, a, b)):
        way = q - p
        part = np.clip(np.sum((point - p) * way, axis=1) / np.sum(way**2, axis=1), 0.0, 1.0)
        gaps.append(np.linalg.norm(p + part[:, None] * way - point, axis=1))
    return np.where(crossing, 0.0, np.min(gaps, axis=0))


def test_edges_in_one_line():
    """Intervals on a line touch if their ends come in another order, or overlap at the start."""
    random = np.random.default_rng(8)
    start, end = random.uniform(-1.0, 1.0, (2, 400, 4))
    low, high = (lambda x, k: x[:, k : k + 2].min(axis=1)), (lambda x, k: x[:, k : k + 2].max(axis=1))
    moved = [(1.0 - t) * start + t * end for t in np.linspace(0.0, 1.0, 2001)]
    gaps = np.array([np.maximum(low(x, 2) - high(x, 0), low(x, 0) - high(x, 2)) for x in moved]).min(axis=0)
    clear = np.abs(gaps) > 2e-3  # what the sampling in time leaves open: speeds up to 4, steps of 1 / 2000
    found = touches(start[:, :, None] * ROTATION[0], end[:, :, None] * ROTATION[0])
    np.testing.assert_array_equal(found[clear], gaps[clear] < 0.0)


def test_strands_that_pass_are_counted_once():
    """One strand thrown through another crosses it in one place; and with both at 20 m/s besides, 83 mm a step."""
    s = np.linspace(-0.03, 0.03, 13) + 0.0011
    flat = np.zeros_like(s)
    layout = layout_of([np.stack([s, flat, flat], 1), np.stack([flat, flat + 0.004, s], 1)])
    missed = MissedCollisions(LAUNCHER, layout)
    start = layout.position
    end = start.copy()
    end[layout.node_strand == 1, 1] -= 0.01

    def count(a: np.ndarray, b: np.ndarray) -> int:
        return missed.count(wp.array(a, dtype=wp.vec3d), wp.array(b, dtype=wp.vec3d))

    assert count(start, end) == 1
    a, b = missed.pairs[0]
    assert start[a, 0] < 0.0 < start[a + 1, 0] and start[b, 2] < 0.0 < start[b + 1, 2]
    assert count(start, end + np.array([0.083, 0.0, 0.02])) == 1
    assert count(start, start) == 0 and count(start, start + 0.083) == 0 and len(missed.pairs) == 0


def test_all_strands_are_looked_at():
    """A tangle in which every strand moves on its own: as many as among all pairs of edges."""
    random = np.random.default_rng(9)
    roots = random.uniform(-0.01, 0.01, (8, 1, 3))
    layout = layout_of(list(roots + np.cumsum(4e-3 * random.standard_normal((8, 10, 3)), axis=1)))
    start = layout.position
    end = start + 6e-3 * random.standard_normal(start.shape) + 0.05
    edges = edges_of(layout.first_node)
    a, b = (edges[k] for k in np.triu_indices(len(edges), 1))
    apart = (b - a > 1) | (layout.node_strand[a] != layout.node_strand[b])
    a, b = a[apart], b[apart]
    pairs = np.stack([a, a + 1, b, b + 1], axis=1)
    expected = touches(start[pairs], end[pairs])
    missed = MissedCollisions(LAUNCHER, layout)
    count = missed.count(wp.array(start, dtype=wp.vec3d), wp.array(end, dtype=wp.vec3d))
    assert count == expected.sum() > 10
    np.testing.assert_array_equal(missed.pairs, np.stack([a, b], axis=1)[expected])
