"""One node against one moving surface over a substep: what it crosses, what it is near, which way is out."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import (
    INSIDE,
    ONE,
    ZERO,
    closest_point,
    get_triangle,
    interpolate,
    triangle_frame,
    unit_normal,
)
from plait.solver.contact.meeting_kernels import HALF, TWO, Bodies, ContactNodes, Near, follow, is_rim, to_float

wp.set_module_options({"enable_backward": False})

QUARTER = wp.constant(wp.float64(0.25))
# Closer to a surface than this part of the radius, the direction to it is noise: its normal is taken.
NOISE = wp.constant(wp.float64(1e-2))
# Where the ways out at a node's start and end differ by more (cosine), that where they first touched is taken.
TURNED = wp.constant(wp.float64(0.5))


@wp.struct
class Seen:
    """The triangle of a surface nearest to where a node starts."""

    triangle: int  # -1: none near enough to matter
    inside: bool  # by the angle-weighted normal there (Baerentzen and Aanaes 2005)


@wp.struct
class Memory:
    """The nearest triangle of a node's start, kept for the passes of a substep; one surface a node."""

    body: wp.array(dtype=wp.int32)  # (node_count,) -1: none
    triangle: wp.array(dtype=wp.int32)
    inside: wp.array(dtype=wp.int32)


@wp.func
def look_from(memory: Memory, bodies: Bodies, body: int, node: int, start: wp.vec3d, search: wp.float64) -> Seen:
    """The nearest triangle within `search` [m] of `start`, remembered or sought."""
    seen = Seen()
    if memory.body[node] == body:
        seen.triangle = memory.triangle[node]
        seen.inside = memory.inside[node] == 1
        return seen
    seen.triangle = -1
    query = wp.mesh_query_point_sign_normal(bodies.mesh_start[body], to_float(start), float(search))
    if query.result:
        seen.triangle = bodies.first_triangle[body] + query.face
        seen.inside = query.sign < 0.0
        memory.body[node] = body
        memory.triangle[node] = seen.triangle
        memory.inside[node] = wp.where(seen.inside, 1, 0)
    return seen


@wp.struct
class Begun:
    """Where a node's start is at the end pose, carried along by the surface."""

    place: wp.vec3d  # [m]
    foot: wp.vec3d  # [m] the nearest point of the surface, carried along
    outward: wp.vec3d  # unit, from the foot to the side that the node belongs on
    distance: wp.float64  # [m] from the foot
    inside: bool
    side: wp.float64  # 1: the triangle's normal points to the node, -1: away; 0: not told by a face


@wp.func
def carry(bodies: Bodies, near: Near, seen: Seen, start: wp.vec3d, full: wp.float64) -> Begun:
    """Carries a node's start from the start pose to the end pose."""
    begun = Begun()
    before = get_triangle(bodies.triangles, bodies.points_start, seen.triangle)
    after = get_triangle(bodies.triangles, bodies.points_end, seen.triangle)
    nearest = closest_point(before, start)
    normal_before = unit_normal(before)
    normal_after = unit_normal(after)
    offset = start - interpolate(before, nearest.weights)
    begun.distance = wp.length(offset)
    # Within an edge's length the triangle's own frame carries; further out its turning says little.
    turn = near.rotation
    if begun.distance <= wp.length(before.b - before.a):
        if wp.length_sq(normal_before) > ZERO and wp.length_sq(normal_after) > ZERO:
            turn = triangle_frame(after, normal_after) * wp.transpose(triangle_frame(before, normal_before))
    begun.foot = interpolate(after, nearest.weights)
    begun.place = begun.foot + turn * offset
    begun.inside = near.keeps_out and seen.inside and not is_rim(bodies, seen.triangle, nearest.feature)
    side = wp.where(wp.dot(offset, normal_before) < ZERO, -ONE, ONE)
    outward = wp.where(near.keeps_out, normal_before, side * normal_before)
    if begun.distance > NOISE * full:
        outward = wp.where(begun.inside, -offset, offset) / begun.distance
    begun.outward = turn * outward
    begun.side = wp.where(nearest.feature == INSIDE, side, ZERO)
    return begun


