"""Pairs of edges whose swept boxes overlap: columns of boxes, swept along the third axis.

Every edge is entered in each column of a square grid across one axis that its box meets; the entries are sorted by
column, then by where their boxes begin along that axis. An edge finds its partners among the entries before and
behind its own in each of its columns. A pair may meet in several columns: it counts in the one that holds the
lower corner of the boxes' intersection. Columns are numbered modulo the table's size, so that the table stays
small; entries know their column, which tells those apart that share a place.
"""

from __future__ import annotations

import warp as wp

from plait.solver.strand_contact.crossing_kernels import distance_of_edges, largest_shift
from plait.solver.strand_contact.edge_box_kernels import Boxes, Edges, Motion, may_meet_itself, room_of_edge

wp.set_module_options({"enable_backward": False})

# Columns along a side are numbered in 15 bits.
LAST_COLUMN = wp.constant(32767.0)
# Where a box begins and ends in a column takes 15 bits of a lane; the sixteenth guards the next lane.
FULL_WIDTH = wp.constant(32767.0)
FULL = wp.constant(wp.uint64(32767))
LANE = wp.constant(wp.uint64(16))
FULLS = wp.constant(wp.uint64(0x7FFF7FFF7FFF7FFF))
GUARDS = wp.constant(wp.uint64(0x8000800080008000))
NO_BITS = wp.constant(wp.uint64(0))
# Entries of an item that takes the running maximum; edges of one that searches.
RUN = wp.constant(1024)
CHUNK = wp.constant(256)


@wp.struct
class Columns:
    """The grid: columns across axis `sweep`; a key is a column's place in the table, then where a box begins."""

    across: wp.vec2i  # the two axes that number the columns
    sweep: int
    origin: wp.vec3f  # [m]
    per_column: wp.vec2f  # [1/m]
    per_step: float  # [1/m] along the sweep axis
    bits: wp.vec2i  # of the table's two sides
    sweep_bits: int


@wp.struct
class Entry:
    """An edge in one of its columns, as numbered: edge after edge."""

    end: wp.int32  # the key at which its box ends
    column: wp.int32  # the column itself: tells those apart that share a place
    tag: wp.int32  # 4 edge + 2 if the box begins in this column along the first side + 1 if along the second
    extent: (
        wp.uint64
    )  # four lanes of 16 bits: how far along both sides its box ends, and begins from the other end


@wp.struct
class Entries:
    """Entries sorted by key."""

    key: wp.array(dtype=wp.int32)  # (entry_count,)
    entry: wp.array(dtype=Entry)
    furthest: wp.array(dtype=wp.int32)  # the largest `end` up to here
    place: wp.array(dtype=wp.int32)  # (entry_count,) where each entry, as numbered, has come to be
    first: wp.array(dtype=wp.int32)  # (node_count + 1,) of an edge's own, as numbered
    count: int


@wp.func
def along_side(columns: Columns, x: wp.vec3f, side: int) -> float:
    """Position along one side in columns. This and what is made of it is monotone in x, so that overlaps stay."""
    axis = columns.across[side]
    return wp.clamp((x[axis] - columns.origin[axis]) * columns.per_column[side], 0.0, LAST_COLUMN)


@wp.func
def in_column(along: float, column: int) -> wp.uint64:
    """Position within a column in steps, 0 before it and `FULL` behind it."""
    return wp.uint64(wp.clamp((along - float(column)) * FULL_WIDTH, 0.0, FULL_WIDTH))


@wp.func
def key_of(columns: Columns, place: int, x: wp.vec3f) -> int:
    """Sorts by place, then along the sweep axis."""
    last = (1 << columns.sweep_bits) - 1
    step = (x[columns.sweep] - columns.origin[columns.sweep]) * columns.per_step
    return (place << columns.sweep_bits) | int(wp.clamp(step, 0.0, float(last)))


