"""Pairs of edges whose swept boxes overlap: columns of boxes, swept along the third axis.

Every edge is entered in each column of a square grid across one axis that its box meets; the entries are sorted by
column, then by where their boxes begin along that axis. An edge finds its partners among the entries before and
behind its own in each of its columns. A pair may meet in several columns: it counts in the one that holds the
lower corner of the boxes' intersection. Columns are numbered modulo the table's size, so that the table stays
small; the boxes' own test tells columns apart that share a place.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# Edges between which a strand is as straight as this (chord over length), at start and end, are no pair.
STRAIGHT = wp.constant(wp.float64(0.9))
# Rounding of a coordinate to float32, generously.
TO_FLOAT = wp.constant(wp.float64(2.0e-7))
LARGEST_COLUMN = wp.constant(1.0e9)
FAR = wp.constant(1.0e30)
# Entries of an item that takes the running maximum.
RUN = wp.constant(1024)


@wp.struct
class Edges:
    """What is constant: edge k joins nodes k and k + 1."""

    first_node: wp.array(dtype=wp.int32)  # (strand_count + 1,)
    strand: wp.array(dtype=wp.int32)  # (node_count,) of node and edge
    reach: wp.array(dtype=wp.float64)  # (node_count,) [m] half of what an edge keeps another at
    along: wp.array(dtype=wp.float64)  # (node_count,) [m] drawn length from the strand's first node
    prescribed: wp.array(dtype=wp.int32)  # (node_count,) 1: both of the edge's nodes are


@wp.struct
class Motion:
    """The strands' common motion over the substep, x to turn_back^T (x - from_) + to, and what is left of it."""

    from_: wp.vec3d  # [m]
    to: wp.vec3d  # [m]
    turn_back: wp.mat33d
    bulge: wp.float64  # how far a path leaves its chord in the moving frame, a part of the chord
    widen: wp.float64  # of distances, seen in the moving frame
    margin: wp.float64  # [m] half of what is to be found beyond the reaches


@wp.struct
class Boxes:
    """Swept boxes of the edges in the moving frame [m], float32 rounded outwards; empty: upper below lower."""

    lower: wp.array(dtype=wp.vec3f)  # (node_count,)
    upper: wp.array(dtype=wp.vec3f)


@wp.struct
class StrandBoxes:
    """The same of whole strands."""

    lower: wp.array(dtype=wp.vec3f)  # (strand_count,)
    upper: wp.array(dtype=wp.vec3f)
    extent: wp.array(dtype=wp.vec3f)  # [m] summed over the strand's edges
    turning: wp.array(dtype=wp.int32)  # 1: the strand turns enough to meet itself


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
class Entries:
    """Edges in columns, sorted by key."""

    key: wp.array(dtype=wp.int32)  # (entry_count,)
    edge: wp.array(dtype=wp.int32)
    lower: wp.array(dtype=wp.vec3f)
    upper: wp.array(dtype=wp.vec3f)
    furthest: wp.array(dtype=wp.int32)  # the largest key at which this box or one before it ends
    place: wp.array(dtype=wp.int32)  # (entry_count,) of the entries as they were numbered, edge after edge
    first: wp.array(dtype=wp.int32)  # (node_count + 1,) of an edge's own, as numbered


@wp.func
def box_of_path(x: wp.vec3d, x_end: wp.vec3d, motion: Motion, reach: wp.float64):
    """(lower, upper) [m] of a node's path in the moving frame, padded."""
    y = x - motion.from_
    y_end = motion.turn_back * (x_end - motion.to)
    size = wp.max(wp.max(wp.abs(y)), wp.max(wp.abs(y_end)))
    pad = motion.bulge * wp.length(y_end - y) + motion.widen * (reach + motion.margin) + TO_FLOAT * size
    pads = wp.vec3d(pad, pad, pad)
    return wp.vec3f(wp.min(y, y_end) - pads), wp.vec3f(wp.max(y, y_end) + pads)


