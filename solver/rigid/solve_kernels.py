"""The impulses at contacts and joints of rigid bodies.

What a contact bounds is the way that its two places go against each other in the substep. It is linear in the
impulses up to what the turning over a finite step adds, which is found anew, at the impulses so far, until it no longer
changes. Each linear problem is solved by Gauss and Seidel's method with Coulomb's exact cone (Jean 1999), started from
the impulses of the substep before. Bodies that touch or are joined make an island, and each is one item: no result
depends on threads.
"""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.find_kernels import Contacts, Geoms, Start, Step
from plait.solver.rigid.joint_kernels import (
    Joints,
    apply_rows,
    begin_joint,
    carry_joint_on,
    joint_change,
    look_at_joint,
    note_joint,
    solve_joint,
    vec6d,
)
from plait.solver.rigid.motion_kernels import HALF, ONE, ZERO, Masses, Motion, rotation_by, turn_freely

wp.set_module_options({"enable_backward": False})

# Of an overlap so much is undone in a substep, where it is more than this part of a margin.
UNDONE = wp.constant(wp.float64(0.25))
SLOP = wp.constant(wp.float64(1e-4))
# Impacts slower than what gravity gives in so many substeps do not rebound.
SLOW = wp.constant(wp.float64(2.0))


@wp.struct
class Islands:
    """Bodies that touch each other or are joined, under the one of least index."""

    root: wp.array(dtype=wp.int32)  # (body_count,)
    body_begin: wp.array(dtype=wp.int32)  # (body_count + 1,), by root
    body: wp.array(dtype=wp.int32)
    contact_begin: wp.array(dtype=wp.int32)
    contact: wp.array(dtype=wp.int32)
    joint_begin: wp.array(dtype=wp.int32)
    joint: wp.array(dtype=wp.int32)


@wp.struct
class Rows:
    """Contacts' rows along the normal and two tangents; entries as those of `Contacts`."""

    axes: wp.array(dtype=wp.mat33d)  # rows: normal, tangents
    response: wp.array(dtype=wp.vec4d)  # [1/kg] of the normal; of the tangents xx, xy, yy
    bias: wp.array(dtype=wp.vec3d)  # [m/s] what turning adds, and animated surfaces; world
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] along the rows
    held: wp.array(dtype=wp.vec3d)  # the same before the last sweep, and how it goes on
    ahead: wp.array(dtype=wp.vec3d)
    least: wp.array(dtype=wp.float64)  # [m/s] bound of the normal speed
    struck: wp.array(dtype=wp.float64)  # [m/s] normal speed before the substep
    push: wp.array(dtype=wp.float64)  # [kg m] of the position pass


@wp.struct
class Work:
    """Of bodies in a substep."""

    spin: wp.array(dtype=wp.vec3d)  # [1/s] with the inertia of the start
    turned: wp.array(dtype=wp.quatd)  # the orientation at the end
    push: wp.array(dtype=wp.vec3d)  # [m] by which overlaps part
    push_turn: wp.array(dtype=wp.vec3d)  # [rad]
    sweeps: wp.array(dtype=wp.int32)  # of the island, by root
    lack: wp.array(dtype=wp.float64)  # [m/s] by which the last sweep still changed a speed, over what was asked


@wp.struct
class Effort:
    """How exactly to solve."""

    tolerance: wp.float64  # part of the speeds
    sweeps: int
    passes: int
    exit_speed: wp.float64  # [m/s]


@wp.func
def find_root(root: wp.array(dtype=wp.int32), b: int) -> int:
    r = b
    while root[r] != r:
        root[r] = root[root[r]]
        r = root[r]
    return r


@wp.func
def unite(root: wp.array(dtype=wp.int32), a: int, b: int):
    p = find_root(root, a)
    q = find_root(root, b)
    if p < q:
        root[q] = p
    else:
        root[p] = q


@wp.func
def one_of(pair: wp.vec2i) -> int:
    return wp.where(pair[0] >= 0, pair[0], pair[1])


@wp.func
def sum_up(begin: wp.array(dtype=wp.int32), count: int):
    """Counts at their own places plus one become where each run begins, one place on; see `take_place`."""
    total = wp.int32(0)
    for b in range(count + 1):
        here = begin[b]
        begin[b] = total
        total += here


