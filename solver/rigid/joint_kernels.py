"""Joints between rigid bodies: what they hold, in float64.

A joint is a condition on where the substep ends: rows along the first frame's axes at the start, three for the
places and three for the turns, and their residuals at the end, found anew until they vanish (Newton's method with
the Jacobian of the start). So joints do not drift. Positions being met and velocities taken from the way, it is
SHAKE (Ryckaert, Ciccotti and Berendsen 1977), which is symplectic.
"""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.joint_limit_kernels import (
    apply_limit,
    look_at_limits,
    room_to_limit,
    solve_limits,
)
from plait.solver.rigid.joint_pose_kernels import (
    Joints,
    Relative,
    begin_drive,
    body_position,
    column,
    drives,
    holds,
    joint_error,
    limit_state,
    limited,
    mat66d,
    pose_after,
    pose_at_start,
    push_pair,
    relative_motion,
    vec6d,
)
from plait.solver.rigid.motion_kernels import ONE, ZERO, Masses, Motion
from plait.solver.rigid.types import Start

wp.set_module_options({"enable_backward": False})


@wp.func
def inverted(matrix: mat66d) -> mat66d:
    """Of a symmetric positive definite matrix (Gauss and Jordan)."""
    m = matrix
    for k in range(6):
        pivot = ONE / m[k, k]
        for i in range(6):
            if i != k:
                factor = m[i, k] * pivot
                for j in range(6):
                    if j != k:
                        m[i, j] = m[i, j] - factor * m[k, j]
                m[i, k] = -factor
        for j in range(6):
            if j != k:
                m[k, j] = m[k, j] * pivot
        m[k, k] = pivot
    return m


@wp.func
def row_force(axes: wp.mat33d, row: int) -> wp.vec3d:
    """The force of a unit impulse along a row."""
    if row < 3:
        return column(axes, row)
    return wp.vec3d()


@wp.func
def row_torque(axes: wp.mat33d, row: int) -> wp.vec3d:
    """Its torque beside that of the force."""
    if row < 3:
        return wp.vec3d()
    return column(axes, row - 3)


@wp.func
def row_response(joints: Joints, masses: Masses, start: Start, j: int, i: int, k: int) -> wp.float64:
    """How much a unit impulse along row k moves the second frame against the first along row i."""
    force_i = row_force(joints.axes[j], i)
    force_k = row_force(joints.axes[j], k)
    pair = joints.body[j]
    out = wp.float64(0.0)
    for side in range(2):
        b = pair[side]
        if b >= 0:
            lever = wp.where(side == 0, joints.lever_a[j], joints.lever_b[j])
            moment_i = wp.cross(lever, force_i) + row_torque(joints.axes[j], i)
            moment_k = wp.cross(lever, force_k) + row_torque(joints.axes[j], k)
            out += wp.dot(force_i, force_k) / masses.mass[b]
            out += wp.dot(moment_i, start.inertia_inverse[b] * moment_k)
    return out


@wp.func
def begin_joint(
    joints: Joints,
    masses: Masses,
    motion: Motion,
    start: Start,
    j: int,
    length: wp.float64,
    exit_distance: wp.float64,
):
    """Rows and their response at the substep's start. What is apart is led back by `exit_distance` [m] at most."""
    pair = joints.body[j]
    kind = joints.kind[j]
    pose = pose_at_start(joints, motion, j)
    joints.axes[j] = wp.quat_to_matrix(pose.turn_a)
    # One place for both sides: what the joint does is equal and opposite, and has no moment.
    joints.lever_a[j] = pose.place_b - body_position(motion, pair[0])
    joints.lever_b[j] = pose.place_b - body_position(motion, pair[1])
    error = joint_error(kind, pose)
    size = wp.length(error)
    keep = ZERO
    if size > exit_distance:
        keep = ONE - exit_distance / size
    joints.error[j] = keep * error
    response = mat66d()
    for i in range(6):
        for k in range(6):
            driven = i == k and drives(joints, j, i)
            value = wp.where(i == k, ONE, ZERO)
            if driven or (holds(kind, i) and holds(kind, k)):
                value = row_response(joints, masses, start, j, i, k)
            if driven:
                value += begin_drive(joints, j, pose, value, length)
            response[i, k] = value
    joints.inverse[j] = inverted(response)


@wp.func
def row_speeds(joints: Joints, j: int, relative: Relative) -> vec6d:
    out = vec6d()
    for k in range(3):
        axis = column(joints.axes[j], k)
        out[k] = wp.dot(axis, relative.velocity)
        out[3 + k] = wp.dot(axis, relative.spin)
    return out


@wp.func
def look_at_joint(
    joints: Joints,
    motion: Motion,
    spin: wp.array(dtype=wp.vec3d),
    turned: wp.array(dtype=wp.quatd),
    j: int,
    length: wp.float64,
    exit_distance: wp.float64,
) -> wp.float64:
    """Takes the residuals where the bodies now end; the largest that they lack [m/s], [1/s]."""
    kind = joints.kind[j]
    pose = pose_after(joints, motion, turned, j, length)
    relative = relative_motion(joints, motion, spin, j)
    lack = (joint_error(kind, pose) - joints.error[j]) / length
    joints.bias[j] = lack - row_speeds(joints, j, relative)
    most = ZERO
    for k in range(6):
        if holds(kind, k):
            most = wp.max(most, wp.abs(lack[k]))
    if limited(joints, j):
        most = wp.max(most, look_at_limits(joints, motion, j, pose, relative, length, exit_distance))
    return most


