"""What overlaps is parted: positions alone."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.island_kernels import Islands, begin_of
from plait.solver.rigid.motion_kernels import HALF, ZERO, Masses, Motion
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
