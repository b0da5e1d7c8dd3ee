"""Normals that turn with the hair: each keeps its place in the material frame of the segment it is drawn at."""

from __future__ import annotations

import numpy as np

from plait.pipeline.shot import Normals


class CarriedNormals:
    """One prim's normals through a run."""

    def __init__(
        self,
        normals: Normals,
        points: np.ndarray,
        directors: np.ndarray,
        rotations: np.ndarray,
        strand_offsets: np.ndarray,
    ) -> None:
        """Takes the frames of a run's first moment, when strands lie as drawn, carried rigidly by their roots.

        points, directors: (n, 3), simulated points and the unit director of the segment behind each, scene world.
        rotations: (strand_count, 3, 3), from the space of the normals to world.  strand_offsets: as `Strands`.
        """
        self._segments = normals.segments
        strand = np.searchsorted(strand_offsets, normals.segments, side="right") - 1
        drawn = np.einsum("nij,nj->ni", rotations[strand], normals.values)
        self._parts = np.einsum("nij,nj->ni", self._frames(points, directors), drawn)

    def at(self, points: np.ndarray, directors: np.ndarray) -> np.ndarray:
        """(m, 3) float64, unit, scene world, with the strands as they are now."""
        return np.einsum("nji,nj->ni", self._frames(points, directors), self._parts)

    def _frames(self, points: np.ndarray, directors: np.ndarray) -> np.ndarray:
        """(m, 3, 3), rows: along the segment, its director, and what is across both."""
        along = points[self._segments + 1] - points[self._segments]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        director = directors[self._segments]
        director = director - np.sum(director * along, axis=1, keepdims=True) * along
        director /= np.linalg.norm(director, axis=1, keepdims=True)
        return np.stack([along, director, np.cross(along, director)], axis=1)
