"""Points of soft skins against moving surfaces: the planes they must stay beyond, and on which side."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import (
    ONE,
    ZERO,
    Triangle,
    closest_point,
    get_triangle,
    interpolate,
    triangle_frame,
    unit_normal,
)
from plait.solver.contact.meeting_kernels import HALF, TWO, Bodies, Near, box_gap, is_rim, to_float
from plait.solver.contact.plane_slots import find_slot
from plait.solver.contact.search_kernels import Contact, Seen, find_contact

wp.set_module_options({"enable_backward": False})

# Planes of a point: a floor and two walls.
SLOTS = wp.constant(3)
# What was torn has contact again when it is stretched no more than this.
LOOSE = wp.constant(wp.float64(1.5))
# A plane found anew carries on the forces of one of the same surface that differs less (cosine).
ALIKE = wp.constant(wp.float64(0.7))


@wp.struct
class ObstaclePlanes:
    """Half-spaces that points must stay in, plane k of point q at q * SLOTS + k; world frame.

    Those of the substep before tell where a point belongs that went under: `depth` along `normal`, however thin
    the surface is there.
    """

    surface: wp.array(dtype=wp.int32)  # index into Scene.surfaces; -1: no plane
    normal: wp.array(dtype=wp.vec3d)  # unit, out of the surface
    offset: wp.array(dtype=wp.float64)  # [m] the point keeps normal . x >= offset
    ground: wp.array(dtype=wp.float64)  # [m] normal . x of the surface itself
    rebound: wp.array(dtype=wp.float64)  # [m] further than `offset`, by which an impact ends the substep
    depth: wp.array(dtype=wp.float64)  # [m] how far under that the point was left; not negative
    anchor: wp.array(dtype=wp.vec3d)  # [m] where the point would be, had the surface carried it along
    shift: wp.array(dtype=wp.vec3d)  # [m] by which the surface, of a rigid body, has given way: all goes with it
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient
    pressure: wp.array(dtype=wp.float64)  # [N] along the normal, at the substep's end
    traction: wp.array(dtype=wp.vec3d)  # [N] friction
    let_go: wp.array(dtype=wp.int32)  # 1 at a point's first plane: it is torn, and has no contact till it is not


@wp.struct
class SkinPoints:
    """Points of skins that may touch something; each moves with the nodes of one tet."""

    nodes: wp.array(dtype=wp.vec4i)
    weights: wp.array(dtype=wp.vec4d)  # rows sum to one
    rest: wp.array(dtype=wp.vec3d)  # (node_count,) [m]
    reach: wp.array(dtype=wp.float64)  # [m] distance kept from surfaces, beside their thickness; 0: no contact
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient; negative: not told
    mass: wp.array(dtype=wp.float64)  # [kg]
    frequency: wp.array(dtype=wp.float64)  # [1/s] of the elastic elements around it
    restitution: wp.array(dtype=wp.float64)


@wp.func
def point_at(points: SkinPoints, q: int, x: wp.array(dtype=wp.vec3d)) -> wp.vec3d:
    nodes = points.nodes[q]
    weights = points.weights[q]
    at = weights[0] * x[nodes[0]]
    for k in range(1, 4):
        at += weights[k] * x[nodes[k]]
    return at


@wp.func
def stretch_at(points: SkinPoints, q: int, x: wp.array(dtype=wp.vec3d)) -> wp.float64:
    """The largest ratio of an edge's length to that at rest, in the tet that the point lies in."""
    nodes = points.nodes[q]
    most = ZERO
    for a in range(4):
        for b in range(a + 1, 4):
            length = wp.length(x[nodes[b]] - x[nodes[a]])
            most = wp.max(most, length / wp.length(points.rest[nodes[b]] - points.rest[nodes[a]]))
    return most


@wp.func
def deepest_slot(planes: ObstaclePlanes, q: int, surface: int) -> int:
    """The plane of a surface that the point was left furthest under, or kept; -1 for none."""
    found = wp.int32(-1)
    deepest = -ONE
    for k in range(SLOTS):
        at = q * SLOTS + k
        if planes.surface[at] == surface and planes.depth[at] > deepest:
            deepest = planes.depth[at]
            found = at
    return found


@wp.func
def carried_by(before: Triangle, after: Triangle, weights: wp.vec3d, deviation: wp.float64) -> Near:
    """The motion of a place on a triangle; without a turn where that has no area."""
    near = Near()
    near.meets = True
    near.centre = interpolate(before, weights)
    near.shift = interpolate(after, weights) - near.centre
    near.rotation = wp.identity(n=3, dtype=wp.float64)
    normal_before = unit_normal(before)
    normal_after = unit_normal(after)
    if wp.length_sq(normal_before) > ZERO and wp.length_sq(normal_after) > ZERO:
        near.rotation = triangle_frame(after, normal_after) * wp.transpose(triangle_frame(before, normal_before))
    near.deviation = deviation
    return near


