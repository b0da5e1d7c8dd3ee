"""What overlaps is parted: positions alone."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.motion_kernels import HALF, ONE, ZERO
from plait.solver.rigid.problem import Island, Problem
from plait.solver.rigid.row_kernels import relative_velocity

wp.set_module_options({"enable_backward": False})

# Of an overlap so much is undone in a substep, where it is more than this part of a margin.
UNDONE = wp.constant(wp.float64(0.25))
SLOP = wp.constant(wp.float64(1e-4))
# The pass ends where it changes no way by more than this part of the longest.
FINE = wp.constant(wp.float64(1e-3))


@wp.func
def measure_overlaps(p: Problem, at: Island) -> bool:
    """Notes in `struck` how far apart an island's contacts are left [m]; whether any overlaps."""
    deep = wp.bool(False)
    for i in range(at.contact_begin, at.contact_end):
        c = p.islands.contact[i]
        u = relative_velocity(p.contacts, c, p.motion.velocity, p.work.spin) + p.rows.bias[c]
        left = p.contacts.gap[c] + at.length * wp.dot(p.contacts.normal[c], u)
        p.rows.push[c] = ZERO
        p.rows.struck[c] = left
        if left < -SLOP * p.geoms.margin[p.contacts.geom[c]]:
            deep = wp.bool(True)
    return deep


@wp.func
def push_side(p: Problem, b: int, lever: wp.vec3d, push: wp.vec3d):
    """push: [kg m] on one side of a contact."""
    if b >= 0:
        p.work.push[b] = p.work.push[b] + push / p.masses.mass[b]
        p.work.push_turn[b] = p.work.push_turn[b] + p.start.inertia_inverse[b] * wp.cross(lever, push)


@wp.func
def push_apart(p: Problem, at: Island, c: int) -> wp.float64:
    """One contact of a sweep of the position pass; the change [m]."""
    left = p.rows.struck[c]
    least = -left
    if left < ZERO:
        least = wp.min(-UNDONE * left, at.exit_distance)
    n = p.contacts.normal[c]
    gained = wp.dot(n, relative_velocity(p.contacts, c, p.work.push, p.work.push_turn))
    now = wp.max(p.rows.push[c] - (gained - least) / p.rows.response[c][0], ZERO)
    change = now - p.rows.push[c]
    p.rows.push[c] = now
    if change != ZERO:
        pair = p.contacts.body[c]
        push_side(p, pair[0], p.contacts.lever_a[c], change * n)
        push_side(p, pair[1], p.contacts.lever_b[c], -change * n)
    return wp.abs(change) * p.rows.response[c][0]


@wp.func
def keep_moment(p: Problem, at: Island, part: wp.float64):
    """Bodies that move have changed their moment of momentum by this: of that their spins take a part back."""
    for i in range(at.contact_begin, at.contact_end):
        c = p.islands.contact[i]
        pair = p.contacts.body[c]
        if p.rows.push[c] > ZERO and pair[0] >= 0 and pair[1] >= 0:
            between = p.motion.velocity[pair[0]] - p.motion.velocity[pair[1]]
            half = HALF * part * p.rows.push[c] * wp.cross(p.contacts.normal[c], between)
            p.motion.angular_momentum[pair[0]] = p.motion.angular_momentum[pair[0]] - half
            p.motion.angular_momentum[pair[1]] = p.motion.angular_momentum[pair[1]] - half


@wp.func
def part_overlaps(p: Problem, at: Island) -> bool:
    """Moves what overlaps apart: a position pass without friction, which gives no velocity. Whether any did."""
    if not measure_overlaps(p, at):
        return False
    for _ in range(p.effort.sweeps):
        most = wp.float64(0.0)
        for i in range(at.contact_begin, at.contact_end):
            most = wp.max(most, push_apart(p, at, p.islands.contact[i]))
        if most <= FINE * at.exit_distance:
            break
    keep_moment(p, at, ONE)
    return True


@wp.func
def put_back(p: Problem, at: Island):
    """Undoes `part_overlaps`."""
    keep_moment(p, at, -ONE)
    for i in range(at.body_begin, at.body_end):
        p.work.push[p.islands.body[i]] = wp.vec3d()
        p.work.push_turn[p.islands.body[i]] = wp.vec3d()
