"""Contacts of edges that cross."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.motion_kernels import HALF, ONE, ZERO
from plait.solver.rigid.nearest_kernels import Side
from plait.solver.rigid.put_kernels import Place, least_margin, put_contact
from plait.solver.rigid.types import Finder

wp.set_module_options({"enable_backward": False})

# Sine of the angle between edges below which they count as parallel: their ends then tell.
PARALLEL = wp.constant(wp.float64(1e-3))
# Sine by which a direction may lean into a face and still count as out at its edge: where two faces lie on each
# other, their edges cross at the corners of what they share, whichever way these lean by rounding.
LEANING = wp.constant(wp.float64(0.03))


@wp.struct
class Segment:
    """An edge at the substep's start, world."""

    a: wp.vec3d  # [m]
    b: wp.vec3d
    way_a: wp.vec3d  # [m] in the substep, of an animated surface
    way_b: wp.vec3d
    into_1: wp.vec3d  # along its faces, across it; zero for none
    into_2: wp.vec3d
    radius: wp.float64  # [m]


@wp.func
def vertex_at(finder: Finder, body: int, i: int) -> wp.vec3d:
    if body < 0:
        return finder.animated.points_start[i]
    return finder.motion.position[body] + wp.quat_rotate(finder.motion.orientation[body], finder.geoms.vertices[i])


@wp.func
def segment_at(finder: Finder, a: int, e: int) -> Segment:
    out = Segment()
    edge = finder.geoms.edges[e]
    body = finder.geoms.body[a]
    out.a = vertex_at(finder, body, edge[0])
    out.b = vertex_at(finder, body, edge[1])
    out.radius = finder.geoms.edge_radius[e]
    if body < 0:
        out.way_a = finder.animated.points_end[edge[0]] - out.a
        out.way_b = finder.animated.points_end[edge[1]] - out.b
    along = wp.normalize(out.b - out.a)
    if edge[2] >= 0:
        into = vertex_at(finder, body, edge[2]) - out.a
        out.into_1 = into - wp.dot(into, along) * along
    if edge[3] >= 0:
        into = vertex_at(finder, body, edge[3]) - out.a
        out.into_2 = into - wp.dot(into, along) * along
    return out


@wp.func
def leaves(edge: Segment, n: wp.vec3d) -> bool:
    """Whether a direction goes out at an edge between its faces."""
    return wp.dot(n, edge.into_1) <= LEANING * wp.length(edge.into_1) and wp.dot(n, edge.into_2) <= (
        LEANING * wp.length(edge.into_2)
    )


@wp.func
def cross_edges(
    finder: Finder,
    a: int,
    b: int,
    pair: int,
    p: Segment,
    q: Segment,
):
    """The contact of two edges where they are nearest to each other, if that is within both."""
    u = p.b - p.a
    v = q.b - q.a
    w = p.a - q.a
    uu = wp.length_sq(u)
    vv = wp.length_sq(v)
    uv = wp.dot(u, v)
    square = uu * vv - uv * uv
    if square <= PARALLEL * PARALLEL * uu * vv:
        return
    s = (uv * wp.dot(v, w) - vv * wp.dot(u, w)) / square
    t = (uu * wp.dot(v, w) - uv * wp.dot(u, w)) / square
    depth = least_margin(finder.geoms, a, b)
    # What touches near the end of an edge is found by its corner.
    end_p = HALF * depth / wp.sqrt(uu)
    end_q = HALF * depth / wp.sqrt(vv)
    if s < end_p or s > ONE - end_p or t < end_q or t > ONE - end_q:
        return
    on_p = p.a + s * u
    on_q = q.a + t * v
    n = wp.normalize(wp.cross(u, v))
    height = wp.dot(n, on_p - on_q)
    # Out of b: by its faces, or where it is round by the side that a is on.
    out = -(q.into_1 + q.into_2)
    if wp.length_sq(out) == ZERO:
        out = p.into_1 + p.into_2
    sign = wp.where(height < ZERO, -ONE, ONE)
    if wp.length_sq(out) > ZERO:
        sign = wp.where(wp.dot(n, out) < ZERO, -ONE, ONE)
    n = sign * n
    height = sign * height
    if not leaves(q, n) or not leaves(p, -n):
        return
    gap = height - p.radius - q.radius - finder.geoms.thickness[a] - finder.geoms.thickness[b]
    if gap < -depth - finder.boxes.travel[a] - finder.boxes.travel[b]:
        return
    place = Place()
    place.x = on_p
    place.way = p.way_a + s * (p.way_b - p.way_a)
    surface = Side()
    surface.normal = n
    surface.gap = gap
    surface.core = on_q
    surface.foot = on_q + q.radius * n
    surface.way = q.way_a + t * (q.way_b - q.way_a)
    put_contact(finder, a, b, -1 - pair, place, -p.radius * n, surface)


@wp.func
def meet_edges(
    finder: Finder,
    a: int,
    b: int,
):
    """Contacts of edges of geom a with edges of geom b that they cross."""
    lower = wp.max(finder.boxes.lower[a], finder.boxes.lower[b])
    upper = wp.min(finder.boxes.upper[a], finder.boxes.upper[b])
    count_b = finder.geoms.first_edge[b + 1] - finder.geoms.first_edge[b]
    for i in range(finder.geoms.first_edge[a], finder.geoms.first_edge[a + 1]):
        p = segment_at(finder, a, i)
        grown = wp.vec3d(p.radius, p.radius, p.radius)
        clear_p = wp.max(wp.min(p.a, p.b) - grown - upper, lower - wp.max(p.a, p.b) - grown)
        if wp.max(clear_p) <= ZERO:
            for j in range(finder.geoms.first_edge[b], finder.geoms.first_edge[b + 1]):
                q = segment_at(finder, b, j)
                grown_q = wp.vec3d(q.radius, q.radius, q.radius)
                clear_q = wp.max(wp.min(q.a, q.b) - grown_q - upper, lower - wp.max(q.a, q.b) - grown_q)
                if wp.max(clear_q) <= ZERO:
                    pair = (i - finder.geoms.first_edge[a]) * count_b + j - finder.geoms.first_edge[b]
                    cross_edges(finder, a, b, pair, p, q)
