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
def where_nearest(p: Segment, q: Segment) -> wp.vec2d:
    """How far along two edges they are nearest to each other, as parts of them; beyond both where parallel."""
    u = p.b - p.a
    v = q.b - q.a
    w = p.a - q.a
    uu = wp.length_sq(u)
    vv = wp.length_sq(v)
    uv = wp.dot(u, v)
    square = uu * vv - uv * uv
    if square <= PARALLEL * PARALLEL * uu * vv:
        return wp.vec2d(-ONE, -ONE)
    s = (uv * wp.dot(v, w) - vv * wp.dot(u, w)) / square
    t = (uu * wp.dot(v, w) - uv * wp.dot(u, w)) / square
    return wp.vec2d(s, t)


@wp.func
def is_within(part: wp.float64, edge: Segment, depth: wp.float64) -> bool:
    """What touches near the end of an edge is found by its corner."""
    end = HALF * depth / wp.length(edge.b - edge.a)
    return part >= end and part <= ONE - end


@wp.func
def outwards(p: Segment, q: Segment, n: wp.vec3d, height: wp.float64) -> wp.float64:
    """1 where n leads out of q's body, else -1: by its faces, or where it is round by the side that p is on."""
    out = -(q.into_1 + q.into_2)
    if wp.length_sq(out) == ZERO:
        out = p.into_1 + p.into_2
    toward = height
    if wp.length_sq(out) > ZERO:
        toward = wp.dot(n, out)
    return wp.where(toward < ZERO, -ONE, ONE)


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
    depth = least_margin(finder.geoms, a, b)
    at = where_nearest(p, q)
    if not is_within(at[0], p, depth) or not is_within(at[1], q, depth):
        return
    on_p = p.a + at[0] * (p.b - p.a)
    on_q = q.a + at[1] * (q.b - q.a)
    n = wp.normalize(wp.cross(p.b - p.a, q.b - q.a))
    height = wp.dot(n, on_p - on_q)
    sign = outwards(p, q, n, height)
    n = sign * n
    height = sign * height
    if not leaves(q, n) or not leaves(p, -n):
        return
    gap = height - p.radius - q.radius - finder.geoms.thickness[a] - finder.geoms.thickness[b]
    if gap < -depth - finder.boxes.travel[a] - finder.boxes.travel[b]:
        return
    place = Place()
    place.x = on_p
    place.way = p.way_a + at[0] * (p.way_b - p.way_a)
    surface = Side()
    surface.normal = n
    surface.gap = gap
    surface.core = on_q
    surface.foot = on_q + q.radius * n
    surface.way = q.way_a + at[1] * (q.way_b - q.way_a)
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