@wp.func
def turns(edges: Edges, x: wp.array(dtype=wp.vec3d), root: int, tip: int) -> bool:
    """Whether any edge leaves the cone about the strand's chord in which a strand cannot meet itself."""
    axis = wp.normalize(x[tip] - x[root])
    for k in range(root, tip):
        if not wp.dot(axis, x[k + 1] - x[k]) >= STRAIGHT * (edges.along[k + 1] - edges.along[k]):
            return True
    return False


@wp.kernel(enable_backward=False)
def bound_strands(
    first: int,
    edges: Edges,
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    motion: Motion,
    boxes_out: Boxes,
    strands_out: StrandBoxes,
):
    strand = first + wp.tid()
    root = edges.first_node[strand] + 1
    tip = edges.first_node[strand + 1] - 1
    empty = wp.vec3f(FAR, FAR, FAR)
    strand_lower = empty
    strand_upper = -empty
    extent = wp.vec3f()
    for k in range(root, tip):
        # Both ends with the edge's reach: it is the larger of its nodes'.
        lower, upper = box_of_path(start[k], end[k], motion, edges.reach[k])
        lower_b, upper_b = box_of_path(start[k + 1], end[k + 1], motion, edges.reach[k])
        lower = wp.min(lower, lower_b)
        upper = wp.max(upper, upper_b)
        if wp.isfinite(lower) and wp.isfinite(upper):
            boxes_out.lower[k] = lower
            boxes_out.upper[k] = upper
            strand_lower = wp.min(strand_lower, lower)
            strand_upper = wp.max(strand_upper, upper)
            extent += upper - lower
        else:
            boxes_out.lower[k] = empty
            boxes_out.upper[k] = -empty
    strands_out.lower[strand] = strand_lower
    strands_out.upper[strand] = strand_upper
    strands_out.extent[strand] = extent
    strands_out.turning[strand] = wp.where(turns(edges, start, root, tip) or turns(edges, end, root, tip), 1, 0)


@wp.func
def column_of(columns: Columns, x: float, side: int) -> int:
    """Number of the column along one side, not yet modulo the table's."""
    along = (x - columns.origin[columns.across[side]]) * columns.per_column[side]
    return int(wp.clamp(along, 0.0, LARGEST_COLUMN))


@wp.func
def span(columns: Columns, lower: wp.vec3f, upper: wp.vec3f, side: int) -> wp.vec2i:
    """(first column, how many) that a box meets along one side; no more than the table has."""
    axis = columns.across[side]
    low = column_of(columns, lower[axis], side)
    return wp.vec2i(low, wp.min(column_of(columns, upper[axis], side) - low + 1, 1 << columns.bits[side]))


@wp.func
def place_of(columns: Columns, u: int, v: int) -> int:
    """A column's place in the table."""
    return ((v & ((1 << columns.bits[1]) - 1)) << columns.bits[0]) | (u & ((1 << columns.bits[0]) - 1))


@wp.func
def key_of(columns: Columns, place: int, x: float) -> int:
    """Sorts by place, then along the sweep axis; monotone in x [m]."""
    last = (1 << columns.sweep_bits) - 1
    step = (x - columns.origin[columns.sweep]) * columns.per_step
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
        count = span(columns, lower, upper, 0)[1] * span(columns, lower, upper, 1)[1]
    count_out[edge] = count


@wp.kernel(enable_backward=False)
def write_entries(
    first: int,
    columns: Columns,
    boxes: Boxes,
    first_entry: wp.array(dtype=wp.int32),
    key_out: wp.array(dtype=wp.int32),
    number_out: wp.array(dtype=wp.int32),
    edge_out: wp.array(dtype=wp.int32),
):
    """Entries as numbered: an edge's together, its columns u after u."""
    edge = first + wp.tid()
    begin = first_entry[edge]
    if begin == first_entry[edge + 1]:
        return
    lower = boxes.lower[edge]
    upper = boxes.upper[edge]
    u = span(columns, lower, upper, 0)
    v = span(columns, lower, upper, 1)
    for j in range(v[1]):
        for i in range(u[1]):
            entry = begin + j * u[1] + i
            place = place_of(columns, u[0] + i, v[0] + j)
            key_out[entry] = key_of(columns, place, lower[columns.sweep])
            number_out[entry] = entry
            edge_out[entry] = edge


