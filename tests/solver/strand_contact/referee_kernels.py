"""Broad phase of the referee: pairs of edges that swept boxes, coplanarity and planes cannot keep apart."""

import warp as wp

MODULE = "plait_tests_strand_referee"
# Rounding of the coefficients below, over the largest product that goes into them.
ROUNDING = 1.0e-12


@wp.kernel(module=MODULE, enable_backward=False)
def box(
    edges: wp.array(dtype=wp.int32),
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    rounding: float,
    lower_out: wp.array(dtype=wp.vec3),
    upper_out: wp.array(dtype=wp.vec3),
):
    """The box that edge k sweeps, rounded outwards."""
    i = wp.tid()
    k = edges[i]
    low = wp.min(wp.min(start[k], start[k + 1]), wp.min(end[k], end[k + 1]))
    high = wp.max(wp.max(start[k], start[k + 1]), wp.max(end[k], end[k + 1]))
    lower_out[i] = wp.vec3(low) - wp.vec3(rounding)
    upper_out[i] = wp.vec3(high) + wp.vec3(rounding)


@wp.func(module=MODULE)
def volume(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    return wp.dot(a, wp.cross(b, c))


@wp.func(module=MODULE)
def may_cross(start: wp.array(dtype=wp.vec3d), end: wp.array(dtype=wp.vec3d), k: int, j: int):
    """Whether the volume of the two edges' tetrahedron may vanish on the way.

    It is a cubic of time; if its Bernstein coefficients have one sign, so has it. With a, b, c three sides of the
    tetrahedron, at the start (0) and end (1), they are [a0 b0 c0], ([a1 b0 c0] + [a0 b1 c0] + [a0 b0 c1]) / 3, ...
    """
    a0 = start[k + 1] - start[k]
    b0 = start[j] - start[k]
    c0 = start[j + 1] - start[k]
    a1 = end[k + 1] - end[k]
    b1 = end[j] - end[k]
    c1 = end[j + 1] - end[k]
    v0 = volume(a0, b0, c0)
    v1 = (volume(a1, b0, c0) + volume(a0, b1, c0) + volume(a0, b0, c1)) / wp.float64(3.0)
    v2 = (volume(a0, b1, c1) + volume(a1, b0, c1) + volume(a1, b1, c0)) / wp.float64(3.0)
    v3 = volume(a1, b1, c1)
    size = wp.max(wp.length(a0) * wp.length(b0) * wp.length(c0), wp.length(a1) * wp.length(b1) * wp.length(c1))
    least = wp.min(wp.min(v0, v1), wp.min(v2, v3))
    most = wp.max(wp.max(v0, v1), wp.max(v2, v3))
    margin = wp.float64(ROUNDING) * size
    return least <= margin and most >= -margin


@wp.func(module=MODULE)
def between(a: wp.vec3d, b: wp.vec3d, p: wp.vec3d, q: wp.vec3d):
    """About the shortest vector from segment a b to segment p q; exact but where both ends clamp."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    u = b - a
    v = q - p
    w = p - a
    uu = wp.dot(u, u)
    uv = wp.dot(u, v)
    vv = wp.dot(v, v)
    determinant = uu * vv - uv * uv
    s = wp.float64(0.5)
    if determinant > wp.float64(1.0e-12) * uu * vv:
        s = wp.clamp((wp.dot(u, w) * vv - wp.dot(v, w) * uv) / determinant, zero, one)
    t = wp.clamp((s * uv - wp.dot(v, w)) / vv, zero, one)
    s = wp.clamp((t * uv + wp.dot(u, w)) / uu, zero, one)
    return w + t * v - s * u


@wp.func(module=MODULE)
def apart(d: wp.vec3d, a: wp.vec3d, b: wp.vec3d, p: wp.vec3d, q: wp.vec3d):
    """Whether segment p q lies beyond segment a b in direction d."""
    gap = wp.min(wp.dot(d, p - a), wp.dot(d, p - b))
    gap = wp.min(gap, wp.min(wp.dot(d, q - a), wp.dot(d, q - b)))
    return gap > wp.float64(ROUNDING) * wp.length(d) * (wp.length(p - a) + wp.length(q - b))


@wp.func(module=MODULE)
def stay_apart(start: wp.array(dtype=wp.vec3d), end: wp.array(dtype=wp.vec3d), k: int, j: int):
    """Whether a plane of fixed direction keeps two edges apart on the whole way.

    Gaps along a fixed direction are linear in time: what holds at both ends holds between.
    """
    half = wp.float64(0.5)
    found = wp.bool(False)
    for i in range(3):
        part = half * wp.float64(i)
        rest = wp.float64(1.0) - part
        d = between(
            rest * start[k] + part * end[k],
            rest * start[k + 1] + part * end[k + 1],
            rest * start[j] + part * end[j],
            rest * start[j + 1] + part * end[j + 1],
        )
        found = found or (
            apart(d, start[k], start[k + 1], start[j], start[j + 1])
            and apart(d, end[k], end[k + 1], end[j], end[j + 1])
        )
    return found


@wp.kernel(module=MODULE, enable_backward=False)
def find(
    tree: wp.uint64,
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
    edges: wp.array(dtype=wp.int32),
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    write: bool,
    pairs_out: wp.array(dtype=wp.vec2i),
    place_out: wp.array(dtype=wp.int32),
):
    """Counts the pairs of edge i with later edges into `place_out`; or writes them from there on."""
    i = wp.tid()
    k = edges[i]
    count = wp.int32(0)
    first = wp.int32(0)
    if write:
        first = place_out[i]
    query = wp.bvh_query_aabb(tree, lower[i], upper[i])
    other = wp.int32(0)
    while wp.bvh_query_next(query, other):
        j = edges[other]
        if j > k + 1 and may_cross(start, end, k, j) and not stay_apart(start, end, k, j):
            if write:
                pairs_out[first + count] = wp.vec2i(k, j)
            count += 1
    if not write:
        place_out[i] = count
