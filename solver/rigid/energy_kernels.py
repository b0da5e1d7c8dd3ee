"""What keeps an island's bodies from getting energy that nothing gave them.

Impulses that answer to where a substep leads may add some: what turns far in it would end inside its neighbour,
and is thrown off by far more than it came with. By the work that an impulse does, J . (u before + u after) / 2,
inelastic contacts with Coulomb friction gain nothing where their places are at the start. So where there is a
gain, they are solved anew for that, and what then overlaps is parted by positions alone.
"""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.joint_kernels import solve_joint, take_joint_where_it_is
from plait.solver.rigid.motion_kernels import HALF, ZERO, rotation_by, turn_freely, world_inverse
from plait.solver.rigid.problem import Island, Problem
from plait.solver.rigid.row_kernels import carried_by, solve_contact

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(wp.float64(0.5))  # [rad]
MUCH = wp.constant(wp.float64(0.1))  # part of the energy


@wp.func
def note_motion(p: Problem, at: Island):
    """As it is before the impulses."""
    for i in range(at.body_begin, at.body_end):
        b = p.islands.body[i]
        p.work.velocity[b] = p.motion.velocity[b]
        p.work.angular_momentum[b] = p.motion.angular_momentum[b]


@wp.func
def turns_far(p: Problem, at: Island) -> bool:
    """Whether a body of an island would turn far in the substep."""
    fastest = wp.float64(0.0)
    for i in range(at.body_begin, at.body_end):
        fastest = wp.max(fastest, wp.length(p.work.spin[p.islands.body[i]]))
    return at.length * fastest > FAR


@wp.func
def kinetic_energy(
    p: Problem, at: Island, velocity: wp.array(dtype=wp.vec3d), angular_momentum: wp.array(dtype=wp.vec3d)
) -> wp.float64:
    """[J] of an island's bodies with these velocities and momenta, where they are."""
    energy = wp.float64(0.0)
    for i in range(at.body_begin, at.body_end):
        b = p.islands.body[i]
        spin = p.start.inertia_inverse[b] * angular_momentum[b]
        energy += HALF * (p.masses.mass[b] * wp.length_sq(velocity[b]) + wp.dot(angular_momentum[b], spin))
    return energy


@wp.func
def given_energy(p: Problem, at: Island) -> wp.float64:
    """[J] what an island had before the impulses, and by the work of what the animation moves."""
    given = kinetic_energy(p, at, p.work.velocity, p.work.angular_momentum)
    for i in range(at.contact_begin, at.contact_end):
        c = p.islands.contact[i]
        impulse = wp.transpose(p.rows.axes[c]) * p.rows.impulse[c]
        given -= wp.dot(impulse, carried_by(p.contacts, c, at.length))
    return given


@wp.func
def solve_where_they_are(p: Problem, at: Island, rough: bool) -> wp.float64:
    """An island's contacts and joints anew, without impulses to begin with nor what turning adds.

    rough: with friction. Without, every step takes energy, so that sweeps may end anywhere. Returns what the last
    one changed.
    """
    for i in range(at.body_begin, at.body_end):
        b = p.islands.body[i]
        p.motion.velocity[b] = p.work.velocity[b]
        p.motion.angular_momentum[b] = p.work.angular_momentum[b]
        p.work.spin[b] = p.start.inertia_inverse[b] * p.motion.angular_momentum[b]
    for i in range(at.contact_begin, at.contact_end):
        c = p.islands.contact[i]
        p.rows.impulse[c] = wp.vec3d()
        p.rows.bias[c] = carried_by(p.contacts, c, at.length)
        p.rows.least[c] = wp.min(-p.contacts.gap[c] / at.length, ZERO)
    for i in range(at.joint_begin, at.joint_end):
        take_joint_where_it_is(p.joints, p.motion, p.islands.joint[i], at.length)
    change = wp.float64(0.0)
    for _ in range(p.effort.sweeps):
        change = wp.float64(0.0)
        for i in range(at.joint_begin, at.joint_end):
            j = p.islands.joint[i]
            change = wp.max(change, solve_joint(p.joints, p.masses, p.motion, p.start, p.work.spin, j))
        for i in range(at.contact_begin, at.contact_end):
            c = p.islands.contact[i]
            friction = wp.where(rough, p.contacts.friction[c], ZERO)
            changed = solve_contact(p.contacts, p.rows, p.masses, p.motion, p.start, p.work, c, friction)
            change = wp.max(change, changed)
        if change <= at.bound:
            break
    return change


@wp.func
def part_of_energy(p: Problem, at: Island) -> wp.float64:
    """By which part of its energy an island's impulses, and what parts its overlaps, may add to it.

    Joints give and take while they keep their places exactly, the more the further they turn, and drives and what
    the animation moves do work: with them only much is too much, and where they turn far.
    """
    if at.joint_begin == at.joint_end:
        return p.effort.tolerance
    if turns_far(p, at):
        return MUCH
    return wp.float64(wp.inf)


@wp.func
def hold_energy(p: Problem, at: Island):
    """Solves an island anew where its impulses have added more than a part of its energy."""
    part = part_of_energy(p, at)
    if part == wp.inf:
        return
    most = part * kinetic_energy(p, at, p.work.velocity, p.work.angular_momentum)
    for rough in range(1, -1, -1):
        after = kinetic_energy(p, at, p.motion.velocity, p.motion.angular_momentum)
        if after - given_energy(p, at) <= most:
            return
        p.work.lack[at.root] = solve_where_they_are(p, at, rough == 1)


@wp.func
def gains_by_parting(p: Problem, at: Island) -> bool:
    """Whether an island pushed apart ends with more energy than it was given.

    Turned aside, a body spins about other axes with the same momentum.
    """
    part = part_of_energy(p, at)
    if part == wp.inf:
        return False
    after = wp.float64(0.0)
    for i in range(at.body_begin, at.body_end):
        b = p.islands.body[i]
        inverse = p.masses.inertia_inverse[b]
        momentum = p.motion.angular_momentum[b]
        turned = turn_freely(p.motion.orientation[b], momentum, inverse, at.length)
        spin = world_inverse(rotation_by(p.work.push_turn[b]) * turned, inverse) * momentum
        after += HALF * (p.masses.mass[b] * wp.length_sq(p.motion.velocity[b]) + wp.dot(momentum, spin))
    before = kinetic_energy(p, at, p.work.velocity, p.work.angular_momentum)
    return after - given_energy(p, at) > part * before
