"""Curves that follow guides through a run: their points, velocities and frames from those of the strands now."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from plait.pipeline import following_kernels as kernels
from plait.pipeline.shot import CurvesNow, Followers, as_drawn
from plait.solver.kinematics.roots import Roots
from plait.solver.scene import Strands

# [s] Span of the difference that gives velocities: back in time, as the strands' own steps are.
DIFFERENCE = 1e-4
# Cost of a following point in units of `Launcher.launch`.
POINT_WORK = 12


class Following:
    """All curves of a run that follow guides."""

    def __init__(self, followers: Sequence[Followers], parts: Mapping[str, Any], turning: bool) -> None:
        """parts: `Model.parts`, just built: strands lie as drawn, carried rigidly by their roots.

        turning: whether some have normals, and so directors and rotations are asked for.
        """
        self._turning = turning
        self._strands, self._kinematics, self._tets = parts["strands"], parts["kinematics"], parts.get("tets")
        model = self._kinematics.model
        self._scene, self._launcher = model.scene, model.launcher
        self._followers = tuple(followers)
        curves = [each.curves for each in followers]
        self._first_point = _sums([len(held.points) for held in curves])
        self._first_curve = _sums([held.strand_count for held in curves])
        self._count, self._point_count = int(self._first_curve[-1]), int(self._first_point[-1])
        self._work = max(1, POINT_WORK * self._point_count // self._count)
        self._roots = Roots(replace(self._scene, strands=(*self._scene.strands, *curves)), self._launcher)
        guide = np.concatenate([each.guides for each in followers])
        self._used, guide = np.unique(guide, return_inverse=True)
        self._nearest = self._used[guide.reshape(-1, kernels.NEAREST)[:, 0]]
        self._lay_out_guides()
        self._lay_out_curves(curves, guide.reshape(-1, kernels.NEAREST))

    def now(self, time: float) -> tuple[CurvesNow, ...]:
        """Of each of the `followers`, the strands being where they are at `time` [s]."""
        earlier, _ = self._at(time, -DIFFERENCE)
        points, rotation = self._at(time, 0.0)
        velocities = (points - earlier) / DIFFERENCE
        directors, rotations = (self._directors(rotation), rotation.numpy()) if self._turning else (None, None)
        result = []
        for k in range(len(self._followers)):
            mine = slice(self._first_point[k], self._first_point[k + 1])
            own = slice(self._first_curve[k], self._first_curve[k + 1])
            turned = (directors[mine], rotations[own]) if self._turning else ()
            result.append(CurvesNow(points[mine], velocities[mine], *turned))
        return tuple(result)

    # --- at rest ----------------------------------------------------------------------------------------------

    def _lay_out_guides(self) -> None:
        """Guides at rest: shapes as drawn, frames as the stage has chosen them."""
        scene = self._scene
        offsets = [held.offsets for held in scene.strands]
        starts = _sums([len(held.points) for held in scene.strands])
        begin = np.concatenate([start + own[:-1] for start, own in zip(starts, offsets, strict=False)])[self._used]
        end = np.concatenate([start + own[1:] for start, own in zip(starts, offsets, strict=False)])[self._used]
        first = _sums(end - begin)
        owner = np.repeat(np.arange(len(begin)), end - begin)
        # The points of guides among those of all strands.
        self._rows = np.arange(first[-1]) - first[owner] + begin[owner]
        self._first_rows = begin
        points = np.concatenate([held.points for held in scene.strands])
        shape = points[self._rows] - points[begin][owner]
        guides = kernels.Guides()
        guides.first = self._hold(first, wp.int32)
        guides.shape = self._hold(shape, wp.vec3d)
        guides.arc = self._hold(_arc_lengths(shape, first), wp.float64)
        rotation = self._kinematics.root_rotation.numpy()[self._used][owner]
        turned = np.einsum("nji,nj->ni", rotation, self._gather(self._strands.directors))
        guides.frame = self._hold(_frames(shape, turned, first), wp.mat33d)
        self._guides = guides
        count = int(first[-1])
        bent = kernels.Bent()
        bent.shape = wp.zeros(count, dtype=wp.vec3d, device=self._launcher.device)
        bent.turn = wp.zeros(count, dtype=wp.quatd, device=self._launcher.device)
        bent.stretch = wp.zeros(count, dtype=wp.float64, device=self._launcher.device)
        self._bent = bent

    def _lay_out_curves(self, curves: Sequence[Strands], guide: np.ndarray) -> None:
        first = np.concatenate(
            [start + held.offsets[:-1] for start, held in zip(self._first_point, curves, strict=False)]
        )
        points = np.concatenate([held.points for held in curves])
        owner = np.repeat(np.arange(self._count), np.diff(np.append(first, self._point_count)))
        shape = points - points[first][owner]
        follow = kernels.Follow()
        follow.first = self._hold(np.append(first, self._point_count), wp.int32)
        follow.shape = self._hold(shape, wp.vec3d)
        follow.director = self._hold(_across(shape), wp.vec3d)
        follow.guide = self._hold(guide, wp.int32)
        follow.weight = self._hold(np.concatenate([each.weights for each in self._followers]), wp.float64)
        # Both drawn: rest spaces differ by where they lie alone.
        roots = np.concatenate([as_drawn(held)[held.offsets[:-1]] for held in curves])
        others = np.concatenate([as_drawn(held)[held.offsets[:-1]] for held in self._scene.strands])[self._used]
        follow.apart = self._hold(roots[:, None] - others[guide], wp.vec3d)
        self._follow = follow

    # --- now --------------------------------------------------------------------------------------------------

    def _at(self, time: float, later: float) -> tuple[np.ndarray, wp.array]:
        """Points and root rotations `later` seconds after `time`, all strands going on as they do."""
        device = self._launcher.device
        now = self._kinematics.root_rotation.numpy()
        total = len(now)
        position = wp.zeros(total + self._count, dtype=wp.vec3d, device=device)
        # A triangle that has collapsed keeps the rotation given here: that of the strand, or of the nearest guide.
        rotation = self._hold(np.concatenate([now, now[self._nearest]]), wp.mat33d)
        self._roots.place(self._kinematics.pose_at, time + later, position, rotation, self._skins(later))
        moving = kernels.Moving()
        moving.position = self._hold(self._gather(self._strands.points), wp.vec3d)
        moving.velocity = self._hold(self._gather(self._strands.velocities), wp.vec3d)
        moving.director = self._hold(self._gather(self._strands.directors), wp.vec3d)
        moving.rotation = self._hold(now[self._used], wp.mat33d)
        moving.later_rotation = self._hold(rotation.numpy()[self._used], wp.mat33d)
        moving.later = later
        self._launcher.launch(
            kernels.bend_guides,
            len(self._used),
            [self._guides, moving, self._bent],
            work_per_item=max(1, POINT_WORK * len(self._rows) // len(self._used)),
        )
        points = wp.zeros(self._point_count, dtype=wp.vec3d, device=device)
        self._launcher.launch(
            kernels.follow_guides,
            self._count,
            [self._guides, self._bent, self._follow, position[total:], rotation[total:]],
            [points],
            work_per_item=self._work,
        )
        return points.numpy(), rotation[total:]

    def _directors(self, rotation: wp.array) -> np.ndarray:
        """(n, 3) by the guides as they were last bent; without meaning at tips."""
        directors = wp.zeros(self._point_count, dtype=wp.vec3d, device=self._launcher.device)
        inputs = [self._guides, self._bent, self._follow, rotation]
        self._launcher.launch(kernels.turn_directors, self._count, inputs, [directors], work_per_item=self._work)
        return directors.numpy()

    def _skins(self, later: float) -> dict[int, Callable[[wp.array, wp.array], None]]:
        """What places the points of each surface that a body carries."""
        surfaces = enumerate(self._scene.surfaces)
        return {index: partial(self._place_skin, s.body, later) for index, s in surfaces if s.body is not None}

    def _place_skin(self, body: int, later: float, points_out: wp.array, _: wp.array) -> None:
        points_out.assign(self._tets.points(body) + later * self._tets.velocities(body))

    def _gather(self, read: Callable[[int], np.ndarray]) -> np.ndarray:
        """(n, 3) what the stage has at the points of guides."""
        return np.concatenate([read(prim) for prim in range(len(self._scene.strands))])[self._rows]

    def _hold(self, values: np.ndarray, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self._launcher.device)


def _sums(counts: Sequence[int] | np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _arc_lengths(points: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(n,) along each line from its first point. first: (line_count + 1,)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return along - np.repeat(along[first[:-1]], np.diff(first))


def _frames(points: np.ndarray, directors: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(n, 3, 3), columns as `Guides.frame`; without meaning where no edge begins."""
    along = np.diff(points, axis=0, append=points[-1:])
    along[first[1:] - 1] = [1.0, 0.0, 0.0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = directors - np.sum(directors * along, axis=1, keepdims=True) * along
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.divide(across, length, out=np.zeros_like(across), where=length > 0.0)
    return np.stack([along, across, np.cross(along, across)], axis=2)


def _across(points: np.ndarray) -> np.ndarray:
    """(n, 3) a unit vector across the edge that begins at each point."""
    along = np.diff(points, axis=0, append=points[-1:])
    axis = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    across = np.cross(along, axis)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.divide(across, length, out=np.zeros_like(across), where=length > 0.0)
