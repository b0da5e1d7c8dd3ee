"""Joints of a scene, laid out for kernels."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.diagnostics import Refused
from plait.solver.model import Interval, Model
from plait.solver.rigid import joint_pose_kernels as kernels
from plait.solver.rigid.quaternions import quaternion
from plait.solver.scene import Drive
from plait.solver.state import State

KINDS = {
    "fixed": kernels.FIXED,
    "revolute": kernels.REVOLUTE,
    "spherical": kernels.SPHERICAL,
    "prismatic": kernels.PRISMATIC,
    "distance": kernels.DISTANCE,
}
SUBSTEP = {
    "axes": wp.mat33d,
    "lever_a": wp.vec3d,
    "lever_b": wp.vec3d,
    "inverse": kernels.mat66d,
    "bias": kernels.vec6d,
    "limit_axis": wp.vec3d,
    "limit_bias": wp.vec2d,
    "limit_impulse": wp.vec2d,
    "error": kernels.vec6d,
    "drive_rate": wp.vec3d,
    "held": kernels.vec6d,
    "ahead": kernels.vec6d,
    "limit_held": wp.vec2d,
    "limit_ahead": wp.vec2d,
}


class JointTable:
    """`Joints` of a scene; the world's frames follow their motions.

    State array: rigid/joint_impulse.
    """

    def __init__(self, model: Model, state: State, centers: list[np.ndarray]) -> None:
        """centers: [m] of mass, in rest space, a body each. Raises `Refused` for joints that hold nothing."""
        device = model.launcher.device
        self.scene_joints, self._centers = model.scene.joints, centers
        self.count = len(self.scene_joints)
        for joint in self.scene_joints:
            if joint.bodies[0] == joint.bodies[1]:
                raise Refused(f"{joint.name}: a joint needs a rigid body, and another or the world")
        self.joints = kernels.Joints()
        for name, dtype in SUBSTEP.items():
            setattr(self.joints, name, wp.zeros(self.count, dtype=dtype, device=device))
        self.joints.impulse = wp.zeros(self.count, dtype=kernels.vec6d, device=device)
        self._before = wp.zeros_like(self.joints.impulse)
        state.arrays["rigid/joint_impulse"] = self.joints.impulse
        bodies = [[-1 if b is None else b for b in joint.bodies] for joint in self.scene_joints]
        bounds = np.array([_bounds(joint) for joint in self.scene_joints]).reshape(-1, 2)

        def hold(values: object, dtype: type) -> wp.array:
            return wp.array(np.array(values), dtype=dtype, device=device)

        self.joints.body = hold(np.array(bodies).reshape(-1, 2), wp.vec2i)
        self.joints.kind = hold([KINDS[joint.kind] for joint in self.scene_joints], wp.int32)
        self.joints.lower, self.joints.upper = hold(bounds[:, 0], wp.float64), hold(bounds[:, 1], wp.float64)
        drives = [joint.drive for joint in self.scene_joints]
        self.joints.driven = hold([_driven(drive) for drive in drives], wp.int32)
        rows = [(d.stiffness, d.damping, d.target, d.target_velocity) if d else np.zeros(4) for d in drives]
        self.joints.drive = hold(np.array(rows).reshape(-1, 4), wp.vec4d)
        self.joints.drive_most = hold([drive.most if drive else 0.0 for drive in drives], wp.float64)
        place, turn = self._frames(model.start_time)
        self.joints.place, self.joints.turn = hold(place, wp.vec3d), hold(turn, wp.quatd)
        self.joints.place_start, self.joints.turn_start = wp.clone(self.joints.place), wp.clone(self.joints.turn)
        self._carried = any(None in joint.bodies and joint.motion.animated for joint in self.scene_joints)

    def begin_substep(self, substep: Interval) -> None:
        if not self.count:
            return
        wp.copy(self._before, self.joints.impulse)
        if self._carried:
            for time, places, turns in (
                (substep.start, self.joints.place_start, self.joints.turn_start),
                (substep.end, self.joints.place, self.joints.turn),
            ):
                place, turn = self._frames(time)
                places.assign(place)
                turns.assign(turn)

    def retract(self) -> None:
        if self.count:
            wp.copy(self.joints.impulse, self._before)

    def _frames(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Places (2 n, 3) and turns (2 n, 4) of both sides, about the bodies' centres of mass."""
        places, turns = [], []
        for joint in self.scene_joints:
            for body, frame in zip(joint.bodies, joint.frames, strict=True):
                held = np.asarray(frame, dtype=np.float64)
                if body is None:
                    held = joint.motion.pose(time).joint_transforms[0] @ held
                places.append(held[:3, 3] - (0.0 if body is None else self._centers[body]))
                turns.append(quaternion(held[:3, :3]))
        return np.array(places).reshape(-1, 3), np.array(turns).reshape(-1, 4)


def _driven(drive: Drive | None) -> int:
    if drive is None or not (drive.stiffness > 0.0 or drive.damping > 0.0):
        return 0
    return 2 if drive.per_inertia else 1


def _bounds(joint: object) -> tuple[float, float]:
    """Of what a joint leaves free."""
    if joint.kind == "spherical":
        return -np.inf, np.inf if joint.cone is None else joint.cone
    if joint.limits is None or joint.kind == "fixed":
        return -np.inf, np.inf
    return joint.limits