@wp.kernel(enable_backward=False)
def count_entries(
    first: int,
    columns: Columns,
    strand: wp.array(dtype=wp.int32),
    near: wp.array(dtype=wp.int32),
    boxes: Boxes,
    count_out: wp.array(dtype=wp.int32),
):
    edge = first + wp.tid()
    lower = boxes.lower[edge]
    upper = boxes.upper[edge]
    count = wp.int32(0)
    if near[strand[edge]] == 1 and lower[0] <= upper[0]:
        count = 1 + int(along_side(columns, upper, 0)) - int(along_side(columns, lower, 0))
        count *= 1 + int(along_side(columns, upper, 1)) - int(along_side(columns, lower, 1))
    count_out[edge] = count


@wp.kernel(enable_backward=False)
def write_entries(
    first: int,
    columns: Columns,
    boxes: Boxes,
    first_entry: wp.array(dtype=wp.int32),
    key_out: wp.array(dtype=wp.int32),
    number_out: wp.array(dtype=wp.int32),
    entry_out: wp.array(dtype=Entry),
):
    """Entries as numbered: an edge's together."""
    edge = first + wp.tid()
    number = first_entry[edge]
    if number == first_entry[edge + 1]:
        return
    lower = boxes.lower[edge]
    upper = boxes.upper[edge]
    u_lower = along_side(columns, lower, 0)
    u_upper = along_side(columns, upper, 0)
    v_lower = along_side(columns, lower, 1)
    v_upper = along_side(columns, upper, 1)
    for v in range(int(v_lower), int(v_upper) + 1):
        v_extent = (in_column(v_upper, v) << LANE) | ((FULL - in_column(v_lower, v)) << (LANE + LANE + LANE))
        v_place = (v & ((1 << columns.bits[1]) - 1)) << columns.bits[0]
        for u in range(int(u_lower), int(u_upper) + 1):
            place = v_place | (u & ((1 << columns.bits[0]) - 1))
            entry = Entry()
            entry.end = key_of(columns, place, upper)
            entry.column = (v << 15) | u
            entry.tag = 4 * edge + wp.where(u == int(u_lower), 2, 0) + wp.where(v == int(v_lower), 1, 0)
            entry.extent = v_extent | in_column(u_upper, u) | ((FULL - in_column(u_lower, u)) << (LANE + LANE))
            entry_out[number] = entry
            key_out[number] = key_of(columns, place, lower)
            number_out[number] = number
            number += 1


@wp.kernel(enable_backward=False)
def gather_entries(
    first: int, number: wp.array(dtype=wp.int32), entry: wp.array(dtype=Entry), entries_out: Entries
):
    slot = first + wp.tid()
    entries_out.entry[slot] = entry[number[slot]]
    entries_out.place[number[slot]] = slot


@wp.kernel(enable_backward=False)
def end_runs(first: int, count: int, entry: wp.array(dtype=Entry), last_out: wp.array(dtype=wp.int32)):
    """The largest key at which a box of a run of entries ends."""
    run = first + wp.tid()
    last = wp.int32(0)
    for slot in range(run * RUN, wp.min((run + 1) * RUN, count)):
        last = wp.max(last, entry[slot].end)
    last_out[run] = last


@wp.kernel(enable_backward=False)
def find_furthest(
    first: int,
    count: int,
    entry: wp.array(dtype=Entry),
    last: wp.array(dtype=wp.int32),
    furthest_out: wp.array(dtype=wp.int32),
):
    """Running maximum of where boxes end. Keys of other columns are out of the way by themselves."""
    run = first + wp.tid()
    furthest = wp.int32(0)
    for before in range(run):
        furthest = wp.max(furthest, last[before])
    for slot in range(run * RUN, wp.min((run + 1) * RUN, count)):
        furthest = wp.max(furthest, entry[slot].end)
        furthest_out[slot] = furthest


@wp.struct
class Search:
    """What a search among the entries reads."""

    edges: Edges
    entries: Entries
    start: wp.array(dtype=wp.vec3d)  # (node_count,) [m]
    end: wp.array(dtype=wp.vec3d)
    motion: Motion
    near_only: bool  # only those of pairs whose boxes overlap that may come near by their own distance
    node_count: int
    again: bool  # only pairs with a `sought` edge, which lists those with edges before it too
    sought: wp.array(dtype=wp.int32)  # (node_count,)


