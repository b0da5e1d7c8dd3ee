"""A skin as something that has an inside: seams closed, shells turned the right way round, places asked about."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

from plait.pipeline.tetrahedra import kernels
from plait.pipeline.tetrahedra.graphs import components
from plait.solver.warp_start import start_warp

# An open shell whose volume, its holes capped, is less than this part of area^1.5 is a sheet: it has no inside.
SHEET = 1e-3
# The same of a closed one: rounding of what has no thickness at all.
FLAT = 1e-9
# Points of a shell that are asked whether they lie in another.
ASKED = 8
# Places that one thread is given at least.
LAUNCHED_TOGETHER = 10_000


@dataclass(frozen=True)
class Skin:
    """points: (n, 3) float64, no two at one place, in the caller's units.  triangles: (m, 3) int32, outward.

    welded: (point_count,) int32, the one of `points` that each of the caller's points became; -1 for points that
    no triangle has, which are no part of it. solid: (m,) bool, False for triangles of shells that have no inside.
    volume: what it encloses."""

    points: np.ndarray
    triangles: np.ndarray
    welded: np.ndarray
    solid: np.ndarray
    volume: float

    @property
    def diagonal(self) -> float:
        """Of the bounding box."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @cached_property
    def normals(self) -> np.ndarray:
        """(m, 3), unit; zero for triangles without area."""
        doubled = _doubled_area(self.points, self.triangles)
        length = np.linalg.norm(doubled, axis=1, keepdims=True)
        return doubled / np.where(length > 0.0, length, 1.0)


def prepare(points: np.ndarray, triangles: np.ndarray) -> Skin:
    """Welds points at the same place (to 1e-7 of the diagonal) and turns the shells that are inside out.

    A shell is inside out when its volume, holes capped, is negative; one that lies within another is taken to have
    been made like that one: turned against it, it bounds a cavity.
    """
    points = np.asarray(points, dtype=np.float64)
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    rounded = np.round((points - points.min(axis=0)) / (1e-7 * diagonal)).astype(np.int64)
    _, first, welded = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    corners = welded.ravel()[np.asarray(triangles)]
    a, b, c = corners.T
    used, corners = np.unique(corners[(a != b) & (b != c) & (c != a)], return_inverse=True)
    corners, first = corners.reshape(-1, 3), first[used]
    number = np.full(int(welded.max()) + 1, -1, dtype=np.int32)
    number[used] = np.arange(len(used))
    welded = number[welded.ravel()]
    shell = components(len(first), np.concatenate([corners[:, :2], corners[:, 1:]]))[corners[:, 0]]
    _, shell = np.unique(shell, return_inverse=True)
    volume, area, closed = shell_volumes(points[first], corners, shell)
    solid = np.abs(volume) > np.where(closed, FLAT, SHEET) * area**1.5
    wrong = _inside_out(points[first], corners, shell, np.where(solid, volume, 0.0))
    turned = np.where(wrong[shell][:, None], corners[:, [0, 2, 1]], corners)
    enclosed = float(np.where(wrong, -volume, volume)[solid].sum())
    return Skin(points[first], turned.astype(np.int32), welded, solid[shell], enclosed)


