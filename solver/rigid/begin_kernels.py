"""The beginning of a substep: forces taken up, and where surfaces may be in it."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.motion_kernels import ZERO, Masses, Motion, world_inverse
from plait.solver.rigid.types import Animated, Boxes, Geoms, Start, Step

wp.set_module_options({"enable_backward": False})

UNBOUNDED = wp.constant(wp.float64(1e30))


@wp.kernel
def begin_bodies(first: int, step: wp.array(dtype=Step), masses: Masses, motion: Motion, start: Start):
    """Takes up gravity and the impulses of others; one body an item."""
    b = first + wp.tid()
    inverse = world_inverse(motion.orientation[b], masses.inertia_inverse[b])
    start.inertia_inverse[b] = inverse
    start.velocity[b] = motion.velocity[b]
    start.spin[b] = inverse * motion.angular_momentum[b]
    if wp.length_sq(motion.impulse[b]) > ZERO or wp.length_sq(motion.angular_impulse[b]) > ZERO:
        motion.still_time[b] = ZERO
        if motion.asleep[b] == 1:
            motion.asleep[b] = 0
    if motion.asleep[b] == 0:
        motion.velocity[b] = motion.velocity[b] + step[0].length * step[0].gravity
    motion.velocity[b] = motion.velocity[b] + motion.impulse[b] / masses.mass[b]
    motion.angular_momentum[b] = motion.angular_momentum[b] + motion.angular_impulse[b]
    motion.impulse[b] = wp.vec3d()
    motion.angular_impulse[b] = wp.vec3d()


@wp.func
def put_box(boxes: Boxes, a: int, lower: wp.vec3d, upper: wp.vec3d, travel: wp.float64):
    still = wp.int32(0)
    if travel == ZERO and boxes.travel[a] == ZERO and boxes.lower[a] == lower and boxes.upper[a] == upper:
        still = 1
    boxes.still[a] = still
    boxes.lower[a] = lower
    boxes.upper[a] = upper
    boxes.travel[a] = travel


@wp.kernel
def bound_geoms(
    first: int,
    step: wp.array(dtype=Step),
    geoms: Geoms,
    animated: Animated,
    motion: Motion,
    start: Start,
    boxes: Boxes,
):
    """Boxes and ways of geoms, one an item."""
    a = first + wp.tid()
    body = geoms.body[a]
    if body >= 0:
        rotation = wp.quat_to_matrix(motion.orientation[body])
        spin = start.inertia_inverse[body] * motion.angular_momentum[body]
        travel = step[0].length * (wp.length(motion.velocity[body]) + wp.length(spin) * geoms.reach[a])
        center = motion.position[body] + rotation * geoms.center[a]
        local = geoms.half[a]
        half = wp.vec3d()
        for k in range(3):
            row = rotation[k]
            half[k] = (
                wp.abs(row[0]) * local[0]
                + wp.abs(row[1]) * local[1]
                + wp.abs(row[2]) * local[2]
                + travel
                + geoms.margin[a]
                + geoms.thickness[a]
            )
        put_box(boxes, a, center - half, center + half, travel)
        return
    entry = a - geoms.carried_count
    lower = wp.vec3d(UNBOUNDED, UNBOUNDED, UNBOUNDED)
    upper = -lower
    furthest = ZERO
    if animated.active[entry] == 1:
        for i in range(animated.points[entry][0], animated.points[entry][1]):
            x = animated.points_start[i]
            y = animated.points_end[i]
            lower = wp.min(lower, wp.min(x, y))
            upper = wp.max(upper, wp.max(x, y))
            furthest = wp.max(furthest, wp.length_sq(y - x))
    reach = wp.vec3d(geoms.thickness[a], geoms.thickness[a], geoms.thickness[a])
    put_box(boxes, a, lower - reach, upper + reach, wp.sqrt(furthest))