@wp.struct
class Partners:
    """Each edge's partners behind it, ascending; a chunk of edges has its own room for their lists."""

    room: wp.array(dtype=wp.int32)  # (chunk_count + 1,) where each chunk's begins
    edge: wp.array(dtype=wp.int32)
    first: wp.array(dtype=wp.int32)  # (node_count,) of each edge's list
    count: wp.array(dtype=wp.int32)  # (node_count + 1,)
    needed: wp.array(dtype=wp.int32)  # (chunk_count,) room for a chunk's lists, if there was not enough


@wp.func
def gather_candidates(search: Search, a: int, first: int, last: int, list_out: wp.array(dtype=wp.int32)) -> int:
    """How many edges behind edge a, or any if `again`, have boxes that overlap its own; lists them from `first`.

    The list's places end before `last`, which takes what does not fit. Without branches in the loop: they would be
    foretold wrongly about as often as not, which costs more than all the rest.
    """
    count = wp.int32(0)
    behind = wp.where(search.again, 0, -1)
    for number in range(search.entries.first[a], search.entries.first[a + 1]):
        place = search.entries.place[number]
        own = search.entries.entry[place]
        key = search.entries.key[place]
        # How far a's box begins, and ends from the other end: what another's must reach, lane by lane.
        extent = FULLS - own.extent
        extent = (extent >> (LANE + LANE)) | (extent << (LANE + LANE))
        slot = place
        while slot > 0 and search.entries.furthest[slot - 1] >= key:
            slot -= 1
        while slot < search.entries.count and search.entries.key[slot] <= own.end:
            other = search.entries.entry[slot]
            # No lane borrows from its guard bit where it is at least a's.
            apart = (((other.extent | GUARDS) - extent) & GUARDS) ^ GUARDS
            # Other columns; columns in which, along a side, neither box begins: the pair counts in another one;
            # boxes that end before a's begins; edges not behind a, unless those count too.
            elsewhere = (other.column ^ own.column) | (((other.tag | own.tag) & 3) ^ 3)
            elsewhere |= ((other.end - key) | ((other.tag - (own.tag | 3) - 1) & behind)) >> 31
            list_out[wp.min(first + count, last)] = other.tag >> 2
            count += wp.where((apart | wp.uint64(elsewhere)) == NO_BITS, 1, 0)
            slot += 1
    return count


@wp.func
def come_near(search: Search, a: int, b: int) -> bool:
    """Whether two edges may come within their reaches and rooms while their nodes move.

    Seen in the moving frame, their distance changes by no more than their ends move against each other.
    """
    motion = search.motion
    a0 = search.start[a] - motion.from_
    a1 = search.start[a + 1] - motion.from_
    b0 = search.start[b] - motion.from_
    b1 = search.start[b + 1] - motion.from_
    c0 = motion.turn_back * (search.end[a] - motion.to)
    c1 = motion.turn_back * (search.end[a + 1] - motion.to)
    d0 = motion.turn_back * (search.end[b] - motion.to)
    d1 = motion.turn_back * (search.end[b + 1] - motion.to)
    u0 = c0 - a0
    u1 = c1 - a1
    v0 = d0 - b0
    v1 = d1 - b1
    fastest = largest_shift(u0, u1, v0, v1)
    limit = motion.widen * (search.edges.reach[a] + search.edges.reach[b])
    limit += motion.widen * (room_of_edge(search.edges, a) + room_of_edge(search.edges, b))
    if motion.bulge > wp.float64(0.0):
        limit += motion.bulge * wp.max(wp.length(u0), wp.length(u1)) + motion.bulge * wp.max(
            wp.length(v0), wp.length(v1)
        )
    at_start = distance_of_edges(a0, a1, b0, b1)
    if at_start - fastest > limit:
        return False
    return at_start + distance_of_edges(c0, c1, d0, d1) - fastest <= wp.float64(2.0) * limit


