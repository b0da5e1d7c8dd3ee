"""Where rigid bodies touch each other and the surfaces that the animation moves."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import (
    INSIDE,
    Triangle,
    closest_point,
    get_triangle,
    interpolate,
    triangle_frame,
    unit_normal,
)
from plait.solver.rigid.motion_kernels import HALF, ONE, ZERO, Masses, Motion, world_inverse
from plait.solver.rigid.shape_kernels import MESH, SPHERE, nearest_on_shape

wp.set_module_options({"enable_backward": False})

# [m] further than anything reaches.
FAR = wp.constant(wp.float64(1e6))
UNBOUNDED = wp.constant(wp.float64(1e30))
# Sine of the angle between edges below which they count as parallel: their ends then tell.
TWO = wp.constant(wp.float64(2.0))
PARALLEL = wp.constant(wp.float64(1e-3))
# Two contacts of one point with one surface differ by more (cosine).
APART = wp.constant(wp.float64(0.9))
# Normals are told from offsets longer than this part of a geom's reach.
NOISE = wp.constant(wp.float64(1e-7))


@wp.struct
class Geoms:
    """Surfaces that touch, those of rigid bodies first; in the axes of rest space about the centre of mass."""

    count: int
    carried_count: int
    body: wp.array(dtype=wp.int32)  # -1: moved by the animation
    kind: wp.array(dtype=wp.int32)
    size: wp.array(dtype=wp.vec3d)  # [m] see `Shape`
    offset: wp.array(dtype=wp.vec3d)  # [m] of the shape's own space
    turn: wp.array(dtype=wp.quatd)
    center: wp.array(dtype=wp.vec3d)  # [m] of the bounding box, and half its edges
    half: wp.array(dtype=wp.vec3d)
    reach: wp.array(dtype=wp.float64)  # [m] no part is further from the centre of mass
    margin: wp.array(dtype=wp.float64)  # [m] contacts are followed from here on
    solid: wp.array(dtype=wp.int32)  # 1: closed and facing out
    friction: wp.array(dtype=wp.float64)  # negative: not told
    thickness: wp.array(dtype=wp.float64)  # [m]
    restitution: wp.array(dtype=wp.float64)
    mesh: wp.array(dtype=wp.uint64)  # of triangles in the body's axes
    first_triangle: wp.array(dtype=wp.int32)
    first_point: wp.array(dtype=wp.int32)  # (count + 1,)
    first_edge: wp.array(dtype=wp.int32)
    first_slot: wp.array(dtype=wp.int32)
    filter_offsets: wp.array(dtype=wp.int32)  # (count + 1,)
    filtered: wp.array(dtype=wp.int32)  # geoms that a geom does not touch
    points: wp.array(dtype=wp.vec3d)  # [m]
    inward: wp.array(dtype=wp.vec3d)  # unit, from the point into its body; zero where it is round
    fans: wp.array(dtype=wp.vec4i)  # of animated surfaces, triangles about the point; -1: none
    point_index: wp.array(dtype=wp.int32)  # of animated surfaces, into their points
    radius: wp.array(dtype=wp.float64)  # [m]
    axis: wp.array(dtype=wp.vec3d)  # unit: the point is a rim about it; else zero
    edges: wp.array(dtype=wp.vec4i)  # both ends, what the faces lie towards; into `vertices`, or animated points
    edge_radius: wp.array(dtype=wp.float64)
    vertices: wp.array(dtype=wp.vec3d)  # [m]
    triangles: wp.array(dtype=wp.vec3i)  # into `vertices`


@wp.struct
class Animated:
    """Surfaces that the animation moves, in this substep; entry a - carried_count of geom a."""

    active: wp.array(dtype=wp.int32)
    mesh: wp.array(dtype=wp.uint64)  # at the start
    points: wp.array(dtype=wp.vec2i)  # of each surface, first and past the last
    points_start: wp.array(dtype=wp.vec3d)  # [m]
    points_end: wp.array(dtype=wp.vec3d)
    triangles: wp.array(dtype=wp.vec3i)


@wp.struct
class Boxes:
    """Where geoms may be in the substep."""

    lower: wp.array(dtype=wp.vec3d)  # [m]
    upper: wp.array(dtype=wp.vec3d)
    travel: wp.array(dtype=wp.float64)  # [m] no part goes further


@wp.struct
class Contacts:
    """A point of geom a against a surface b; those of geom a from first_slot[a] on, count[a] of them.

    The point's place is that of its core, which moves with its body, and a constant offset, the arm, that turns with
    the velocity alone: so that what is round rolls. The same on the other side.
    """

    count: wp.array(dtype=wp.int32)  # (geom_count,)
    geom: wp.array(dtype=wp.int32)  # b
    feature: wp.array(dtype=wp.int32)  # which point or pair of edges
    body: wp.array(dtype=wp.vec2i)  # of a and b; -1: animated
    core_a: wp.array(
        dtype=wp.vec3d
    )  # [m] in the body's axes; of an animated surface its way in the substep, world
    core_b: wp.array(dtype=wp.vec3d)
    arm_a: wp.array(dtype=wp.vec3d)  # [m] world
    arm_b: wp.array(dtype=wp.vec3d)
    lever_a: wp.array(dtype=wp.vec3d)  # [m] from the centre of mass to where the impulse acts, world
    lever_b: wp.array(dtype=wp.vec3d)
    normal: wp.array(dtype=wp.vec3d)  # unit, from b to a
    gap: wp.array(dtype=wp.float64)  # [m] at the substep's start
    friction: wp.array(dtype=wp.float64)
    restitution: wp.array(dtype=wp.float64)
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] on a, world


@wp.struct
class Kept:
    """What the next substep needs to know of contacts."""

    count: wp.array(dtype=wp.int32)
    geom: wp.array(dtype=wp.int32)
    feature: wp.array(dtype=wp.int32)
    normal: wp.array(dtype=wp.vec3d)
    impulse: wp.array(dtype=wp.vec3d)


@wp.struct
class Start:
    """Of each body at the substep's start."""

    inertia_inverse: wp.array(dtype=wp.mat33d)  # world
    velocity: wp.array(dtype=wp.vec3d)  # [m/s] before the substep's forces
    spin: wp.array(dtype=wp.vec3d)  # [1/s] before the substep's forces


