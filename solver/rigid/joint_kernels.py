"""Joints between rigid bodies: what they hold, in float64.

A joint is a condition on where the substep ends: rows along the first frame's axes at the start, three for the
places and three for the turns, and their residuals at the end, found anew until they vanish (Newton's method with
the Jacobian of the start). So joints do not drift. Positions being met and velocities taken from the way, it is
SHAKE (Ryckaert, Ciccotti and Berendsen 1977), which is symplectic.
"""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.joint_pose_kernels import (
    Joints,
    begin_drive,
    body_orientation,
    body_position,
    column,
    drives,
    holds,
    joint_error,
    joint_pose,
    limit_state,
    limited,
    mat66d,
    pose_at_start,
    slides,
    vec6d,
)
from plait.solver.rigid.motion_kernels import ONE, ZERO, Masses, Motion
from plait.solver.rigid.types import Start

wp.set_module_options({"enable_backward": False})


@wp.func
def row_response(start: Start, b: int, force: wp.vec3d, torque: wp.vec3d, lever: wp.vec3d) -> wp.vec3d:
    """[1/s] the spin that a unit row impulse gives a body."""
    return start.inertia_inverse[b] * (wp.cross(lever, force) + torque)


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
    a = pair[0]
    b = pair[1]
    pose = pose_at_start(joints, motion, j)
    axes = wp.quat_to_matrix(pose.turn_a)
    joints.axes[j] = axes
    # One place for both sides: what the joint does is equal and opposite, and has no moment.
    joints.lever_a[j] = pose.place_b - body_position(motion, a)
    joints.lever_b[j] = pose.place_b - body_position(motion, b)
    error = joint_error(kind, pose)
    size = wp.length(error)
    keep = ZERO
    if size > exit_distance:
        keep = ONE - exit_distance / size
    joints.error[j] = keep * error
    response = mat66d()
    for i in range(6):
        force_i = wp.vec3d()
        torque_i = wp.vec3d()
        if i < 3:
            force_i = column(axes, i)
        else:
            torque_i = column(axes, i - 3)
        for k in range(6):
            force_k = wp.vec3d()
            torque_k = wp.vec3d()
            if k < 3:
                force_k = column(axes, k)
            else:
                torque_k = column(axes, k - 3)
            value = ZERO
            driven = i == k and drives(joints, j, i)
            if driven or (holds(kind, i) and holds(kind, k)):
                if a >= 0:
                    spin = row_response(start, a, force_k, torque_k, joints.lever_a[j])
                    value += wp.dot(force_i, force_k) / masses.mass[a]
                    value += wp.dot(wp.cross(joints.lever_a[j], force_i) + torque_i, spin)
                if b >= 0:
                    spin = row_response(start, b, force_k, torque_k, joints.lever_b[j])
                    value += wp.dot(force_i, force_k) / masses.mass[b]
                    value += wp.dot(wp.cross(joints.lever_b[j], force_i) + torque_i, spin)
            elif i == k:
                value = ONE
            if driven:
                value += begin_drive(joints, j, pose, value, length)
            response[i, k] = value
    joints.inverse[j] = inverted(response)


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
    if pair[0] >= 0:
        moment = wp.cross(joints.lever_a[j], force) + torque
        motion.velocity[pair[0]] = motion.velocity[pair[0]] - force / masses.mass[pair[0]]
        motion.angular_momentum[pair[0]] = motion.angular_momentum[pair[0]] - moment
        spin[pair[0]] = spin[pair[0]] - start.inertia_inverse[pair[0]] * moment
    if pair[1] >= 0:
        moment = wp.cross(joints.lever_b[j], force) + torque
        motion.velocity[pair[1]] = motion.velocity[pair[1]] + force / masses.mass[pair[1]]
        motion.angular_momentum[pair[1]] = motion.angular_momentum[pair[1]] + moment
        spin[pair[1]] = spin[pair[1]] + start.inertia_inverse[pair[1]] * moment


@wp.struct
class Relative:
    """The second body's motion against the first, at the joint."""

    velocity: wp.vec3d  # [m/s]
    spin: wp.vec3d  # [1/s]


@wp.func
def relative_motion(joints: Joints, motion: Motion, spin: wp.array(dtype=wp.vec3d), j: int) -> Relative:
    out = Relative()
    pair = joints.body[j]
    if pair[0] >= 0:
        out.velocity -= motion.velocity[pair[0]] + wp.cross(spin[pair[0]], joints.lever_a[j])
        out.spin -= spin[pair[0]]
    if pair[1] >= 0:
        out.velocity += motion.velocity[pair[1]] + wp.cross(spin[pair[1]], joints.lever_b[j])
        out.spin += spin[pair[1]]
    return out


@wp.func
def row_speeds(joints: Joints, j: int, relative: Relative) -> vec6d:
    out = vec6d()
    for k in range(3):
        axis = column(joints.axes[j], k)
        out[k] = wp.dot(axis, relative.velocity)
        out[3 + k] = wp.dot(axis, relative.spin)
    return out


