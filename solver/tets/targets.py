"""Where the animation takes the nodes of a body: those pinned and attached each substep, all of them at times."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.kinematics.deformer import Deformer
from plait.solver.launch import Launcher
from plait.solver.scene import Pose, Surface, TetBody


class Targets:
    """Skins a body's nodes.

    driven: (driven_count,) int32 nodes that are pinned or attached, ascending.
    position: (driven_count,) vec3d [m], world, where the last `place` took them.
    """

    def __init__(self, body: TetBody, launcher: Launcher) -> None:
        self._launcher, self._motion = launcher, body.motion
        self._nodes = Surface(
            body.name,
            np.asarray(body.nodes, dtype=np.float64),
            np.zeros((0, 3), dtype=np.int32),
            body.motion,
            body.skinning,
            body.blend_shapes,
        )
        held = np.asarray(body.pinned, dtype=bool) | (np.asarray(body.attachment) > 0.0)
        self.driven = np.flatnonzero(held).astype(np.int32)
        self.position = wp.empty(len(self.driven), dtype=wp.vec3d, device=launcher.device)
        self._no_query_points = wp.empty(0, dtype=wp.vec3f, device=launcher.device)
        self._deformer = Deformer(self._nodes, launcher, self.driven) if len(self.driven) else None
        self._all: Deformer | None = None
        self._time: float | None = None

    def place(self, time: float) -> None:
        """Brings `position` to `time` [s]."""
        time = time if self._motion.animated else 0.0
        if self._deformer is not None and time != self._time:
            self._deformer.place(self._motion.pose(time), self.position, self._no_query_points)
            self._time = time

    @property
    def animated(self) -> bool:
        return self._motion.animated

    def moves(self, start: float, end: float) -> bool:
        """Whether driven nodes are elsewhere at `end` [s] than at `start`."""
        if self._deformer is None or not self._motion.animated:
            return False
        return not _same(self._motion.pose(start), self._motion.pose(end))

    def all_nodes(self, time: float) -> np.ndarray:
        """(node_count, 3) float64 [m], world: every node where the animation alone would take it at `time` [s]."""
        self._all = self._all or Deformer(self._nodes, self._launcher)
        points = wp.empty(self._all.count, dtype=wp.vec3d, device=self._launcher.device)
        self._all.place(self._motion.pose(time), points, self._no_query_points)
        return points.numpy().copy()


def _same(one: Pose, other: Pose) -> bool:
    if (one.points is None) != (other.points is None):
        return False
    if one.points is not None:
        return np.array_equal(one.points, other.points)
    return np.array_equal(one.joint_transforms, other.joint_transforms) and np.array_equal(
        one.blend_weights, other.blend_weights
    )