@wp.kernel(enable_backward=False)
def gather_entries(
    first: int,
    number: wp.array(dtype=wp.int32),
    edge: wp.array(dtype=wp.int32),
    boxes: Boxes,
    entries_out: Entries,
):
    """What the search needs of each sorted entry, side by side in memory."""
    slot = first + wp.tid()
    entry = number[slot]
    k = edge[entry]
    entries_out.edge[slot] = k
    entries_out.lower[slot] = boxes.lower[k]
    entries_out.upper[slot] = boxes.upper[k]
    entries_out.place[entry] = slot


@wp.func
def end_key(columns: Columns, entries: Entries, slot: int) -> int:
    return key_of(columns, entries.key[slot] >> columns.sweep_bits, entries.upper[slot][columns.sweep])


@wp.kernel(enable_backward=False)
def end_runs(first: int, columns: Columns, count: int, entries: Entries, last_out: wp.array(dtype=wp.int32)):
    """The largest key at which a box of a run of entries ends."""
    run = first + wp.tid()
    last = wp.int32(0)
    for slot in range(run * RUN, wp.min((run + 1) * RUN, count)):
        last = wp.max(last, end_key(columns, entries, slot))
    last_out[run] = last


@wp.kernel(enable_backward=False)
def find_furthest(first: int, columns: Columns, count: int, last: wp.array(dtype=wp.int32), entries_out: Entries):
    """Running maximum of where boxes end. Keys of other columns are out of the way by themselves."""
    run = first + wp.tid()
    furthest = wp.int32(0)
    for before in range(run):
        furthest = wp.max(furthest, last[before])
    for slot in range(run * RUN, wp.min((run + 1) * RUN, count)):
        furthest = wp.max(furthest, end_key(columns, entries_out, slot))
        entries_out.furthest[slot] = furthest


@wp.func
def overlap(a_lower: wp.vec3f, a_upper: wp.vec3f, b_lower: wp.vec3f, b_upper: wp.vec3f) -> bool:
    return (
        a_lower[0] <= b_upper[0]
        and b_lower[0] <= a_upper[0]
        and a_lower[1] <= b_upper[1]
        and b_lower[1] <= a_upper[1]
        and a_lower[2] <= b_upper[2]
        and b_lower[2] <= a_upper[2]
    )


@wp.func
def owns(columns: Columns, place: int, a_lower: wp.vec3f, b_lower: wp.vec3f) -> bool:
    """Whether a column is the one in which two overlapping boxes count."""
    u = columns.across[0]
    v = columns.across[1]
    column = column_of(columns, wp.max(a_lower[u], b_lower[u]), 0)
    return place == place_of(columns, column, column_of(columns, wp.max(a_lower[v], b_lower[v]), 1))


@wp.func
def straight_between(edges: Edges, x: wp.array(dtype=wp.vec3d), a: int, b: int) -> bool:
    return wp.length(x[b + 1] - x[a]) >= STRAIGHT * (edges.along[b + 1] - edges.along[a])


@wp.func
def may_meet(edges: Edges, start: wp.array(dtype=wp.vec3d), end: wp.array(dtype=wp.vec3d), p: int, q: int) -> bool:
    """Whether two edges whose boxes overlap are a pair at all."""
    if edges.prescribed[p] == 1 and edges.prescribed[q] == 1:
        return False
    if edges.strand[p] != edges.strand[q]:
        return True
    a = wp.min(p, q)
    b = wp.max(p, q)
    if b - a < 2 or edges.along[b] - edges.along[a + 1] < edges.reach[a] + edges.reach[b]:
        return False
    return not (straight_between(edges, start, a, b) and straight_between(edges, end, a, b))


@wp.struct
class Search:
    """What a search among the entries reads."""

    edges: Edges
    columns: Columns
    entries: Entries
    start: wp.array(dtype=wp.vec3d)
    end: wp.array(dtype=wp.vec3d)
    entry_count: int


