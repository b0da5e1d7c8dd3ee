"""Bezier curves pass through every third of their control points: rods run along the curve itself.

A rod along the control polygon would bend at the handles and at the joints alike, and the curve drawn from it
would have a kink at every joint, a third of all the bending. So the curve is simulated at the parameters 0, 1/3,
2/3, 1 of each segment, as many points as it has control points, and these are found back from them exactly.
"""

from __future__ import annotations

import numpy as np

from plait.pipeline.shot import Stencil

# Cubic Bernstein polynomials at 1/3 and 2/3, and the inverse map, for the two handles of a segment.
_EVALUATE = np.array([[8, 12, 6, 1], [1, 6, 12, 8]]) / 27.0
_RECOVER = np.array([[-5, 18, -9, 2], [2, -9, 18, -5]]) / 6.0


def on_curve(points: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(n, 3) points of the curves, one a control point (n, 3). counts: (curve_count,)."""
    nodes = points.copy()
    first = _segments(counts)
    for k in (0, 1):
        nodes[first + 1 + k] = np.einsum("j,sjd->sd", _EVALUATE[k], points[first[:, None] + np.arange(4)])
    return nodes


def stencil(counts: np.ndarray, point_map: np.ndarray) -> Stencil:
    """The control points from simulated ones. point_map: (n,), the simulated point of each of `on_curve`."""
    entries = np.repeat(np.arange(len(point_map))[:, None], 4, axis=1)
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (len(point_map), 1))
    first = _segments(counts)
    for k in (0, 1):
        entries[first + 1 + k] = first[:, None] + np.arange(4)
        weights[first + 1 + k] = _RECOVER[k]
    return Stencil(point_map[entries].astype(np.int32), weights)


def _segments(counts: np.ndarray) -> np.ndarray:
    """The first control point of each segment; a curve whose count makes no whole segments has none."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    pieces = [
        start + 3 * np.arange((count - 1) // 3)
        for start, count in zip(starts, counts, strict=True)
        if count >= 4 and (count - 1) % 3 == 0
    ]
    return np.concatenate(pieces) if pieces else np.zeros(0, dtype=np.int64)