@wp.struct
class Step:
    length: wp.float64  # [s]
    gravity: wp.vec3d  # [m/s2]
    friction: wp.float64  # where neither side tells


@wp.kernel
def begin_bodies(first: int, step: wp.array(dtype=Step), masses: Masses, motion: Motion, start: Start):
    """Takes up gravity and the impulses of others; one body an item."""
    b = first + wp.tid()
    inverse = world_inverse(motion.orientation[b], masses.inertia_inverse[b])
    start.inertia_inverse[b] = inverse
    start.velocity[b] = motion.velocity[b]
    start.spin[b] = inverse * motion.angular_momentum[b]
    push = step[0].length * step[0].gravity + motion.impulse[b] / masses.mass[b]
    motion.velocity[b] = motion.velocity[b] + push
    motion.angular_momentum[b] = motion.angular_momentum[b] + motion.angular_impulse[b]
    motion.impulse[b] = wp.vec3d()
    motion.angular_impulse[b] = wp.vec3d()


@wp.kernel
def bound_geoms(
    first: int,
    step: wp.array(dtype=Step),
    geoms: Geoms,
    animated: Animated,
    motion: Motion,
    start: Start,
    boxes: Boxes,
):
    """Boxes and ways of geoms, one an item."""
    a = first + wp.tid()
    body = geoms.body[a]
    if body >= 0:
        rotation = wp.quat_to_matrix(motion.orientation[body])
        spin = start.inertia_inverse[body] * motion.angular_momentum[body]
        travel = step[0].length * (wp.length(motion.velocity[body]) + wp.length(spin) * geoms.reach[a])
        center = motion.position[body] + rotation * geoms.center[a]
        local = geoms.half[a]
        half = wp.vec3d()
        for k in range(3):
            row = rotation[k]
            half[k] = (
                wp.abs(row[0]) * local[0]
                + wp.abs(row[1]) * local[1]
                + wp.abs(row[2]) * local[2]
                + travel
                + geoms.margin[a]
                + geoms.thickness[a]
            )
        boxes.lower[a] = center - half
        boxes.upper[a] = center + half
        boxes.travel[a] = travel
        return
    entry = a - geoms.carried_count
    lower = wp.vec3d(UNBOUNDED, UNBOUNDED, UNBOUNDED)
    upper = -lower
    furthest = ZERO
    if animated.active[entry] == 1:
        for i in range(animated.points[entry][0], animated.points[entry][1]):
            x = animated.points_start[i]
            y = animated.points_end[i]
            lower = wp.min(lower, wp.min(x, y))
            upper = wp.max(upper, wp.max(x, y))
            furthest = wp.max(furthest, wp.length_sq(y - x))
    reach = wp.vec3d(geoms.thickness[a], geoms.thickness[a], geoms.thickness[a])
    boxes.lower[a] = lower - reach
    boxes.upper[a] = upper + reach
    boxes.travel[a] = wp.sqrt(furthest)