@wp.struct
class Contact:
    """One node against one surface over a substep."""

    found: bool
    overtaken: bool  # the surface passed over the node: its carried start is on the wrong side
    normal: wp.vec3d  # out of the surface, unit
    point: wp.vec3d  # [m] on the surface, at the end pose
    target: wp.float64  # [m] distance to keep from `point` along `normal`
    anchor: wp.vec3d  # [m] the start position carried along by the surface
    depth: wp.float64  # [m] how deep inside the node is at the end; 0 outside


@wp.func
def first_hit(bodies: Bodies, body: int, start: wp.vec3d, end: wp.vec3d) -> int:
    """The triangle first crossed between two points at the end pose, or -1."""
    way = end - start
    length = wp.length(way)
    if length <= ZERO:
        return -1
    query = wp.mesh_query_ray(bodies.mesh_end[body], to_float(start), to_float(way / length), float(length))
    if query.result:
        return bodies.first_triangle[body] + query.face
    return -1


@wp.func
def find_crossing(
    bodies: Bodies, body: int, keeps_out: bool, begun: Begun, end: wp.vec3d, full: wp.float64, contact: Contact
) -> Contact:
    """The triangle that the way from the carried start to the end goes through, if any."""
    # From no nearer than half the radius, so that rounding cannot put the ray's start behind the surface.
    origin = begun.foot + begun.outward * HALF * full
    lifted = begun.foot + begun.outward * wp.max(begun.distance, HALF * full)
    hit = wp.int32(-1)
    # Another part of the surface may have come between the nearest triangle and the node.
    if begun.distance > full:
        hit = first_hit(bodies, body, origin, lifted)
    overtaken = hit >= 0
    if not overtaken:
        origin = lifted
        hit = first_hit(bodies, body, lifted, end)
    if hit >= 0:
        struck = get_triangle(bodies.triangles, bodies.points_end, hit)
        normal = unit_normal(struck)
        facing = wp.dot(origin - struck.a, normal)
        if not keeps_out and facing < ZERO:
            normal = -normal
            facing = -facing
        # A solid left through its back face was only entered by rounding.
        if facing > ZERO:
            contact.found = True
            contact.overtaken = overtaken
            contact.normal = normal
            contact.point = end - wp.dot(end - struck.a, normal) * normal
            contact.depth = wp.max(wp.dot(struck.a - end, normal), ZERO)
    return contact


@wp.func
def find_nearest(
    bodies: Bodies,
    body: int,
    keeps_out: bool,
    side: wp.float64,
    end: wp.vec3d,
    full: wp.float64,
    look: wp.float64,
    contact: Contact,
) -> Contact:
    """The point of the surface nearest to the end, within `look` [m]; out is away from it, or its normal."""
    query = wp.mesh_query_point_sign_normal(bodies.mesh_end[body], to_float(end), float(look))
    if not query.result:
        return contact
    index = bodies.first_triangle[body] + query.face
    triangle = get_triangle(bodies.triangles, bodies.points_end, index)
    nearest = closest_point(triangle, end)
    contact.point = interpolate(triangle, nearest.weights)
    normal = unit_normal(triangle)
    away = end - contact.point
    gap = wp.length(away)
    inside = keeps_out and query.sign < 0.0 and not is_rim(bodies, index, nearest.feature)
    if not keeps_out:
        # Deformation may have carried the surface over the node without a crossing.
        if side == ZERO:
            side = wp.where(wp.dot(away, normal) < ZERO, -ONE, ONE)
        normal = side * normal
        inside = nearest.feature == INSIDE and wp.dot(away, normal) < ZERO
    contact.normal = normal
    if gap > NOISE * full:
        contact.normal = wp.where(inside, -away, away) / gap
    contact.depth = wp.where(inside, gap, ZERO)
    # Only a triangle without area that is touched exactly leaves no direction.
    contact.found = wp.length_sq(contact.normal) > ZERO
    return contact


