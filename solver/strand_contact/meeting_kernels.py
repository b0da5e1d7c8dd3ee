"""Edges of strands that meet: geometry, and an augmented Lagrangian of Signorini's law and Coulomb friction.

For edges a and b with closest points p_a, p_b, normal n from b to a, distance to keep d, stiffness k, and forces
lambda (pressure) and tau (traction) held so far (Simo and Laursen 1992):

    pressure  lambda' = max(lambda - k (n . (p_a - p_b) - d), 0)
    traction  tau' = tau - k (1 - n n^T) slip, shortened to mu lambda where it is longer

with `slip` the way that the one point has gone along the other in the substep. On a acts lambda' n + tau', on b
the opposite. Both are gradients of convex energies once the pressure that bounds friction is held.
"""

from __future__ import annotations

import warp as wp

from plait.solver.strand_contact.crossing_kernels import (
    closest_on_edges,
    distance_of_edges,
    drawn_through,
    exactly_closest,
    first_touch,
    largest_shift,
    least_distance,
    may_cross,
)

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))
HALF = wp.constant(wp.float64(0.5))
ONE = wp.constant(wp.float64(1.0))
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
# Faults of a pair: its edges have gone through each other; are nearer than they may be, or press from too far; are
# far nearer.
CROSSING = wp.constant(1)
OUT_OF_PLACE = wp.constant(2)
DEEP = wp.constant(4)
# A contact that has changed the way it slides so often is damped for good, others for one pass.
SWINGS = wp.constant(3)
# A node's room over how far it has strayed; what is left of it a substep later.
AGAIN = wp.constant(wp.float64(1.5))
KEPT = wp.constant(wp.float64(0.8))
# [m] A way that no strand goes.
NEVER_AGAIN = wp.constant(wp.float64(1.0e30))
# Contacts of which each edge remembers the forces for the next substep, the largest of them.
HELD_AN_EDGE = wp.constant(4)


@wp.struct
class Nodes:
    """What is constant of nodes, (node_count,) each."""

    reach: wp.array(dtype=wp.float64)  # [m] half of the distance to keep
    radius: wp.array(dtype=wp.float64)  # [m]
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient; a pair's is the mean of both
    drawn: wp.array(dtype=wp.vec3d)  # [m] where the artist has drawn them: what is near there is meant to be
    strand: wp.array(dtype=wp.int32)


@wp.struct
class Meetings:
    """Pairs of edges that may meet in a substep, (pair_count,) each; edge k joins nodes k and k + 1."""

    edges: wp.array(dtype=wp.vec2i)  # a, b
    apart: wp.array(dtype=wp.vec3d)  # [m] from b to a at the start, once `drawn` is known
    drawn: wp.array(dtype=wp.float64)  # [m] their distance as drawn; negative: not known yet
    clear_until: wp.array(dtype=wp.float64)  # [m] travel of both together for which they surely keep apart
    place: wp.array(dtype=wp.vec2d)  # where on a and on b, 0 to 1
    normal: wp.array(dtype=wp.vec3d)  # from b to a
    target: wp.array(dtype=wp.float64)  # [m] distance to keep
    gap: wp.array(dtype=wp.float64)  # [m] distance beyond that
    slack: wp.array(dtype=wp.float64)  # [m] by which a gap may be wrong
    fault: wp.array(dtype=wp.int32)  # of CROSSING, OUT_OF_PLACE and DEEP, added
    turned: wp.array(dtype=wp.int32)  # 1: the edges have been kept from going through each other
    stiffness: wp.array(dtype=wp.float64)  # [N/m] k; 0 where the pair takes no part
    pressure: wp.array(dtype=wp.float64)  # [N] held
    traction: wp.array(dtype=wp.vec3d)  # [N] held
    sliding: wp.array(dtype=wp.vec3d)  # direction of the traction of what slid in the last pass
    swings: wp.array(dtype=wp.int32)  # how often what slid one way in a pass slid the other way in the next
    heir: wp.array(dtype=wp.int32)  # the pair, beyond a node, to which these have passed; -1: none
    passed_pressure: wp.array(dtype=wp.float64)  # [N] to it, and
    passed_traction: wp.array(dtype=wp.vec3d)
    acts: wp.array(dtype=wp.int32)  # 1: a force or stiffness there is
    force: wp.array(dtype=wp.vec3d)  # [N] on a
    block: wp.array(dtype=wp.mat33d)  # [N/m] its derivative by -p_a


