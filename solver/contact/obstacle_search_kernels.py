"""Points of soft skins against moving surfaces: the planes they must stay beyond, and on which side."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import (
    ONE,
    ZERO,
    closest_point,
    get_triangle,
    interpolate,
    triangle_frame,
    unit_normal,
)
from plait.solver.contact.meeting_kernels import TWO, Bodies, Near, box_gap, is_rim, to_float
from plait.solver.contact.search_kernels import Contact, Seen, find_contact

wp.set_module_options({"enable_backward": False})

# Planes of a point: a floor and two walls.
SLOTS = wp.constant(3)
# Planes of one surface whose normals differ less (cosine) are the same contact, refined.
SAME = wp.constant(wp.float64(0.9995))
# What is nearest to a point that went under faces the way it came (cosine), or is the far side of something thin.
FACES = wp.constant(wp.float64(0.3))
# A plane found anew carries on the forces of one of the same surface that differs less (cosine).
ALIKE = wp.constant(wp.float64(0.7))


@wp.struct
class ObstaclePlanes:
    """Half-spaces that points must stay in, plane k of point q at q * SLOTS + k; world frame.

    Those of the substep before tell where a point belongs: on the side that `normal` points to, of surface
    `surface`, even where it has gone under, or through something thinner than that.
    """

    surface: wp.array(dtype=wp.int32)  # index into Scene.surfaces; -1: no plane
    normal: wp.array(dtype=wp.vec3d)  # unit, out of the surface
    offset: wp.array(dtype=wp.float64)  # [m] the point keeps normal . x >= offset
    anchor: wp.array(dtype=wp.vec3d)  # [m] where the point would be, had the surface carried it along
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient
    pressure: wp.array(dtype=wp.float64)  # [N] along the normal, at the substep's end
    traction: wp.array(dtype=wp.vec3d)  # [N] friction


@wp.struct
class SkinPoints:
    """Points of skins that may touch something; each moves with the nodes of one tet."""

    nodes: wp.array(dtype=wp.vec4i)
    weights: wp.array(dtype=wp.vec4d)  # rows sum to one
    reach: wp.array(dtype=wp.float64)  # [m] distance kept from surfaces, beside their thickness; 0: no contact
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient; negative: not told
    mass: wp.array(dtype=wp.float64)  # [kg]
    frequency: wp.array(dtype=wp.float64)  # [1/s] of the elastic elements around it


@wp.func
def point_at(points: SkinPoints, q: int, x: wp.array(dtype=wp.vec3d)) -> wp.vec3d:
    nodes = points.nodes[q]
    weights = points.weights[q]
    at = weights[0] * x[nodes[0]]
    for k in range(1, 4):
        at += weights[k] * x[nodes[k]]
    return at


@wp.func
def slot_of(planes: ObstaclePlanes, q: int, surface: int) -> int:
    """The first plane of a surface that the point has, or -1."""
    for k in range(SLOTS):
        if planes.surface[q * SLOTS + k] == surface:
            return q * SLOTS + k
    return -1


@wp.func
def carried_by(before: wp.vec3d, after: wp.vec3d, turn: wp.mat33d, slack: wp.float64) -> Near:
    near = Near()
    near.meets = True
    near.centre = before
    near.shift = after - before
    near.rotation = turn
    near.deviation = slack
    return near


@wp.func
def turn_of(before: wp.vec3d, after: wp.vec3d, start: wp.mat33d, end: wp.mat33d) -> wp.mat33d:
    """How a triangle turned, from its normals and frames at both ends; not at all where it has no area."""
    if wp.length_sq(before) > ZERO and wp.length_sq(after) > ZERO:
        return end * wp.transpose(start)
    return wp.identity(n=3, dtype=wp.float64)


@wp.func
def led_back(
    bodies: Bodies,
    body: int,
    triangle: int,
    foot: wp.vec3d,
    start: wp.vec3d,
    end: wp.vec3d,
    out: wp.vec3d,
    full: wp.float64,
    exit_distance: wp.float64,
) -> Contact:
    """The contact of a point that starts on the wrong side of `triangle`, which it went through at `foot`.

    out: the side it belongs on.  The triangle's plane, where the surface carries that place, leads it back.
    """
    contact = Contact()
    before = get_triangle(bodies.triangles, bodies.points_start, triangle)
    after = get_triangle(bodies.triangles, bodies.points_end, triangle)
    normal_before = unit_normal(before)
    normal_after = unit_normal(after)
    if wp.length_sq(normal_before) == ZERO or wp.length_sq(normal_after) == ZERO:
        return contact
    turn = triangle_frame(after, normal_after) * wp.transpose(triangle_frame(before, normal_before))
    place = interpolate(after, closest_point(before, foot).weights)
    contact.found = True
    contact.normal = wp.where(wp.dot(out, normal_before) < ZERO, -normal_after, normal_after)
    contact.point = place
    contact.anchor = place + turn * (start - foot)
    deep = wp.dot(contact.normal, place - contact.anchor)
    contact.target = wp.min(full, exit_distance - deep)
    contact.depth = wp.max(wp.dot(contact.normal, place - end), ZERO)
    return contact


@wp.func
def meet_surface(
    bodies: Bodies,
    body: int,
    start: wp.vec3d,
    end: wp.vec3d,
    full: wp.float64,
    travel: wp.float64,
    belongs: bool,
    out: wp.vec3d,
    exit_distance: wp.float64,
) -> Contact:
    """The plane that one surface sets a point that goes from `start` (start pose) to `end` (end pose), if any.

    travel: [m] no point of the surface moves further.  belongs: the point was known to belong on the side `out`.
    A point that starts inside a solid without having been seen outside has no contact with it.
    """
    contact = Contact()
    solid = bodies.solid[body] == 1
    search = TWO * full + wp.length(end - start) + TWO * travel
    query = wp.mesh_query_point_sign_normal(bodies.mesh_start[body], to_float(start), float(search))
    if not query.result:
        return contact
    seen = Seen()
    seen.triangle = bodies.first_triangle[body] + query.face
    before = get_triangle(bodies.triangles, bodies.points_start, seen.triangle)
    nearest = closest_point(before, start)
    foot = interpolate(before, nearest.weights)
    rim = is_rim(bodies, seen.triangle, nearest.feature)
    seen.inside = query.sign < 0.0
    normal = unit_normal(before)
    if not rim:
        if solid and seen.inside:
            if not belongs:
                return contact
            if wp.dot(normal, out) < FACES:
                # The far side of something thin: the way back is the way it came.
                ray = wp.mesh_query_ray(bodies.mesh_start[body], to_float(start), to_float(out), float(search))
                if not ray.result:
                    return contact
                through = bodies.first_triangle[body] + ray.face
                foot = start + wp.float64(ray.t) * out
                return led_back(bodies, body, through, foot, start, end, out, full, exit_distance)
        if not solid and belongs:
            side = wp.where(seen.inside, -ONE, ONE)
            if side * wp.dot(normal, out) < ZERO:
                return led_back(bodies, body, seen.triangle, foot, start, end, out, full, exit_distance)
    after = get_triangle(bodies.triangles, bodies.points_end, seen.triangle)
    normal_after = unit_normal(after)
    turn = turn_of(normal, normal_after, triangle_frame(before, normal), triangle_frame(after, normal_after))
    near = carried_by(foot, interpolate(after, nearest.weights), turn, TWO * travel)
    near.keeps_out = solid
    return find_contact(bodies, body, near, seen, start, end, full - bodies.thickness[body], full, exit_distance)


@wp.func
def put(
    planes: ObstaclePlanes,
    q: int,
    surface: int,
    contact: Contact,
    end: wp.vec3d,
    friction: wp.float64,
    tolerance: wp.float64,
) -> int:
    """Puts a contact in force; its place, or -1 where the point keeps it anyway and has a plane of that surface.

    It replaces a plane of the same surface and direction, else takes a free place, else that with most room.
    """
    offset = wp.dot(contact.normal, contact.point) + contact.target
    slot = wp.int32(-1)
    free = wp.int32(-1)
    known = wp.bool(False)
    loosest = q * SLOTS
    most_room = wp.float64(-1.0e30)
    for k in range(SLOTS):
        at = q * SLOTS + k
        if planes.surface[at] < 0:
            if free < 0:
                free = at
        else:
            if planes.surface[at] == surface:
                known = True
                if wp.dot(planes.normal[at], contact.normal) > SAME:
                    slot = at
            room = wp.dot(planes.normal[at], end) - planes.offset[at]
            if room > most_room:
                most_room = room
                loosest = at
    if slot < 0:
        if known and offset - wp.dot(contact.normal, end) <= tolerance:
            return -1
        slot = wp.where(free >= 0, free, loosest)
        planes.pressure[slot] = ZERO
        planes.traction[slot] = wp.vec3d()
    planes.surface[slot] = surface
    planes.normal[slot] = contact.normal
    planes.offset[slot] = offset
    planes.anchor[slot] = contact.anchor
    planes.friction[slot] = friction
    return slot


@wp.func
def carry_on(before: ObstaclePlanes, q: int, planes: ObstaclePlanes, slot: int):
    """A plane found anew starts with the forces of the one it continues; friction stays across its normal."""
    best = ALIKE
    found = wp.int32(-1)
    for k in range(SLOTS):
        at = q * SLOTS + k
        if before.surface[at] == planes.surface[slot]:
            alike = wp.dot(before.normal[at], planes.normal[slot])
            if alike > best:
                best = alike
                found = at
    if found >= 0:
        normal = planes.normal[slot]
        traction = before.traction[found]
        planes.pressure[slot] = before.pressure[found]
        planes.traction[slot] = traction - wp.dot(normal, traction) * normal


@wp.func
def pair_friction(points: SkinPoints, q: int, bodies: Bodies, body: int) -> wp.float64:
    """The mean of the two; where one is not told, the other's."""
    a = points.friction[q]
    b = bodies.friction[body]
    if a < ZERO:
        return b
    if b < ZERO:
        return a
    return (a + b) / TWO