@wp.func
def is_partner(search: Search, a: int, slot: int, place: int, lower: wp.vec3f, upper: wp.vec3f) -> bool:
    if not overlap(lower, upper, search.entries.lower[slot], search.entries.upper[slot]):
        return False
    if not owns(search.columns, place, lower, search.entries.lower[slot]):
        return False
    return may_meet(search.edges, search.start, search.end, a, search.entries.edge[slot])


@wp.func
def insert(list: wp.array(dtype=wp.int32), first: int, count: int, value: int):
    """`value` into the ascending run of `count` entries that begins at `first`."""
    slot = first + count
    while slot > first and list[slot - 1] > value:
        list[slot] = list[slot - 1]
        slot -= 1
    list[slot] = value


@wp.func
def find_partners(
    search: Search, boxes: Boxes, a: int, listing: bool, first: int, list_out: wp.array(dtype=wp.int32)
) -> wp.vec2i:
    """(partners of edge a, those of them behind it); writes them in ascending order if `listing`."""
    count = wp.int32(0)
    behind = wp.int32(0)
    lower = boxes.lower[a]
    upper = boxes.upper[a]
    for entry in range(search.entries.first[a], search.entries.first[a + 1]):
        own = search.entries.place[entry]
        key = search.entries.key[own]
        place = key >> search.columns.sweep_bits
        until = key_of(search.columns, place, upper[search.columns.sweep])
        slot = own + 1
        while slot < search.entry_count and search.entries.key[slot] <= until:
            if is_partner(search, a, slot, place, lower, upper):
                b = search.entries.edge[slot]
                if listing:
                    insert(list_out, first, count, b)
                count += 1
                behind += wp.where(b > a, 1, 0)
            slot += 1
        slot = own - 1
        while slot >= 0 and search.entries.furthest[slot] >= key:
            if is_partner(search, a, slot, place, lower, upper):
                b = search.entries.edge[slot]
                if listing:
                    insert(list_out, first, count, b)
                count += 1
                behind += wp.where(b > a, 1, 0)
            slot -= 1
    return wp.vec2i(count, behind)


@wp.kernel(enable_backward=False)
def count_partners(
    first: int,
    search: Search,
    boxes: Boxes,
    count_out: wp.array(dtype=wp.int32),
    behind_out: wp.array(dtype=wp.int32),
):
    edge = first + wp.tid()
    found = find_partners(search, boxes, edge, False, 0, count_out)
    count_out[edge] = found[0]
    behind_out[edge] = found[1]


@wp.kernel(enable_backward=False)
def list_partners(
    first: int,
    search: Search,
    boxes: Boxes,
    first_partner: wp.array(dtype=wp.int32),
    partner_out: wp.array(dtype=wp.int32),
):
    edge = first + wp.tid()
    if first_partner[edge] < first_partner[edge + 1]:
        find_partners(search, boxes, edge, True, first_partner[edge], partner_out)


@wp.kernel(enable_backward=False)
def number_pairs(
    first: int,
    first_partner: wp.array(dtype=wp.int32),
    partner: wp.array(dtype=wp.int32),
    first_pair: wp.array(dtype=wp.int32),
    pairs_out: wp.array(dtype=wp.vec2i),
    incident_out: wp.array(dtype=wp.int32),
):
    """Pairs in the order of their first edges; each edge's own, in the order of its partners."""
    edge = first + wp.tid()
    pair = first_pair[edge]
    for slot in range(first_partner[edge], first_partner[edge + 1]):
        other = partner[slot]
        if other > edge:
            pairs_out[pair] = wp.vec2i(edge, other)
            incident_out[slot] = 2 * pair
            pair += 1
        else:
            # The other's pairs are numbered from its last partners backwards.
            last = first_partner[other + 1] - 1
            rank = wp.int32(0)
            while partner[last - rank] != edge:
                rank += 1
            incident_out[slot] = 2 * (first_pair[other + 1] - 1 - rank) + 1