@wp.struct
class Side:
    """The surface side of a contact, world."""

    found: bool
    gap: wp.float64  # [m] of the point at its start from the surface, along the normal
    distance: wp.float64  # [m] from the surface at the start
    normal: wp.vec3d  # at the substep's end
    foot: wp.vec3d  # [m] at the start
    core: wp.vec3d  # [m] at the start
    way: wp.vec3d  # [m] that an animated surface carries the foot


@wp.struct
class OnMesh:
    """The nearest place of a mesh."""

    found: bool
    triangle: int
    weights: wp.vec3d
    foot: wp.vec3d  # [m]
    normal: wp.vec3d
    distance: wp.float64  # [m] negative inside, or behind


@wp.func
def to_float(x: wp.vec3d) -> wp.vec3f:
    return wp.vec3f(float(x[0]), float(x[1]), float(x[2]))


@wp.func
def nearest_on_mesh(
    mesh: wp.uint64,
    triangles: wp.array(dtype=wp.vec3i),
    points: wp.array(dtype=wp.vec3d),
    first_triangle: int,
    solid: bool,
    x: wp.vec3d,
    search: wp.float64,
    witness: wp.vec3d,
) -> OnMesh:
    """The nearest place of a mesh within `search` [m]; witness: a point on the side of an open one that counts."""
    out = OnMesh()
    query = wp.mesh_query_point_sign_normal(mesh, to_float(x), float(search))
    if not query.result:
        return out
    out.found = True
    out.triangle = first_triangle + query.face
    triangle = get_triangle(triangles, points, out.triangle)
    place = closest_point(triangle, x)
    out.weights = place.weights
    out.foot = interpolate(triangle, place.weights)
    away = x - out.foot
    out.normal = unit_normal(triangle)
    # Where the nearest place is within a triangle its own plane tells the side, without float32's rounding.
    behind = query.sign < 0.0
    if not solid and wp.dot(witness - out.foot, out.normal) < ZERO:
        out.normal = -out.normal
    if not solid or place.feature == INSIDE:
        behind = wp.dot(away, out.normal) < ZERO
    distance = wp.length(away)
    out.distance = wp.where(behind, -distance, distance)
    if distance > NOISE * (wp.length(triangle.b - triangle.a) + wp.length(triangle.c - triangle.a)):
        out.normal = away / out.distance
    return out


@wp.func
def nearest_on_animated(
    geoms: Geoms, animated: Animated, b: int, x: wp.vec3d, search: wp.float64, witness: wp.vec3d
) -> Side:
    """The place nearest to a point at the substep's start, carried along to its end."""
    out = Side()
    near = nearest_on_mesh(
        animated.mesh[b - geoms.carried_count],
        animated.triangles,
        animated.points_start,
        geoms.first_triangle[b],
        geoms.solid[b] == 1,
        x,
        search,
        witness,
    )
    if not near.found:
        return out
    before = get_triangle(animated.triangles, animated.points_start, near.triangle)
    after = get_triangle(animated.triangles, animated.points_end, near.triangle)
    out.found = True
    out.normal = near.normal
    normal_before = unit_normal(before)
    normal_after = unit_normal(after)
    if wp.length_sq(normal_before) > ZERO and wp.length_sq(normal_after) > ZERO:
        carry = triangle_frame(after, normal_after) * wp.transpose(triangle_frame(before, normal_before))
        out.normal = carry * near.normal
    out.foot = near.foot
    out.core = near.foot
    out.way = interpolate(after, near.weights) - near.foot
    out.distance = near.distance
    out.gap = wp.dot(out.normal, x - near.foot) - geoms.thickness[b]
    return out


