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
from plait.solver.rigid.joint_pose_kernels import vec6d
from plait.solver.rigid.motion_kernels import ZERO, Masses, Motion, rotation_by, turn_freely
from plait.solver.rigid.overlap_kernels import part_overlaps, put_back
from plait.solver.rigid.problem import Island, Problem, island_of
from plait.solver.rigid.row_kernels import (
    Work,
    begin_contact,
    contact_change,
    give,
    look_at_contact,
    solve_contact,
)
from plait.solver.rigid.sleep_kernels import lay_down, may_sleep, wake, watch
from plait.solver.rigid.types import Step

# Unrolled, the joints' loops over rows would be most of the code.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Impacts slower than what gravity gives in so many substeps do not rebound.
SLOW = wp.constant(wp.float64(2.0))


@wp.func
def sweep(p: Problem, at: Island) -> wp.float64:
    """Gauss and Seidel's, once over an island; the largest change of a speed [m/s]."""
    change = wp.float64(0.0)
    for i in range(at.joint_begin, at.joint_end):
        note_joint(p.joints, p.islands.joint[i])
    for i in range(at.contact_begin, at.contact_end):
        p.rows.held[p.islands.contact[i]] = p.rows.impulse[p.islands.contact[i]]
    for i in range(at.joint_begin, at.joint_end):
        j = p.islands.joint[i]
        change = wp.max(change, solve_joint(p.joints, p.masses, p.motion, p.start, p.work.spin, j))
    for i in range(at.contact_begin, at.contact_end):
        c = p.islands.contact[i]
        friction = p.contacts.friction[c]
        changed = solve_contact(p.contacts, p.rows, p.masses, p.motion, p.start, p.work, c, friction)
        change = wp.max(change, changed)
    p.work.sweeps[at.root] = p.work.sweeps[at.root] + 1
    return change


@wp.func
def changed_by(p: Problem, at: Island) -> wp.float64:
    """[J] a measure of what the last sweep has changed."""
    change = wp.float64(0.0)
    for i in range(at.joint_begin, at.joint_end):
        change += joint_change(p.joints, p.islands.joint[i])
    for i in range(at.contact_begin, at.contact_end):
        change += contact_change(p.rows, p.islands.contact[i])
    return change


@wp.func
def go_on(p: Problem, at: Island, part: wp.float64, fresh: bool):
    """Takes `part` of the way that the sweeps so far have gone once more; `fresh`: there is none yet."""
    for i in range(at.joint_begin, at.joint_end):
        j = p.islands.joint[i]
        if fresh:
            p.joints.ahead[j] = vec6d()
            p.joints.limit_ahead[j] = wp.vec2d()
        carry_joint_on(p.joints, p.masses, p.motion, p.start, p.work.spin, j, part)
    for i in range(at.contact_begin, at.contact_end):
        c = p.islands.contact[i]
        if fresh:
            p.rows.ahead[c] = wp.vec3d()
        ahead = part * p.rows.ahead[c]
        p.rows.ahead[c] = ahead + p.rows.impulse[c] - p.rows.held[c]
        if part > ZERO:
            p.rows.impulse[c] = p.rows.impulse[c] + ahead
            impulse = wp.transpose(p.rows.axes[c]) * ahead
            give(p.contacts, p.masses, p.motion, p.start, p.work, c, impulse)


@wp.func
def solve_linear(p: Problem, at: Island):
    """Sweeps over an island until no speed changes by more than the bound; notes what the last one changed.

    Between sweeps the impulses go on along conjugate directions, as Silcowitz-Hansen, Niebe and Erleben (2010)
    make them from what sweeps change: heavy things on light ones take Gauss and Seidel far too long.
    """
    before = wp.float64(0.0)
    for k in range(p.effort.sweeps):
        change = sweep(p, at)
        p.work.lack[at.root] = change
        if change <= at.bound or k == p.effort.sweeps - 1:
            break
        now = changed_by(p, at)
        part = wp.float64(0.0)
        if k > 0 and now < before:
            part = now / before
        go_on(p, at, part, k == 0)
        before = now