@wp.kernel
def find_islands(
    first: int,
    geoms: Geoms,
    contacts: Contacts,
    joints: Joints,
    joint_count: int,
    body_count: int,
    islands: Islands,
):
    """One item in all: passes over bodies, contacts and joints that are short beside the solve."""
    if first + wp.tid() > 0:
        return
    root = islands.root
    for b in range(body_count):
        root[b] = b
        islands.body_begin[b] = 0
        islands.contact_begin[b] = 0
        islands.joint_begin[b] = 0
    islands.body_begin[body_count] = 0
    islands.contact_begin[body_count] = 0
    islands.joint_begin[body_count] = 0
    for a in range(geoms.count):
        for k in range(geoms.first_slot[a], geoms.first_slot[a] + contacts.count[a]):
            pair = contacts.body[k]
            if pair[0] >= 0 and pair[1] >= 0:
                unite(root, pair[0], pair[1])
    for j in range(joint_count):
        if joints.body[j][0] >= 0 and joints.body[j][1] >= 0:
            unite(root, joints.body[j][0], joints.body[j][1])
    for b in range(body_count):
        root[b] = find_root(root, b)
        islands.body_begin[root[b]] += 1
    for a in range(geoms.count):
        for k in range(geoms.first_slot[a], geoms.first_slot[a] + contacts.count[a]):
            islands.contact_begin[root[one_of(contacts.body[k])]] += 1
    for j in range(joint_count):
        islands.joint_begin[root[one_of(joints.body[j])]] += 1
    sum_up(islands.body_begin, body_count)
    sum_up(islands.contact_begin, body_count)
    sum_up(islands.joint_begin, body_count)
    # Each run is filled from its beginning, which moves on to its end: the beginning of the next.
    for b in range(body_count):
        at = islands.body_begin[root[b]]
        islands.body[at] = b
        islands.body_begin[root[b]] = at + 1
    for a in range(geoms.count):
        for k in range(geoms.first_slot[a], geoms.first_slot[a] + contacts.count[a]):
            r = root[one_of(contacts.body[k])]
            at = islands.contact_begin[r]
            islands.contact[at] = k
            islands.contact_begin[r] = at + 1
    for j in range(joint_count):
        r = root[one_of(joints.body[j])]
        at = islands.joint_begin[r]
        islands.joint[at] = j
        islands.joint_begin[r] = at + 1


@wp.func
def begin_of(end: wp.array(dtype=wp.int32), r: int) -> int:
    """Where a run begins: where the one before it ends."""
    if r == 0:
        return 0
    return end[r - 1]


@wp.func
def angular_response(start: Start, b: int, lever: wp.vec3d, way: wp.vec3d) -> wp.vec3d:
    return wp.cross(start.inertia_inverse[b] * wp.cross(lever, way), lever)


@wp.func
def respond(contacts: Contacts, masses: Masses, start: Start, c: int, way: wp.vec3d) -> wp.vec3d:
    """[1/kg] the relative velocity that a unit impulse gives."""
    pair = contacts.body[c]
    out = wp.vec3d()
    if pair[0] >= 0:
        out += way / masses.mass[pair[0]] + angular_response(start, pair[0], contacts.lever_a[c], way)
    if pair[1] >= 0:
        out += way / masses.mass[pair[1]] + angular_response(start, pair[1], contacts.lever_b[c], way)
    return out


@wp.func
def relative_velocity(
    contacts: Contacts, c: int, velocity: wp.array(dtype=wp.vec3d), spin: wp.array(dtype=wp.vec3d)
) -> wp.vec3d:
    """Of the bodies' places where the impulse acts, a against b."""
    pair = contacts.body[c]
    u = wp.vec3d()
    if pair[0] >= 0:
        u += velocity[pair[0]] + wp.cross(spin[pair[0]], contacts.lever_a[c])
    if pair[1] >= 0:
        u -= velocity[pair[1]] + wp.cross(spin[pair[1]], contacts.lever_b[c])
    return u


