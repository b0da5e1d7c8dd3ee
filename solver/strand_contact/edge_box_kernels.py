"""Swept boxes of edges and of strands in a frame that moves with the strands; which strands meet themselves."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# Rounding of a coordinate to float32, generously.
TO_FLOAT = wp.constant(wp.float64(2.0e-7))
FAR = wp.constant(1.0e30)
# Edges of a strand passed over at once, when it is asked whether it meets itself.
MOST_PASSED = wp.constant(1.0e6)


@wp.struct
class Edges:
    """What is constant: edge k joins nodes k and k + 1."""

    first_node: wp.array(dtype=wp.int32)  # (strand_count + 1,)
    strand: wp.array(dtype=wp.int32)  # (node_count,) of node and edge
    reach: wp.array(dtype=wp.float64)  # (node_count,) [m] half of what an edge keeps another at
    along: wp.array(dtype=wp.float64)  # (node_count,) [m] drawn length from the strand's first node
    prescribed: wp.array(dtype=wp.int32)  # (node_count,) 1: both of the edge's nodes are
    straight: wp.float64  # chord over drawn length from which on edges of one strand are no pair
    room: wp.array(dtype=wp.float64)  # (node_count,) [m] what is to be found beyond a node's reach
    least_room: wp.float64  # [m] of any


@wp.struct
class Motion:
    """The strands' common motion over the substep, x to turn_back^T (x - from_) + to, and what is left of it."""

    from_: wp.vec3d  # [m]
    to: wp.vec3d  # [m]
    turn_back: wp.mat33d
    bulge: wp.float64  # how far a path leaves its chord in the moving frame, a part of the chord
    widen: wp.float64  # of distances, seen in the moving frame


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
    largest: wp.array(dtype=wp.vec3f)  # [m] of its edges
    meets_itself: wp.array(dtype=wp.int32)  # 1: any two of the strand's edges are a pair


@wp.func
def room_of_edge(edges: Edges, edge: int) -> wp.float64:
    return wp.max(edges.least_room, wp.max(edges.room[edge], edges.room[edge + 1]))


@wp.func
def box_of_path(x: wp.vec3d, x_end: wp.vec3d, motion: Motion, reach: wp.float64):
    """(lower, upper) [m] of a node's path in the moving frame, padded."""
    y = x - motion.from_
    y_end = motion.turn_back * (x_end - motion.to)
    size = wp.max(wp.max(wp.abs(y)), wp.max(wp.abs(y_end)))
    pad = motion.bulge * wp.length(y_end - y) + motion.widen * reach + TO_FLOAT * size
    pads = wp.vec3d(pad, pad, pad)
    return wp.vec3f(wp.min(y, y_end) - pads), wp.vec3f(wp.max(y, y_end) + pads)


@wp.func
def may_meet_itself(
    edges: Edges, start: wp.array(dtype=wp.vec3d), end: wp.array(dtype=wp.vec3d), a: int, b: int
) -> bool:
    """Whether two edges of one strand, a before b and without a common node, are a pair.

    Not if too little strand is between them, or if it is nearly straight from one to the other all the while.
    """
    if edges.along[b] - edges.along[a + 1] < edges.reach[a] + edges.reach[b]:
        return False
    chord = start[b + 1] - start[a]
    change = end[b + 1] - end[a] - chord
    squared = wp.dot(change, change)
    if squared > wp.float64(0.0):
        # To where it is shortest.
        chord += wp.clamp(-wp.dot(chord, change) / squared, wp.float64(0.0), wp.float64(1.0)) * change
    return wp.length(chord) < edges.straight * (edges.along[b + 1] - edges.along[a])


@wp.func
def meets_itself(
    edges: Edges,
    boxes: Boxes,
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    root: int,
    tip: int,
    largest: float,
) -> bool:
    """Whether any two edges of a strand are a pair whose boxes overlap. largest: of its boxes' sides [m].

    Boxes of neighbours overlap: one that is a gap away from an edge's comes near it after gap / largest more, no
    sooner, so that many are passed over.
    """
    for a in range(root, tip - 2):
        b = wp.int32(a + 2)
        while b < tip:
            apart = wp.max(wp.max(boxes.lower[a] - boxes.upper[b]), wp.max(boxes.lower[b] - boxes.upper[a]))
            if apart <= 0.0 and may_meet_itself(edges, start, end, a, b):
                return True
            b += int(wp.clamp(apart / largest, 1.0, MOST_PASSED))
    return False


@wp.kernel(enable_backward=False)
def bound_strands(
    first: int,
    edges: Edges,
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    motion: Motion,
    with_themselves: bool,
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
    largest = wp.vec3f()
    for k in range(root, tip):
        # Both ends with the edge's reach: it is the larger of its nodes'.
        reach = edges.reach[k] + room_of_edge(edges, k)
        lower, upper = box_of_path(start[k], end[k], motion, reach)
        lower_b, upper_b = box_of_path(start[k + 1], end[k + 1], motion, reach)
        lower = wp.min(lower, lower_b)
        upper = wp.max(upper, upper_b)
        if wp.isfinite(lower) and wp.isfinite(upper):
            boxes_out.lower[k] = lower
            boxes_out.upper[k] = upper
            strand_lower = wp.min(strand_lower, lower)
            strand_upper = wp.max(strand_upper, upper)
            extent += upper - lower
            largest = wp.max(largest, upper - lower)
        else:
            boxes_out.lower[k] = empty
            boxes_out.upper[k] = -empty
    strands_out.lower[strand] = strand_lower
    strands_out.upper[strand] = strand_upper
    strands_out.extent[strand] = extent
    strands_out.largest[strand] = largest
    if with_themselves:
        meets = meets_itself(edges, boxes_out, start, end, root, tip, wp.max(largest))
        strands_out.meets_itself[strand] = wp.where(meets, 1, 0)