@wp.func
def nearest_on_geom(
    geoms: Geoms, animated: Animated, motion: Motion, b: int, x: wp.vec3d, search: wp.float64, witness: wp.vec3d
) -> Side:
    """The place of geom b nearest to a point, world; witness: a point on the side of an open one that counts."""
    body = geoms.body[b]
    if body < 0:
        return nearest_on_animated(geoms, animated, b, x, search, witness)
    out = Side()
    orientation = motion.orientation[body]
    origin = motion.position[body]
    local = wp.quat_rotate_inv(orientation, x - origin)
    if geoms.kind[b] == MESH:
        near = nearest_on_mesh(
            geoms.mesh[b],
            geoms.triangles,
            geoms.vertices,
            geoms.first_triangle[b],
            geoms.solid[b] == 1,
            local,
            search,
            wp.quat_rotate_inv(orientation, witness - origin),
        )
        out.found = near.found
        out.distance = near.distance
        out.normal = near.normal
        out.foot = near.foot
        out.core = near.foot
    else:
        turn = geoms.turn[b]
        on_shape = nearest_on_shape(geoms.kind[b], geoms.size[b], wp.quat_rotate_inv(turn, local - geoms.offset[b]))
        out.found = on_shape.distance <= search
        out.distance = on_shape.distance
        out.normal = wp.quat_rotate(turn, on_shape.normal)
        out.foot = geoms.offset[b] + wp.quat_rotate(turn, on_shape.foot)
        out.core = geoms.offset[b] + wp.quat_rotate(turn, on_shape.core)
    out.gap = out.distance - geoms.thickness[b]
    out.normal = wp.quat_rotate(orientation, out.normal)
    out.foot = origin + wp.quat_rotate(orientation, out.foot)
    out.core = origin + wp.quat_rotate(orientation, out.core)
    out.way = wp.vec3d()
    return out


@wp.struct
class Place:
    """A point of a geom at the substep's start, world."""

    x: wp.vec3d  # [m] of its core
    way: wp.vec3d  # [m] in the substep, of an animated surface
    radius: wp.float64  # [m]
    axis: wp.vec3d
    inward: wp.vec3d  # unit, or zero


@wp.func
def place_of(geoms: Geoms, animated: Animated, motion: Motion, a: int, p: int) -> Place:
    out = Place()
    body = geoms.body[a]
    if body < 0:
        i = geoms.point_index[p]
        out.x = animated.points_start[i]
        out.way = animated.points_end[i] - out.x
        fan = geoms.fans[p]
        for k in range(4):
            if fan[k] >= 0:
                out.inward -= unit_normal(get_triangle(animated.triangles, animated.points_start, fan[k]))
        out.inward = wp.normalize(out.inward)
        return out
    out.x = motion.position[body] + wp.quat_rotate(motion.orientation[body], geoms.points[p])
    out.radius = geoms.radius[p]
    out.axis = wp.quat_rotate(motion.orientation[body], geoms.axis[p])
    out.inward = wp.quat_rotate(motion.orientation[body], geoms.inward[p])
    return out


@wp.func
def velocity_at(motion: Motion, start: Start, body: int, lever: wp.vec3d) -> wp.vec3d:
    spin = start.inertia_inverse[body] * motion.angular_momentum[body]
    return motion.velocity[body] + wp.cross(spin, lever)


@wp.func
def kept_at(kept: Kept, first: int, count: int, geom: int, feature: int) -> int:
    for k in range(first, first + count):
        if kept.geom[k] == geom and kept.feature[k] == feature:
            return k
    return -1


@wp.func
def find_slot(contacts: Contacts, geoms: Geoms, a: int, gap: wp.float64) -> int:
    """A place for one more contact of geom a: where none are left that of the widest gap, if it is wider; or -1."""
    first = geoms.first_slot[a]
    count = contacts.count[a]
    if first + count < geoms.first_slot[a + 1]:
        contacts.count[a] = count + 1
        return first + count
    widest = wp.int32(first)
    for k in range(first + 1, first + count):
        if contacts.gap[k] > contacts.gap[widest]:
            widest = k
    if contacts.gap[widest] > gap:
        return widest
    return -1