@wp.struct
class Ways:
    """How strands move in the passes of a substep."""

    moved: wp.array(dtype=wp.float64)  # (strand_count,) longest displacement in the last step, over its segments
    stray: wp.array(dtype=wp.float64)  # (strand_count,) furthest of a node from where expected, over its room
    travel: wp.array(dtype=wp.float64)  # (node_count,) [m] way since the first pass


@wp.struct
class Held:
    """Forces of contacts that last, HELD_AN_EDGE slots an edge."""

    other: wp.array(dtype=wp.int32)  # (slot_count,) the second edge; -1: none
    pressure: wp.array(dtype=wp.float64)  # [N]
    traction: wp.array(dtype=wp.vec3d)  # [N]


@wp.func
def along(x: wp.array(dtype=wp.vec3d), edge: int, place: wp.float64):
    return (ONE - place) * x[edge] + place * x[edge + 1]


@wp.func
def between(a0: wp.vec3d, a1: wp.vec3d, b0: wp.vec3d, b1: wp.vec3d, place: wp.vec2d):
    """From a place on edge b to one on edge a."""
    s = place[0]
    t = place[1]
    return (ONE - s) * a0 + s * a1 - (ONE - t) * b0 - t * b1


@wp.kernel
def expect(
    first: int,
    lasting: wp.array(dtype=wp.int32),
    strand: wp.array(dtype=wp.int32),
    start: wp.array(dtype=wp.vec3d),
    velocity: wp.array(dtype=wp.vec3d),
    length: wp.float64,
    alone: wp.array(dtype=wp.vec3d),
    expected_out: wp.array(dtype=wp.vec3d),
):
    """Where nodes are expected: those of `lasting` strands go on, others where they go alone; one an item."""
    node = first + wp.tid()
    expected_out[node] = alone[node]
    if lasting[strand[node]] != 0:
        expected_out[node] = start[node] + length * velocity[node]


@wp.kernel
def make_room(
    first: int,
    most: wp.float64,
    expected: wp.array(dtype=wp.vec3d),
    x: wp.array(dtype=wp.vec3d),
    room: wp.array(dtype=wp.float64),
):
    """Room for nodes that stray from where they are expected, to do so again; one node an item.

    most: [m] of it.  room: (node_count,) [m].
    """
    node = first + wp.tid()
    stray = wp.length(x[node] - expected[node])
    room[node] = wp.min(wp.max(room[node], AGAIN * stray), most)


@wp.kernel
def lose_room(first: int, room: wp.array(dtype=wp.float64)):
    """What nodes have not needed they have less of in the next substep; one node an item."""
    node = first + wp.tid()
    room[node] = KEPT * room[node]


@wp.func
def rest(meetings: Meetings, item: int):
    """The pair takes no part."""
    meetings.stiffness[item] = ZERO
    meetings.pressure[item] = ZERO
    meetings.traction[item] = wp.vec3d()
    meetings.heir[item] = -1
    meetings.acts[item] = 0
    # The side that it was kept on is of another place than where its edges may meet again.
    meetings.turned[item] = 0


@wp.func
def begin_unknown(meetings: Meetings, item: int):
    """A pair of which nothing is known yet."""
    meetings.drawn[item] = -ONE
    meetings.clear_until[item] = -ONE
    meetings.pressure[item] = ZERO
    meetings.traction[item] = wp.vec3d()
    meetings.acts[item] = 0
    meetings.turned[item] = 0
    meetings.swings[item] = 0
    meetings.sliding[item] = wp.vec3d()


