"""What keeps an island's bodies from getting energy that nothing gave them.

Impulses that answer to where a substep leads may add some: what turns far in it would end inside its neighbour,
and is thrown off by far more than it came with. By the work that an impulse does, J . (u before + u after) / 2,
inelastic contacts with Coulomb friction gain nothing where their places are at the start. So where there is a
gain, they are solved anew for that, and what then overlaps is parted by positions alone.
"""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.island_kernels import Islands, begin_of
from plait.solver.rigid.joint_kernels import solve_joint, take_joint_where_it_is
from plait.solver.rigid.joint_pose_kernels import Joints
from plait.solver.rigid.motion_kernels import (
    HALF,
    ONE,
    ZERO,
    Masses,
    Motion,
    rotation_by,
    turn_freely,
    world_inverse,
)
from plait.solver.rigid.row_kernels import Rows, Work, carried_by, solve_contact
from plait.solver.rigid.types import Contacts, Start

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(wp.float64(0.5))  # [rad]
MUCH = wp.constant(wp.float64(0.1))  # part of the energy


@wp.func
def note_motion(islands: Islands, motion: Motion, work: Work, r: int):
    for i in range(begin_of(islands.body_begin, r), islands.body_begin[r]):
        b = islands.body[i]
        work.velocity[b] = motion.velocity[b]
        work.angular_momentum[b] = motion.angular_momentum[b]


@wp.func
def turns_far(islands: Islands, work: Work, r: int, length: wp.float64) -> bool:
    """Whether a body of an island would turn far in the substep."""
    fastest = wp.float64(0.0)
    for i in range(begin_of(islands.body_begin, r), islands.body_begin[r]):
        fastest = wp.max(fastest, wp.length(work.spin[islands.body[i]]))
    return length * fastest > FAR


@wp.func
def kinetic_energy(
    islands: Islands,
    masses: Masses,
    start: Start,
    velocity: wp.array(dtype=wp.vec3d),
    angular_momentum: wp.array(dtype=wp.vec3d),
    r: int,
) -> wp.float64:
    """[J] of an island's bodies."""
    energy = wp.float64(0.0)
    for i in range(begin_of(islands.body_begin, r), islands.body_begin[r]):
        b = islands.body[i]
        spin = start.inertia_inverse[b] * angular_momentum[b]
        energy += HALF * (masses.mass[b] * wp.length_sq(velocity[b]) + wp.dot(angular_momentum[b], spin))
    return energy


@wp.func
def given_by_animation(islands: Islands, contacts: Contacts, rows: Rows, r: int, length: wp.float64) -> wp.float64:
    """[J] the work of what the animation moves at an island's contacts."""
    given = wp.float64(0.0)
    for i in range(begin_of(islands.contact_begin, r), islands.contact_begin[r]):
        c = islands.contact[i]
        given -= wp.dot(wp.transpose(rows.axes[c]) * rows.impulse[c], carried_by(contacts, c, length))
    return given


@wp.func
def gain_of(
    islands: Islands,
    contacts: Contacts,
    rows: Rows,
    masses: Masses,
    motion: Motion,
    start: Start,
    work: Work,
    r: int,
    length: wp.float64,
) -> wp.float64:
    """[J] by how much the impulses have added to what the bodies had, and what the animation gave them."""
    before = kinetic_energy(islands, masses, start, work.velocity, work.angular_momentum, r)
    after = kinetic_energy(islands, masses, start, motion.velocity, motion.angular_momentum, r)
    return after - before - given_by_animation(islands, contacts, rows, r, length)


