"""Collision particles inside triangles, in the middle of equal parts, so that each has one face's normal."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Triangles with no more divisions are filled whole, whatever part of them is asked for.
WHOLE = 6


class FaceParticles(NamedTuple):
    """A lattice (Han 2019 §4.1, not at random): the centroids of the n^2 parts, alike, that a triangle falls into.

    triangle: (count,) int64.  weight: (count, 3) barycentric.  share: (count,) of the triangle's area.
    key: (count,) int64, which of its triangle's particles it is.
    """

    triangle: np.ndarray
    weight: np.ndarray
    share: np.ndarray
    key: np.ndarray

    def take(self, chosen: np.ndarray) -> FaceParticles:
        return FaceParticles(*(array[chosen] for array in self))


def fill(corners: np.ndarray, spacing: float, box: np.ndarray | None = None) -> FaceParticles:
    """Particles of triangles (n, 3, 3) [m], in parts whose sides are at most `spacing` [m] long.

    box: (2, 3) [m] that those asked for lie in; None for all.
    """
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    divisions = np.maximum(np.ceil(sides.max(axis=1, initial=0.0) / spacing - 1e-9), 1).astype(np.int64)
    by_part = box is not None
    found = [_no_particles()]
    for n in np.unique(divisions[divisions <= WHOLE] if by_part else divisions):
        chosen = np.flatnonzero(divisions == n)
        weight, key = _lattice(int(n), np.zeros(2, dtype=int), np.full(2, n))
        found.append(_particles(np.repeat(chosen, len(key)), np.tile(weight, (len(chosen), 1)), key, n))
    for t in np.flatnonzero(divisions > WHOLE) if by_part else ():
        n = int(divisions[t])
        weight, key = _lattice(n, *_range_in(corners[t], n, box))
        found.append(_particles(np.full(len(key), t), weight, key, n))
    joined = FaceParticles(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))
    if not by_part:
        return joined
    place = np.einsum("nk,nkd->nd", joined.weight, corners[joined.triangle])
    return joined.take(((place >= box[0]) & (place <= box[1])).all(axis=1))


def fill_boxes(corners: np.ndarray, spacing: float, boxes: np.ndarray) -> FaceParticles:
    """Of the particles of `fill` those in some of (m, 2, 3) boxes [m], each once."""
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    found = [_no_particles()]
    for box in boxes:
        meets = np.flatnonzero(((lower <= box[1]) & (upper >= box[0])).all(axis=1))
        held = fill(corners[meets], spacing, box)
        found.append(held._replace(triangle=meets[held.triangle]))
    joined = FaceParticles(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))
    order = np.lexsort((joined.key, joined.triangle))
    changes = np.diff(joined.triangle[order], prepend=-1) | np.diff(joined.key[order], prepend=-1)
    return joined.take(order[changes != 0])


def _lattice(n: int, first: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (k, 3) and keys (k,) of the parts in columns and rows first to end - 1, (2,) each, of n."""
    i, j = (grid.ravel() for grid in np.mgrid[first[0] : end[0], first[1] : end[1]])
    way, key = [], []
    for k, third in enumerate((1.0, 2.0)):
        held = i + j < n - k
        way.append((np.stack([i[held], j[held]], axis=1) + third / 3.0) / n)
        key.append(2 * (i[held] * n + j[held]) + k)
    joined = np.concatenate(way)
    return np.column_stack([1.0 - joined.sum(axis=1), joined]), np.concatenate(key)


def _range_in(corners: np.ndarray, n: int, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of a triangle (3, 3) that hold what of it is in a box (2, 3): those of its corners."""
    picks = np.indices((2, 2, 2)).reshape(3, -1).T
    offset = box[picks, np.arange(3)] - corners[0]
    way = n * offset @ np.linalg.pinv(np.stack([corners[1] - corners[0], corners[2] - corners[0]]))
    first, end = np.floor(way.min(axis=0)) - 1.0, np.ceil(way.max(axis=0)) + 1.0
    return np.clip(first, 0, n).astype(int), np.clip(end, 0, n).astype(int)


def _particles(triangle: np.ndarray, weight: np.ndarray, key: np.ndarray, n: int) -> FaceParticles:
    repeats = len(triangle) // max(len(key), 1)
    return FaceParticles(triangle, weight, np.full(len(triangle), 1.0 / n**2), np.tile(key, repeats))


def _no_particles() -> FaceParticles:
    none = np.zeros(0, dtype=np.int64)
    return FaceParticles(none, np.zeros((0, 3)), np.zeros(0), none)
