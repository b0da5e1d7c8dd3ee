"""Limits of joints, which hold from one side, in float64."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.joint_pose_kernels import (
    JointPose,
    Joints,
    Relative,
    limit_state,
    pose_at_start,
    push_pair,
    relative_motion,
    slides,
)
from plait.solver.rigid.motion_kernels import ONE, ZERO, Masses, Motion
from plait.solver.rigid.types import Start

wp.set_module_options({"enable_backward": False})


@wp.func
def limit_sign(k: int) -> wp.float64:
    """Which way leads from the lower limit (0), and from the upper (1)."""
    return wp.where(k == 0, ONE, -ONE)


@wp.func
def room_to_limit(joints: Joints, j: int, k: int, value: wp.float64) -> wp.float64:
    """[m], [rad] how far it is to a limit; negative beyond it."""
    return limit_sign(k) * (value - wp.where(k == 0, joints.lower[j], joints.upper[j]))


@wp.func
def limit_speed(joints: Joints, j: int, relative: Relative) -> wp.float64:
    if slides(joints.kind[j]):
        return wp.dot(joints.limit_axis[j], relative.velocity)
    return wp.dot(joints.limit_axis[j], relative.spin)


@wp.func
def look_at_limits(
    joints: Joints,
    motion: Motion,
    j: int,
    pose: JointPose,
    relative: Relative,
    length: wp.float64,
    exit_distance: wp.float64,
) -> wp.float64:
    """Takes the room that is left at the end, where the joint stands as `pose` has it.

    By how much that has changed where a limit bears, or should [m/s], [1/s].
    """
    state = limit_state(joints.kind[j], pose)
    joints.limit_axis[j] = state.axis
    speed = limit_speed(joints, j, relative)
    begun = limit_state(joints.kind[j], pose_at_start(joints, motion, j)).value
    pause = exit_distance / length
    bias = wp.vec2d()
    most = wp.float64(0.0)
    for k in range(2):
        room = room_to_limit(joints, j, k, state.value) / length
        # What starts beyond is led back.
        room = room + wp.max(ZERO, -room_to_limit(joints, j, k, begun) / length - pause)
        bias[k] = room - limit_sign(k) * speed
        if joints.limit_impulse[j][k] > ZERO or room < ZERO:
            most = wp.max(most, wp.abs(bias[k] - joints.limit_bias[j][k]))
    joints.limit_bias[j] = bias
    return most


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
def solve_limits(
    joints: Joints, masses: Masses, motion: Motion, start: Start, spin: wp.array(dtype=wp.vec3d), j: int
) -> wp.float64:
    """The limits' part of a sweep; the largest change of a speed [m/s], [1/s]."""
    response = limit_response(joints, masses, start, j)
    most = wp.float64(0.0)
    for k in range(2):
        sign = limit_sign(k)
        speed = limit_speed(joints, j, relative_motion(joints, motion, spin, j))
        held = joints.limit_impulse[j]
        now = wp.max(held[k] - (joints.limit_bias[j][k] + sign * speed) / response, ZERO)
        if now != held[k]:
            most = wp.max(most, wp.abs(now - held[k]) * response)
            apply_limit(joints, masses, motion, start, spin, j, sign * (now - held[k]))
            held[k] = now
            joints.limit_impulse[j] = held
    return most
