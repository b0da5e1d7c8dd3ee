"""Wigs of mannequins: strands start off the skin and hardly within each other, and stay where they grow."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from plait.assets import groom, mannequin, wig

WIG = wig.Wig(60, 10, 0.4)


def nearer(strands: np.ndarray, width: float) -> int:
    """Pairs of points of different strands (strand_count, n, 3) that are nearer than `width`."""
    pairs = cKDTree(strands.reshape(-1, 3)).query_pairs(width, output_type="ndarray")
    return int((pairs[:, 0] // strands.shape[1] != pairs[:, 1] // strands.shape[1]).sum())


def test_strands_keep_off_each_other_and_the_skin():
    body = mannequin.make(mannequin.AVERAGE)
    drawn = groom.build(body.points, body.triangles, WIG.style)
    apart = wig.spread(drawn.points, WIG)
    assert nearer(apart, WIG.width) < 0.1 * nearer(drawn.points, WIG.width)
    assert np.array_equal(apart[:, :2], drawn.points[:, :2])
    # The clearance is met to what a step along the distance's gradient leaves of it.
    assert WIG.style.distance(apart[:, 2:].reshape(-1, 3)).min() > 0.9 * WIG.style.clearance