@wp.func
def way_of(b: int, core: wp.vec3d, arm: wp.vec3d, motion: Motion, work: Work, length: wp.float64) -> wp.vec3d:
    """[m] that one side's place goes in the substep."""
    if b < 0:
        return core
    turned = wp.quat_rotate(work.turned[b], core) - wp.quat_rotate(motion.orientation[b], core)
    return length * (motion.velocity[b] + wp.cross(work.spin[b], arm)) + turned


@wp.func
def give(contacts: Contacts, masses: Masses, motion: Motion, start: Start, work: Work, c: int, impulse: wp.vec3d):
    """An impulse on a, its opposite on b."""
    pair = contacts.body[c]
    if pair[0] >= 0:
        moment = wp.cross(contacts.lever_a[c], impulse)
        motion.velocity[pair[0]] = motion.velocity[pair[0]] + impulse / masses.mass[pair[0]]
        motion.angular_momentum[pair[0]] = motion.angular_momentum[pair[0]] + moment
        work.spin[pair[0]] = work.spin[pair[0]] + start.inertia_inverse[pair[0]] * moment
    if pair[1] >= 0:
        moment = wp.cross(contacts.lever_b[c], impulse)
        motion.velocity[pair[1]] = motion.velocity[pair[1]] - impulse / masses.mass[pair[1]]
        motion.angular_momentum[pair[1]] = motion.angular_momentum[pair[1]] - moment
        work.spin[pair[1]] = work.spin[pair[1]] - start.inertia_inverse[pair[1]] * moment


@wp.func
def begin_contact(
    contacts: Contacts, rows: Rows, masses: Masses, motion: Motion, start: Start, work: Work, c: int, step: Step
):
    """Axes, response and bounds; the impulse of the substep before is given again."""
    n = contacts.normal[c]
    other = wp.vec3d(ONE, ZERO, ZERO)
    if wp.abs(n[0]) > wp.float64(0.7):
        other = wp.vec3d(ZERO, ONE, ZERO)
    s = wp.normalize(wp.cross(n, other))
    t = wp.cross(n, s)
    axes = wp.matrix_from_rows(n, s, t)
    rows.axes[c] = axes
    of_n = respond(contacts, masses, start, c, n)
    of_s = respond(contacts, masses, start, c, s)
    of_t = respond(contacts, masses, start, c, t)
    rows.response[c] = wp.vec4d(wp.dot(n, of_n), wp.dot(s, of_s), wp.dot(s, of_t), wp.dot(t, of_t))
    gap = contacts.gap[c]
    rows.least[c] = wp.min(-gap / step.length, ZERO)
    carried = wp.vec3d()
    if contacts.body[c][0] < 0:
        carried += contacts.core_a[c] / step.length
    if contacts.body[c][1] < 0:
        carried -= contacts.core_b[c] / step.length
    rows.struck[c] = wp.dot(n, relative_velocity(contacts, c, start.velocity, start.spin) + carried)
    impulse = axes * contacts.impulse[c]
    impulse = wp.vec3d(wp.max(impulse[0], ZERO), impulse[1], impulse[2])
    rows.impulse[c] = impulse
    rows.bias[c] = wp.vec3d()
    give(contacts, masses, motion, start, work, c, wp.transpose(axes) * impulse)


@wp.func
def look_at_contact(
    contacts: Contacts, rows: Rows, motion: Motion, work: Work, c: int, length: wp.float64
) -> wp.float64:
    """Takes what turning adds anew; by how much that has changed [m/s], where the contact acts."""
    pair = contacts.body[c]
    way = way_of(pair[0], contacts.core_a[c], contacts.arm_a[c], motion, work, length)
    way -= way_of(pair[1], contacts.core_b[c], contacts.arm_b[c], motion, work, length)
    bias = way / length - relative_velocity(contacts, c, motion.velocity, work.spin)
    change = wp.length(bias - rows.bias[c])
    rows.bias[c] = bias
    if rows.impulse[c][0] == ZERO and wp.dot(contacts.normal[c], way) / length >= rows.least[c]:
        return ZERO
    return change


