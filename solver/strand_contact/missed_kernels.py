"""Whether two edges pass through each other while their ends move linearly: by the roots of polynomials.

Edges that touch are coplanar (Provot 1997): f = w . (u x v) vanishes, for the edges' vectors u, v and w from one's
first end to the other's, a cubic in time. Its roots are bracketed by its extrema and found by bisection; at each
the edges' distance decides. Values below their rounding (bounded as in Bridson et al. 2002) count as roots. Edges
that move in one plane all the while touch first where an end of one meets the other: roots of quadratics.
"""

from __future__ import annotations

import warp as wp

from plait.solver.strand_contact.crossing_kernels import (
    HALF,
    ONE,
    ZERO,
    distance_of_edges,
    drawn_through,
    triple,
)

wp.set_module_options({"enable_backward": False})

TWO = wp.constant(wp.float64(2.0))
THREE = wp.constant(wp.float64(3.0))
# Edges nearer than this part of their length touch.
TOUCHING = wp.constant(wp.float64(1.0e-9))
# Rounding of f, a part of the lengths' product, whose factors it sums in 6 terms of some 10 operations.
ROUNDING = wp.constant(wp.float64(1.0e-14))
BISECTIONS = wp.constant(60)


@wp.struct
class MovingPair:
    """Ends of two edges seen from the first end of the first, at the start and at the end [m]."""

    u: wp.vec3d
    u_end: wp.vec3d
    p: wp.vec3d
    p_end: wp.vec3d
    q: wp.vec3d
    q_end: wp.vec3d


@wp.func
def moved(start: wp.vec3d, end: wp.vec3d, t: wp.float64) -> wp.vec3d:
    return (ONE - t) * start + t * end


@wp.func
def touch_at(pair: MovingPair, t: wp.float64) -> bool:
    """Whether the edges touch at time t; never outside of [0, 1]."""
    if not (t >= ZERO and t <= ONE):
        return False
    u = moved(pair.u, pair.u_end, t)
    p = moved(pair.p, pair.p_end, t)
    q = moved(pair.q, pair.q_end, t)
    return distance_of_edges(wp.vec3d(), u, p, q) <= TOUCHING * (wp.length(u) + wp.length(q - p))


@wp.func
def coplanarity(pair: MovingPair, t: wp.float64) -> wp.float64:
    p = moved(pair.p, pair.p_end, t)
    return triple(p, moved(pair.u, pair.u_end, t), moved(pair.q, pair.q_end, t) - p)


@wp.func
def roots_of_quadratic(a: wp.float64, b: wp.float64, c: wp.float64) -> wp.vec2d:
    """Ascending roots of a x^2 + b x + c; where it has none, twice its extremum; -1 for what is not there."""
    none = -ONE
    if a == ZERO:
        if b == ZERO:
            return wp.vec2d(none, none)
        return wp.vec2d(-c / b, -c / b)
    inside = b * b - wp.float64(4.0) * a * c
    if inside <= ZERO:
        return wp.vec2d(-HALF * b / a, -HALF * b / a)
    # Without cancellation: the larger root first, the other from their product.
    half = -HALF * (b + wp.where(b < ZERO, -ONE, ONE) * wp.sqrt(inside))
    x = half / a
    y = c / half
    return wp.vec2d(wp.min(x, y), wp.max(x, y))


@wp.func
def cubic(pair: MovingPair) -> wp.vec4d:
    """Coefficients of f by powers of time."""
    w = pair.p
    u = pair.u
    v = pair.q - pair.p
    dw = pair.p_end - pair.p
    du = pair.u_end - pair.u
    dv = pair.q_end - pair.p_end - v
    linear = triple(dw, u, v) + triple(w, du, v) + triple(w, u, dv)
    square = triple(w, du, dv) + triple(dw, u, dv) + triple(dw, du, v)
    return wp.vec4d(triple(w, u, v), linear, square, triple(dw, du, dv))


@wp.func
def has_no_root(c: wp.vec4d, rounding: wp.float64) -> bool:
    """Whether the Bernstein coefficients, whose hull holds the cubic's values on [0, 1], are all of one sign."""
    early = c[0] + c[1] / THREE
    late = early + (c[1] + c[2]) / THREE
    end = c[0] + c[1] + c[2] + c[3]
    lowest = wp.min(wp.min(c[0], early), wp.min(late, end))
    highest = wp.max(wp.max(c[0], early), wp.max(late, end))
    return lowest > rounding or highest < -rounding


@wp.func
def touch_between(
    pair: MovingPair, t0: wp.float64, t1: wp.float64, f0: wp.float64, f1: wp.float64, rounding: wp.float64
) -> bool:
    """Whether the edges touch at the root between two times, if f changes sign there, or at the first time."""
    if wp.abs(f0) <= rounding and touch_at(pair, t0):
        return True
    if f0 * f1 >= ZERO:
        return False
    low = t0
    high = t1
    for _ in range(BISECTIONS):
        middle = HALF * (low + high)
        if (coplanarity(pair, middle) > ZERO) == (f0 > ZERO):
            low = middle
        else:
            high = middle
    return touch_at(pair, low) or touch_at(pair, high)


