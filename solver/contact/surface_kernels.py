"""Strand nodes against moving triangle surfaces: contact planes, the last guard, and what is inside."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import (
    INSIDE,
    ONE,
    ZERO,
    Groups,
    closest_point,
    get_triangle,
    interpolate,
    triangle_frame,
    unit_normal,
)
from plait.solver.contact.planes import PLANES_A_NODE, ContactPlanes

wp.set_module_options({"enable_backward": False})

HALF = wp.constant(wp.float64(0.5))
TWO = wp.constant(wp.float64(2.0))
QUARTER = wp.constant(wp.float64(0.25))
# A strand's first nodes, ghost and root, are prescribed and never in contact.
PRESCRIBED = wp.constant(2)
# Closer to a surface than this part of the radius, the direction to it is noise: its normal is taken.
NOISE = wp.constant(wp.float64(1e-2))
# A plane broken by less than this part of radius and thickness needs no further solve.
TOLERANCE = wp.constant(wp.float64(0.1))
# Planes of one surface whose normals differ less (cosine) are the same contact, refined.
SAME = wp.constant(wp.float64(0.9995))
# Planes that face each other within this (cosine) share the room between them.
OPPOSED = wp.constant(wp.float64(-0.9))
GUARD_ROUNDS = wp.constant(8)
UNBOUNDED = wp.constant(wp.float64(1e30))


@wp.struct
class Bodies:
    """The surfaces in reach in this frame, one entry each; see `Colliders` for the point buffers."""

    count: int
    mesh_start: wp.array(dtype=wp.uint64)
    mesh_end: wp.array(dtype=wp.uint64)
    surface: wp.array(dtype=wp.int32)  # index into Scene.surfaces
    first_triangle: wp.array(dtype=wp.int32)
    solid: wp.array(dtype=wp.int32)  # 1: closed, with an inside that nothing belongs in
    thickness: wp.array(dtype=wp.float64)  # [m]
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient; negative leaves it to the strand
    lower: wp.array(dtype=wp.vec3d)  # [m] box over the frame
    upper: wp.array(dtype=wp.vec3d)
    first_group: wp.array(dtype=wp.int32)
    group_count: wp.array(dtype=wp.int32)
    groups: Groups
    triangles: wp.array(dtype=wp.vec3i)
    rim: wp.array(dtype=wp.int32)  # bit f set: feature f of the triangle lies on the surface's open border
    points_start: wp.array(dtype=wp.vec3d)
    points_end: wp.array(dtype=wp.vec3d)


@wp.struct
class ContactNodes:
    """What is constant of the strands."""

    first_node: wp.array(dtype=wp.int32)  # (strand_count + 1,)
    radius: wp.array(dtype=wp.float64)  # (node_count,) [m]
    clearance: wp.array(dtype=wp.float64)  # (node_count,) [m] least distance ever asked; negative: no contact
    friction: wp.array(dtype=wp.float64)  # (strand_count,)
    surface: wp.array(dtype=wp.int32)  # (strand_count,) grown on, index into Scene.surfaces


@wp.struct
class Contact:
    """One node against one surface over a substep."""

    found: bool
    hit: bool  # the surface was crossed
    normal: wp.vec3d  # out of the surface, unit
    point: wp.vec3d  # [m] on the surface, at the end pose
    target: wp.float64  # [m] distance to keep from `point` along `normal`
    anchor: wp.vec3d  # [m] the start position carried along by the surface
    depth: wp.float64  # [m] how deep inside the node is at the end; 0 outside


@wp.func
def to_float(x: wp.vec3d) -> wp.vec3f:
    return wp.vec3f(float(x[0]), float(x[1]), float(x[2]))


@wp.func
def is_rim(bodies: Bodies, triangle: int, feature: int) -> bool:
    return (bodies.rim[triangle] >> feature) & 1 == 1


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


@wp.struct
class Near:
    """A strand against a surface: whether they can meet, and how the surface moves nearby.

    The motion is x' = rotation (x - centre) + centre + shift; no part of the surface near the strand moves
    otherwise by more than `deviation`.
    """

    meets: bool
    centre: wp.vec3d  # [m]
    shift: wp.vec3d  # [m]
    rotation: wp.mat33d
    deviation: wp.float64  # [m]


@wp.func
def box_gap(lower1: wp.vec3d, upper1: wp.vec3d, lower2: wp.vec3d, upper2: wp.vec3d) -> wp.float64:
    gap = wp.max(wp.max(lower1 - upper2, lower2 - upper1), wp.vec3d())
    return wp.length(gap)


@wp.func
def follow(near: Near, x: wp.vec3d) -> wp.vec3d:
    return near.rotation * (x - near.centre) + near.centre + near.shift


@wp.func
def find_near(bodies: Bodies, body: int, lower: wp.vec3d, upper: wp.vec3d, margin: wp.float64) -> Near:
    """Against the box of a strand's start and end positions, grown by `margin`; the nearest group's motion."""
    near = Near()
    if box_gap(lower, upper, bodies.lower[body], bodies.upper[body]) > margin:
        return near
    groups = bodies.groups
    begin = bodies.first_group[body]
    end = begin + bodies.group_count[body]
    nearest = wp.int32(-1)
    least = margin
    for g in range(begin, end):
        gap = box_gap(lower, upper, groups.lower[g], groups.upper[g])
        if gap < least or (nearest < 0 and gap <= margin):
            least = gap
            nearest = g
    if nearest < 0:
        return near
    near.meets = True
    near.centre = groups.centre[nearest]
    near.shift = groups.shift[nearest]
    near.rotation = groups.rotation[nearest]
    for g in range(begin, end):
        if box_gap(lower, upper, groups.lower[g], groups.upper[g]) <= margin:
            # Two rigid motions differ no more than at one point, and by their turning over the way from there.
            half = HALF * wp.length(groups.upper[g] - groups.lower[g])
            apart = wp.length(groups.centre[g] + groups.shift[g] - follow(near, groups.centre[g]))
            turning = groups.rotation[g] - near.rotation
            turn = wp.sqrt(wp.ddot(turning, turning))
            near.deviation = wp.max(near.deviation, apart + TWO * turn * half + groups.deformation[g])
    return near


@wp.struct
class Seen:
    """The triangle of a surface nearest to where a node starts."""

    triangle: int  # -1: none near enough to matter
    inside: bool  # by the angle-weighted normal there (Baerentzen and Aanaes 2005)


@wp.func
def find_contact(
    bodies: Bodies,
    body: int,
    near: Near,
    keeps_out: bool,
    seen: Seen,
    start: wp.vec3d,
    end: wp.vec3d,
    radius: wp.float64,
    clearance: wp.float64,
    exit_distance: wp.float64,
) -> Contact:
    """The plane a node must stay beyond, if any, going from `start` (start pose) to `end` (end pose).

    The start is carried along by the surface; from there a ray to the end, at the end pose, finds what was crossed
    however fast body and node moved; else the nearest point decides. A surface that
    keeps out (a solid, or the one the strand grows on) has an inside, told by the angle-weighted normal at the
    nearest feature (Baerentzen and Aanaes 2005); on any other surface a node stays on the side it was on.

    seen: what of the surface is nearest to `start`.
    exit_distance: [m] what starts nearer than asked, or inside, gains no more than this.
    """
    contact = Contact()
    full = radius + bodies.thickness[body]
    index = seen.triangle
    before = get_triangle(bodies.triangles, bodies.points_start, index)
    after = get_triangle(bodies.triangles, bodies.points_end, index)
    nearest = closest_point(before, start)
    normal_before = unit_normal(before)
    normal_after = unit_normal(after)
    offset = start - interpolate(before, nearest.weights)
    distance = wp.length(offset)
    # Within an edge's length the triangle's own frame carries; further out its turning says little.
    turn = near.rotation
    if distance <= wp.length(before.b - before.a):
        if wp.length_sq(normal_before) > ZERO and wp.length_sq(normal_after) > ZERO:
            turn = triangle_frame(after, normal_after) * wp.transpose(triangle_frame(before, normal_before))
    side = ONE
    if wp.dot(offset, normal_before) < ZERO:
        side = -ONE
    began_inside = keeps_out and seen.inside and not is_rim(bodies, index, nearest.feature)
    outward = side * normal_before
    if keeps_out:
        outward = normal_before
    if distance > NOISE * full:
        outward = offset / distance
    base = interpolate(after, nearest.weights)
    carried = base + turn * offset
    moved = wp.length(end - carried)
    relative = wp.length(end - follow(near, start))
    look = TWO * full + QUARTER * moved
    # No part of the surface can have come nearer to the node's way than this.
    if not began_inside and distance - near.deviation > relative + look:
        return contact

    began = distance
    if began_inside:
        began = -distance
    contact.anchor = carried
    contact.target = wp.min(wp.min(full, clearance), began + exit_distance)

    if not began_inside:
        # From no nearer than half the radius, so that rounding cannot put the ray's start behind the surface.
        origin = base + turn * outward * HALF * full
        lifted = base + turn * outward * wp.max(distance, HALF * full)
        hit = wp.int32(-1)
        if wp.max(moved, relative) + TWO * near.deviation >= distance:
            # Another part of the surface may have come between the nearest triangle and the node.
            if distance > full:
                hit = first_hit(bodies, body, origin, lifted)
            if hit < 0:
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
                contact.hit = True
                contact.normal = normal
                contact.point = end - wp.dot(end - struck.a, normal) * normal
                contact.depth = wp.max(wp.dot(struck.a - end, normal), ZERO)
                return contact

    if began_inside:
        look += distance + moved
    query = wp.mesh_query_point_sign_normal(bodies.mesh_end[body], to_float(end), float(look))
    if not query.result:
        return contact
    index = bodies.first_triangle[body] + query.face
    triangle = get_triangle(bodies.triangles, bodies.points_end, index)
    struck_at = closest_point(triangle, end)
    normal = unit_normal(triangle)
    contact.found = True
    contact.point = interpolate(triangle, struck_at.weights)
    away = end - contact.point
    gap = wp.length(away)
    inside = keeps_out and query.sign < 0.0 and not is_rim(bodies, index, struck_at.feature)
    if not keeps_out:
        # Deformation may have carried the surface over the node without a crossing of the ray.
        if nearest.feature != INSIDE:
            side = ONE
            if wp.dot(away, normal) < ZERO:
                side = -ONE
        normal = side * normal
        inside = struck_at.feature == INSIDE and wp.dot(away, normal) < ZERO
    contact.normal = normal
    if gap > NOISE * full:
        contact.normal = away / gap
        if inside:
            contact.normal = -contact.normal
    if inside:
        contact.depth = gap
    # Only a triangle without area that is touched exactly leaves no direction.
    contact.found = wp.length_sq(contact.normal) > ZERO
    return contact


@wp.struct
class StrandBox:
    lower: wp.vec3d
    upper: wp.vec3d
    radius: wp.float64  # [m] largest


@wp.func
def strand_box(
    nodes: ContactNodes, strand: int, start: wp.array(dtype=wp.vec3d), end: wp.array(dtype=wp.vec3d)
) -> StrandBox:
    root = nodes.first_node[strand] + PRESCRIBED - 1
    box = StrandBox()
    box.lower = wp.min(start[root], end[root])
    box.upper = wp.max(start[root], end[root])
    for i in range(root, nodes.first_node[strand + 1]):
        box.lower = wp.min(box.lower, wp.min(start[i], end[i]))
        box.upper = wp.max(box.upper, wp.max(start[i], end[i]))
        box.radius = wp.max(box.radius, nodes.radius[i])
    return box


@wp.func
def add_plane(
    planes: ContactPlanes,
    plane_body: wp.array(dtype=wp.int32),
    node: int,
    body: int,
    contact: Contact,
    start: wp.vec3d,
    end: wp.vec3d,
    friction: wp.float64,
    tolerance: wp.float64,
) -> bool:
    """Puts a contact in force; whether the node, as it is, breaks it.

    A contact that is kept already is only noted where the node has no plane of that surface yet. It replaces a
    plane of the same surface and direction, else takes a free place, else that of the plane with most room.
    """
    offset = wp.dot(contact.normal, contact.point) + contact.target
    broken = offset - wp.dot(contact.normal, end)
    first = node * PLANES_A_NODE
    slot = wp.int32(-1)
    free = wp.int32(-1)
    known = wp.bool(False)
    loosest = first
    most_room = -UNBOUNDED
    for k in range(PLANES_A_NODE):
        at = first + k
        if plane_body[at] < 0:
            if free < 0:
                free = at
        else:
            if plane_body[at] == body:
                known = True
                if wp.dot(planes.normal[at], contact.normal) > SAME:
                    slot = at
            room = wp.dot(planes.normal[at], end) - planes.offset[at]
            if room > most_room:
                most_room = room
                loosest = at
    if broken <= tolerance and known:
        return False
    if slot < 0:
        slot = free
    if slot < 0:
        slot = loosest
    planes.normal[slot] = contact.normal
    planes.offset[slot] = offset
    planes.anchor[slot] = contact.anchor
    planes.drift[slot] = contact.anchor - start
    planes.friction[slot] = friction
    plane_body[slot] = body
    return broken > tolerance


@wp.func
def share_room(planes: ContactPlanes, plane_body: wp.array(dtype=wp.int32), node: int):
    """Two planes that face each other with less room than both ask for give way equally."""
    a = node * PLANES_A_NODE
    b = a + 1
    if plane_body[a] >= 0 and plane_body[b] >= 0:
        if wp.dot(planes.normal[a], planes.normal[b]) < OPPOSED:
            excess = planes.offset[a] + planes.offset[b]
            if excess > ZERO:
                planes.offset[a] = planes.offset[a] - HALF * excess
                planes.offset[b] = planes.offset[b] - HALF * excess


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
    keeps_out = bodies.solid[body] == 1 or bodies.surface[body] == nodes.surface[strand]
    return find_contact(
        bodies, body, near, keeps_out, seen, start, end, radius, nodes.clearance[node], exit_distance
    )


@wp.kernel
def find_planes(
    first: int,
    bodies: Bodies,
    nodes: ContactNodes,
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    depth: wp.array(dtype=wp.float64),
    exit_distance: wp.float64,
    memory: Memory,
    planes: ContactPlanes,
    plane_body: wp.array(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    depth_out: wp.array(dtype=wp.float64),
):
    """Contacts of the strands flagged; a flag stays where a plane is broken. One strand an item."""
    strand = first + wp.tid()
    if flags[strand] == 0:
        return
    flags[strand] = 0
    deepest = ZERO
    box = strand_box(nodes, strand, start, end)
    for body in range(bodies.count):
        full = box.radius + bodies.thickness[body]
        near = find_near(bodies, body, box.lower, box.upper, TWO * full + depth[strand])
        if near.meets:
            friction = bodies.friction[body]
            if friction < ZERO:
                friction = nodes.friction[strand]
            for i in range(nodes.first_node[strand] + PRESCRIBED, nodes.first_node[strand + 1]):
                if nodes.clearance[i] >= ZERO:
                    contact = node_contact(
                        bodies,
                        body,
                        near,
                        nodes,
                        memory,
                        strand,
                        i,
                        start[i],
                        end[i],
                        depth[strand],
                        exit_distance,
                    )
                    if contact.found:
                        deepest = wp.max(deepest, contact.depth)
                        tolerance = TOLERANCE * (nodes.radius[i] + bodies.thickness[body])
                        if add_plane(planes, plane_body, i, body, contact, start[i], end[i], friction, tolerance):
                            flags[strand] = 1
                        share_room(planes, plane_body, i)
    depth_out[strand] = deepest


@wp.kernel
def project_out(
    first: int,
    bodies: Bodies,
    nodes: ContactNodes,
    start: wp.array(dtype=wp.vec3d),
    depth: wp.array(dtype=wp.float64),
    exit_distance: wp.float64,
    flags: wp.array(dtype=wp.int32),
    memory: Memory,
    end: wp.array(dtype=wp.vec3d),
    moved_out: wp.array(dtype=wp.int32),
    depth_out: wp.array(dtype=wp.float64),
):
    """Puts what is still under a surface just above it, in the strands flagged. One strand an item.

    Only a node whose centre is under the surface, or deeper than it may be while it is led out, is moved; bodies
    that overlap can still leave it inside one of them.
    """
    strand = first + wp.tid()
    if flags[strand] == 0:
        return
    deepest = ZERO
    for _ in range(GUARD_ROUNDS):
        changed = wp.bool(False)
        deepest = ZERO
        box = strand_box(nodes, strand, start, end)
        for body in range(bodies.count):
            full = box.radius + bodies.thickness[body]
            near = find_near(bodies, body, box.lower, box.upper, TWO * full + depth[strand])
            if near.meets:
                for i in range(nodes.first_node[strand] + PRESCRIBED, nodes.first_node[strand + 1]):
                    if nodes.clearance[i] >= ZERO:
                        contact = node_contact(
                            bodies,
                            body,
                            near,
                            nodes,
                            memory,
                            strand,
                            i,
                            start[i],
                            end[i],
                            depth[strand],
                            exit_distance,
                        )
                        if contact.found:
                            deepest = wp.max(deepest, contact.depth)
                            height = wp.dot(contact.normal, end[i] - contact.point)
                            if height < wp.min(contact.target, ZERO):
                                asked = nodes.radius[i] + bodies.thickness[body]
                                goal = wp.min(contact.target, TOLERANCE * asked)
                                end[i] = end[i] + (goal - height) * contact.normal
                                moved_out[strand] = moved_out[strand] + 1
                                changed = True
        if not changed:
            break
    depth_out[strand] = deepest