@wp.func
def keep_partners(search: Search, a: int, first: int, count: int, list_out: wp.array(dtype=wp.int32)) -> int:
    """How many of `count` candidates of edge a are its partners; sorts them to the front.

    Of two edges that are both sought again the first one lists the other.
    """
    begin = search.edges.first_node[search.edges.strand[a]]
    end = search.edges.first_node[search.edges.strand[a] + 1]
    prescribed = search.edges.prescribed[a] == 1
    kept = int(first)
    for candidate in range(first, first + count):
        b = list_out[candidate]
        meets = b >= end or b < begin
        low = wp.min(a, b)
        high = wp.max(a, b)
        if not meets:
            meets = high > low + 1 and may_meet_itself(search.edges, search.start, search.end, low, high)
        elif prescribed:
            meets = search.edges.prescribed[b] == 0
        if b < a and meets:
            meets = search.sought[b] == 0
        if meets and search.near_only:
            meets = come_near(search, low, high)
        if meets:
            slot = int(kept)
            while slot > first and list_out[slot - 1] > b:
                list_out[slot] = list_out[slot - 1]
                slot -= 1
            list_out[slot] = b
            kept += 1
    return kept - first


@wp.kernel(enable_backward=False)
def list_partners(first: int, search: Search, partners_out: Partners):
    chunk = first + wp.tid()
    begin = partners_out.room[chunk]
    last = partners_out.room[chunk + 1] - 1
    slot = begin
    missing = wp.int32(0)
    for edge in range(chunk * CHUNK, wp.min((chunk + 1) * CHUNK, search.node_count)):
        count = wp.int32(0)
        if not search.again or search.sought[edge] != 0:
            count = gather_candidates(search, edge, slot, last, partners_out.edge)
        partners_out.first[edge] = slot
        if slot + count > last:
            missing += count
        else:
            kept = keep_partners(search, edge, slot, count, partners_out.edge)
            partners_out.count[edge] = kept
            slot += kept
    partners_out.needed[chunk] = wp.where(missing > 0, slot - begin + missing + 1, 0)


@wp.kernel(enable_backward=False)
def write_pairs(
    first: int,
    partners: Partners,
    first_pair: wp.array(dtype=wp.int32),
    pairs_out: wp.array(dtype=wp.vec2i),
):
    """Pairs in the order of their edges."""
    edge = first + wp.tid()
    begin = first_pair[edge]
    for k in range(partners.count[edge]):
        other = partners.edge[partners.first[edge] + k]
        pairs_out[begin + k] = wp.vec2i(edge, other)


@wp.kernel(enable_backward=False)
def number_pairs(
    first: int,
    pairs: wp.array(dtype=wp.vec2i),
    second_out: wp.array(dtype=wp.int32),
    number_out: wp.array(dtype=wp.int32),
):
    """The pairs' second edges and their numbers, to be sorted."""
    pair = first + wp.tid()
    second_out[pair] = pairs[pair][1]
    number_out[pair] = pair


@wp.kernel(enable_backward=False)
def find_seconds(
    first: int, count: int, second: wp.array(dtype=wp.int32), first_second_out: wp.array(dtype=wp.int32)
):
    """How many of the sorted second edges lie before each edge. Item k for edges from one second to the next."""
    item = first + wp.tid()
    begin = wp.int32(0)
    end = first_second_out.shape[0]
    if item > 0:
        begin = second[item - 1] + 1
    if item < count:
        end = second[item] + 1
    for edge in range(begin, end):
        first_second_out[edge] = item


@wp.kernel(enable_backward=False)
def write_incident(
    first: int,
    first_pair: wp.array(dtype=wp.int32),
    first_second: wp.array(dtype=wp.int32),
    number: wp.array(dtype=wp.int32),
    first_out: wp.array(dtype=wp.int32),
    incident_out: wp.array(dtype=wp.int32),
):
    """Each edge's pairs: those it is second in, then those it is first in."""
    edge = first + wp.tid()
    slot = first_pair[edge] + first_second[edge]
    first_out[edge + 1] = first_pair[edge + 1] + first_second[edge + 1]
    for k in range(first_second[edge], first_second[edge + 1]):
        incident_out[slot] = 2 * number[k] + 1
        slot += 1
    for pair in range(first_pair[edge], first_pair[edge + 1]):
        incident_out[slot] = 2 * pair
        slot += 1