@wp.func
def within(cone: wp.float64, x: wp.float64, y: wp.float64) -> wp.vec2d:
    size = wp.sqrt(x * x + y * y)
    if size <= cone:
        return wp.vec2d(x, y)
    return (cone / size) * wp.vec2d(x, y)


@wp.func
def solve_contact(
    contacts: Contacts, rows: Rows, masses: Masses, motion: Motion, start: Start, work: Work, c: int
) -> wp.float64:
    """One contact of a sweep; the largest change of a speed [m/s]."""
    axes = rows.axes[c]
    k = rows.response[c]
    held = rows.impulse[c]
    u = axes * (relative_velocity(contacts, c, motion.velocity, work.spin) + rows.bias[c])
    normal = wp.max(held[0] - (u[0] - rows.least[c]) / k[0], ZERO)
    if normal == ZERO and held[0] == ZERO:
        return ZERO
    change_n = normal - held[0]
    # Friction sees the normal impulse as it now is, and what that does across.
    if change_n != ZERO:
        give(contacts, masses, motion, start, work, c, change_n * contacts.normal[c])
        u = axes * (relative_velocity(contacts, c, motion.velocity, work.spin) + rows.bias[c])
    cone = contacts.friction[c] * normal
    det = k[1] * k[3] - k[2] * k[2]
    x = held[1] - (k[3] * u[1] - k[2] * u[2]) / det
    y = held[2] - (k[1] * u[2] - k[2] * u[1]) / det
    across = wp.vec2d(x, y)
    if x * x + y * y > cone * cone:
        # Towards the cone by a step that every direction takes alike: where it ends, friction opposes slip exactly.
        half = HALF * (k[1] - k[3])
        most = HALF * (k[1] + k[3]) + wp.sqrt(half * half + k[2] * k[2])
        across = within(cone, held[1] - u[1] / most, held[2] - u[2] / most)
    change = wp.vec3d(ZERO, across[0] - held[1], across[1] - held[2])
    rows.impulse[c] = wp.vec3d(normal, across[0], across[1])
    give(contacts, masses, motion, start, work, c, wp.transpose(axes) * change)
    return wp.max(wp.abs(change_n) * k[0], wp.length(change) * wp.max(k[1], k[3]))


@wp.func
def contact_change(rows: Rows, c: int) -> wp.float64:
    """[J] a measure of what a sweep has changed: the impulse's change squared, by its response."""
    change = rows.impulse[c] - rows.held[c]
    k = rows.response[c]
    return change[0] * change[0] * k[0] + change[1] * change[1] * k[1] + change[2] * change[2] * k[3]


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

    Between sweeps the impulses go on along conjugate directions, as Silcowitz-Hansen, Niebe and Erleben (2010) make
    them from what sweeps change: heavy things on light ones take Gauss and Seidel far too long.
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
            change = wp.max(change, solve_contact(contacts, rows, masses, motion, start, work, c))
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