@wp.func
def begin(p: Problem, at: Island) -> wp.float64:
    """Rows of contacts and joints, and the impulses of the substep before given again; the bound of the solve."""
    step = p.step[0]
    fastest = at.length * wp.length(step.gravity)
    for i in range(at.body_begin, at.body_end):
        b = p.islands.body[i]
        p.work.spin[b] = p.start.inertia_inverse[b] * p.motion.angular_momentum[b]
        fastest = wp.max(fastest, wp.length(p.motion.velocity[b]))
    note_motion(p, at)
    for i in range(at.joint_begin, at.joint_end):
        j = p.islands.joint[i]
        begin_joint(p.joints, p.masses, p.motion, p.start, j, at.length, at.exit_distance)
        apply_rows(p.joints, p.masses, p.motion, p.start, p.work.spin, j, p.joints.impulse[j])
        p.joints.limit_impulse[j] = wp.vec2d()
    for i in range(at.contact_begin, at.contact_end):
        begin_contact(p.contacts, p.rows, p.masses, p.motion, p.start, p.work, p.islands.contact[i], step)
    return p.effort.tolerance * fastest


@wp.func
def look_ahead(p: Problem, at: Island) -> wp.float64:
    """Takes what turning adds anew; by how much that has changed [m/s], [1/s]."""
    for i in range(at.body_begin, at.body_end):
        b = p.islands.body[i]
        p.work.turned[b] = turn_freely(
            p.motion.orientation[b], p.motion.angular_momentum[b], p.masses.inertia_inverse[b], at.length
        )
    change = wp.float64(0.0)
    for i in range(at.contact_begin, at.contact_end):
        c = p.islands.contact[i]
        change = wp.max(change, look_at_contact(p.contacts, p.rows, p.motion, p.work, c, at.length))
    for i in range(at.joint_begin, at.joint_end):
        j = p.islands.joint[i]
        lack = look_at_joint(p.joints, p.motion, p.work.spin, p.work.turned, j, at.length, at.exit_distance)
        change = wp.max(change, lack)
    return change


@wp.func
def rebounds(p: Problem, at: Island) -> bool:
    """Whether a contact is an impact with restitution; it is then to part as fast as Newton's law says."""
    slow = SLOW * at.length * wp.length(p.step[0].gravity)
    some = wp.bool(False)
    for i in range(at.contact_begin, at.contact_end):
        c = p.islands.contact[i]
        if p.contacts.restitution[c] > ZERO and p.rows.impulse[c][0] > ZERO and p.rows.struck[c] < -slow:
            p.rows.least[c] = -p.contacts.restitution[c] * p.rows.struck[c]
            some = wp.bool(True)
    return some


@wp.func
def solve(p: Problem, at: Island):
    """The impulses of an island whose rows are begun."""
    # What turns far is held to first order before what turning adds is found: where a whole turn leads back to,
    # there would be nothing to hold.
    if turns_far(p, at):
        for i in range(at.joint_begin, at.joint_end):
            loosen_joint(p.joints, p.islands.joint[i])
        solve_linear(p, at)
    for k in range(p.effort.passes):
        change = look_ahead(p, at)
        if k > 0 and change <= at.bound:
            break
        solve_linear(p, at)
    if rebounds(p, at):
        solve_linear(p, at)
    hold_energy(p, at)


@wp.kernel
def solve_islands(first: int, p: Problem):
    """All of an island's impulses; one body an item, the island's own one works."""
    r = first + wp.tid()
    p.work.sweeps[r] = 0
    p.work.lack[r] = ZERO
    if p.islands.root[r] != r:
        return
    at = island_of(p, r)
    for i in range(at.body_begin, at.body_end):
        p.work.push[p.islands.body[i]] = wp.vec3d()
        p.work.push_turn[p.islands.body[i]] = wp.vec3d()
    if may_sleep(p.islands, p.contacts, p.motion, r):
        lay_down(p.islands, p.motion, r)
        return
    wake(p.islands, p.motion, r, at.length * p.step[0].gravity)
    if at.contact_begin == at.contact_end and at.joint_begin == at.joint_end:
        return
    at.bound = begin(p, at)
    solve(p, at)
    if part_overlaps(p, at):
        if gains_by_parting(p, at):
            put_back(p, at)
    for i in range(at.contact_begin, at.contact_end):
        c = p.islands.contact[i]
        p.contacts.impulse[c] = wp.transpose(p.rows.axes[c]) * p.rows.impulse[c]
    p.work.lack[r] = p.work.lack[r] / wp.max(at.bound, wp.float64(1e-300))


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
