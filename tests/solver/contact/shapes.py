"""Moving bodies for contact tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plait.solver.scene import Pose


@dataclass(frozen=True)
class Played:
    """Points given by a function of the rest points and time."""

    function: Callable[[np.ndarray, float], np.ndarray]
    rest: np.ndarray
    animated: bool = True

    def pose(self, time: float) -> Pose:
        return Pose(np.eye(4)[None], points=self.function(self.rest, time))


def grid(count: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """A square sheet in z = 0 facing up."""
    along = np.linspace(-0.5 * size, 0.5 * size, count)
    points = np.array([[x, y, 0.0] for x in along for y in along])
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    first = np.stack([corner, corner + count, corner + 1], axis=1)
    second = np.stack([corner + count, corner + count + 1, corner + 1], axis=1)
    return points, np.concatenate([first, second])


def ball(rings: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed sphere facing out."""
    around = 2 * rings
    polar, turn = np.pi * np.arange(1, rings) / rings, np.pi * np.arange(around) / rings
    circle = np.stack(
        [
            np.outer(np.sin(polar), np.cos(turn)),
            np.outer(np.sin(polar), np.sin(turn)),
            np.outer(np.cos(polar), np.ones(around)),
        ],
        axis=2,
    )
    points = np.vstack([circle.reshape(-1, 3), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]) * radius
    triangles = []
    for j in range(around):
        following = (j + 1) % around
        triangles.append([len(points) - 2, j, following])
        last = (rings - 2) * around
        triangles.append([len(points) - 1, last + following, last + j])
        for i in range(rings - 2):
            a, b = i * around + j, i * around + following
            triangles += [[a, a + around, b], [b, a + around, b + around]]
    return points, np.array(triangles)