@wp.func
def part_overlaps(
    islands: Islands,
    contacts: Contacts,
    rows: Rows,
    geoms: Geoms,
    masses: Masses,
    start: Start,
    motion: Motion,
    work: Work,
    r: int,
    step: Step,
    effort: Effort,
):
    """Moves what overlaps apart: a position pass without friction, which gives no velocity."""
    begin = begin_of(islands.contact_begin, r)
    end = islands.contact_begin[r]
    deep = wp.int32(0)
    for i in range(begin, end):
        c = islands.contact[i]
        u = relative_velocity(contacts, c, motion.velocity, work.spin) + rows.bias[c]
        left = contacts.gap[c] + step.length * wp.dot(contacts.normal[c], u)
        rows.push[c] = ZERO
        rows.struck[c] = left
        pair = contacts.body[c]
        margin = geoms.margin[contacts.geom[c]]
        if pair[0] >= 0 and left < -SLOP * margin:
            deep = wp.int32(1)
        if pair[0] < 0 and left < -SLOP * margin:
            deep = wp.int32(1)
    if deep == 0:
        return
    for _ in range(effort.sweeps):
        most = ZERO
        for i in range(begin, end):
            c = islands.contact[i]
            left = rows.struck[c]
            least = -left
            if left < ZERO:
                least = wp.min(-UNDONE * left, effort.exit_speed * step.length)
            n = contacts.normal[c]
            gained = wp.dot(n, relative_velocity(contacts, c, work.push, work.push_turn))
            now = wp.max(rows.push[c] - (gained - least) / rows.response[c][0], ZERO)
            change = now - rows.push[c]
            if change != ZERO:
                rows.push[c] = now
                most = wp.max(most, wp.abs(change) * rows.response[c][0])
                pair = contacts.body[c]
                if pair[0] >= 0:
                    turn = start.inertia_inverse[pair[0]] * wp.cross(contacts.lever_a[c], change * n)
                    work.push[pair[0]] = work.push[pair[0]] + change / masses.mass[pair[0]] * n
                    work.push_turn[pair[0]] = work.push_turn[pair[0]] + turn
                if pair[1] >= 0:
                    turn = start.inertia_inverse[pair[1]] * wp.cross(contacts.lever_b[c], change * n)
                    work.push[pair[1]] = work.push[pair[1]] - change / masses.mass[pair[1]] * n
                    work.push_turn[pair[1]] = work.push_turn[pair[1]] - turn
        if most <= wp.float64(1e-3) * effort.exit_speed * step.length:
            break
    # Bodies that move have changed their moment of momentum by this: their spins take it back.
    for i in range(begin, end):
        c = islands.contact[i]
        pair = contacts.body[c]
        if rows.push[c] > ZERO and pair[0] >= 0 and pair[1] >= 0:
            between = motion.velocity[pair[0]] - motion.velocity[pair[1]]
            half = HALF * rows.push[c] * wp.cross(contacts.normal[c], between)
            motion.angular_momentum[pair[0]] = motion.angular_momentum[pair[0]] - half
            motion.angular_momentum[pair[1]] = motion.angular_momentum[pair[1]] - half


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
    if islands.root[r] != r:
        return
    work.sweeps[r] = 0
    work.lack[r] = ZERO
    body_begin = begin_of(islands.body_begin, r)
    body_end = islands.body_begin[r]
    for i in range(body_begin, body_end):
        b = islands.body[i]
        work.push[b] = wp.vec3d()
        work.push_turn[b] = wp.vec3d()
    contact_begin = begin_of(islands.contact_begin, r)
    contact_end = islands.contact_begin[r]
    joint_begin = begin_of(islands.joint_begin, r)
    joint_end = islands.joint_begin[r]
    if contact_begin == contact_end and joint_begin == joint_end:
        return
    step = step_at[0]
    length = step.length
    exit_distance = effort.exit_speed * length
    fastest = length * wp.length(step.gravity)
    for i in range(body_begin, body_end):
        b = islands.body[i]
        work.spin[b] = start.inertia_inverse[b] * motion.angular_momentum[b]
        fastest = wp.max(fastest, wp.length(motion.velocity[b]))
    bound = effort.tolerance * fastest
    for i in range(joint_begin, joint_end):
        j = islands.joint[i]
        begin_joint(joints, masses, motion, start, j, exit_distance)
        apply_rows(joints, masses, motion, start, work.spin, j, joints.impulse[j])
        joints.limit_impulse[j] = wp.vec2d()
    for i in range(contact_begin, contact_end):
        begin_contact(contacts, rows, masses, motion, start, work, islands.contact[i], step)
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
    part_overlaps(islands, contacts, rows, geoms, masses, start, motion, work, r, step, effort)
    for i in range(contact_begin, contact_end):
        c = islands.contact[i]
        contacts.impulse[c] = wp.transpose(rows.axes[c]) * rows.impulse[c]
    work.lack[r] = work.lack[r] / wp.max(bound, wp.float64(1e-300))


@wp.kernel
def advance_bodies(first: int, step: wp.array(dtype=Step), masses: Masses, motion: Motion, work: Work):
    """Poses at the substep's end, one body an item."""
    b = first + wp.tid()
    length = step[0].length
    turned = turn_freely(motion.orientation[b], motion.angular_momentum[b], masses.inertia_inverse[b], length)
    motion.position[b] = motion.position[b] + length * motion.velocity[b] + work.push[b]
    motion.orientation[b] = wp.normalize(rotation_by(work.push_turn[b]) * turned)