def shell_volumes(
    points: np.ndarray, triangles: np.ndarray, shell: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each shell: signed volume with every hole closed by a fan about its middle, area, whether none was."""
    count = int(shell.max()) + 1
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    ordered = np.sort(edges, axis=1)
    _, inverse = np.unique(ordered[:, 0] * len(points) + ordered[:, 1], return_inverse=True)
    # Each direction an edge is passed in counts against the other; what is left over bounds a hole.
    net = np.bincount(inverse, np.where(edges[:, 0] < edges[:, 1], 1.0, -1.0))
    rim = np.abs(net[inverse]) > 0.5
    edges, owner = edges[rim], np.repeat(shell, 3)[rim]
    doubled = np.linalg.norm(_doubled_area(points, triangles), axis=1)
    area = np.bincount(shell, 0.5 * doubled, count)
    corner = np.zeros(count, dtype=np.int64)
    corner[shell[::-1]] = triangles[::-1, 0]
    centre = points[corner]
    volume = np.bincount(shell, _cone(points[triangles], centre[shell]), count)
    if len(edges):
        _, hole = np.unique(components(len(points), edges)[edges[:, 0]], return_inverse=True)
        middles = points[edges].mean(axis=1).T
        middle = np.stack([np.bincount(hole, m) for m in middles], axis=1) / np.bincount(hole)[:, None]
        cap = np.stack([points[edges[:, 1]], points[edges[:, 0]], middle[hole]], axis=1)
        volume += np.bincount(owner, _cone(cap, centre[owner]), count)
    return volume, area, np.bincount(owner, minlength=count) == 0


def _inside_out(points: np.ndarray, triangles: np.ndarray, shell: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """(shell_count,) bool. volume: signed, zero for shells without an inside."""
    wrong = volume < 0.0
    if len(volume) == 1 or not wrong.any():
        return wrong
    corners = [points[triangles[shell == k]] for k in range(len(volume))]
    low = np.array([c.min(axis=(0, 1)) for c in corners])
    high = np.array([c.max(axis=(0, 1)) for c in corners])
    result = wrong.copy()
    done: list[int] = []
    for k in np.argsort(-np.abs(volume), kind="stable"):
        own = corners[k].reshape(-1, 3)
        own = own[:: max(1, len(own) // ASKED)]
        for other in reversed(done):  # the smallest that holds it
            boxed = np.all(low[other] <= low[k]) and np.all(high[k] <= high[other])
            if volume[k] and boxed and np.all(np.abs(winding_numbers(own, corners[other])) > 0.5):
                result[k] = result[other]
                break
        done.append(int(k))
    return result


def winding_numbers(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(n,) of places (n, 3) about triangles (m, 3, 3): solid angles over 4 pi (Van Oosterom & Strackee 1983)."""
    a, b, c = (corners[None, :, k] - places[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    triple = np.einsum("nmi,nmi->nm", a, np.cross(b, c))
    dots = [np.einsum("nmi,nmi->nm", u, v) for u, v in ((a, b), (b, c), (c, a))]
    under = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return np.arctan2(triple, under).sum(axis=1) / (2.0 * np.pi)


def _doubled_area(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _cone(corners: np.ndarray, apex: np.ndarray) -> np.ndarray:
    x = corners - apex[:, None]
    return np.einsum("ni,ni->n", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6.0


class Inside:
    """Answers what lies inside a skin, by its winding number (Jacobson 2013, Barill 2018; as in Warp).

    Places are in any units; arithmetic is float32 in units of the skin's size about its middle. Nothing is inside
    no triangles, and everything infinitely far from them.
    """

    @classmethod
    def of(cls, skin: Skin) -> Inside:
        """Of the shells that have an inside; triangles are told by their number in the skin."""
        return cls(skin.points, skin.triangles[skin.solid], np.flatnonzero(skin.solid))

    def __init__(self, points: np.ndarray, triangles: np.ndarray, numbers: np.ndarray | None = None) -> None:
        start_warp()
        self._numbers = np.arange(len(triangles)) if numbers is None else numbers
        self.middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        self.scale = float(np.linalg.norm(np.ptp(points, axis=0)))
        corners = np.ascontiguousarray(triangles, dtype=np.int32).ravel()
        self._mesh = None
        if len(corners):
            self._mesh = wp.Mesh(
                self._vectors(self.unit(points)),
                wp.array(corners, dtype=wp.int32, device="cpu"),
                support_winding_number=True,
            )

    def unit(self, places: np.ndarray) -> np.ndarray:
        """Places as float32, in units of the mesh's size about its middle."""
        return np.ascontiguousarray((places - self.middle) / self.scale, dtype=np.float32)

    def query(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) signed distance to the skin, negative inside, and (n,) the closest triangle."""
        if self._mesh is None:
            return np.full(len(places), np.inf), np.full(len(places), -1)
        distance, face = self._empty(len(places), wp.float32), self._empty(len(places), wp.int32)
        self._launch(kernels.signed_distance, [self._vectors(self.unit(places))], [distance, face])
        return distance.numpy().astype(np.float64) * self.scale, self._numbers[face.numpy()]

    def first_hit(self, starts: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) the triangle each ray meets first, -1 for none, and (n,) how far; directions of length one."""
        if self._mesh is None:
            return np.full(len(starts), -1), np.zeros(len(starts))
        distance, face = self._empty(len(starts), wp.float32), self._empty(len(starts), wp.int32)
        rays = [self._vectors(self.unit(starts)), self._vectors(directions)]
        self._launch(kernels.first_hit, rays, [face, distance])
        met = face.numpy()
        return np.where(met >= 0, self._numbers[met], -1), distance.numpy().astype(np.float64) * self.scale

    def stays(self, starts: np.ndarray, ends: np.ndarray, step: float) -> np.ndarray:
        """(n,) bool: whether the line between two places inside stays there. step: past the skin, of its size."""
        if self._mesh is None:
            return np.zeros(len(starts), dtype=bool)
        clear = self._empty(len(starts), wp.bool)
        lines = [self._vectors(self.unit(starts)), self._vectors(self.unit(ends)), step]
        self._launch(kernels.stays_inside, lines, [clear])
        return clear.numpy()

    def share(self, starts: np.ndarray, ends: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        """(n,) the part of each line that is inside, and (n, 3) the middle of the longest run of it."""
        share, middle = self._empty(len(starts), wp.float32), self._empty(len(starts), wp.float32)
        if self._mesh is None:
            return np.zeros(len(starts)), starts
        lines = [self._vectors(self.unit(starts)), self._vectors(self.unit(ends)), step]
        self._launch(kernels.length_inside, lines, [share, middle])
        at = middle.numpy().astype(np.float64)[:, None]
        return share.numpy().astype(np.float64), (1.0 - at) * starts + at * ends

    def _vectors(self, values: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(values, dtype=np.float32), dtype=wp.vec3, device="cpu")

    def _empty(self, count: int, kind: type) -> wp.array:
        return wp.empty(count, dtype=kind, device="cpu")

    def _launch(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        """Every place is asked about by itself, so threads share them; a launch lets go of Python meanwhile."""
        count = len(outputs[0])
        parts = min(count // LAUNCHED_TOGETHER, os.cpu_count() or 1) + 1
        bounds = np.linspace(0, count, parts + 1).astype(int)

        def launch(k: int) -> None:
            part = slice(bounds[k], bounds[k + 1])
            own = [value[part] if isinstance(value, wp.array) else value for value in inputs]
            results = [value[part] for value in outputs]
            size = bounds[k + 1] - bounds[k]
            wp.launch(kernel, dim=size, inputs=[self._mesh.id, *own], outputs=results, device="cpu")

        if not count:
            return
        if parts == 1:
            launch(0)
            return
        wp.load_module(kernels, device="cpu")
        with ThreadPoolExecutor(parts) as threads:
            list(threads.map(launch, range(parts)))
