"""A skin as something that has an inside: seams closed, shells turned the right way round, places asked about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from plait.pipeline.tetrahedra.graphs import components
from plait.pipeline.tetrahedra.kernels import signed_distance
from plait.solver.warp_start import start_warp

# A shell whose volume, its holes capped, is less than this part of area^1.5 is a sheet: no side of it is outside.
SHEET = 1e-4


@dataclass(frozen=True)
class Skin:
    """points: (n, 3) float64, no two at one place; triangles: (m, 3) int32, outward; in the caller's units.

    welded: (point_count,) int32, the one of `points` that each of the caller's points became.
    flipped: how many shells were inside out.  shell: (m,) the connected piece each triangle belongs to.
    """

    points: np.ndarray
    triangles: np.ndarray
    welded: np.ndarray
    shell: np.ndarray
    flipped: int

    @property
    def diagonal(self) -> float:
        """Of the bounding box, in the caller's units."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))


def prepare(points: np.ndarray, triangles: np.ndarray) -> Skin:
    """Welds points at the same place (to 1e-7 of the diagonal), turns shells that are inside out."""
    points = np.asarray(points, dtype=np.float64)
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    rounded = np.round((points - points.min(axis=0)) / (1e-7 * diagonal)).astype(np.int64)
    _, first, welded = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    welded = welded.ravel()
    corners = welded[np.asarray(triangles)]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    shell_of_point = components(len(first), np.concatenate([corners[:, :2], corners[:, 1:]]))
    _, shell = np.unique(shell_of_point[corners[:, 0]], return_inverse=True)
    corners, flipped = _outward(points[first], corners, shell)
    return Skin(points[first], corners.astype(np.int32), welded.astype(np.int32), shell, flipped)


def _outward(points: np.ndarray, triangles: np.ndarray, shell: np.ndarray) -> tuple[np.ndarray, int]:
    count = int(shell.max()) + 1
    volume, area = capped_volumes(points, triangles, shell, count)
    wrong = volume < -SHEET * area**1.5
    turned = np.where(wrong[shell][:, None], triangles[:, [0, 2, 1]], triangles)
    return turned, int(wrong.sum())


def capped_volumes(
    points: np.ndarray, triangles: np.ndarray, shell: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """(count,) signed volume of each shell with every hole closed by a fan about its middle, and (count,) area."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    owner = np.tile(shell, 3)
    ordered = np.sort(edges, axis=1)
    _, inverse = np.unique(ordered[:, 0] * len(points) + ordered[:, 1], return_inverse=True)
    # Each direction an edge is passed in counts against the other; what is left over bounds a hole.
    net = np.bincount(inverse, np.where(edges[:, 0] < edges[:, 1], 1.0, -1.0))
    rim = np.abs(net[inverse]) > 0.5
    edges, owner = edges[rim], owner[rim]
    middle = points[triangles].mean(axis=1)
    area2 = np.linalg.norm(_cross(points, triangles), axis=1)
    centre = np.stack([np.bincount(shell, area2 * m, count) for m in middle.T], axis=1)
    centre /= np.bincount(shell, area2, count)[:, None]
    volume = np.bincount(shell, _from(points[triangles], centre[shell]), count)
    if len(edges):
        hole = components(len(points), edges)[edges[:, 0]]
        _, hole = np.unique(hole, return_inverse=True)
        size = np.bincount(hole)
        fan = np.stack([np.bincount(hole, m) for m in points[edges].mean(axis=1).T], axis=1) / size[:, None]
        cap = np.stack([points[edges[:, 1]], points[edges[:, 0]], fan[hole]], axis=1)
        volume += np.bincount(owner, _from(cap, centre[owner]), count)
    return volume, np.bincount(shell, 0.5 * area2, count)


def _cross(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _from(corners: np.ndarray, centre: np.ndarray) -> np.ndarray:
    x = corners - centre[:, None]
    return np.einsum("ni,ni->n", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6.0


class Inside:
    """Answers where places lie, by winding number (Barill 2018, as in Warp), in any units; float32 of the size."""

    def __init__(self, points: np.ndarray, triangles: np.ndarray) -> None:
        start_warp()
        self.middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        self.scale = float(np.linalg.norm(np.ptp(points, axis=0)))
        self.mesh = wp.Mesh(
            wp.array(self.unit(points), dtype=wp.vec3, device="cpu"),
            wp.array(np.ascontiguousarray(triangles, dtype=np.int32).ravel(), dtype=wp.int32, device="cpu"),
            support_winding_number=True,
        )

    def unit(self, places: np.ndarray) -> np.ndarray:
        """Places as float32, in units of the mesh's size about its middle."""
        return np.ascontiguousarray((places - self.middle) / self.scale, dtype=np.float32)

    def query(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) signed distance to the skin, negative inside, and (n,) int32 the closest triangle."""
        count = len(places)
        distance = wp.empty(count, dtype=wp.float32, device="cpu")
        face = wp.empty(count, dtype=wp.int32, device="cpu")
        at = wp.array(self.unit(places), dtype=wp.vec3, device="cpu")
        wp.launch(signed_distance, dim=count, inputs=[self.mesh.id, at], outputs=[distance, face], device="cpu")
        return distance.numpy().astype(np.float64) * self.scale, face.numpy()