@wp.func
def solve_where_they_are(
    islands: Islands,
    contacts: Contacts,
    rows: Rows,
    joints: Joints,
    masses: Masses,
    motion: Motion,
    start: Start,
    work: Work,
    r: int,
    length: wp.float64,
    bound: wp.float64,
    sweeps: int,
    rough: bool,
):
    """An island's contacts and joints anew, without impulses to begin with nor what turning adds.

    rough: with friction. Without, every step takes energy, so that sweeps may end anywhere.
    """
    for i in range(begin_of(islands.body_begin, r), islands.body_begin[r]):
        b = islands.body[i]
        motion.velocity[b] = work.velocity[b]
        motion.angular_momentum[b] = work.angular_momentum[b]
        work.spin[b] = start.inertia_inverse[b] * motion.angular_momentum[b]
    contact_begin = begin_of(islands.contact_begin, r)
    contact_end = islands.contact_begin[r]
    for i in range(contact_begin, contact_end):
        c = islands.contact[i]
        rows.impulse[c] = wp.vec3d()
        rows.bias[c] = carried_by(contacts, c, length)
        rows.least[c] = wp.min(-contacts.gap[c] / length, ZERO)
    joint_begin = begin_of(islands.joint_begin, r)
    joint_end = islands.joint_begin[r]
    for i in range(joint_begin, joint_end):
        take_joint_where_it_is(joints, motion, islands.joint[i], length)
    for _ in range(sweeps):
        change = wp.float64(0.0)
        for i in range(joint_begin, joint_end):
            change = wp.max(change, solve_joint(joints, masses, motion, start, work.spin, islands.joint[i]))
        for i in range(contact_begin, contact_end):
            c = islands.contact[i]
            friction = wp.where(rough, contacts.friction[c], ZERO)
            change = wp.max(change, solve_contact(contacts, rows, masses, motion, start, work, c, friction))
        if change <= bound:
            break


@wp.func
def part_of_energy(islands: Islands, work: Work, r: int, length: wp.float64, tolerance: wp.float64) -> wp.float64:
    """By which part of its energy an island's impulses, and what parts its overlaps, may add to it.

    Joints give and take while they keep their places exactly, the more the further they turn, and drives and what
    the animation moves do work: with them only much is too much, and where they turn far.
    """
    if begin_of(islands.joint_begin, r) == islands.joint_begin[r]:
        return tolerance
    if turns_far(islands, work, r, length):
        return MUCH
    return wp.float64(wp.inf)


@wp.func
def hold_energy(
    islands: Islands,
    contacts: Contacts,
    rows: Rows,
    joints: Joints,
    masses: Masses,
    motion: Motion,
    start: Start,
    work: Work,
    r: int,
    length: wp.float64,
    tolerance: wp.float64,
    bound: wp.float64,
    sweeps: int,
):
    """Solves an island anew where its impulses have added more than a part of its energy."""
    part = part_of_energy(islands, work, r, length, tolerance)
    if part == wp.inf:
        return
    most = part * kinetic_energy(islands, masses, start, work.velocity, work.angular_momentum, r)
    if gain_of(islands, contacts, rows, masses, motion, start, work, r, length) <= most:
        return
    for rough in range(1, -1, -1):
        solve_where_they_are(
            islands, contacts, rows, joints, masses, motion, start, work, r, length, bound, sweeps, rough == 1
        )
        if gain_of(islands, contacts, rows, masses, motion, start, work, r, length) <= most:
            return


@wp.func
def gains_by_parting(
    islands: Islands,
    contacts: Contacts,
    rows: Rows,
    masses: Masses,
    motion: Motion,
    start: Start,
    work: Work,
    r: int,
    length: wp.float64,
    tolerance: wp.float64,
) -> bool:
    """Whether an island pushed apart ends with more energy than before its impulses: turned aside, a body spins
    about other axes with the same momentum."""
    part = part_of_energy(islands, work, r, length, tolerance)
    if part == wp.inf:
        return False
    after = wp.float64(0.0)
    for i in range(begin_of(islands.body_begin, r), islands.body_begin[r]):
        b = islands.body[i]
        momentum = motion.angular_momentum[b]
        turned = turn_freely(motion.orientation[b], momentum, masses.inertia_inverse[b], length)
        inverse = world_inverse(rotation_by(work.push_turn[b]) * turned, masses.inertia_inverse[b])
        after += HALF * (masses.mass[b] * wp.length_sq(motion.velocity[b]) + wp.dot(momentum, inverse * momentum))
    before = kinetic_energy(islands, masses, start, work.velocity, work.angular_momentum, r)
    given = given_by_animation(islands, contacts, rows, r, length)
    return after - given > (ONE + part) * before