@wp.func
def end_meets(
    pair: MovingPair, r: wp.vec3d, r_end: wp.vec3d, e: wp.vec3d, e_end: wp.vec3d, flat: wp.float64
) -> bool:
    """For motion in a plane: whether the edges touch when r, from one's end to the other's, lies along that, e.

    flat: r x e below this is none; then all lies in one line, and the edges touch when r vanishes or is e.
    """
    dr = r_end - r
    de = e_end - e
    constant = wp.cross(r, e)
    linear = wp.cross(dr, e) + wp.cross(r, de)
    square = wp.cross(dr, de)
    sizes = wp.abs(constant) + wp.abs(linear) + wp.abs(square)
    axis = wp.argmax(sizes)
    times = wp.vec2d()
    if sizes[axis] > flat:
        times = roots_of_quadratic(square[axis], linear[axis], constant[axis])
    else:
        axis = wp.argmax(wp.abs(dr))
        along = wp.argmax(wp.abs(dr - de))
        times[0] = roots_of_quadratic(ZERO, dr[axis], r[axis])[0]
        times[1] = roots_of_quadratic(ZERO, dr[along] - de[along], r[along] - e[along])[0]
    return touch_at(pair, times[0]) or touch_at(pair, times[1])


@wp.func
def touch_in_plane(pair: MovingPair, size: wp.float64) -> bool:
    """The same for edges that move in one plane: an end of one then meets the other first."""
    v = pair.q - pair.p
    v_end = pair.q_end - pair.p_end
    flat = ROUNDING * size * size
    return (
        touch_at(pair, ZERO)
        or end_meets(pair, -pair.p, -pair.p_end, v, v_end, flat)
        or end_meets(pair, pair.u - pair.p, pair.u_end - pair.p_end, v, v_end, flat)
        or end_meets(pair, pair.p, pair.p_end, pair.u, pair.u_end, flat)
        or end_meets(pair, pair.q, pair.q_end, pair.u, pair.u_end, flat)
    )


@wp.func
def pass_through(pair: MovingPair) -> bool:
    """Whether the edges touch at any time in [0, 1]."""
    u_size = wp.max(wp.length(pair.u), wp.length(pair.u_end))
    v_size = wp.max(wp.length(pair.q - pair.p), wp.length(pair.q_end - pair.p_end))
    w_size = wp.max(wp.length(pair.p), wp.length(pair.p_end))
    rounding = ROUNDING * u_size * v_size * w_size
    c = cubic(pair)
    # Differences of the ends are up to twice as large as these, and a coefficient sums up to eight such products.
    if has_no_root(c, wp.float64(64.0) * rounding):
        return False
    turning = roots_of_quadratic(THREE * c[3], TWO * c[2], c[1])
    t1 = wp.clamp(turning[0], ZERO, ONE)
    t2 = wp.clamp(turning[1], ZERO, ONE)
    f0 = coplanarity(pair, ZERO)
    f1 = coplanarity(pair, t1)
    f2 = coplanarity(pair, t2)
    f3 = coplanarity(pair, ONE)
    # The extrema and both ends of a cubic bound it: if they vanish, it does.
    if wp.max(wp.max(wp.abs(f0), wp.abs(f1)), wp.max(wp.abs(f2), wp.abs(f3))) <= rounding:
        return touch_in_plane(pair, u_size + v_size + w_size)
    return (
        touch_between(pair, ZERO, t1, f0, f1, rounding)
        or touch_between(pair, t1, t2, f1, f2, rounding)
        or touch_between(pair, t2, ONE, f2, f3, rounding)
        or (wp.abs(f3) <= rounding and touch_at(pair, ONE))
    )


@wp.kernel(enable_backward=False)
def find_missed(
    first: int,
    pairs: wp.array(dtype=wp.vec2i),
    drawn: wp.array(dtype=wp.vec3d),
    radius: wp.array(dtype=wp.float64),
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    missed_out: wp.array(dtype=wp.int32),
):
    """1 for every pair of edges that passes through each other and is not `drawn` so."""
    item = first + wp.tid()
    a = pairs[item][0]
    b = pairs[item][1]
    pair = MovingPair()
    pair.u = start[a + 1] - start[a]
    pair.u_end = end[a + 1] - end[a]
    pair.p = start[b] - start[a]
    pair.p_end = end[b] - end[a]
    pair.q = start[b + 1] - start[a]
    pair.q_end = end[b + 1] - end[a]
    missed_out[item] = 0
    if pass_through(pair):
        apart = distance_of_edges(drawn[a], drawn[a + 1], drawn[b], drawn[b + 1])
        missed_out[item] = wp.where(drawn_through(radius, a, b, apart), 0, 1)