@wp.func
def limit_speed(joints: Joints, j: int, relative: Relative) -> wp.float64:
    if slides(joints.kind[j]):
        return wp.dot(joints.limit_axis[j], relative.velocity)
    return wp.dot(joints.limit_axis[j], relative.spin)


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
    pair = joints.body[j]
    kind = joints.kind[j]
    x_a = body_position(motion, pair[0])
    x_b = body_position(motion, pair[1])
    if pair[0] >= 0:
        x_a += length * motion.velocity[pair[0]]
    if pair[1] >= 0:
        x_b += length * motion.velocity[pair[1]]
    q_a = body_orientation(turned, pair[0])
    q_b = body_orientation(turned, pair[1])
    pose = joint_pose(joints.place, joints.turn, j, x_a, q_a, x_b, q_b)
    relative = relative_motion(joints, motion, spin, j)
    lack = (joint_error(kind, pose) - joints.error[j]) / length
    joints.bias[j] = lack - row_speeds(joints, j, relative)
    most = ZERO
    for k in range(6):
        if holds(kind, k):
            most = wp.max(most, wp.abs(lack[k]))
    if limited(joints, j):
        state = limit_state(kind, pose)
        old = joints.limit_bias[j]
        joints.limit_axis[j] = state.axis
        speed = limit_speed(joints, j, relative)
        room = wp.vec2d((state.value - joints.lower[j]) / length, (joints.upper[j] - state.value) / length)
        # What starts beyond is led back.
        pause = exit_distance / length
        begun = limit_state(kind, pose_at_start(joints, motion, j)).value
        room[0] = room[0] + wp.max(ZERO, (joints.lower[j] - begun) / length - pause)
        room[1] = room[1] + wp.max(ZERO, (begun - joints.upper[j]) / length - pause)
        joints.limit_bias[j] = wp.vec2d(room[0] - speed, room[1] + speed)
        if joints.limit_impulse[j][0] > ZERO or room[0] < ZERO:
            most = wp.max(most, wp.abs(joints.limit_bias[j][0] - old[0]))
        if joints.limit_impulse[j][1] > ZERO or room[1] < ZERO:
            most = wp.max(most, wp.abs(joints.limit_bias[j][1] - old[1]))
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
def apply_limit(
    joints: Joints,
    masses: Masses,
    motion: Motion,
    start: Start,
    spin: wp.array(dtype=wp.vec3d),
    j: int,
    change: wp.float64,
):
    if slides(joints.kind[j]):
        push_pair(joints, masses, motion, start, spin, j, change * joints.limit_axis[j], wp.vec3d())
    else:
        push_pair(joints, masses, motion, start, spin, j, wp.vec3d(), change * joints.limit_axis[j])


@wp.func
def limit_response(joints: Joints, masses: Masses, start: Start, j: int) -> wp.float64:
    pair = joints.body[j]
    axis = joints.limit_axis[j]
    out = ZERO
    for side in range(2):
        b = pair[side]
        if b >= 0:
            lever = wp.where(side == 0, joints.lever_a[j], joints.lever_b[j])
            moment = axis
            if slides(joints.kind[j]):
                moment = wp.cross(lever, axis)
                out += ONE / masses.mass[b]
            out += wp.dot(moment, start.inertia_inverse[b] * moment)
    return out


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
        response = limit_response(joints, masses, start, j)
        for k in range(2):
            sign = wp.where(k == 0, ONE, -ONE)
            speed = limit_speed(joints, j, relative_motion(joints, motion, spin, j))
            held = joints.limit_impulse[j]
            now = wp.max(held[k] - (joints.limit_bias[j][k] + sign * speed) / response, ZERO)
            if now != held[k]:
                most = wp.max(most, wp.abs(now - held[k]) * response)
                apply_limit(joints, masses, motion, start, spin, j, sign * (now - held[k]))
                held[k] = now
                joints.limit_impulse[j] = held
    return most


@wp.func
def loosen_joint(joints: Joints, j: int):
    """Nothing is added to what the rows' speeds lack, and no limit is near."""
    joints.bias[j] = vec6d()
    joints.limit_bias[j] = wp.vec2d(wp.inf, wp.inf)


@wp.func
def take_joint_where_it_is(joints: Joints, motion: Motion, j: int, length: wp.float64):
    """No impulses, and of the substep's end only what the animation moves and how far it is to a limit."""
    pair = joints.body[j]
    kind = joints.kind[j]
    begun = pose_at_start(joints, motion, j)
    x_a = body_position(motion, pair[0])
    x_b = body_position(motion, pair[1])
    q_a = body_orientation(motion.orientation, pair[0])
    q_b = body_orientation(motion.orientation, pair[1])
    carried = joint_pose(joints.place, joints.turn, j, x_a, q_a, x_b, q_b)
    joints.impulse[j] = vec6d()
    joints.limit_impulse[j] = wp.vec2d()
    joints.bias[j] = (joint_error(kind, carried) - joint_error(kind, begun)) / length
    if limited(joints, j):
        state = limit_state(kind, carried)
        joints.limit_axis[j] = state.axis
        joints.limit_bias[j] = wp.vec2d(
            wp.max(state.value - joints.lower[j], ZERO) / length,
            wp.max(joints.upper[j] - state.value, ZERO) / length,
        )


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
