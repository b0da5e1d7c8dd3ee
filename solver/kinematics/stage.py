"""What follows the animation: strand roots, and the surfaces that strands and elastic bodies collide with."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from plait.solver.kinematics.colliders import Collider, Colliders
from plait.solver.kinematics.reach import sweep, touches
from plait.solver.kinematics.roots import Roots
from plait.solver.model import Interval, Model
from plait.solver.scene import Pose, Surface
from plait.solver.state import State

# A strand may stretch by this part of its arc length, and contact looks this far [m] beyond its radius.
STRETCH_ALLOWANCE = 0.05
QUERY_ALLOWANCE = 0.01
# Instants of a frame at which bounds are taken.
SAMPLES = 5


class KinematicsStage:
    """Follows the poses of the shot, at the substeps' own times.

    root_position: (strand_count,) vec3d [m] and root_rotation: (strand_count,) mat33d, world, float64: where each
        strand's rest root is carried and how its triangle has turned since rest. Valid at the end of the substep
        last stepped, and at the start time after `build`.
        Only in scenes with strands.
    colliders: every surface that collides, or None.  in_reach: those that some strand may touch in this frame;
        only these are skinned.  boxes: (2, 3) bounds [m] of each of them over the frame.
    followed: the colliders that bodies carry and that strands or grains may touch in this frame.
    start, end: which buffer of `colliders` holds the substep's start and end.

    Skins of elastic bodies, and roots on them, go where the bodies take them: `follow_bodies`, once those have
    stepped.
    """

    name = "kinematics"

    def __init__(self, model: Model, state: State) -> None:
        self.model, self._surfaces = model, model.scene.surfaces
        launcher = model.launcher
        self._poses: dict[tuple[int, float], Pose] = {}
        self.roots = Roots(model.scene, launcher) if model.scene.strands else None
        if self.roots is not None:
            device, count = launcher.device, self.roots.count
            self.root_position = wp.zeros(count, dtype=wp.vec3d, device=device)
            self.root_rotation = wp.array(np.tile(np.eye(3), (count, 1, 1)), dtype=wp.mat33d, device=device)
            # A triangle that collapses keeps the rotation it had, so rotations are state.
            state.arrays["kinematics/root_position"] = self.root_position
            state.arrays["kinematics/root_rotation"] = self.root_rotation
            self.place_roots(model.start_time)
        colliders = Colliders(self._surfaces, launcher)
        self.colliders = colliders if colliders.items else None
        self.in_reach: list[Collider] = []
        self.boxes: list[np.ndarray] = []
        self.followed: list[Collider] = []
        self._frame_boxes: dict[int, np.ndarray] = {}
        self.start, self.end = 0, 1
        self._placed: set[int] = set()
        self._skinned = 0

    def pose_at(self, surface: int, time: float) -> Pose:
        """The pose of a surface at `time` [s], evaluated once a frame."""
        key = (surface, time if self._surfaces[surface].motion.animated else 0.0)
        if key not in self._poses:
            self._poses[key] = self._surfaces[surface].motion.pose(time)
        return self._poses[key]

    @property
    def carries(self) -> bool:
        """Whether some strands grow on a body's skin."""
        return self.roots is not None and any(_carried(self._surfaces[s]) for s in self.roots.surfaces)

    def place_roots(self, time: float) -> None:
        """Moves `root_position` and `root_rotation` to `time` [s], those on skins to where the bodies are."""
        self.roots.place(self.pose_at, time, self.root_position, self.root_rotation, self.skins())

    def begin_frame(self, state: State, frame: Interval) -> None:
        """Finds the colliders in reach and places them at the frame's start."""
        self._poses = {key: pose for key, pose in self._poses.items() if key[1] in (frame.start, frame.end, 0.0)}
        self._skinned = 0
        self._placed = set()
        self.in_reach, self.boxes, self._frame_boxes, self.followed = [], [], {}, []
        if self.colliders is None:
            return
        times = [frame.start + frame.length * i / (SAMPLES - 1) for i in range(SAMPLES)]
        times[-1] = frame.end
        self._frame_boxes = {c.index: self.box(c, times) for c in self.colliders.items if not c.carried}
        if self.roots is not None:
            self._find_in_reach(frame, times)
        carried = [collider for collider in self.colliders.items if collider.carried]
        met_by_grains = carried if self.model.scene.granular else []
        self.followed = met_by_grains or [collider for collider in self.in_reach if collider.carried]
        for collider in {c.index: c for c in (*self.in_reach, *self.followed)}.values():
            self._place(collider, self.end, frame.start)

    def step(self, state: State, substep: Interval, last_resort: bool = False) -> bool:
        """Moves roots and the colliders in reach to the substep's end; what was the end becomes the start."""
        self.start, self.end = self.end, self.start
        if self.roots is not None and not self.carries:
            self.place_roots(substep.end)
        for collider in self.in_reach:
            if not collider.carried:
                self._place(collider, self.end, substep.end)
        return True

    def follow_bodies(self, time: float) -> None:
        """Moves the surfaces `followed`, and the roots on bodies, to where the bodies are at `time`."""
        for collider in self.followed:
            self._place(collider, self.end, time)
        if self.carries:
            self.place_roots(time)

    def colliders_near(
        self, lower: np.ndarray, upper: np.ndarray, substep: Interval, rigid: bool = False
    ) -> list[Collider]:
        """Surfaces that no body carries and that may enter a box (3,), (3,) [m] in the substep last stepped.

        They are placed at both its ends; whatever else moved them there comes for free.
        rigid: also those of rigid bodies, which have stepped.
        """
        near = []
        for collider in self.colliders.items if self.colliders else ():
            margin = collider.surface.thickness
            if collider.surface.rigid is not None:
                if rigid and _meet(self.model.parts["rigid"].bounds(collider.surface.rigid), lower, upper, margin):
                    self.take_rigid(collider)
                    near.append(collider)
                continue
            box = self._frame_boxes.get(collider.index)
            if box is None or not _meet(box, lower, upper, margin):
                continue
            box = self.box(collider, [substep.start, substep.end])
            if _meet(box, lower, upper, margin):
                self._place(collider, self.start, substep.start)
                self._place(collider, self.end, substep.end)
                near.append(collider)
        return near

    def take_rigid(self, collider: Collider) -> None:
        """Places a rigid body's surface at both ends of the substep that the body last stepped."""
        stage = self.model.parts["rigid"]
        self._plant(collider)
        for buffer, at_end in ((self.start, False), (self.end, True)):
            place = partial(stage.place_surface, collider.index, at_end=at_end)
            self._skinned += self.colliders.take(collider, buffer, place)

    def followed_near(self, lower: np.ndarray, upper: np.ndarray) -> list[Collider]:
        """Of `followed`, those that are in a box (3,), (3,) [m] at either end of the substep last stepped."""
        near = []
        for collider in self.followed:
            ends = [points[collider.points].numpy() for points in self.colliders.points]
            margin = collider.surface.thickness
            below = np.minimum(*(x.min(axis=0) for x in ends)) <= upper + margin
            above = np.maximum(*(x.max(axis=0) for x in ends)) >= lower - margin
            if below.all() and above.all():
                near.append(collider)
        return near

    def retract(self, state: State, substep: Interval) -> None:
        """The surfaces at the substep's start are the present ones again, and so are the roots."""
        self.start, self.end = self.end, self.start
        if self.roots is not None:
            self.place_roots(substep.start)

    def end_frame(self, state: State, frame: Interval) -> dict[str, Any]:
        """How many surfaces there are and were in reach, the names skipped, and the points skinned."""
        items = self.colliders.items if self.colliders else []
        return {
            "surfaces": len(items),
            "in_reach": len(self._placed),
            "skipped": [collider.surface.name for collider in items if collider.index not in self._placed],
            "skinned_points": self._skinned,
        }

    def skins(self) -> dict[int, Callable[[wp.array, wp.array], None]]:
        """What places the points of each surface that a body carries; none before there are bodies."""
        tets, rigid = self.model.parts.get("tets"), self.model.parts.get("rigid")
        carried = [(index, s.body) for index, s in enumerate(self._surfaces) if s.body is not None]
        of_tets = {index: partial(tets.place_skin, body) for index, body in carried} if tets is not None else {}
        return of_tets | (rigid.skins() if rigid is not None else {})

    def _plant(self, collider: Collider) -> None:
        self._placed.add(collider.index)
        if not collider.meshes:
            first = self.model.start_time
            self._skinned += self.colliders.plant(collider, self.pose_at(collider.index, first), first)

    def _place(self, collider: Collider, buffer: int, time: float) -> None:
        self._plant(collider)
        if collider.carried:
            self._skinned += self.colliders.take(collider, buffer, self.skins()[collider.index])
        else:
            self._skinned += self.colliders.place(collider, buffer, self.pose_at(collider.index, time), time)

    def box(self, collider: Collider, times: list[float]) -> np.ndarray:
        """(2, 3) bounds [m] of an animated surface through `times`, equally spaced."""
        seen = times if collider.surface.motion.animated else times[:1]
        return sweep(np.stack([collider.bounds.at(self.pose_at(collider.index, time)) for time in seen]))

    def _find_in_reach(self, frame: Interval, times: list[float]) -> None:
        """Notes the colliders whose bounds over the frame some strand's reach meets.

        A strand stays within its arc length of its root. Root and surface are sampled at equal times. Where a body
        will carry either, or a free strand go, is not known beforehand: then everything is in reach.
        """
        everywhere = np.array([[-np.inf] * 3, [np.inf] * 3])
        free = any(strands.free is not None and strands.free.any() for strands in self.model.scene.strands)
        roots = None if self.carries or free else self._root_boxes(times)
        for collider in self.colliders.items:
            box = everywhere if collider.carried else self._frame_boxes[collider.index]
            margin = self.roots.radius + collider.surface.thickness + QUERY_ALLOWANCE
            reach = self.roots.arc_length * (1.0 + STRETCH_ALLOWANCE) + margin
            if collider.carried or roots is None or touches(box, roots, reach):
                self.in_reach.append(collider)
                self.boxes.append(box)

    def _root_boxes(self, times: list[float]) -> np.ndarray:
        """(strand_count, 2, 3) boxes of the roots' ways through `times`."""
        position, rotation = wp.empty_like(self.root_position), wp.clone(self.root_rotation)
        moving = any(self._surfaces[strands.roots.surface].motion.animated for strands in self.model.scene.strands)
        placed = []
        for time in times if moving else times[:1]:
            self.roots.place(self.pose_at, time, position, rotation, {})
            placed.append(position.numpy().copy())
        samples = np.stack(placed)
        boxes = np.stack([samples.min(axis=0), samples.max(axis=0)], axis=1)
        if len(samples) > 2:
            bend = np.abs(samples[2:] - 2.0 * samples[1:-1] + samples[:-2]).max(axis=0)
            boxes += np.stack([-bend, bend], axis=1)
        return boxes


def _meet(box: np.ndarray, lower: np.ndarray, upper: np.ndarray, margin: float) -> bool:
    """Whether two boxes are no further apart than `margin` [m]."""
    return bool(np.all(box[0] <= upper + margin) and np.all(box[1] >= lower - margin))


def _carried(surface: Surface) -> bool:
    """Whether an elastic or a rigid body takes a surface along."""
    return surface.body is not None or surface.rigid is not None


def build(model: Model, state: State) -> KinematicsStage:
    """Raises `Refused` for roots that cannot be carried."""
    return KinematicsStage(model, state)
