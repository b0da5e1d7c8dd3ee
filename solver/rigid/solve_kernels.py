"""The impulses at contacts and joints of rigid bodies.

What a contact bounds is the way that its two places go against each other in the substep. It is linear in the
impulses up to what the turning over a finite step adds, which is found anew, at the impulses so far, until it no
longer changes. Each linear problem is solved by Gauss and Seidel's method with Coulomb's exact cone (Jean 1999),
started from the impulses of the substep before. Bodies that touch or are joined make an island, and each is one
item: no result depends on threads.
"""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.energy_kernels import gains_by_parting, hold_energy, note_motion, turns_far
from plait.solver.rigid.island_kernels import Islands, begin_of
from plait.solver.rigid.joint_kernels import (
    apply_rows,
    begin_joint,
    carry_joint_on,
    joint_change,
    look_at_joint,
    loosen_joint,
    note_joint,
    solve_joint,
)
from plait.solver.rigid.joint_pose_kernels import Joints, vec6d
from plait.solver.rigid.motion_kernels import ZERO, Masses, Motion, rotation_by, turn_freely
from plait.solver.rigid.overlap_kernels import Effort, part_overlaps, put_back
from plait.solver.rigid.row_kernels import (
    Rows,
    Work,
    begin_contact,
    contact_change,
    give,
    look_at_contact,
    solve_contact,
)
from plait.solver.rigid.sleep_kernels import lay_down, may_sleep, wake, watch
from plait.solver.rigid.types import Contacts, Geoms, Start, Step

# Unrolled, the joints' loops over rows would be most of the code.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Impacts slower than what gravity gives in so many substeps do not rebound.
SLOW = wp.constant(wp.float64(2.0))


@wp.func
def sweep_until(
    islands: Islands,
    contacts: Contacts,
    rows: Rows,
    joints: Joints,
    masses: Masses,
    motion: Motion,
    start: Start,
    work: Work,
    r: int,
    bound: wp.float64,
    sweeps: int,
) -> wp.float64:
    """Sweeps over an island until no speed changes by more than `bound` [m/s]; what the last one changed.

    Between sweeps the impulses go on along conjugate directions, as Silcowitz-Hansen, Niebe and Erleben (2010)
    make them from what sweeps change: heavy things on light ones take Gauss and Seidel far too long.
    """
    contact_begin = begin_of(islands.contact_begin, r)
    contact_end = islands.contact_begin[r]
    joint_begin = begin_of(islands.joint_begin, r)
    joint_end = islands.joint_begin[r]
    change = ZERO
    before = ZERO
    for sweep in range(sweeps):
        change = ZERO
        for i in range(joint_begin, joint_end):
            note_joint(joints, islands.joint[i])
        for i in range(contact_begin, contact_end):
            rows.held[islands.contact[i]] = rows.impulse[islands.contact[i]]
        for i in range(joint_begin, joint_end):
            change = wp.max(change, solve_joint(joints, masses, motion, start, work.spin, islands.joint[i]))
        for i in range(contact_begin, contact_end):
            c = islands.contact[i]
            friction = contacts.friction[c]
            change = wp.max(change, solve_contact(contacts, rows, masses, motion, start, work, c, friction))
        work.sweeps[r] = work.sweeps[r] + 1
        if change <= bound or sweep == sweeps - 1:
            break
        now = ZERO
        for i in range(joint_begin, joint_end):
            now += joint_change(joints, islands.joint[i])
        for i in range(contact_begin, contact_end):
            now += contact_change(rows, islands.contact[i])
        part = ZERO
        if sweep > 0 and now < before:
            part = now / before
        for i in range(joint_begin, joint_end):
            if sweep == 0:
                joints.ahead[islands.joint[i]] = vec6d()
                joints.limit_ahead[islands.joint[i]] = wp.vec2d()
            carry_joint_on(joints, masses, motion, start, work.spin, islands.joint[i], part)
        for i in range(contact_begin, contact_end):
            c = islands.contact[i]
            if sweep == 0:
                rows.ahead[c] = wp.vec3d()
            ahead = part * rows.ahead[c]
            rows.ahead[c] = ahead + rows.impulse[c] - rows.held[c]
            if part > ZERO:
                rows.impulse[c] = rows.impulse[c] + ahead
                give(contacts, masses, motion, start, work, c, wp.transpose(rows.axes[c]) * ahead)
        before = now
    return change


