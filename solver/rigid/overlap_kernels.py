"""What overlaps is parted: positions alone."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.island_kernels import Islands, begin_of
from plait.solver.rigid.motion_kernels import HALF, ONE, ZERO, Masses, Motion
from plait.solver.rigid.row_kernels import Rows, Work, relative_velocity
from plait.solver.rigid.types import Contacts, Geoms, Start, Step

wp.set_module_options({"enable_backward": False})

# Of an overlap so much is undone in a substep, where it is more than this part of a margin.
UNDONE = wp.constant(wp.float64(0.25))
SLOP = wp.constant(wp.float64(1e-4))


@wp.struct
class Effort:
    """How exactly to solve."""

    tolerance: wp.float64  # part of the speeds
    sweeps: int
    passes: int
    exit_speed: wp.float64  # [m/s]


@wp.func
def measure_overlaps(
    islands: Islands,
    contacts: Contacts,
    rows: Rows,
    geoms: Geoms,
    motion: Motion,
    work: Work,
    r: int,
    length: wp.float64,
) -> bool:
    """Notes in `struck` how far apart an island's contacts are left [m]; whether any overlaps."""
    deep = wp.bool(False)
    for i in range(begin_of(islands.contact_begin, r), islands.contact_begin[r]):
        c = islands.contact[i]
        u = relative_velocity(contacts, c, motion.velocity, work.spin) + rows.bias[c]
        left = contacts.gap[c] + length * wp.dot(contacts.normal[c], u)
        rows.push[c] = ZERO
        rows.struck[c] = left
        if left < -SLOP * geoms.margin[contacts.geom[c]]:
            deep = wp.bool(True)
    return deep


@wp.func
def push_apart(
    contacts: Contacts, rows: Rows, masses: Masses, start: Start, work: Work, c: int, exit_distance: wp.float64
) -> wp.float64:
    """One contact of a sweep of the position pass; the change [m]."""
    left = rows.struck[c]
    least = -left
    if left < ZERO:
        least = wp.min(-UNDONE * left, exit_distance)
    n = contacts.normal[c]
    gained = wp.dot(n, relative_velocity(contacts, c, work.push, work.push_turn))
    now = wp.max(rows.push[c] - (gained - least) / rows.response[c][0], ZERO)
    change = now - rows.push[c]
    rows.push[c] = now
    if change != ZERO:
        pair = contacts.body[c]
        if pair[0] >= 0:
            turn = start.inertia_inverse[pair[0]] * wp.cross(contacts.lever_a[c], change * n)
            work.push[pair[0]] = work.push[pair[0]] + change / masses.mass[pair[0]] * n
            work.push_turn[pair[0]] = work.push_turn[pair[0]] + turn
        if pair[1] >= 0:
            turn = start.inertia_inverse[pair[1]] * wp.cross(contacts.lever_b[c], change * n)
            work.push[pair[1]] = work.push[pair[1]] - change / masses.mass[pair[1]] * n
            work.push_turn[pair[1]] = work.push_turn[pair[1]] - turn
    return wp.abs(change) * rows.response[c][0]


@wp.func
def keep_moment(islands: Islands, contacts: Contacts, rows: Rows, motion: Motion, r: int, part: wp.float64):
    """Bodies that move have changed their moment of momentum by this: of that their spins take a part back."""
    for i in range(begin_of(islands.contact_begin, r), islands.contact_begin[r]):
        c = islands.contact[i]
        pair = contacts.body[c]
        if rows.push[c] > ZERO and pair[0] >= 0 and pair[1] >= 0:
            between = motion.velocity[pair[0]] - motion.velocity[pair[1]]
            half = HALF * part * rows.push[c] * wp.cross(contacts.normal[c], between)
            motion.angular_momentum[pair[0]] = motion.angular_momentum[pair[0]] - half
            motion.angular_momentum[pair[1]] = motion.angular_momentum[pair[1]] - half


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
) -> bool:
    """Moves what overlaps apart: a position pass without friction, which gives no velocity. Whether any did."""
    if not measure_overlaps(islands, contacts, rows, geoms, motion, work, r, step.length):
        return False
    exit_distance = effort.exit_speed * step.length
    for _ in range(effort.sweeps):
        most = wp.float64(0.0)
        for i in range(begin_of(islands.contact_begin, r), islands.contact_begin[r]):
            change = push_apart(contacts, rows, masses, start, work, islands.contact[i], exit_distance)
            most = wp.max(most, change)
        if most <= wp.float64(1e-3) * exit_distance:
            break
    keep_moment(islands, contacts, rows, motion, r, ONE)
    return True


@wp.func
def put_back(islands: Islands, contacts: Contacts, rows: Rows, motion: Motion, work: Work, r: int):
    """Undoes `part_overlaps`."""
    keep_moment(islands, contacts, rows, motion, r, -ONE)
    for i in range(begin_of(islands.body_begin, r), islands.body_begin[r]):
        work.push[islands.body[i]] = wp.vec3d()
        work.push_turn[islands.body[i]] = wp.vec3d()
