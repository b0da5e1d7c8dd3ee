"""How curves follow guides: each guide's shape in its root's frame, and what follows it.

A place on a guide is told by its arc length from the root, at rest. There the guide's own displacement against the
rigid motion of its root is known, and a rotation: that of its edge's material frame, interpolated between the
middles of the edges and the root, which does not turn. What lies beside the guide is carried by both.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# How many guides a curve follows at most.
NEAREST = wp.constant(3)
# Of an edge's length at rest: shorter than this, guides that point apart have cancelled its direction.
CANCELLED = wp.constant(wp.float64(1.0e-3))
# One plus the cosine between directions that rounding does not tell from opposite ones.
OPPOSITE = wp.constant(wp.float64(1.0e-12))
ZERO = wp.constant(wp.float64(0.0))
HALF = wp.constant(wp.float64(0.5))
ONE = wp.constant(wp.float64(1.0))


@wp.struct
class Guides:
    """Guides at rest, in their roots' frames; arrays of guides' points unless said otherwise."""

    first: wp.array(dtype=wp.int32)  # (guide_count + 1,) each guide's first point
    shape: wp.array(dtype=wp.vec3d)  # [m] from the root
    arc: wp.array(dtype=wp.float64)  # [m] length from the root
    frame: wp.array(dtype=wp.mat33d)  # columns: along the edge that begins here, its director, across both


@wp.struct
class Bent:
    """Guides now, in their roots' frames as these are now."""

    shape: wp.array(dtype=wp.vec3d)  # [m] from the root
    turn: wp.array(dtype=wp.quatd)  # of the edge that begins here, since rest
    stretch: wp.array(dtype=wp.float64)  # of that edge: length over that at rest


@wp.struct
class Moving:
    """Where guides are at one instant, and how they go on; arrays of guides' points unless said otherwise."""

    position: wp.array(dtype=wp.vec3d)  # [m] world
    velocity: wp.array(dtype=wp.vec3d)  # [m/s] world
    director: wp.array(dtype=wp.vec3d)  # unit, world, of the edge that begins here
    rotation: wp.array(dtype=wp.mat33d)  # (guide_count,) rest space to world, of the root
    later_rotation: wp.array(dtype=wp.mat33d)  # (guide_count,) the same when `later` has passed
    later: wp.float64  # [s] after the instant


@wp.struct
class Follow:
    """Curves that follow, at rest, in their roots' frames; arrays of their points unless said otherwise."""

    first: wp.array(dtype=wp.int32)  # (curve_count + 1,) each curve's first point
    shape: wp.array(dtype=wp.vec3d)  # [m] from the root
    director: wp.array(dtype=wp.vec3d)  # unit, across the edge that begins here
    guide: wp.array2d(dtype=wp.int32)  # (curve_count, NEAREST), heaviest first
    weight: wp.array2d(dtype=wp.float64)  # (curve_count, NEAREST), rows sum to one; zero for none
    apart: wp.array2d(dtype=wp.vec3d)  # (curve_count, NEAREST) [m] from the guide's root to the curve's


@wp.func
def transported(vector: wp.vec3d, start: wp.vec3d, end: wp.vec3d) -> wp.vec3d:
    """A vector across one unit vector, turned by the smallest rotation that takes that to another.

    Between opposite ones there is no smallest; it then stays, across both.
    """
    nearness = ONE + wp.dot(start, end)
    result = vector
    if nearness > OPPOSITE:
        axis = wp.cross(start, end)
        once = wp.cross(axis, vector)
        result = vector + once + wp.cross(axis, once) / nearness
    return result


@wp.func
def framed(along: wp.vec3d, director: wp.vec3d) -> wp.mat33d:
    """Columns: a unit vector, what of the director is across it, and what is across both."""
    across = wp.normalize(director - wp.dot(director, along) * along)
    return wp.matrix_from_cols(along, across, wp.cross(along, across))


@wp.kernel
def bend_guides(first: int, guides: Guides, moving: Moving, bent_out: Bent):
    """One guide an item: its shape `moving.later` seconds on.

    Directors then have the angle that they have now to one that is carried along the guide without twist, from how
    the root is clamped: rods spin about themselves as their shape demands, and twist far less.
    """
    g = first + wp.tid()
    begin = guides.first[g]
    end = guides.first[g + 1]
    now = wp.transpose(moving.rotation[g])
    then = wp.transpose(moving.later_rotation[g])
    root = moving.position[begin] + moving.later * moving.velocity[begin]
    bent_out.shape[begin] = wp.vec3d()
    before = wp.quatd(ZERO, ZERO, ZERO, ONE)
    clamp = guides.frame[begin]
    last = wp.vec3d(clamp[0, 0], clamp[1, 0], clamp[2, 0])
    last_later = last
    level = wp.vec3d(clamp[0, 1], clamp[1, 1], clamp[2, 1])
    level_later = level
    for i in range(begin, end - 1):
        edge = moving.position[i + 1] - moving.position[i]
        later_edge = edge + moving.later * (moving.velocity[i + 1] - moving.velocity[i])
        place = moving.position[i + 1] + moving.later * moving.velocity[i + 1]
        bent_out.shape[i + 1] = then * (place - root)
        along = wp.normalize(now * edge)
        along_later = wp.normalize(then * later_edge)
        level = transported(level, last, along)
        level_later = transported(level_later, last_later, along_later)
        last = along
        last_later = along_later
        own = now * moving.director[i]
        director = wp.dot(own, level) * level_later
        director += wp.dot(own, wp.cross(along, level)) * wp.cross(along_later, level_later)
        turn = wp.quat_from_matrix(framed(along_later, director) * wp.transpose(guides.frame[i]))
        if wp.dot(turn, before) < ZERO:
            turn = -turn
        bent_out.turn[i] = turn
        bent_out.stretch[i] = wp.length(later_edge) / (guides.arc[i + 1] - guides.arc[i])
        before = turn


