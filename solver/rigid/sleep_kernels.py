"""Bodies at rest with all that they touch are left alone, until something happens to one of them."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.island_kernels import Islands, begin_of
from plait.solver.rigid.motion_kernels import HALF, ONE, ZERO, Masses, Motion
from plait.solver.rigid.types import Contacts

wp.set_module_options({"enable_backward": False})

# A body rests that for this time [s] has stayed where it was: within this part of its radius of gyration, and of a
# radian.
REST_TIME = wp.constant(wp.float64(0.5))
STILL = wp.constant(wp.float64(1e-3))


@wp.func
def watch(motion: Motion, masses: Masses, b: int, length: wp.float64):
    """Takes note of a substep of `length` [s] that a body has taken."""
    inertia = masses.inertia[b]
    room = STILL * wp.sqrt(HALF * wp.trace(inertia) / masses.mass[b])
    moved = wp.length(motion.position[b] - motion.still_position[b])
    # Half the cosine of half the angle off one is an eighth of its square.
    turned = ONE - wp.abs(wp.dot(motion.orientation[b], motion.still_orientation[b]))
    if moved > room or turned > wp.float64(0.125) * STILL * STILL:
        motion.still_position[b] = motion.position[b]
        motion.still_orientation[b] = motion.orientation[b]
        motion.still_time[b] = ZERO
    else:
        motion.still_time[b] = motion.still_time[b] + length


@wp.func
def may_sleep(islands: Islands, contacts: Contacts, motion: Motion, r: int) -> bool:
    """Whether all of an island rests on something, and nothing that it touches moves. Not with joints."""
    if begin_of(islands.joint_begin, r) != islands.joint_begin[r]:
        return False
    begin = begin_of(islands.contact_begin, r)
    end = islands.contact_begin[r]
    if begin == end:
        return False
    for i in range(begin_of(islands.body_begin, r), islands.body_begin[r]):
        if motion.still_time[islands.body[i]] < REST_TIME:
            return False
    for i in range(begin, end):
        c = islands.contact[i]
        # Of an animated surface the core is its way in the substep.
        if contacts.body[c][0] < 0 and wp.length_sq(contacts.core_a[c]) > ZERO:
            return False
        if contacts.body[c][1] < 0 and wp.length_sq(contacts.core_b[c]) > ZERO:
            return False
    return True


@wp.func
def lay_down(islands: Islands, motion: Motion, r: int):
    for i in range(begin_of(islands.body_begin, r), islands.body_begin[r]):
        b = islands.body[i]
        motion.velocity[b] = wp.vec3d()
        motion.angular_momentum[b] = wp.vec3d()
        motion.asleep[b] = 1


@wp.func
def wake(islands: Islands, motion: Motion, r: int, weight: wp.vec3d):
    """weight: [m/s] what gravity gives in the substep, which the bodies asleep have not taken up."""
    for i in range(begin_of(islands.body_begin, r), islands.body_begin[r]):
        b = islands.body[i]
        if motion.asleep[b] == 1:
            motion.velocity[b] = motion.velocity[b] + weight
            motion.asleep[b] = 0
