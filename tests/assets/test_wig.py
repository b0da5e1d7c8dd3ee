"""Wigs of mannequins: strands start off the skin and hardly within each other, and stay where they grow."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from plait.assets import groom, mannequin, wig

WIG = wig.Wig(60, 10, 0.4)


def nearer(strands: np.ndarray, width: float) -> int:
    """Pairs of points nearer than `width`, 16 a segment, of different strands (strand_count, n, 3)."""
    part = np.linspace(0.0, 1.0, 16, endpoint=False)[:, None]
    points = (1.0 - part) * strands[:, 1:-1, None] + part * strands[:, 2:, None]
    pairs = cKDTree(points.reshape(-1, 3)).query_pairs(width, output_type="ndarray")
    first, second = (pairs // (points.shape[1] * points.shape[2])).T
    return int((first != second).sum())


def test_strands_keep_off_each_other_and_the_skin():
    body = mannequin.make(mannequin.AVERAGE)
    drawn = groom.build(body.points, body.triangles, WIG.style)
    apart = wig.spread(drawn.points, WIG)
    assert nearer(apart, WIG.width) < 0.01 * nearer(drawn.points, WIG.width)
    assert np.array_equal(apart[:, :2], drawn.points[:, :2])
    # The clearance is met to what a step along the distance's gradient leaves of it.
    assert WIG.style.distance(apart[:, 2:].reshape(-1, 3)).min() > 0.9 * WIG.style.clearance
