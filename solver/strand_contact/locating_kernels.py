"""Where edges of strands on their way through a substep touch or are nearest, and whether they went through."""

from __future__ import annotations

import warp as wp

from plait.solver.strand_contact.crossing_kernels import (
    HALF,
    ONE,
    ZERO,
    closest_on_edges,
    distance_of_edges,
    drawn_through,
    exactly_closest,
    first_touch,
    largest_shift,
    least_distance,
    may_cross,
)
from plait.solver.strand_contact.meeting_kernels import (
    CROSSING,
    DEEP,
    OUT_OF_PLACE,
    Meetings,
    Nodes,
    Ways,
    along,
    between,
    rest,
)

wp.set_module_options({"enable_backward": False})

TWO = wp.constant(wp.float64(2.0))
QUARTER = wp.constant(wp.float64(0.25))
# Contacts may be nearer, or press from further, by this part of the distance that two of the thinner would keep.
OVERLAP = wp.constant(wp.float64(0.1))
# What two strands nearer than their distance to keep are asked to regain of it in a substep.
REGAINED = wp.constant(wp.float64(0.2))
# Where edges are on their way through each other, their geometry is taken when so much of their distance is left.
LEFT = wp.constant(wp.float64(0.1))
# Stiffness of a contact over that of the nodes it holds.
STIFFER = wp.constant(wp.float64(10.0))
# After so many passes contacts may be so many times as near as they otherwise may.
DEEPEST = wp.constant(wp.float64(5.0))
# [m] A way that no strand goes.
NEVER_AGAIN = wp.constant(wp.float64(1.0e30))


@wp.func
def begin(nodes: Nodes, start: wp.array(dtype=wp.vec3d), widest: wp.float64, item: int, meetings: Meetings):
    """How far apart a pair is at the start, and as drawn; where that is more than `widest`, only that it is."""
    a = meetings.edges[item][0]
    b = meetings.edges[item][1]
    place = closest_on_edges(start[a], start[a + 1], start[b], start[b + 1])
    meetings.apart[item] = along(start, a, place[0]) - along(start, b, place[1])
    u = nodes.drawn[a + 1] - nodes.drawn[a]
    v = nodes.drawn[b + 1] - nodes.drawn[b]
    w = nodes.drawn[b] + HALF * v - nodes.drawn[a] - HALF * u
    drawn = wp.length(w) - HALF * (wp.length(u) + wp.length(v))
    if drawn <= widest:
        drawn = distance_of_edges(nodes.drawn[a], nodes.drawn[a + 1], nodes.drawn[b], nodes.drawn[b + 1])
    meetings.drawn[item] = drawn


@wp.struct
class Sweep:
    """Two edges on their way through a substep: their ends [m] at its start, and where they have come to."""

    a0: wp.vec3d
    a1: wp.vec3d
    b0: wp.vec3d
    b1: wp.vec3d
    a0_end: wp.vec3d
    a1_end: wp.vec3d
    b0_end: wp.vec3d
    b1_end: wp.vec3d


@wp.func
def sweep_of(start: wp.array(dtype=wp.vec3d), x: wp.array(dtype=wp.vec3d), a: int, b: int):
    return Sweep(start[a], start[a + 1], start[b], start[b + 1], x[a], x[a + 1], x[b], x[b + 1])


@wp.func
def clearance_of_boxes(w: Sweep) -> wp.float64:
    """How far apart the boxes of two edges' ways are along an axis; negative where they overlap along all."""
    a_lower = wp.min(wp.min(w.a0, w.a1), wp.min(w.a0_end, w.a1_end))
    a_upper = wp.max(wp.max(w.a0, w.a1), wp.max(w.a0_end, w.a1_end))
    b_lower = wp.min(wp.min(w.b0, w.b1), wp.min(w.b0_end, w.b1_end))
    b_upper = wp.max(wp.max(w.b0, w.b1), wp.max(w.b0_end, w.b1_end))
    return wp.max(wp.max(a_lower - b_upper), wp.max(b_lower - a_upper))


