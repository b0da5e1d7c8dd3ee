"""Pairs of edges of strands that may meet: what is known of them, how they begin and are found again."""

from __future__ import annotations

import warp as wp

from plait.solver.strand_contact.crossing_kernels import ONE, ZERO

wp.set_module_options({"enable_backward": False})

# Faults of a pair: its edges have gone through each other; are nearer than they may be, or press from too far; are
# far nearer.
CROSSING = wp.constant(1)
OUT_OF_PLACE = wp.constant(2)
DEEP = wp.constant(4)
# A node's room over how far it has strayed; what is left of it a substep later.
AGAIN = wp.constant(wp.float64(1.5))
KEPT = wp.constant(wp.float64(0.8))
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
    stiffer: wp.array(dtype=wp.float64)  # what k has grown by since the substep began
    overlap: wp.array(dtype=wp.float64)  # [m] nearer than `target` when its force was last held
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
    meetings.stiffer[item] = ONE
    meetings.overlap[item] = ZERO


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
    meetings.stiffer[item] = before.stiffer[low]
    meetings.overlap[item] = before.overlap[low]
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
