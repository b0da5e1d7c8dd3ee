"""Free motion of rigid bodies, in float64."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

HALF = wp.constant(wp.float64(0.5))
ONE = wp.constant(wp.float64(1.0))
ZERO = wp.constant(wp.float64(0.0))
# One part turns by at most so much [rad] where it is of second order, and of fourth.
SMALL = wp.constant(wp.float64(0.01))
LARGE = wp.constant(wp.float64(0.2))
MAX_PARTS = wp.constant(256)
MAX_ROUNDS = wp.constant(30)
# Suzuki's: two parts of this length, one of 1 - 4 times it, two more.
SUZUKI = wp.constant(wp.float64(1.0 / (4.0 - 4.0 ** (1.0 / 3.0))))
# Below this part of the momentum the implicit step has converged: round-off.
ROUND_OFF = wp.constant(wp.float64(4e-16))


@wp.struct
class Motion:
    """What evolves, one entry a body; world frame."""

    position: wp.array(dtype=wp.vec3d)  # [m] of the centre of mass
    orientation: wp.array(dtype=wp.quatd)  # unit, from the axes of rest space to world
    velocity: wp.array(dtype=wp.vec3d)  # [m/s]
    angular_momentum: wp.array(dtype=wp.vec3d)  # [kg m2/s] about the centre of mass
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] from others, taken up by the next substep
    angular_impulse: wp.array(dtype=wp.vec3d)  # [kg m2/s] about the centre of mass
    still_position: wp.array(dtype=wp.vec3d)  # [m] where the body has been near, for a time [s]
    still_orientation: wp.array(dtype=wp.quatd)
    still_time: wp.array(dtype=wp.float64)
    asleep: wp.array(dtype=wp.int32)  # 1: left alone in the substep before, with all that it touches


@wp.struct
class Masses:
    """What is constant."""

    mass: wp.array(dtype=wp.float64)  # [kg]
    inertia: wp.array(dtype=wp.mat33d)  # [kg m2] about the centre of mass, axes of rest space
    inertia_inverse: wp.array(dtype=wp.mat33d)


@wp.func
def rotation_by(turn: wp.vec3d) -> wp.quatd:
    """exp of a rotation vector [rad]."""
    angle = wp.length(turn)
    if angle < wp.float64(1e-8):
        return wp.normalize(wp.quatd(HALF * turn[0], HALF * turn[1], HALF * turn[2], ONE))
    axis = turn / angle
    s = wp.sin(HALF * angle)
    return wp.quatd(s * axis[0], s * axis[1], s * axis[2], wp.cos(HALF * angle))


@wp.func
def world_inverse(orientation: wp.quatd, inertia_inverse: wp.mat33d) -> wp.mat33d:
    """R I^-1 R^T."""
    rotation = wp.quat_to_matrix(orientation)
    return rotation * inertia_inverse * wp.transpose(rotation)


@wp.func
def turn_part(
    orientation: wp.quatd, angular_momentum: wp.vec3d, inertia_inverse: wp.mat33d, length: wp.float64
) -> wp.quatd:
    m = wp.quat_rotate_inv(orientation, angular_momentum)
    w = inertia_inverse * m
    bound = ROUND_OFF * wp.length(w)
    for _ in range(MAX_ROUNDS):
        after = wp.quat_rotate(rotation_by(-length * w), m)
        w_next = inertia_inverse * (HALF * (m + after))
        change = wp.length(w_next - w)
        w = w_next
        if change <= bound:
            break
    return wp.normalize(orientation * rotation_by(length * w))


@wp.func
def turn_freely(
    orientation: wp.quatd, angular_momentum: wp.vec3d, inertia_inverse: wp.mat33d, length: wp.float64
) -> wp.quatd:
    """Where a torque-free body turns in `length` [s], in its angular momentum (world), which stays.

    In the body's frame, with momentum m: the implicit step

        m1 = exp(-h w) m0,  w = I^-1 (m0 + m1) / 2,  R1 = R0 exp(h w)

    keeps R m exactly, and the energy m . I^-1 m / 2 too, since m1 - m0 is across w; a steady spin is exact. It is
    that of Austin, Krishnaprasad and Wang (J. Comput. Phys. 107, 1993) with exp for Cayley's transform; symmetric,
    so of second order, and where a step turns far, parts composed after Suzuki (1990) make it fourth.
    """
    angle = length * wp.length(inertia_inverse * wp.quat_rotate_inv(orientation, angular_momentum))
    if angle == ZERO:
        return orientation
    if angle <= SMALL:
        return turn_part(orientation, angular_momentum, inertia_inverse, length)
    parts = wp.clamp(int(wp.ceil(angle / LARGE)), 1, MAX_PARTS)
    whole = length / wp.float64(parts)
    turned = orientation
    for k in range(5 * parts):
        part = SUZUKI * whole
        if k % 5 == 2:
            part = whole - wp.float64(4.0) * part
        turned = turn_part(turned, angular_momentum, inertia_inverse, part)
    return turned