@wp.kernel
def measure_travel(
    first: int,
    points: wp.array(dtype=wp.vec2i),
    points_start: wp.array(dtype=wp.vec3d),
    points_end: wp.array(dtype=wp.vec3d),
    travel_out: wp.array(dtype=wp.float64),
):
    """[m] the furthest that any of points[s][0]:points[s][1] goes in the substep; one surface s an item."""
    s = first + wp.tid()
    furthest = ZERO
    for i in range(points[s][0], points[s][1]):
        furthest = wp.max(furthest, wp.length_sq(points_end[i] - points_start[i]))
    travel_out[s] = wp.sqrt(furthest)


@wp.kernel
def find_obstacle_planes(
    first: int,
    anew: int,
    bodies: Bodies,
    travel: wp.array(dtype=wp.float64),
    points: SkinPoints,
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    exit_distance: wp.float64,
    before: ObstaclePlanes,
    planes: ObstaclePlanes,
    depth_out: wp.array(dtype=wp.float64),
):
    """Planes of every point, one an item; `anew` forgets those already found in this substep.

    start, end: (node_count,) [m].  before: of the substep before.
    depth_out: [m] how deep the point lies under surfaces at `end`.
    """
    q = first + wp.tid()
    depth_out[q] = ZERO
    if anew == 1:
        for k in range(SLOTS):
            planes.surface[q * SLOTS + k] = -1
    if points.reach[q] <= ZERO:
        return
    x = point_at(points, q, start)
    y = point_at(points, q, end)
    deepest = ZERO
    for body in range(bodies.count):
        full = points.reach[q] + bodies.thickness[body]
        if box_gap(wp.min(x, y), wp.max(x, y), bodies.lower[body], bodies.upper[body]) <= TWO * full:
            surface = bodies.surface[body]
            known = slot_of(before, q, surface)
            out = wp.vec3d()
            if known >= 0:
                out = before.normal[known]
            contact = meet_surface(bodies, body, x, y, full, travel[body], known >= 0, out, exit_distance)
            if contact.found:
                deepest = wp.max(deepest, contact.depth)
                friction = pair_friction(points, q, bodies, body)
                slot = put(planes, q, surface, contact, y, friction, wp.float64(0.1) * full)
                if slot >= 0 and anew == 1:
                    carry_on(before, q, planes, slot)
    depth_out[q] = deepest