@wp.func
def clearance(w: Sweep, before: wp.vec3d, after: wp.vec3d) -> wp.float64:
    """What two edges keep apart all the way, at least; between their `closest_on_edges`, `before` and `after` it.

    Their distance changes by no more than their ends move against each other.
    """
    ends = least_distance(before, w.a1 - w.a0, w.b1 - w.b0)
    ends += least_distance(after, w.a1_end - w.a0_end, w.b1_end - w.b0_end)
    return HALF * (ends - largest_shift(w.a0_end - w.a0, w.a1_end - w.a1, w.b0_end - w.b0, w.b1_end - w.b1))


@wp.func
def time_of_touch(w: Sweep, before: wp.vec3d, after: wp.vec3d, least: wp.float64) -> wp.float64:
    """When two edges first are `least` [m] apart, from 0 to 1, if they may go through each other; else 2.

    0: they touch at the start. before, after: as of `clearance`.
    """
    may = may_cross(w.a0, w.a1, w.b0, w.b1, w.a0_end, w.a1_end, w.b0_end, w.b1_end)
    if not may and wp.dot(after, before) <= ZERO:
        # So near an end on the right side that the closest points, which are drawn to the middles, show another.
        may = distance_of_edges(w.a0_end, w.a1_end, w.b0_end, w.b1_end) < least
    time = TWO
    if may:
        time = first_touch(w.a0, w.a1, w.b0, w.b1, w.a0_end, w.a1_end, w.b0_end, w.b1_end, least)
    return time


@wp.func
def stop_at(w: Sweep, time: wp.float64):
    """The same way, only until `time`."""
    return Sweep(
        w.a0, w.a1, w.b0, w.b1,
        w.a0 + time * (w.a0_end - w.a0), w.a1 + time * (w.a1_end - w.a1),
        w.b0 + time * (w.b0_end - w.b0), w.b1 + time * (w.b1_end - w.b1),
    )  # fmt: skip


@wp.func
def leave_out(meetings: Meetings, item: int, clear: wp.float64):
    """The pair keeps `clear` [m] apart, or must be let be."""
    meetings.fault[item] = 0
    meetings.gap[item] = clear
    meetings.slack[item] = wp.abs(clear)
    rest(meetings, item)


@wp.func
def stiffness_between(stiffness: wp.array(dtype=wp.float64), a: int, b: int, place: wp.vec2d) -> wp.float64:
    """Of a contact [N/m]: that of the nodes it holds, one edge's behind the other's, and more."""
    of_a = (ONE - place[0]) * stiffness[a] + place[0] * stiffness[a + 1]
    of_b = (ONE - place[1]) * stiffness[b] + place[1] * stiffness[b + 1]
    return STIFFER * of_a * of_b / (of_a + of_b)


@wp.func
def distance_to_keep(nodes: Nodes, a: int, b: int, place: wp.vec2d) -> wp.float64:
    """[m]"""
    of_a = (ONE - place[0]) * nodes.reach[a] + place[0] * nodes.reach[a + 1]
    return of_a + (ONE - place[1]) * nodes.reach[b] + place[1] * nodes.reach[b + 1]


