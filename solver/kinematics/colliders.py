"""Moving triangle surfaces for queries: points and search trees at both ends of a substep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from plait.solver.kinematics.deformer import Deformer
from plait.solver.kinematics.reach import SurfaceBounds
from plait.solver.launch import Launcher
from plait.solver.scene import Pose, Surface


@dataclass
class Collider:
    """One surface that collides; its points and triangles are slices of those of `Colliders`.

    index: into `Scene.surfaces`.  meshes: search trees for the two buffers, one and the same if it never moves.
    closed: every edge is shared by exactly two triangles that run along it in opposite directions.
    placed: the time [s] each buffer holds, None before the first.
    """

    index: int
    surface: Surface
    first_point: int
    first_triangle: int
    triangle_count: int
    closed: bool
    deformer: Deformer
    bounds: SurfaceBounds
    meshes: list[wp.Mesh] = field(default_factory=list)
    placed: list[float | None] = field(default_factory=lambda: [None, None])

    @property
    def carried(self) -> bool:
        """Whether an elastic or a rigid body takes it along."""
        return self.surface.body is not None or self.surface.rigid is not None

    @property
    def moves(self) -> bool:
        return self.surface.motion.animated or self.carried

    @property
    def points(self) -> slice:
        return slice(self.first_point, self.first_point + self.deformer.count)


class Colliders:
    """All surfaces that collide, with two buffers of points that take turns as substep start and end.

    points: two (point_count,) vec3d arrays [m], world.  triangles: (triangle_count,) vec3i into them.
    query_points: the same points rounded to float32, on which the search trees stand; they only find triangles,
    distances are then taken in float64 from `points`.
    Triangles without area at rest take no part. A tree is built in the shot's first pose, whenever it is first
    needed, and refitted from then on, which depends on the points alone: a resumed run finds the same.
    """

    def __init__(self, scene_surfaces: tuple[Surface, ...], launcher: Launcher) -> None:
        self.launcher = launcher
        self.items: list[Collider] = []
        triangles, first_point, first_triangle = [], 0, 0
        for index, surface in enumerate(scene_surfaces):
            kept = _with_area(surface) if surface.collides else np.zeros((0, 3), dtype=np.int32)
            if not len(kept):
                continue
            self.items.append(
                Collider(
                    index,
                    surface,
                    first_point,
                    first_triangle,
                    len(kept),
                    _is_closed(kept),
                    Deformer(surface, launcher),
                    SurfaceBounds(surface),
                )
            )
            triangles.append(kept + first_point)
            first_point += len(surface.points)
            first_triangle += len(kept)
        device = launcher.device
        self.points = [wp.zeros(first_point, dtype=wp.vec3d, device=device) for _ in range(2)]
        self.query_points = [wp.zeros(first_point, dtype=wp.vec3f, device=device) for _ in range(2)]
        held = np.concatenate(triangles) if triangles else np.zeros((0, 3))
        self.triangles = wp.array(held, dtype=wp.vec3i, device=device)

    def plant(self, collider: Collider, pose: Pose, time: float) -> int:
        """Places both buffers in the shot's first pose and builds their trees; how many points were placed."""
        self._deform(collider, 0, pose, time)
        wp.copy(self.points[1][collider.points], self.points[0][collider.points])
        wp.copy(self.query_points[1][collider.points], self.query_points[0][collider.points])
        collider.placed[1] = time
        local = self.triangles.numpy()[collider.first_triangle :][: collider.triangle_count] - collider.first_point
        indices = wp.array(local.ravel(), dtype=wp.int32, device=self.launcher.device)
        trees = range(2 if collider.moves else 1)
        held = [wp.Mesh(self.query_points[i][collider.points], indices) for i in trees]
        collider.meshes = held * (2 // len(held))
        return collider.deformer.count

    def place(self, collider: Collider, buffer: int, pose: Pose, time: float) -> int:
        """Moves one buffer of a planted surface to `pose` and refits its tree; how many points were placed."""
        if collider.placed[buffer] == time or not collider.surface.motion.animated:
            return 0
        self._deform(collider, buffer, pose, time)
        collider.meshes[buffer].refit()
        return collider.deformer.count

    def take(self, collider: Collider, buffer: int, place: Callable[[wp.array, wp.array], None]) -> int:
        """Like `place` for a planted surface that a body carries: `place` writes its points and query points."""
        place(self.points[buffer][collider.points], self.query_points[buffer][collider.points])
        collider.meshes[buffer].refit()
        return collider.deformer.count

    def _deform(self, collider: Collider, buffer: int, pose: Pose, time: float) -> None:
        points = self.points[buffer][collider.points]
        collider.deformer.place(pose, points, self.query_points[buffer][collider.points])
        collider.placed[buffer] = time


def _with_area(surface: Surface) -> np.ndarray:
    """The triangles that have an area at rest, (n, 3)."""
    triangles = np.asarray(surface.triangles, dtype=np.int32).reshape(-1, 3)
    corners = np.asarray(surface.points, dtype=np.float64)[triangles]
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    twice_area = np.linalg.norm(np.cross(edge1, edge2), axis=1)
    rounding = 4.0 * np.finfo(np.float64).eps * np.abs(corners).max(axis=(1, 2)) ** 2
    return triangles[twice_area > rounding]


def _is_closed(triangles: np.ndarray) -> bool:
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    key, back = directed @ [1 << 32, 1], directed @ [1, 1 << 32]
    unique = np.unique(key)
    return len(unique) == len(key) and np.array_equal(unique, np.unique(back))
