"""Two edges: their closest points, and when they first touch as their ends move along straight lines.

Edge a joins points a0 and a1, edge b joins b0 and b1, float64 [m]. Only differences of the points are used, so
nothing here loses accuracy far from the scene's origin or in a fast common motion.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))
HALF = wp.constant(wp.float64(0.5))
ONE = wp.constant(wp.float64(1.0))
# Weight of the middles in the closest points, a part of the edges' squared lengths: edges less than about its root
# [rad] from parallel meet in the middle of their overlap.
PARALLEL = wp.constant(wp.float64(1.0e-4))
# Edges whose squared sine is below this are parallel as far as rounding allows to tell.
FLAT = wp.constant(wp.float64(1.0e-24))
# Rounding of a triple product of differences, a part of the product of their lengths: 64 half ulps at most
# (Shewchuk 1997, orient3d, and the sums of three).
TRIPLE_ROUNDING = wp.constant(wp.float64(1.0e-14))
# Rounding of positions and gaps, a part of the pair's size.
ROUNDING = wp.constant(wp.float64(1.0e-14))
# No first touch can be told of edges that start closer together than this part of their size.
NO_GAP = wp.constant(wp.float64(1.0e-12))
# A first touch is found when the gap left is within this part of the distance asked for.
NEAR_ENOUGH = wp.constant(wp.float64(0.1))
MAX_ADVANCES = wp.constant(256)
NEVER = wp.constant(wp.float64(2.0))
# What is drawn nearer than this part of its radii cannot be told from what is drawn through each other.
DRAWN_THROUGH = wp.constant(wp.float64(0.05))


@wp.func
def unit_clamp(x: wp.float64) -> wp.float64:
    return wp.clamp(x, ZERO, ONE)


@wp.func
def closest_on_edges(a0: wp.vec3d, a1: wp.vec3d, b0: wp.vec3d, b1: wp.vec3d) -> wp.vec2d:
    """Parameters (s, t) in [0, 1] of the edges' closest points, smooth through parallel edges.

    The exact minimiser of |d|^2 + PARALLEL (|a|^2 (s - 1/2)^2 + |b|^2 (t - 1/2)^2) over the square, a strictly
    convex quadratic: s and t are continuous, and smooth but for the clamps. The squared distance of these points
    is at most PARALLEL (|a|^2 + |b|^2) / 4 above the edges' own; parallel edges take the middle between their
    middles, that of the overlap if they are equally long. An edge without length gives 1/2.
    """
    u = a1 - a0
    v = b1 - b0
    w = b0 + HALF * v - a0 - HALF * u  # from middle to middle
    uu = wp.dot(u, u)
    vv = wp.dot(v, v)
    if uu == ZERO or vv == ZERO:
        return closest_of_point_and_edge(u, v, w, uu, vv)
    uv = wp.dot(u, v)
    stiff_u = uu * (ONE + PARALLEL)
    stiff_v = vv * (ONE + PARALLEL)
    uw = wp.dot(u, w)
    vw = wp.dot(v, w)
    # In p = s - 1/2, q = t - 1/2: stiff_u p - uv q = uw, stiff_v q - uv p = -vw.
    p = wp.clamp((uw * stiff_v - uv * vw) / (stiff_u * stiff_v - uv * uv), -HALF, HALF)
    q = (uv * p - vw) / stiff_v
    if wp.abs(q) > HALF:
        q = wp.clamp(q, -HALF, HALF)
        p = wp.clamp((uv * q + uw) / stiff_u, -HALF, HALF)
    return wp.vec2d(HALF + p, HALF + q)


@wp.func
def least_distance(between: wp.vec3d, u: wp.vec3d, v: wp.vec3d) -> wp.float64:
    """The least that edges u and v can be apart whose `closest_on_edges` are `between` apart."""
    weight = wp.float64(0.25) * PARALLEL * (wp.length_sq(u) + wp.length_sq(v))
    return wp.sqrt(wp.max(wp.length_sq(between) - weight, ZERO))


@wp.func
def largest_shift(a0: wp.vec3d, a1: wp.vec3d, b0: wp.vec3d, b1: wp.vec3d) -> wp.float64:
    """The most that points of two edges move against each other, whose ends move by a0, a1, b0, b1."""
    of_first = wp.max(wp.length_sq(a0 - b0), wp.length_sq(a0 - b1))
    return wp.sqrt(wp.max(of_first, wp.max(wp.length_sq(a1 - b0), wp.length_sq(a1 - b1))))


@wp.func
def closest_of_point_and_edge(u: wp.vec3d, v: wp.vec3d, w: wp.vec3d, uu: wp.float64, vv: wp.float64) -> wp.vec2d:
    """As `closest_on_edges` where one edge, or both, are a point."""
    p = ZERO
    q = ZERO
    if uu > ZERO:
        p = wp.clamp(wp.dot(u, w) / (uu * (ONE + PARALLEL)), -HALF, HALF)
    if vv > ZERO:
        q = wp.clamp(-wp.dot(v, w) / (vv * (ONE + PARALLEL)), -HALF, HALF)
    return wp.vec2d(HALF + p, HALF + q)


@wp.func
def closest_on_edge(p: wp.vec3d, a0: wp.vec3d, u: wp.vec3d) -> wp.float64:
    """Parameter in [0, 1] of the point of the edge a0 + s u closest to p; 1/2 for an edge without length."""
    uu = wp.dot(u, u)
    s = HALF
    if uu > ZERO:
        s = unit_clamp(wp.dot(p - a0, u) / uu)
    return s


@wp.func
def exactly_closest(a0: wp.vec3d, a1: wp.vec3d, b0: wp.vec3d, b1: wp.vec3d) -> wp.vec2d:
    """Parameters (s, t) in [0, 1] of the edges' closest points; of parallel edges, of some that are as close."""
    u = a1 - a0
    v = b1 - b0
    w = b0 - a0
    across = wp.cross(u, v)
    sine = wp.dot(across, across)
    if sine > FLAT * wp.dot(u, u) * wp.dot(v, v):
        # Through the cross product: the determinant by dot products would lose half the digits.
        s = unit_clamp(wp.dot(wp.cross(w, v), across) / sine)
        t = closest_on_edge(a0 + s * u, b0, v)
        return wp.vec2d(closest_on_edge(b0 + t * v, a0, u), t)
    best = wp.vec2d(ZERO, closest_on_edge(a0, b0, v))
    other = wp.vec2d(ONE, closest_on_edge(a1, b0, v))
    if wp.length_sq(w + other[1] * v - other[0] * u) < wp.length_sq(w + best[1] * v - best[0] * u):
        best = other
    other = wp.vec2d(closest_on_edge(b0, a0, u), ZERO)
    if wp.length_sq(w + other[1] * v - other[0] * u) < wp.length_sq(w + best[1] * v - best[0] * u):
        best = other
    other = wp.vec2d(closest_on_edge(b1, a0, u), ONE)
    if wp.length_sq(w + other[1] * v - other[0] * u) < wp.length_sq(w + best[1] * v - best[0] * u):
        best = other
    return best


