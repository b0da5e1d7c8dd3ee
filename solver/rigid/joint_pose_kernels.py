"""Joints as they are laid out, where their two sides stand and how they move."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.impulse_kernels import place_velocity, push_body
from plait.solver.rigid.motion_kernels import ONE, ZERO, Masses, Motion
from plait.solver.rigid.types import Start

wp.set_module_options({"enable_backward": False})

FIXED = wp.constant(0)
REVOLUTE = wp.constant(1)
SPHERICAL = wp.constant(2)
PRISMATIC = wp.constant(3)
DISTANCE = wp.constant(4)
TWO = wp.constant(wp.float64(2.0))

vec6d = wp.types.vector(length=6, dtype=wp.float64)
mat66d = wp.types.matrix(shape=(6, 6), dtype=wp.float64)


@wp.struct
class Joints:
    """One entry a joint; see `plait.solver.scene.Joint`."""

    body: wp.array(dtype=wp.vec2i)  # -1: the world
    kind: wp.array(dtype=wp.int32)
    place: wp.array(
        dtype=wp.vec3d
    )  # (2 joint_count,) [m] about the centre of mass; of the world at the substep's end
    turn: wp.array(dtype=wp.quatd)  # (2 joint_count,)
    place_start: wp.array(dtype=wp.vec3d)  # the same, of the world at the substep's start
    turn_start: wp.array(dtype=wp.quatd)
    lower: wp.array(dtype=wp.float64)  # [rad] or [m]; -inf: no limit
    upper: wp.array(dtype=wp.float64)
    driven: wp.array(dtype=wp.int32)  # 0: not; 1: by a force; 2: by one for an inertia of one
    drive: wp.array(dtype=wp.vec4d)  # stiffness, damping, target, target velocity; see `plait.solver.scene.Drive`
    drive_most: wp.array(dtype=wp.float64)  # [N] or [N m]
    impulse: wp.array(dtype=vec6d)  # [kg m/s], [kg m2/s] on the second body, along the rows; a drive's on its own
    limit_impulse: wp.array(dtype=wp.vec2d)  # at the lower limit, at the upper: not negative
    # of a substep
    axes: wp.array(dtype=wp.mat33d)  # columns
    lever_a: wp.array(dtype=wp.vec3d)  # [m]
    lever_b: wp.array(dtype=wp.vec3d)
    inverse: wp.array(dtype=mat66d)  # of the rows' response
    bias: wp.array(dtype=vec6d)  # [m/s], [1/s] what the rows' speeds lack
    limit_axis: wp.array(dtype=wp.vec3d)
    limit_bias: wp.array(dtype=wp.vec2d)  # distance left to each limit over the length of the substep
    error: wp.array(dtype=vec6d)  # [m], [rad] at the start, as far as it is to stay
    drive_rate: wp.array(
        dtype=wp.vec3d
    )  # what a drive's row lacks: its softness, its bias; and its largest impulse
    held: wp.array(dtype=vec6d)  # impulses before the last sweep, and how they go on
    ahead: wp.array(dtype=vec6d)
    limit_held: wp.array(dtype=wp.vec2d)
    limit_ahead: wp.array(dtype=wp.vec2d)


@wp.struct
class JointPose:
    """The two frames of a joint, world."""

    place_a: wp.vec3d  # [m]
    place_b: wp.vec3d
    turn_a: wp.quatd
    turn_b: wp.quatd


@wp.func
def holds(kind: int, row: int) -> bool:
    """Whether a joint holds a row."""
    if kind == SPHERICAL:
        return row < 3
    if kind == REVOLUTE:
        return row != 5
    if kind == PRISMATIC:
        return row != 2
    return kind == FIXED


@wp.func
def slides(kind: int) -> bool:
    """Whether what a joint's limits bound is a way, not a turn."""
    return kind == PRISMATIC or kind == DISTANCE


@wp.func
def drives(joints: Joints, j: int, row: int) -> bool:
    """Whether a row is the one that the joint's drive acts along."""
    return joints.driven[j] > 0 and row == wp.where(joints.kind[j] == REVOLUTE, 5, 2)


@wp.func
def limited(joints: Joints, j: int) -> bool:
    return joints.lower[j] > -wp.inf or joints.upper[j] < wp.inf


@wp.func
def body_position(motion: Motion, b: int) -> wp.vec3d:
    if b < 0:
        return wp.vec3d()
    return motion.position[b]


@wp.func
def body_orientation(orientation: wp.array(dtype=wp.quatd), b: int) -> wp.quatd:
    if b < 0:
        return wp.quatd(ZERO, ZERO, ZERO, ONE)
    return orientation[b]


@wp.func
def joint_pose(
    place: wp.array(dtype=wp.vec3d),
    turn: wp.array(dtype=wp.quatd),
    j: int,
    x_a: wp.vec3d,
    q_a: wp.quatd,
    x_b: wp.vec3d,
    q_b: wp.quatd,
) -> JointPose:
    """With the bodies at x and q; for the world x = 0, q = 1."""
    out = JointPose()
    out.place_a = x_a + wp.quat_rotate(q_a, place[2 * j])
    out.place_b = x_b + wp.quat_rotate(q_b, place[2 * j + 1])
    out.turn_a = q_a * turn[2 * j]
    out.turn_b = q_b * turn[2 * j + 1]
    return out


@wp.func
def pose_at_start(joints: Joints, motion: Motion, j: int) -> JointPose:
    pair = joints.body[j]
    return joint_pose(
        joints.place_start,
        joints.turn_start,
        j,
        body_position(motion, pair[0]),
        body_orientation(motion.orientation, pair[0]),
        body_position(motion, pair[1]),
        body_orientation(motion.orientation, pair[1]),
    )