@wp.func
def least_margin(geoms: Geoms, a: int, b: int) -> wp.float64:
    """[m] of the smaller of two bodies, or of the one body."""
    if geoms.body[a] < 0 or (geoms.body[b] >= 0 and geoms.margin[b] < geoms.margin[a]):
        return geoms.margin[b]
    return geoms.margin[a]


@wp.func
def mean_friction(a: wp.float64, b: wp.float64, otherwise: wp.float64) -> wp.float64:
    """The mean of the two; where one is not told, the other's."""
    if a < ZERO and b < ZERO:
        return otherwise
    if a < ZERO:
        return b
    if b < ZERO:
        return a
    return HALF * (a + b)


@wp.func
def put_contact(
    geoms: Geoms,
    motion: Motion,
    start: Start,
    kept: Kept,
    contacts: Contacts,
    step: Step,
    a: int,
    b: int,
    feature: int,
    place: Place,
    arm: wp.vec3d,
    surface: Side,
):
    """Notes a contact of a point, its core at place.x and itself at place.x + arm, if it may touch in the substep."""
    body_a = geoms.body[a]
    body_b = geoms.body[b]
    n = surface.normal
    touch = place.x + arm
    approach = (surface.way - place.way) / step.length
    if body_a >= 0:
        approach -= velocity_at(motion, start, body_a, touch - motion.position[body_a])
    if body_b >= 0:
        approach += velocity_at(motion, start, body_b, touch - motion.position[body_b])
    margin = least_margin(geoms, a, b)
    gap = surface.gap
    if gap > margin + wp.max(ZERO, step.length * wp.dot(approach, n)):
        return
    slot = find_slot(contacts, geoms, a, gap)
    if slot < 0:
        return
    contacts.geom[slot] = b
    contacts.feature[slot] = feature
    contacts.body[slot] = wp.vec2i(body_a, body_b)
    contacts.arm_a[slot] = arm
    contacts.arm_b[slot] = surface.foot - surface.core
    if body_a >= 0:
        contacts.core_a[slot] = wp.quat_rotate_inv(motion.orientation[body_a], place.x - motion.position[body_a])
        contacts.lever_a[slot] = touch - motion.position[body_a]
    else:
        contacts.core_a[slot] = place.way
    if body_b >= 0:
        contacts.core_b[slot] = wp.quat_rotate_inv(
            motion.orientation[body_b], surface.core - motion.position[body_b]
        )
        contacts.lever_b[slot] = touch - motion.position[body_b]
    else:
        contacts.core_b[slot] = surface.way
    contacts.normal[slot] = n
    contacts.gap[slot] = gap
    contacts.friction[slot] = mean_friction(geoms.friction[a], geoms.friction[b], step.friction)
    contacts.restitution[slot] = wp.max(geoms.restitution[a], geoms.restitution[b])
    contacts.impulse[slot] = wp.vec3d()
    before = kept_at(kept, geoms.first_slot[a], kept.count[a], b, feature)
    if before >= 0:
        contacts.impulse[slot] = kept.impulse[before]


@wp.func
def led_back(surface: Side, before: wp.vec3d) -> Side:
    """Of a point that went through something thin, the way back: it was on the other side in the substep before."""
    out = surface
    if wp.dot(surface.normal, before) < -HALF:
        out.normal = -surface.normal
        out.gap = -wp.abs(surface.gap)
    return out


