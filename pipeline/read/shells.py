"""Closed surfaces that grains fill."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pxr import Usd

from plait.pipeline.read.parameters import Given
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Body
from plait.pipeline.read.triangles import weld
from plait.pipeline.read.turns import nearest_axes
from plait.solver.scene import Surface

# Of the cube about it, the part of a surface's volume below which it encloses none.
FLAT = 1e-12
# Places that are looked at, inside or not, of which there must not be too many: hours of them.
MOST_PLACES = 1e10


@dataclass(frozen=True)
class Shell:
    """A closed surface at the first frame, facing outwards.

    points: (n, 3) float64 [m], scene world.  triangles: (m, 3) int32.  volume: [m3] it encloses.
    velocity: (3,) [m/s], world, that its grains start with.
    """

    prim: Usd.Prim
    points: np.ndarray
    triangles: np.ndarray
    volume: float
    velocity: np.ndarray

    @property
    def box(self) -> np.ndarray:
        """(2, 3) [m], scene world."""
        return np.array([self.points.min(axis=0), self.points.max(axis=0)])

    def filled(self, source: Source, spacing: float, seed: int, threads: int) -> np.ndarray:
        """(count, 3) [m] places within, about `spacing` [m] apart. Raises InputError where there are none."""
        if np.prod(np.ptp(self.box, axis=0) / spacing + 1.0) > MOST_PLACES:
            mend = "author a larger one, or fill what lies far apart as prims of its own"
            raise source.error(f"is {spacing:.3g} m, too small for its box", self.prim, "plait:spacing", mend)
        # Here, so that a shot is inspected without loading Warp.
        from plait.solver.granular.filling import fill_surface
        from plait.solver.launch import Launcher

        launcher = Launcher("cpu", threads)
        try:
            places, _ = fill_surface(self.points, self.triangles, spacing, 1, launcher, seed=seed)
        finally:
            launcher.close()
        if not len(places):
            problem = f"is {np.ptp(self.box, axis=0).max():.3g} m wide, too small for grains {spacing:.3g} m apart"
            raise source.error(problem, self.prim, mend="author a smaller plait:spacing, or make it larger")
        return places


def read_shell(source: Source, body: Body, given: Given) -> Shell:
    """Raises InputError for a surface that is not closed, or encloses nothing."""
    points = body.posed
    kept, welded = weld(points, body.surface.triangles, np.zeros((len(points), 0)))
    points, triangles = points[kept], welded[body.surface.triangles]
    edges = _open_edges(triangles)
    if edges:
        problem = f"is not closed: {edges} of its edges have a face on one side alone"
        raise source.error(problem, body.prim, "faceVertexIndices", "close it, so that it has an inside to fill")
    volume = _volume(points, triangles)
    if not abs(volume) > FLAT * float(np.ptp(points, axis=0).max()) ** 3:
        raise source.error("encloses no volume", body.prim, "points", "give it an inside to fill")
    if volume < 0.0:  # drawn inside out, or mirrored
        triangles = triangles[:, ::-1]
    axes = nearest_axes(source.placed_at_start(body.prim)[:3, :3])
    velocity = axes @ (given["velocity"] if "velocity" in given else np.zeros(3))
    return Shell(body.prim, points, np.ascontiguousarray(triangles), abs(volume), velocity)


def tell_of_inward(source: Source, surfaces: Sequence[Surface]) -> None:
    """A warning for each closed collider whose faces point inwards: it may be a room, or drawn inside out."""
    for surface in surfaces:
        closed = surface.collides and not _open_edges(surface.triangles)
        if closed and _volume(surface.points, surface.triangles) < 0.0:
            text = "its faces point inwards: grains are kept within it, not out; turn them round where not meant"
            source.warn(text, surface.name, "orientation")


def _volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """That a closed surface encloses, below zero where it faces inwards: the divergence theorem."""
    a, b, c = (points[triangles[:, k]] - points.mean(axis=0) for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6.0


def _open_edges(triangles: np.ndarray) -> int:
    """How many edges are not run along as often in one direction as in the other."""
    ends = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    low, high = ends.min(axis=1), ends.max(axis=1)
    _, edge = np.unique(low * (triangles.max() + 1) + high, return_inverse=True)
    return int(np.count_nonzero(np.bincount(edge, np.where(ends[:, 0] < ends[:, 1], 1.0, -1.0))))