@wp.func
def apply_rows(
    joints: Joints,
    masses: Masses,
    motion: Motion,
    start: Start,
    spin: wp.array(dtype=wp.vec3d),
    j: int,
    change: vec6d,
):
    axes = joints.axes[j]
    force = axes * wp.vec3d(change[0], change[1], change[2])
    torque = axes * wp.vec3d(change[3], change[4], change[5])
    push_pair(joints, masses, motion, start, spin, j, force, torque)


@wp.func
def solve_drive(
    joints: Joints, masses: Masses, motion: Motion, start: Start, spin: wp.array(dtype=wp.vec3d), j: int
) -> wp.float64:
    """A drive's part of a sweep; the change of its speed [m/s], [1/s]."""
    speeds = row_speeds(joints, j, relative_motion(joints, motion, spin, j))
    rate = joints.drive_rate[j]
    most = ZERO
    for k in range(6):
        if drives(joints, j, k):
            held = joints.impulse[j][k]
            now = held - joints.inverse[j][k, k] * (speeds[k] + rate[1] + rate[0] * held)
            now = wp.clamp(now, -rate[2], rate[2])
            change = vec6d()
            change[k] = now - held
            joints.impulse[j] = joints.impulse[j] + change
            apply_rows(joints, masses, motion, start, spin, j, change)
            most = wp.abs(change[k]) / joints.inverse[j][k, k]
    return most


@wp.func
def solve_joint(
    joints: Joints, masses: Masses, motion: Motion, start: Start, spin: wp.array(dtype=wp.vec3d), j: int
) -> wp.float64:
    """One joint of a sweep; the largest change of a speed [m/s], [1/s]."""
    kind = joints.kind[j]
    lack = row_speeds(joints, j, relative_motion(joints, motion, spin, j)) + joints.bias[j]
    most = ZERO
    for k in range(6):
        if not holds(kind, k):
            lack[k] = ZERO
        most = wp.max(most, wp.abs(lack[k]))
    change = -(joints.inverse[j] * lack)
    joints.impulse[j] = joints.impulse[j] + change
    apply_rows(joints, masses, motion, start, spin, j, change)
    if joints.driven[j] > 0:
        most = wp.max(most, solve_drive(joints, masses, motion, start, spin, j))
    if limited(joints, j):
        most = wp.max(most, solve_limits(joints, masses, motion, start, spin, j))
    return most


@wp.func
def loosen_joint(joints: Joints, j: int):
    """Nothing is added to what the rows' speeds lack, and no limit is near."""
    joints.bias[j] = vec6d()
    joints.limit_bias[j] = wp.vec2d(wp.inf, wp.inf)


@wp.func
def take_joint_where_it_is(joints: Joints, motion: Motion, j: int, length: wp.float64):
    """No impulses, and of the substep's end only what the animation moves and how far it is to a limit."""
    kind = joints.kind[j]
    carried = pose_after(joints, motion, motion.orientation, j, ZERO)
    joints.impulse[j] = vec6d()
    joints.limit_impulse[j] = wp.vec2d()
    joints.bias[j] = (joint_error(kind, carried) - joint_error(kind, pose_at_start(joints, motion, j))) / length
    if limited(joints, j):
        state = limit_state(kind, carried)
        joints.limit_axis[j] = state.axis
        bias = wp.vec2d()
        for k in range(2):
            bias[k] = wp.max(room_to_limit(joints, j, k, state.value), ZERO) / length
        joints.limit_bias[j] = bias


@wp.func
def note_joint(joints: Joints, j: int):
    """Before a sweep."""
    joints.held[j] = joints.impulse[j]
    joints.limit_held[j] = joints.limit_impulse[j]


@wp.func
def joint_change(joints: Joints, j: int) -> wp.float64:
    """[J] a measure of what a sweep has changed: the impulses' changes squared, over their response."""
    change = joints.impulse[j] - joints.held[j]
    out = ZERO
    for k in range(6):
        out += change[k] * change[k] / joints.inverse[j][k, k]
    return out


@wp.func
def carry_joint_on(
    joints: Joints,
    masses: Masses,
    motion: Motion,
    start: Start,
    spin: wp.array(dtype=wp.vec3d),
    j: int,
    part: wp.float64,
):
    """Goes on by `part` of the way so far; see `sweep_until`."""
    ahead = part * joints.ahead[j]
    ahead_limit = part * joints.limit_ahead[j]
    joints.ahead[j] = ahead + joints.impulse[j] - joints.held[j]
    joints.limit_ahead[j] = ahead_limit + joints.limit_impulse[j] - joints.limit_held[j]
    if part > ZERO:
        joints.impulse[j] = joints.impulse[j] + ahead
        apply_rows(joints, masses, motion, start, spin, j, ahead)
        if limited(joints, j):
            joints.limit_impulse[j] = joints.limit_impulse[j] + ahead_limit
            apply_limit(joints, masses, motion, start, spin, j, ahead_limit[0] - ahead_limit[1])