@wp.func
def vector_between_edges(a0: wp.vec3d, a1: wp.vec3d, b0: wp.vec3d, b1: wp.vec3d) -> wp.vec3d:
    """The shortest vector [m] from edge a to edge b, exact to about 1e-12 of their lengths."""
    place = exactly_closest(a0, a1, b0, b1)
    return b0 - a0 + place[1] * (b1 - b0) - place[0] * (a1 - a0)


@wp.func
def distance_of_edges(a0: wp.vec3d, a1: wp.vec3d, b0: wp.vec3d, b1: wp.vec3d) -> wp.float64:
    """The edges' distance [m], exact to about 1e-12 of their lengths."""
    return wp.length(vector_between_edges(a0, a1, b0, b1))


@wp.func
def triple(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.float64:
    return wp.dot(a, wp.cross(b, c))


@wp.func
def stay_on_one_side(
    w: wp.vec3d, u: wp.vec3d, v: wp.vec3d, w_end: wp.vec3d, u_end: wp.vec3d, v_end: wp.vec3d
) -> bool:
    """Whether the vectors, moving linearly, surely never come to lie in one plane.

    True where the Bernstein coefficients of the cubic w . (u x v) all have one sign, rounding included.
    """
    third = ONE / wp.float64(3.0)
    start = triple(w, u, v)
    end = triple(w_end, u_end, v_end)
    early = third * (triple(w_end, u, v) + triple(w, u_end, v) + triple(w, u, v_end))
    late = third * (triple(w, u_end, v_end) + triple(w_end, u, v_end) + triple(w_end, u_end, v))
    largest = wp.max(wp.dot(w, w), wp.dot(w_end, w_end)) * wp.max(wp.dot(u, u), wp.dot(u_end, u_end))
    rounding = TRIPLE_ROUNDING * wp.sqrt(largest * wp.max(wp.dot(v, v), wp.dot(v_end, v_end)))
    lowest = wp.min(wp.min(start, end), wp.min(early, late))
    highest = wp.max(wp.max(start, end), wp.max(early, late))
    return lowest > rounding or highest < -rounding


@wp.func
def may_cross(
    a0: wp.vec3d,
    a1: wp.vec3d,
    b0: wp.vec3d,
    b1: wp.vec3d,
    a0_end: wp.vec3d,
    a1_end: wp.vec3d,
    b0_end: wp.vec3d,
    b1_end: wp.vec3d,
) -> bool:
    """False only if the edges surely stay apart while their ends move linearly: quick, not sharp.

    They do if they are never coplanar (`stay_on_one_side`), or if, seen from a0, the boxes they sweep are apart.
    """
    if stay_on_one_side(b0 - a0, a1 - a0, b1 - b0, b0_end - a0_end, a1_end - a0_end, b1_end - b0_end):
        return False
    # Positions from a0, which rests; a point's path is then a segment too.
    a = a1 - a0
    a_end = a1_end - a0_end
    b = b0 - a0
    c = b1 - a0
    b_end = b0_end - a0_end
    c_end = b1_end - a0_end
    lower = wp.min(wp.min(b, b_end), wp.min(c, c_end)) - wp.max(wp.vec3d(), wp.max(a, a_end))
    upper = wp.max(wp.max(b, b_end), wp.max(c, c_end)) - wp.min(wp.vec3d(), wp.min(a, a_end))
    # Rounding of a difference is a part of itself: it cannot make a box end on the other side of another by more.
    slack = ROUNDING * (wp.max(wp.max(wp.abs(lower)), wp.max(wp.abs(upper))))
    return wp.max(lower) <= slack and wp.min(upper) >= -slack


@wp.func
def lasting_gap(n: wp.vec3d, from_: wp.vec3d, to: wp.vec3d, time: wp.float64, floor: wp.float64) -> wp.float64:
    """Until when n . r exceeds `floor`, `time` or later; r moves linearly from `from_` at 0 to `to` at 1."""
    start = wp.dot(n, from_) - floor
    change = wp.dot(n, to - from_)
    until = NEVER
    if start + change <= ZERO:
        until = time
        if start + time * change > ZERO:
            until = -start / change
    return until


@wp.func
def first_touch(
    a0: wp.vec3d,
    a1: wp.vec3d,
    b0: wp.vec3d,
    b1: wp.vec3d,
    a0_end: wp.vec3d,
    a1_end: wp.vec3d,
    b0_end: wp.vec3d,
    b1_end: wp.vec3d,
    least: wp.float64,
) -> wp.float64:
    """A time in [0, 1] before which the edges stay `least` [m] apart and from which they may not; 2 if they do.

    Additive continuous detection (Li et al. 2021, Codimensional IPC, section 4.4), with its bound on the approach
    taken along the shortest vector between the edges instead of in all directions (Mirtich 1996): the edges stay
    apart as long as their four pairs of ends do along that vector, and each of those gaps is linear in time. Never
    later than the true touch: where iterations run out, the time reached so far is the answer. Edges that start
    nearer than twice `least` are kept half their starting distance apart; those that touch at the start give 0.
    """
    r00 = b0 - a0
    r01 = b1 - a0
    r10 = b0 - a1
    r11 = b1 - a1
    e00 = b0_end - a0_end
    e01 = b1_end - a0_end
    e10 = b0_end - a1_end
    e11 = b1_end - a1_end
    u = a1 - a0
    u_end = a1_end - a0_end
    between = vector_between_edges(wp.vec3d(), u, r00, r01)
    distance = wp.length(between)
    size = wp.max(wp.length(r00), wp.length(e00)) + wp.max(wp.length(r11), wp.length(e11))
    size += wp.max(wp.length(u), wp.length(u_end))
    if distance <= NO_GAP * size:
        return ZERO
    floor = wp.min(least, HALF * distance)
    safe = floor + ROUNDING * size
    time = ZERO
    for _ in range(MAX_ADVANCES):
        n = between / distance
        until = lasting_gap(n, r00, e00, time, safe)
        until = wp.min(until, lasting_gap(n, r01, e01, time, safe))
        until = wp.min(until, lasting_gap(n, r10, e10, time, safe))
        until = wp.min(until, lasting_gap(n, r11, e11, time, safe))
        if until > ONE:
            return NEVER
        near = distance - safe <= NEAR_ENOUGH * floor or distance <= NO_GAP * size
        if near or until <= time:
            return time
        time = until
        rest = ONE - time
        between = vector_between_edges(
            wp.vec3d(), rest * u + time * u_end, rest * r00 + time * e00, rest * r01 + time * e01
        )
        distance = wp.length(between)
        if distance == ZERO:
            return time
    return time


@wp.func
def drawn_through(radius: wp.array(dtype=wp.float64), a: int, b: int, drawn: wp.float64) -> bool:
    """Whether edges a and b, `drawn` [m] apart by the artist, are so deep in each other that neither has a side.

    radius: (node_count,) [m].
    """
    return drawn < DRAWN_THROUGH * (wp.min(radius[a], radius[a + 1]) + wp.min(radius[b], radius[b + 1]))
