"""Collision particles in triangles: their areas, and those in a part of space."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.rigid.face_particles import fill, fill_boxes

SPACING = 0.05
# Two large triangles, a sliver and a small one.
CORNERS = np.array(
    [
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        [[1.0, 0.0, 0.0], [1.0, 0.3, 1.0], [0.0, 0.0, 1.0]],
        [[0.0, 0.0, 0.0], [0.9, 0.0, 0.0], [0.0, 0.001, 0.0]],
        [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]],
    ]
)


def places(found) -> np.ndarray:
    return np.einsum("nk,nkd->nd", found.weight, CORNERS[found.triangle])


def test_particles_are_the_centroids_of_equal_parts():
    """Shares of each triangle add up to one, so do weights; their mean is its centroid; none lies on its edge."""
    found = fill(CORNERS, SPACING)
    count = len(CORNERS)
    assert np.bincount(found.triangle, found.share, minlength=count) == pytest.approx(np.ones(count))
    assert found.weight.sum(axis=1) == pytest.approx(np.ones(len(found.key)))
    assert found.weight.min() > 0.0
    for t in range(count):
        own = found.triangle == t
        assert found.weight[own].mean(axis=0) == pytest.approx(np.full(3, 1.0 / 3.0))
        assert np.isclose(found.share[own], 1.0 / own.sum()).all()
        assert len(np.unique(found.key[own])) == own.sum()


def test_neighbours_are_closer_than_a_part_is_long():
    x = places(fill(CORNERS[:1], SPACING))
    apart = np.linalg.norm(x[:, None] - x, axis=2) + np.eye(len(x))
    assert apart.min(axis=1).max() < SPACING


def test_those_in_boxes_are_the_same_each_once():
    boxes = np.array(
        [
            [[0.2, -0.1, 0.2], [0.4, 0.1, 0.9]],
            [[0.3, -0.1, 0.2], [0.6, 0.1, 0.5]],
            [[-1.0, -1.0, -1.0], [0.1, 0.1, 0.1]],
            [[5.0, 5.0, 5.0], [6.0, 6.0, 6.0]],
        ]
    )
    every, found = fill(CORNERS, SPACING), fill_boxes(CORNERS, SPACING, boxes)
    x = places(every)
    inside = np.array([((x >= low) & (x <= high)).all(axis=1) for low, high in boxes]).any(axis=0)
    asked = sorted(zip(every.triangle[inside], every.key[inside], strict=True))
    assert sorted(zip(found.triangle, found.key, strict=True)) == asked
    assert len(asked) > 100
    assert not len(fill_boxes(CORNERS, SPACING, boxes[3:]).key)
