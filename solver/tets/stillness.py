"""How long an elastic body in contact has lain still."""

from __future__ import annotations

import numpy as np
import warp as wp

# A body lies still once none of its nodes has gone further than this part of a tet's edge for so long [s]: what
# speeds up by more than a ten-thousandth of gravity goes further in tets of ten centimetres.
STILL, STILL_TIME = 1e-3, 0.5
# Times are sums of substeps.
ROUNDING = 1e-9


class Stillness:
    """Watches over one body.

    place: (node_count,) vec3d [m], where its nodes were when they were last found to move.
    time: (1,) float64 [s], how long they have been no further from there; 0: nothing is noted.
    Both are parts of the state.
    """

    def __init__(self, place: wp.array, time: wp.array, edge: float) -> None:
        """edge: [m] mean, of the body's tets."""
        self._place, self._time, self._furthest = place, time, STILL * edge
        self._kept_place = wp.zeros_like(place)
        self._moved = False

    @property
    def noted(self) -> bool:
        """Whether the body was in contact, and nothing disturbed it, when a step last ended."""
        return self._elapsed > 0.0

    @property
    def lasts(self) -> bool:
        """Whether the body lies still."""
        return self._elapsed >= STILL_TIME - ROUNDING

    @property
    def _elapsed(self) -> float:
        return float(self._time.numpy()[0])

    def begin(self) -> None:
        """From here `retract` takes it back to."""
        self._kept_time, self._moved = self._elapsed, False

    def forget(self) -> None:
        """Something has happened to the body."""
        self._time.zero_()

    def watch(self, position: wp.array, length: float) -> None:
        """Takes note of where a step of `length` [s] in contact has taken the nodes, (node_count,) vec3d."""
        elapsed = self._elapsed
        if elapsed > 0.0:
            way = position.numpy() - self._place.numpy()
            if np.einsum("ni,ni->n", way, way).max() <= self._furthest**2:
                self._time.fill_(elapsed + length)
                return
        wp.copy(self._kept_place, self._place)
        self._moved = True
        wp.copy(self._place, position)
        self._time.fill_(length)

    def retract(self) -> None:
        """As it was at `begin`."""
        if self._moved:
            wp.copy(self._place, self._kept_place)
        self._time.fill_(self._kept_time)


def islands(count: int, pairs: np.ndarray) -> list[np.ndarray]:
    """Bodies 0 to `count` in groups, within which `pairs`, (n, 2), lead from each to each; ascending."""
    label = np.arange(count)
    while True:
        least = label.copy()
        np.minimum.at(least, pairs[:, 0], label[pairs[:, 1]])
        np.minimum.at(least, pairs[:, 1], label[pairs[:, 0]])
        if np.array_equal(least, label):
            return [np.flatnonzero(label == first) for first in np.unique(label)]
        label = least
