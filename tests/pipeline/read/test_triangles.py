"""Faces to triangles: area and orientation kept, concave faces too; seams closed only where points move alike."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.read.triangles import clip_ears, triangulate, weld

# A comb, a star and a spiral arm: simple polygons that a fan would leave.
COMB = [(0, 0), (7, 0), (7, 3), (6, 3), (6, 1), (5, 1), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (0, 3)]
ARROW = [(0, 0), (4, 2), (0, 4), (1, 2)]


def _polygon_area(flat: np.ndarray) -> float:
    x, y = flat.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _star(count: int) -> np.ndarray:
    angles = 2.0 * np.pi * np.arange(2 * count) / (2 * count)
    return (
        np.column_stack([np.cos(angles), np.sin(angles)]) * np.where(np.arange(2 * count) % 2, 0.3, 1.0)[:, None]
    )


def _areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


@pytest.mark.parametrize(
    "flat", [np.array(COMB, float), np.array(ARROW, float), _star(7)], ids=["comb", "arrow", "star"]
)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_simple_polygons_are_covered_once(flat: np.ndarray, axis: int) -> None:
    """The triangles' signed areas, all positive, sum to the shoelace formula's."""
    points = np.roll(np.column_stack([flat, np.zeros(len(flat))]), axis, axis=1)
    triangles, faces = triangulate(points, np.array([len(flat)]), np.arange(len(flat)))
    normal = np.roll([0.0, 0.0, 1.0], axis)
    areas = _areas(points, triangles) @ normal
    assert np.all(areas > 0.0)
    assert areas.sum() == pytest.approx(_polygon_area(flat), rel=1e-12)
    assert len(triangles) == len(flat) - 2 and not faces.any()


def test_left_handed_faces_are_turned() -> None:
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float)
    right, _ = triangulate(points, np.array([4]), np.arange(4))
    left, _ = triangulate(points, np.array([4]), np.arange(4), left_handed=True)
    assert np.all(_areas(points, right)[:, 2] > 0.0) and np.all(_areas(points, left)[:, 2] < 0.0)


def test_faces_keep_their_numbers_and_lines_are_left_out() -> None:
    points = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0)], float)
    counts, indices = np.array([3, 3, 0, 4]), np.array([0, 1, 2, 0, 1, 3, 0, 1, 4, 3])
    triangles, faces = triangulate(points, counts, indices)
    assert faces.tolist() == [1, 3, 3]
    assert len(triangles) == 3


def test_a_polygon_that_crosses_itself_still_ends() -> None:
    bow = np.array([(0, 0, 0), (2, 2, 0), (2, 0, 0), (0, 2, 0), (-1, 1, 0)], float)
    assert clip_ears(bow, np.arange(5)).shape == (3, 3)


def test_weld_joins_equal_points_that_move_alike() -> None:
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 0, 0), (-0.0, 0, 0)], float)
    attached = np.array([[1.0], [1.0], [1.0], [2.0]])
    kept, welded = weld(points, np.zeros((0, 3), int), attached)
    assert kept.tolist() == [0, 1, 3]
    assert welded.tolist() == [0, 1, 0, 2]