@wp.func
def meet_points(
    geoms: Geoms,
    animated: Animated,
    motion: Motion,
    start: Start,
    boxes: Boxes,
    kept: Kept,
    contacts: Contacts,
    step: Step,
    a: int,
    b: int,
):
    """Contacts of the points of geom a with the surface of geom b."""
    travel = boxes.travel[a] + boxes.travel[b]
    depth = least_margin(geoms, a, b)
    reach = TWO * depth + geoms.thickness[b] + travel
    for p in range(geoms.first_point[a], geoms.first_point[a + 1]):
        place = place_of(geoms, animated, motion, a, p)
        search = reach + place.radius
        grown = wp.vec3d(search, search, search)
        x = place.x
        inside_lower = wp.min(x - boxes.lower[b] + grown, boxes.upper[b] + grown - x)
        if wp.min(inside_lower) >= ZERO:
            feature = 4 * (p - geoms.first_point[a])
            before = kept_at(kept, geoms.first_slot[a], kept.count[a], b, feature)
            # What meets an open surface for the first time belongs where its body mostly is.
            witness = x
            if before >= 0:
                witness = x + FAR * kept.normal[before]
            elif geoms.body[a] >= 0:
                witness = motion.position[geoms.body[a]]
            rim = wp.length_sq(place.axis) > ZERO
            arm = wp.vec3d()
            # What is looked for from a little within the point's own body tells the side also where both bodies end.
            within = x + depth * place.inward
            surface = nearest_on_geom(geoms, animated, motion, b, within, search + place.radius, witness)
            surface.gap -= wp.dot(surface.normal, within - x)
            if rim and surface.found:
                # The place of the rim that is nearest to the surface's tangent plane, found again from there.
                for _ in range(3):
                    down = -surface.normal + wp.dot(surface.normal, place.axis) * place.axis
                    length = wp.length(down)
                    if length > wp.float64(1e-6) and surface.found:
                        arm = (place.radius / length) * down
                        surface = nearest_on_geom(geoms, animated, motion, b, x + arm, search, witness)
            elif surface.found:
                arm = -place.radius * surface.normal
                surface.gap -= place.radius
            if surface.found and before >= 0:
                surface = led_back(surface, kept.normal[before])
            if surface.found:
                put_contact(geoms, motion, start, kept, contacts, step, a, b, feature, place, arm, surface)
            if surface.found and place.radius > ZERO and not rim and geoms.kind[b] == MESH:
                meet_further_walls(
                    geoms, animated, motion, start, kept, contacts, step, a, b, feature, place, surface, search
                )


@wp.func
def meet_further_walls(
    geoms: Geoms,
    animated: Animated,
    motion: Motion,
    start: Start,
    kept: Kept,
    contacts: Contacts,
    step: Step,
    a: int,
    b: int,
    feature: int,
    place: Place,
    nearest: Side,
    search: wp.float64,
):
    """A ball in a corner of a mesh touches up to three of its walls: they are sought further from those found."""
    away = nearest.normal
    for k in range(1, 3):
        shift = place.radius * away
        seen = nearest_on_geom(geoms, animated, motion, b, place.x + shift, search + place.radius, place.x)
        if not seen.found:
            return
        if wp.dot(seen.normal, wp.normalize(away)) > APART or wp.dot(seen.normal, nearest.normal) > APART:
            return
        # The wall's foot beneath the ball itself.
        seen.gap = wp.dot(seen.normal, place.x - seen.foot) - geoms.thickness[b] - place.radius
        slide = shift - wp.dot(seen.normal, shift) * seen.normal
        seen.foot = seen.foot - slide
        seen.core = seen.foot
        arm = -place.radius * seen.normal
        put_contact(geoms, motion, start, kept, contacts, step, a, b, feature + k, place, arm, seen)
        away = away + seen.normal


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
def vertex_at(geoms: Geoms, animated: Animated, motion: Motion, body: int, i: int) -> wp.vec3d:
    if body < 0:
        return animated.points_start[i]
    return motion.position[body] + wp.quat_rotate(motion.orientation[body], geoms.vertices[i])


@wp.func
def segment_at(geoms: Geoms, animated: Animated, motion: Motion, a: int, e: int) -> Segment:
    out = Segment()
    edge = geoms.edges[e]
    body = geoms.body[a]
    out.a = vertex_at(geoms, animated, motion, body, edge[0])
    out.b = vertex_at(geoms, animated, motion, body, edge[1])
    out.radius = geoms.edge_radius[e]
    if body < 0:
        out.way_a = animated.points_end[edge[0]] - out.a
        out.way_b = animated.points_end[edge[1]] - out.b
    along = wp.normalize(out.b - out.a)
    if edge[2] >= 0:
        into = vertex_at(geoms, animated, motion, body, edge[2]) - out.a
        out.into_1 = into - wp.dot(into, along) * along
    if edge[3] >= 0:
        into = vertex_at(geoms, animated, motion, body, edge[3]) - out.a
        out.into_2 = into - wp.dot(into, along) * along
    return out


@wp.func
def leaves(edge: Segment, n: wp.vec3d) -> bool:
    """Whether a direction goes out at an edge between its faces."""
    tolerance = wp.float64(1e-6)
    return wp.dot(n, edge.into_1) <= tolerance * wp.length(edge.into_1) and wp.dot(n, edge.into_2) <= (
        tolerance * wp.length(edge.into_2)
    )


