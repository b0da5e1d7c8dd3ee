"""Edges of strands that meet: an augmented Lagrangian of Signorini's law and Coulomb friction.

For edges a and b with closest points p_a, p_b, normal n from b to a, distance to keep d, stiffness k, and forces
lambda (pressure) and tau (traction) held so far (Simo and Laursen 1992):

    pressure  lambda' = max(lambda - k (n . (p_a - p_b) - d), 0)
    traction  tau' = tau - k (1 - n n^T) slip, shortened to mu lambda where it is longer

with `slip` the way that the one point has gone along the other in the substep. On a acts lambda' n + tau', on b
the opposite. Both are gradients of convex energies once the pressure that bounds friction is held.
"""

from __future__ import annotations

import warp as wp

from plait.solver.strand_contact.crossing_kernels import HALF, ZERO
from plait.solver.strand_contact.meeting_kernels import OUT_OF_PLACE, Meetings, Nodes, Ways, along

wp.set_module_options({"enable_backward": False})

# A contact that has changed the way it slides so often is damped for good, others for one pass.
SWINGS = wp.constant(3)
# A contact whose overlap has not fallen to this part since its force was last held gets so many times as stiff.
FALLEN, STIFFER_STILL = wp.constant(wp.float64(0.5)), wp.constant(wp.float64(4.0))


@wp.struct
class Push:
    """What the edges of a pair do to each other."""

    pressure: wp.float64  # [N]
    traction: wp.vec3d  # [N] on a
    block: wp.mat33d  # [N/m] the force's derivative by -p_a, or more
    sliding: wp.vec3d  # direction of the traction where b slides


@wp.func
def push(
    nodes: Nodes,
    start: wp.array(dtype=wp.vec3d),
    x: wp.array(dtype=wp.vec3d),
    meetings: Meetings,
    item: int,
):
    """Of a pair at `x`."""
    a = meetings.edges[item][0]
    b = meetings.edges[item][1]
    s = meetings.place[item][0]
    t = meetings.place[item][1]
    n = meetings.normal[item]
    k = meetings.stiffness[item]
    out = Push()
    if k == ZERO:
        return out
    offset = along(x, a, s) - along(x, b, t)
    held = meetings.pressure[item]
    out.pressure = wp.max(held - k * (wp.dot(n, offset) - meetings.target[item]), ZERO)
    if out.pressure > ZERO:
        nn = wp.outer(n, n)
        out.block = k * nn
        bound = HALF * (nodes.friction[a] + nodes.friction[b]) * held
        if bound > ZERO:
            across = wp.identity(n=3, dtype=wp.float64) - nn
            slip = offset - along(start, a, s) + along(start, b, t)
            traction = across * (meetings.traction[item] - k * slip)
            size = wp.length(traction)
            if size <= bound:
                out.traction = traction
                out.block += k * across
            else:
                direction = traction / size
                out.traction = bound * direction
                out.sliding = direction
                out.block += (k * bound / size) * across
                if meetings.swings[item] < SWINGS and wp.dot(direction, meetings.sliding[item]) >= ZERO:
                    out.block -= (k * bound / size) * wp.outer(direction, direction)
    return out


@wp.kernel
def press(
    first: int,
    chosen: wp.array(dtype=wp.int32),
    nodes: Nodes,
    start: wp.array(dtype=wp.vec3d),
    x: wp.array(dtype=wp.vec3d),
    meetings: Meetings,
):
    """Force and stiffness at `x` of the pairs `chosen`; one an item. What presses from too far is out of place."""
    item = chosen[first + wp.tid()]
    if meetings.stiffness[item] == ZERO:
        return
    if meetings.pressure[item] == ZERO and meetings.gap[item] > ZERO and meetings.acts[item] == 0:
        return
    pushed = push(nodes, start, x, meetings, item)
    meetings.acts[item] = wp.where(pushed.pressure > ZERO, 1, 0)
    meetings.force[item] = pushed.pressure * meetings.normal[item] + pushed.traction
    meetings.block[item] = pushed.block
    if wp.dot(pushed.sliding, meetings.sliding[item]) < ZERO:
        meetings.swings[item] = meetings.swings[item] + 1
    meetings.sliding[item] = pushed.sliding
    if pushed.pressure > ZERO and meetings.gap[item] > meetings.slack[item]:
        meetings.fault[item] = meetings.fault[item] | OUT_OF_PLACE


@wp.func
def stiffen(meetings: Meetings, item: int):
    """A contact whose force is held gets stiffer if its overlap has not fallen enough since it last was.

    The multiplier converges as (1 + k / K)^-n against a resistance K, which of taut or hooked strands is far above
    that to a point load, from which k comes (Bertsekas 1982, Constrained Optimization and Lagrange Multiplier
    Methods, 2.2.5).
    """
    overlap = -meetings.gap[item]
    before = meetings.overlap[item]
    if before > ZERO and overlap > wp.max(meetings.slack[item], FALLEN * before):
        meetings.stiffness[item] = STIFFER_STILL * meetings.stiffness[item]
        meetings.stiffer[item] = STIFFER_STILL * meetings.stiffer[item]
    meetings.overlap[item] = wp.max(overlap, ZERO)


@wp.kernel
def hold(
    first: int,
    chosen: wp.array(dtype=wp.int32),
    nodes: Nodes,
    start: wp.array(dtype=wp.vec3d),
    x: wp.array(dtype=wp.vec3d),
    ways: Ways,
    calmer: wp.float64,
    calm: wp.float64,
    meetings: Meetings,
):
    """Holds the force at `x` of a pair that took part in the last step; one of the pairs `chosen` an item.

    If of its two strands the one that moved further did so by more than `calmer`, up to `calm`. Or if there is
    less of it: what has parted presses no more.
    """
    item = chosen[first + wp.tid()]
    if meetings.stiffness[item] == ZERO or meetings.acts[item] == 0:
        return
    edges = meetings.edges[item]
    moved = wp.max(ways.moved[nodes.strand[edges[0]]], ways.moved[nodes.strand[edges[1]]])
    if moved <= calmer:
        return
    pushed = push(nodes, start, x, meetings, item)
    if moved > calm and (meetings.gap[item] <= meetings.slack[item] or pushed.pressure >= meetings.pressure[item]):
        return
    meetings.pressure[item] = pushed.pressure
    meetings.traction[item] = pushed.traction
    stiffen(meetings, item)