@wp.func
def edge_at(guides: Guides, guide: wp.int32, edge: wp.int32, arc: wp.float64) -> wp.int32:
    """The edge of the guide at an arc length, from one that is not beyond it; beyond the tip the last."""
    last = guides.first[guide + 1] - 2
    found = edge
    while found < last and arc > guides.arc[found + 1]:
        found += 1
    return found


@wp.func
def turn_at(guides: Guides, bent: Bent, guide: wp.int32, edge: wp.int32, arc: wp.float64) -> wp.quatd:
    """The guide's rotation at an arc length on an edge: none at the root, that of edges at their middles."""
    middle = HALF * (guides.arc[edge] + guides.arc[edge + 1])
    own = bent.turn[edge]
    other = own
    share = ZERO
    if arc < middle:
        start = ZERO
        other = wp.quatd(ZERO, ZERO, ZERO, ONE)
        if edge > guides.first[guide]:
            start = HALF * (guides.arc[edge - 1] + guides.arc[edge])
            other = bent.turn[edge - 1]
        share = (middle - arc) / (middle - start)
    elif edge < guides.first[guide + 1] - 2:
        end = HALF * (guides.arc[edge + 1] + guides.arc[edge + 2])
        other = bent.turn[edge + 1]
        share = (arc - middle) / (end - middle)
    return wp.normalize((ONE - share) * own + share * other)


@wp.func
def carried(
    guides: Guides, bent: Bent, guide: wp.int32, edge: wp.int32, arc: wp.float64, place: wp.vec3d
) -> wp.vec3d:
    """Where the guide takes a place, in its root's frame, from beside its own at an arc length on an edge."""
    start = guides.arc[edge]
    share = wp.min((arc - start) / (guides.arc[edge + 1] - start), ONE)
    rest = wp.lerp(guides.shape[edge], guides.shape[edge + 1], share)
    now = wp.lerp(bent.shape[edge], bent.shape[edge + 1], share)
    return now + wp.quat_rotate(turn_at(guides, bent, guide, edge, arc), place - rest)


@wp.func
def roots_of(guides: Guides, follow: Follow, curve: wp.int32) -> wp.vec3i:
    """The first edges of a curve's guides."""
    return wp.vec3i(
        guides.first[follow.guide[curve, 0]],
        guides.first[follow.guide[curve, 1]],
        guides.first[follow.guide[curve, 2]],
    )


@wp.kernel
def follow_guides(
    first: int,
    guides: Guides,
    bent: Bent,
    follow: Follow,
    root: wp.array(dtype=wp.vec3d),
    rotation: wp.array(dtype=wp.mat33d),
    position_out: wp.array(dtype=wp.vec3d),
):
    """One curve an item.

    Its points go by the weighed displacements that its guides give them; then its edges get the length they have
    at rest, times the guides' stretch, each from the end of the one before, so that guides which part do not
    shrink what is between them.
    """
    c = first + wp.tid()
    begin = follow.first[c]
    edges = roots_of(guides, follow, c)
    arc = ZERO
    meant = wp.vec3d()  # by the guides alone
    placed = wp.vec3d()
    position_out[begin] = root[c]
    for i in range(begin, follow.first[c + 1] - 1):
        edge = follow.shape[i + 1] - follow.shape[i]
        length = wp.length(edge)
        middle = arc + HALF * length
        arc += length
        goal = wp.vec3d()
        stretch = ZERO
        for k in range(NEAREST):
            weight = follow.weight[c, k]
            if weight > ZERO:
                g = follow.guide[c, k]
                at = edge_at(guides, g, edges[k], middle)
                beyond = middle > guides.arc[guides.first[g + 1] - 1]
                stretch += weight * wp.where(beyond, ONE, bent.stretch[at])
                at = edge_at(guides, g, at, arc)
                apart = follow.apart[c, k]
                goal += weight * (carried(guides, bent, g, at, arc, apart + follow.shape[i + 1]) - apart)
                edges[k] = at
        step = goal - meant
        if wp.length(step) < CANCELLED * length:
            step = wp.quat_rotate(turn_at(guides, bent, follow.guide[c, 0], edges[0], arc), edge)
        placed += (stretch * length) * wp.normalize(step)
        meant = goal
        position_out[i + 1] = root[c] + rotation[c] * placed


@wp.kernel
def turn_directors(
    first: int,
    guides: Guides,
    bent: Bent,
    follow: Follow,
    rotation: wp.array(dtype=wp.mat33d),
    director_out: wp.array(dtype=wp.vec3d),
):
    """One curve an item: the director of each edge, by the mean of the guides' rotations at its middle."""
    c = first + wp.tid()
    edges = roots_of(guides, follow, c)
    arc = ZERO
    for i in range(follow.first[c], follow.first[c + 1] - 1):
        length = wp.length(follow.shape[i + 1] - follow.shape[i])
        middle = arc + HALF * length
        arc += length
        turn = wp.quatd(ZERO, ZERO, ZERO, ZERO)
        for k in range(NEAREST):
            weight = follow.weight[c, k]
            if weight > ZERO:
                at = edge_at(guides, follow.guide[c, k], edges[k], middle)
                own = turn_at(guides, bent, follow.guide[c, k], at, middle)
                turn += weight * wp.where(wp.dot(own, turn) < ZERO, -own, own)
                edges[k] = at
        director_out[i] = rotation[c] * wp.quat_rotate(wp.normalize(turn), follow.director[i])