@wp.func
def meet_edges(
    geoms: Geoms,
    animated: Animated,
    motion: Motion,
    start: Start,
    boxes: Boxes,
    kept: Kept,
    contacts: Contacts,
    step: Step,
    a: int,
    b: int,
):
    """Contacts of edges of geom a with edges of geom b that they cross."""
    lower = wp.max(boxes.lower[a], boxes.lower[b])
    upper = wp.min(boxes.upper[a], boxes.upper[b])
    count_b = geoms.first_edge[b + 1] - geoms.first_edge[b]
    for i in range(geoms.first_edge[a], geoms.first_edge[a + 1]):
        p = segment_at(geoms, animated, motion, a, i)
        grown = wp.vec3d(p.radius, p.radius, p.radius)
        clear_p = wp.max(wp.min(p.a, p.b) - grown - upper, lower - wp.max(p.a, p.b) - grown)
        if wp.max(clear_p) <= ZERO:
            for j in range(geoms.first_edge[b], geoms.first_edge[b + 1]):
                q = segment_at(geoms, animated, motion, b, j)
                grown_q = wp.vec3d(q.radius, q.radius, q.radius)
                clear_q = wp.max(wp.min(q.a, q.b) - grown_q - upper, lower - wp.max(q.a, q.b) - grown_q)
                if wp.max(clear_q) <= ZERO:
                    pair = (i - geoms.first_edge[a]) * count_b + j - geoms.first_edge[b]
                    cross_edges(geoms, motion, start, boxes, kept, contacts, step, a, b, pair, p, q)


@wp.func
def cross_edges(
    geoms: Geoms,
    motion: Motion,
    start: Start,
    boxes: Boxes,
    kept: Kept,
    contacts: Contacts,
    step: Step,
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
    depth = least_margin(geoms, a, b)
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
    gap = height - p.radius - q.radius - geoms.thickness[a] - geoms.thickness[b]
    if gap < -depth - boxes.travel[a] - boxes.travel[b]:
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
    put_contact(geoms, motion, start, kept, contacts, step, a, b, -1 - pair, place, -p.radius * n, surface)


@wp.func
def touches(geoms: Geoms, boxes: Boxes, a: int, b: int) -> bool:
    """Whether geoms may touch."""
    if geoms.body[a] == geoms.body[b]:
        return False
    apart = wp.max(boxes.lower[a] - boxes.upper[b], boxes.lower[b] - boxes.upper[a])
    if wp.max(apart) > ZERO:
        return False
    for k in range(geoms.filter_offsets[a], geoms.filter_offsets[a + 1]):
        if geoms.filtered[k] == b:
            return False
    return True


@wp.kernel
def find_contacts(
    first: int,
    step: wp.array(dtype=Step),
    geoms: Geoms,
    animated: Animated,
    motion: Motion,
    start: Start,
    boxes: Boxes,
    kept: Kept,
    contacts: Contacts,
):
    """Contacts of geoms' points and edges, one geom an item."""
    a = first + wp.tid()
    contacts.count[a] = 0
    others = geoms.count
    if geoms.body[a] < 0:
        others = geoms.carried_count
    for b in range(others):
        if touches(geoms, boxes, a, b):
            # Of two balls one side tells all.
            if a < b or geoms.kind[a] != SPHERE or geoms.kind[b] != SPHERE:
                meet_points(geoms, animated, motion, start, boxes, kept, contacts, step[0], a, b)
            if a < b:
                meet_edges(geoms, animated, motion, start, boxes, kept, contacts, step[0], a, b)


@wp.kernel
def keep_contacts(first: int, geoms: Geoms, contacts: Contacts, kept: Kept):
    """Keeps a substep's contacts for the next, one geom an item."""
    a = first + wp.tid()
    kept.count[a] = contacts.count[a]
    begin = geoms.first_slot[a]
    for k in range(begin, begin + contacts.count[a]):
        kept.geom[k] = contacts.geom[k]
        kept.feature[k] = contacts.feature[k]
        kept.normal[k] = contacts.normal[k]
        kept.impulse[k] = contacts.impulse[k]