@wp.kernel
def locate(
    first: int,
    chosen: wp.array(dtype=wp.int32),
    nodes: Nodes,
    stiffness: wp.array(dtype=wp.float64),
    ways: Ways,
    steady: wp.float64,
    start: wp.array(dtype=wp.vec3d),
    x: wp.array(dtype=wp.vec3d),
    meetings: Meetings,
):
    """Where edges on their way from `start` to `x` touch or are nearest, and their gap; one pair `chosen` an item.

    What pushes keeps its place and normal once its strands move less than `steady`: points of nearly parallel
    edges would go to and fro.

    stiffness: (node_count,) [N/m] of the nodes.
    """
    item = chosen[first + wp.tid()]
    a = meetings.edges[item][0]
    b = meetings.edges[item][1]
    travelled = wp.max(ways.travel[a], ways.travel[a + 1]) + wp.max(ways.travel[b], ways.travel[b + 1])
    if travelled < meetings.clear_until[item]:
        return
    sweep = sweep_of(start, x, a, b)
    reach_a = wp.max(nodes.reach[a], nodes.reach[a + 1])
    reach_b = wp.max(nodes.reach[b], nodes.reach[b + 1])
    widest = reach_a + reach_b
    clear = clearance_of_boxes(sweep)
    apart = wp.vec3d()
    place = wp.vec2d()
    offset = wp.vec3d()
    if clear <= widest:
        if meetings.drawn[item] < ZERO:
            begin(nodes, start, widest, item, meetings)
            if drawn_through(nodes.radius, a, b, meetings.drawn[item]):
                meetings.clear_until[item] = NEVER_AGAIN
                leave_out(meetings, item, ZERO)
                return
        apart = meetings.apart[item]
        place = closest_on_edges(sweep.a0_end, sweep.a1_end, sweep.b0_end, sweep.b1_end)
        offset = between(sweep.a0_end, sweep.a1_end, sweep.b0_end, sweep.b1_end, place)
        clear = clearance(sweep, apart, offset)
    if clear > widest:
        meetings.clear_until[item] = travelled + clear - widest
        leave_out(meetings, item, clear)
        return
    fault = wp.int32(0)
    before = wp.length(apart)
    least = LEFT * wp.min(before, nodes.reach[a] + nodes.reach[b])
    if clear <= least:
        time = time_of_touch(sweep, apart, offset, least)
        if time == ZERO:
            # They touch where they start: neither has a side that it could be kept on.
            leave_out(meetings, item, clear)
            return
        if time <= ONE:
            fault = CROSSING
            touch = stop_at(sweep, time)
            # So near each other that points drawn to the middles would show a way along the edges.
            place = exactly_closest(touch.a0_end, touch.a1_end, touch.b0_end, touch.b1_end)
            offset = between(touch.a0_end, touch.a1_end, touch.b0_end, touch.b1_end, place)
    distance = wp.length(offset)
    normal = wp.vec3d()
    if distance > ZERO:
        normal = offset / distance
    full = wp.min(distance_to_keep(nodes, a, b, place), meetings.drawn[item])
    target = full
    if before < full:
        target = before + REGAINED * (full - before)
    held = meetings.stiffer[item] * stiffness_between(stiffness, a, b, place)
    gap = wp.dot(normal, along(x, a, place[0]) - along(x, b, place[1])) - target
    if wp.dot(normal, apart) <= ZERO and meetings.turned[item] == 0:
        # On another side without having gone through: past an end, or a neighbour has. It is left to that.
        held = ZERO
        gap = wp.max(gap, ZERO)
        rest(meetings, item)
    # Towards a root, where the reach goes to nothing, gaps are no more exact than elsewhere on its edge.
    slack = TWO * OVERLAP * wp.min(reach_a, reach_b)
    keeps = meetings.acts[item] != 0 and held > ZERO and wp.abs(gap) <= slack
    keeps = keeps and wp.max(ways.moved[nodes.strand[a]], ways.moved[nodes.strand[b]]) <= steady
    if fault == CROSSING:
        meetings.turned[item] = 1
    elif meetings.turned[item] != 0:
        keeps = True
        offset = along(x, a, meetings.place[item][0]) - along(x, b, meetings.place[item][1])
        gap = wp.dot(meetings.normal[item], offset) - meetings.target[item]
    if fault == CROSSING or not keeps:
        meetings.place[item] = place
        meetings.normal[item] = normal
        meetings.target[item] = target
        meetings.stiffness[item] = held
    if gap < -wp.max(slack - (full - target), QUARTER * slack):
        fault += OUT_OF_PLACE
    if gap < -DEEPEST * slack:
        fault += DEEP
    meetings.slack[item] = slack
    meetings.gap[item] = gap
    meetings.fault[item] = fault