@wp.kernel
def recall(first: int, held: Held, meetings: Meetings):
    """How a pair begins, and the forces that it had before; one pair an item."""
    item = first + wp.tid()
    begin_unknown(meetings, item)
    edges = meetings.edges[item]
    for i in range(HELD_AN_EDGE):
        slot = edges[0] * HELD_AN_EDGE + i
        if held.other[slot] == edges[1]:
            meetings.pressure[item] = held.pressure[slot]
            meetings.traction[item] = held.traction[slot]


@wp.kernel
def resume(
    first: int, before: Meetings, before_first: wp.array(dtype=wp.int32), elsewhere: bool, meetings: Meetings
):
    """What was known of a pair when pairs were last found in this substep; one pair an item.

    before: what was known.  before_first: (node_count + 1,) each edge's pairs there in which it is the first.
    elsewhere: strands have not travelled to where they are now: nothing surely keeps apart.
    """
    item = first + wp.tid()
    edges = meetings.edges[item]
    low = before_first[edges[0]]
    end = before_first[edges[0] + 1]
    while low < end and before.edges[low][1] < edges[1]:
        low += 1
    known = wp.bool(False)
    if low < end:
        known = before.edges[low] == edges
    if not known:
        begin_unknown(meetings, item)
        return
    meetings.apart[item] = before.apart[low]
    meetings.drawn[item] = before.drawn[low]
    meetings.clear_until[item] = before.clear_until[low]
    if elsewhere:
        meetings.drawn[item] = -ONE
        meetings.clear_until[item] = -ONE
    meetings.fault[item] = before.fault[low]
    meetings.swings[item] = before.swings[low]
    meetings.sliding[item] = before.sliding[low]
    meetings.stiffness[item] = before.stiffness[low]
    if before.stiffness[low] == ZERO:
        meetings.gap[item] = before.gap[low]
        meetings.slack[item] = before.slack[low]
        rest(meetings, item)
        return
    meetings.place[item] = before.place[low]
    meetings.normal[item] = before.normal[low]
    meetings.target[item] = before.target[low]
    meetings.gap[item] = before.gap[low]
    meetings.slack[item] = before.slack[low]
    meetings.turned[item] = before.turned[low]
    meetings.pressure[item] = before.pressure[low]
    meetings.traction[item] = before.traction[low]
    meetings.acts[item] = before.acts[low]


@wp.kernel
def remember(
    first: int,
    incident_first: wp.array(dtype=wp.int32),
    incident: wp.array(dtype=wp.int32),
    meetings: Meetings,
    held_out: Held,
):
    """Keeps the forces of an edge's pairs in which it is the first; one edge an item."""
    edge = first + wp.tid()
    for i in range(HELD_AN_EDGE):
        held_out.other[edge * HELD_AN_EDGE + i] = -1
        held_out.pressure[edge * HELD_AN_EDGE + i] = ZERO
        held_out.traction[edge * HELD_AN_EDGE + i] = wp.vec3d()
    for at in range(incident_first[edge], incident_first[edge + 1]):
        pair = incident[at] / 2
        if incident[at] % 2 == 0 and meetings.pressure[pair] > ZERO:
            least = wp.int32(0)
            for i in range(1, HELD_AN_EDGE):
                if held_out.pressure[edge * HELD_AN_EDGE + i] < held_out.pressure[edge * HELD_AN_EDGE + least]:
                    least = i
            slot = edge * HELD_AN_EDGE + least
            if meetings.pressure[pair] > held_out.pressure[slot]:
                held_out.other[slot] = meetings.edges[pair][1]
                held_out.pressure[slot] = meetings.pressure[pair]
                held_out.traction[slot] = meetings.traction[pair]


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
    held = stiffness_between(stiffness, a, b, place)
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