@wp.kernel
def solve_islands(
    first: int,
    step_at: wp.array(dtype=Step),
    effort: Effort,
    geoms: Geoms,
    islands: Islands,
    contacts: Contacts,
    rows: Rows,
    joints: Joints,
    masses: Masses,
    motion: Motion,
    start: Start,
    work: Work,
):
    """All of an island's impulses; one body an item, the island's own one works."""
    r = first + wp.tid()
    work.sweeps[r] = 0
    work.lack[r] = ZERO
    if islands.root[r] != r:
        return
    body_begin = begin_of(islands.body_begin, r)
    body_end = islands.body_begin[r]
    for i in range(body_begin, body_end):
        b = islands.body[i]
        work.push[b] = wp.vec3d()
        work.push_turn[b] = wp.vec3d()
    step = step_at[0]
    if may_sleep(islands, contacts, motion, r):
        lay_down(islands, motion, r)
        return
    wake(islands, motion, r, step.length * step.gravity)
    contact_begin = begin_of(islands.contact_begin, r)
    contact_end = islands.contact_begin[r]
    joint_begin = begin_of(islands.joint_begin, r)
    joint_end = islands.joint_begin[r]
    if contact_begin == contact_end and joint_begin == joint_end:
        return
    length = step.length
    exit_distance = effort.exit_speed * length
    fastest = length * wp.length(step.gravity)
    for i in range(body_begin, body_end):
        b = islands.body[i]
        work.spin[b] = start.inertia_inverse[b] * motion.angular_momentum[b]
        fastest = wp.max(fastest, wp.length(motion.velocity[b]))
    bound = effort.tolerance * fastest
    note_motion(islands, motion, work, r)
    for i in range(joint_begin, joint_end):
        j = islands.joint[i]
        begin_joint(joints, masses, motion, start, j, length, exit_distance)
        apply_rows(joints, masses, motion, start, work.spin, j, joints.impulse[j])
        joints.limit_impulse[j] = wp.vec2d()
    for i in range(contact_begin, contact_end):
        begin_contact(contacts, rows, masses, motion, start, work, islands.contact[i], step)
    # What turns far is held to first order before what turning adds is found: where a whole turn leads back to,
    # there would be nothing to hold.
    if turns_far(islands, work, r, length):
        for i in range(joint_begin, joint_end):
            loosen_joint(joints, islands.joint[i])
        work.lack[r] = sweep_until(
            islands, contacts, rows, joints, masses, motion, start, work, r, bound, effort.sweeps
        )
    for k in range(effort.passes):
        for i in range(body_begin, body_end):
            b = islands.body[i]
            work.turned[b] = turn_freely(
                motion.orientation[b], motion.angular_momentum[b], masses.inertia_inverse[b], length
            )
        change = ZERO
        for i in range(contact_begin, contact_end):
            change = wp.max(change, look_at_contact(contacts, rows, motion, work, islands.contact[i], length))
        for i in range(joint_begin, joint_end):
            j = islands.joint[i]
            change = wp.max(
                change, look_at_joint(joints, motion, work.spin, work.turned, j, length, exit_distance)
            )
        if k > 0 and change <= bound:
            break
        work.lack[r] = sweep_until(
            islands, contacts, rows, joints, masses, motion, start, work, r, bound, effort.sweeps
        )
    rebounds = wp.int32(0)
    slow = SLOW * length * wp.length(step.gravity)
    for i in range(contact_begin, contact_end):
        c = islands.contact[i]
        if contacts.restitution[c] > ZERO and rows.impulse[c][0] > ZERO and rows.struck[c] < -slow:
            rows.least[c] = -contacts.restitution[c] * rows.struck[c]
            rebounds = wp.int32(1)
    if rebounds == 1:
        work.lack[r] = sweep_until(
            islands, contacts, rows, joints, masses, motion, start, work, r, bound, effort.sweeps
        )
    hold_energy(
        islands,
        contacts,
        rows,
        joints,
        masses,
        motion,
        start,
        work,
        r,
        length,
        effort.tolerance,
        bound,
        effort.sweeps,
    )
    if part_overlaps(islands, contacts, rows, geoms, masses, start, motion, work, r, step, effort):
        if gains_by_parting(islands, contacts, rows, masses, motion, start, work, r, length, effort.tolerance):
            put_back(islands, contacts, rows, motion, work, r)
    for i in range(contact_begin, contact_end):
        c = islands.contact[i]
        contacts.impulse[c] = wp.transpose(rows.axes[c]) * rows.impulse[c]
    work.lack[r] = work.lack[r] / wp.max(bound, wp.float64(1e-300))


@wp.kernel
def advance_bodies(first: int, step: wp.array(dtype=Step), masses: Masses, motion: Motion, work: Work):
    """Poses at the substep's end, one body an item."""
    b = first + wp.tid()
    if motion.asleep[b] == 1:
        return
    length = step[0].length
    turned = turn_freely(motion.orientation[b], motion.angular_momentum[b], masses.inertia_inverse[b], length)
    motion.position[b] = motion.position[b] + length * motion.velocity[b] + work.push[b]
    motion.orientation[b] = wp.normalize(rotation_by(work.push_turn[b]) * turned)
    watch(motion, masses, b, length)