@wp.func
def led_back(
    bodies: Bodies,
    body: int,
    start: wp.vec3d,
    end: wp.vec3d,
    out: wp.vec3d,
    depth: wp.float64,
    full: wp.float64,
    exit_distance: wp.float64,
) -> Contact:
    """The contact of a point that was left `depth` [m] under a surface, `out` of which it belongs.

    The surface that it went through, wherever that is carried, leads it back. Not found where there is none: the
    point has come by its rim.
    """
    contact = Contact()
    foot = start + depth * out
    query = wp.mesh_query_point_no_sign(bodies.mesh_start[body], to_float(foot), float(full + HALF * depth))
    if not query.result:
        return contact
    index = bodies.first_triangle[body] + query.face
    before = get_triangle(bodies.triangles, bodies.points_start, index)
    after = get_triangle(bodies.triangles, bodies.points_end, index)
    normal_before = unit_normal(before)
    normal_after = unit_normal(after)
    if wp.length_sq(normal_before) == ZERO or wp.length_sq(normal_after) == ZERO:
        return contact
    place = closest_point(before, foot)
    foot = interpolate(before, place.weights)
    turn = triangle_frame(after, normal_after) * wp.transpose(triangle_frame(before, normal_before))
    contact.found = True
    contact.point = interpolate(after, place.weights)
    contact.normal = turn * out
    contact.anchor = contact.point + turn * (start - foot)
    contact.target = wp.min(full, exit_distance - wp.dot(contact.normal, contact.point - contact.anchor))
    contact.depth = wp.max(wp.dot(contact.normal, contact.point - end), ZERO)
    return contact


@wp.func
def meet_surface(
    bodies: Bodies,
    body: int,
    start: wp.vec3d,
    end: wp.vec3d,
    full: wp.float64,
    travel: wp.float64,
    known: bool,
    exit_distance: wp.float64,
) -> Contact:
    """The plane that one surface sets a point that goes from `start` (start pose) to `end` (end pose), if any.

    travel: [m] no point of the surface moves further.  known: the point was seen outside before. One that starts
    inside a solid without that has no contact with it.
    """
    search = TWO * full + wp.length(end - start) + TWO * travel
    query = wp.mesh_query_point_sign_normal(bodies.mesh_start[body], to_float(start), float(search))
    if not query.result:
        return Contact()
    seen = Seen()
    seen.triangle = bodies.first_triangle[body] + query.face
    seen.inside = query.sign < 0.0
    before = get_triangle(bodies.triangles, bodies.points_start, seen.triangle)
    after = get_triangle(bodies.triangles, bodies.points_end, seen.triangle)
    nearest = closest_point(before, start)
    solid = bodies.solid[body] == 1
    if solid and seen.inside and not known and not is_rim(bodies, seen.triangle, nearest.feature):
        return Contact()
    near = carried_by(before, after, nearest.weights, TWO * travel)
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
    """Puts a contact in force; its place, or -1 where the point keeps it and has a plane of that surface."""
    offset = wp.dot(contact.normal, contact.point) + contact.target
    found = find_slot(q * SLOTS, SLOTS, planes.surface, planes.normal, planes.offset, surface, contact.normal, end)
    slot = found.at
    if not found.refines:
        if found.known and offset - wp.dot(contact.normal, end) <= tolerance:
            return -1
        planes.pressure[slot] = ZERO
        planes.traction[slot] = wp.vec3d()
        planes.rebound[slot] = ZERO
    planes.surface[slot] = surface
    planes.normal[slot] = contact.normal
    planes.offset[slot] = offset
    planes.ground[slot] = offset - contact.target
    planes.anchor[slot] = contact.anchor
    planes.shift[slot] = wp.vec3d()
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
    first_point: int,
    anew: int,
    bodies: Bodies,
    travel: wp.array(dtype=wp.float64),
    points: SkinPoints,
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    exit_distance: wp.float64,
    before: ObstaclePlanes,
    planes: ObstaclePlanes,
):
    """Planes of points from `first_point` on, one an item; `anew` forgets those already found in this substep.

    start, end: (node_count,) [m].  before: of the substep before."""
    q = first_point + first + wp.tid()
    if anew == 1:
        for k in range(SLOTS):
            planes.surface[q * SLOTS + k] = -1
        planes.let_go[q * SLOTS] = 0
        if before.let_go[q * SLOTS] == 1 and stretch_at(points, q, start) > LOOSE:
            planes.let_go[q * SLOTS] = 1
    if points.reach[q] <= ZERO or planes.let_go[q * SLOTS] == 1:
        return
    x = point_at(points, q, start)
    y = point_at(points, q, end)
    for body in range(bodies.count):
        full = points.reach[q] + bodies.thickness[body]
        if box_gap(wp.min(x, y), wp.max(x, y), bodies.lower[body], bodies.upper[body]) <= TWO * full:
            surface = bodies.surface[body]
            known = deepest_slot(before, q, surface)
            contact = Contact()
            if known >= 0:
                if before.depth[known] > ZERO:
                    contact = led_back(
                        bodies, body, x, y, before.normal[known], before.depth[known], full, exit_distance
                    )
            if not contact.found:
                contact = meet_surface(bodies, body, x, y, full, travel[body], known >= 0, exit_distance)
            if contact.found:
                friction = pair_friction(points, q, bodies, body)
                slot = put(planes, q, surface, contact, y, friction, wp.float64(0.1) * full)
                if slot >= 0 and anew == 1:
                    carry_on(before, q, planes, slot)