@wp.func
def find_touch(bodies: Bodies, body: int, begun: Begun, end: wp.vec3d, contact: Contact) -> Contact:
    """The contact where the node first came as near as it may, by the distances at both ends of its way.

    It is taken where it is more like the surface that the node came from, and the node goes through it.
    """
    height = wp.dot(contact.normal, end - contact.point)
    part = wp.clamp((begun.distance - contact.target) / (begun.distance - height), ZERO, ONE)
    touch = begun.place + part * (end - begun.place)
    query = wp.mesh_query_point_sign_normal(bodies.mesh_end[body], to_float(touch), float(TWO * begun.distance))
    if query.result:
        index = bodies.first_triangle[body] + query.face
        triangle = get_triangle(bodies.triangles, bodies.points_end, index)
        point = interpolate(triangle, closest_point(triangle, touch).weights)
        normal = wp.normalize(touch - point)
        nearer = wp.dot(normal, begun.outward) > wp.dot(contact.normal, begun.outward)
        if nearer and wp.dot(normal, end - point) < contact.target:
            contact.normal = normal
            contact.point = point
    return contact


@wp.func
def find_contact(
    bodies: Bodies,
    body: int,
    near: Near,
    seen: Seen,
    start: wp.vec3d,
    end: wp.vec3d,
    radius: wp.float64,
    clearance: wp.float64,
    exit_distance: wp.float64,
) -> Contact:
    """The plane a node must stay beyond, if any, going from `start` (start pose) to `end` (end pose).

    The start is carried along by the surface; from there a ray to the end, at the end pose, finds what was crossed
    however fast body and node moved; else the nearest point decides. A surface that keeps out (a solid, or the one
    the strand grows on) has an inside; on any other surface a node stays on the side it was on.

    seen: what of the surface is nearest to `start`.
    exit_distance: [m] what starts nearer than asked, or inside, gains no more than this.
    """
    contact = Contact()
    full = radius + bodies.thickness[body]
    begun = carry(bodies, near, seen, start, full)
    moved = wp.length(end - begun.place)
    relative = wp.length(end - follow(near, start))
    look = TWO * full + QUARTER * moved
    began = wp.where(begun.inside, -begun.distance, begun.distance)
    contact.anchor = begun.place
    contact.target = wp.min(wp.min(full, clearance), began + exit_distance)
    if begun.inside:
        return find_nearest(
            bodies, body, near.keeps_out, begun.side, end, full, look + begun.distance + moved, contact
        )
    # No part of the surface can have come nearer to the node's way than this.
    if begun.distance - near.deviation > relative + look:
        return contact
    if wp.max(moved, relative) + TWO * near.deviation >= begun.distance:
        contact = find_crossing(bodies, body, near.keeps_out, begun, end, full, contact)
    if not contact.found:
        contact = find_nearest(bodies, body, near.keeps_out, begun.side, end, full, look, contact)
    if contact.found and not contact.overtaken and begun.distance > contact.target:
        if wp.dot(contact.normal, begun.outward) < TURNED:
            if wp.dot(contact.normal, end - contact.point) < contact.target:
                contact = find_touch(bodies, body, begun, end, contact)
    return contact


@wp.func
def node_contact(
    bodies: Bodies,
    body: int,
    near: Near,
    nodes: ContactNodes,
    memory: Memory,
    strand: int,
    node: int,
    start: wp.vec3d,
    end: wp.vec3d,
    depth: wp.float64,
    exit_distance: wp.float64,
) -> Contact:
    radius = nodes.radius[node]
    search = (
        TWO * (radius + bodies.thickness[body]) + wp.length(end - follow(near, start)) + near.deviation + depth
    )
    seen = look_from(memory, bodies, body, node, start, search)
    if seen.triangle < 0:
        return Contact()
    return find_contact(bodies, body, near, seen, start, end, radius, nodes.clearance[node], exit_distance)