@wp.func
def pose_after(
    joints: Joints, motion: Motion, orientation: wp.array(dtype=wp.quatd), j: int, length: wp.float64
) -> JointPose:
    """With the bodies gone on for `length` [s] and turned so, and the world as it is at the substep's end."""
    pair = joints.body[j]
    x_a = body_position(motion, pair[0])
    x_b = body_position(motion, pair[1])
    if pair[0] >= 0:
        x_a += length * motion.velocity[pair[0]]
    if pair[1] >= 0:
        x_b += length * motion.velocity[pair[1]]
    q_a = body_orientation(orientation, pair[0])
    q_b = body_orientation(orientation, pair[1])
    return joint_pose(joints.place, joints.turn, j, x_a, q_a, x_b, q_b)


@wp.struct
class Relative:
    """The second body's motion against the first, at the joint."""

    velocity: wp.vec3d  # [m/s]
    spin: wp.vec3d  # [1/s]


@wp.func
def relative_motion(joints: Joints, motion: Motion, spin: wp.array(dtype=wp.vec3d), j: int) -> Relative:
    pair = joints.body[j]
    out = Relative()
    out.velocity = place_velocity(motion.velocity, spin, pair[1], joints.lever_b[j])
    out.velocity -= place_velocity(motion.velocity, spin, pair[0], joints.lever_a[j])
    if pair[0] >= 0:
        out.spin -= spin[pair[0]]
    if pair[1] >= 0:
        out.spin += spin[pair[1]]
    return out


@wp.func
def push_pair(
    joints: Joints,
    masses: Masses,
    motion: Motion,
    start: Start,
    spin: wp.array(dtype=wp.vec3d),
    j: int,
    force: wp.vec3d,
    torque: wp.vec3d,
):
    """Gives the second body an impulse and an angular impulse, and the first the opposite."""
    pair = joints.body[j]
    moment_a = wp.cross(joints.lever_a[j], force) + torque
    moment_b = wp.cross(joints.lever_b[j], force) + torque
    push_body(masses, motion, start, spin, pair[0], -force, -moment_a)
    push_body(masses, motion, start, spin, pair[1], force, moment_b)


@wp.func
def column(m: wp.mat33d, k: int) -> wp.vec3d:
    return wp.vec3d(m[0, k], m[1, k], m[2, k])


@wp.func
def between(pose: JointPose) -> wp.quatd:
    """The second frame's turn against the first, the shorter way."""
    q = wp.quat_inverse(pose.turn_a) * pose.turn_b
    if q[3] < ZERO:
        q = wp.quatd(-q[0], -q[1], -q[2], -q[3])
    return q


@wp.func
def joint_error(kind: int, pose: JointPose) -> vec6d:
    """[m], [rad] how far the second frame is from where it is held, along the first's axes."""
    out = vec6d()
    apart = wp.quat_rotate_inv(pose.turn_a, pose.place_b - pose.place_a)
    q = between(pose)
    turn = TWO * wp.vec3d(q[0], q[1], q[2])
    if kind == REVOLUTE:
        # The second z axis as the first frame sees it: its tilt alone.
        z = wp.quat_rotate(q, wp.vec3d(ZERO, ZERO, ONE))
        turn = wp.vec3d(-z[1], z[0], ZERO)
    for k in range(3):
        if holds(kind, k):
            out[k] = apart[k]
        if holds(kind, 3 + k):
            out[3 + k] = turn[k]
    return out


@wp.struct
class LimitState:
    value: wp.float64  # [rad] or [m]
    axis: wp.vec3d  # of what changes it, world


@wp.func
def limit_state(kind: int, pose: JointPose) -> LimitState:
    """What a joint's limits bound."""
    out = LimitState()
    z_a = wp.quat_rotate(pose.turn_a, wp.vec3d(ZERO, ZERO, ONE))
    out.axis = z_a
    if kind == PRISMATIC:
        out.value = wp.dot(z_a, pose.place_b - pose.place_a)
    if kind == DISTANCE:
        apart = pose.place_b - pose.place_a
        out.value = wp.length(apart)
        if out.value > ZERO:
            out.axis = apart / out.value
    if kind == REVOLUTE:
        q = between(pose)
        out.value = TWO * wp.atan2(q[2], q[3])
    if kind == SPHERICAL:
        z_b = wp.quat_rotate(pose.turn_b, wp.vec3d(ZERO, ZERO, ONE))
        lean = wp.cross(z_a, z_b)
        sine = wp.length(lean)
        out.value = wp.atan2(sine, wp.dot(z_a, z_b))
        if sine > wp.float64(1e-12):
            out.axis = lean / sine
    return out


@wp.func
def begin_drive(joints: Joints, j: int, pose: JointPose, response: wp.float64, length: wp.float64) -> wp.float64:
    """Of a drive's row, whose impulse moves it by `response`: what is to be added to that.

    At the end of the step, with speed v, the impulse is -h [k (x + h v - x*) + c (v - v*)] (backward Euler), that
    is, v + bias + softness impulse = 0.
    """
    drive = joints.drive[j]
    scale = ONE
    if joints.driven[j] == 2:
        scale = ONE / response
    away = limit_state(joints.kind[j], pose).value - drive[2]
    if joints.kind[j] == REVOLUTE and not limited(joints, j):  # the shorter way, where nothing bars it
        away = wp.atan2(wp.sin(away), wp.cos(away))
    strength = length * drive[0] + drive[1]
    softness = ONE / (scale * length * strength)
    bias = (drive[0] * away - drive[1] * drive[3]) / strength
    joints.drive_rate[j] = wp.vec3d(softness, bias, length * joints.drive_most[j])
    return softness
