"""Collision particles against the triangles of skins: the places where they may touch in a substep."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import (
    EDGE,
    INSIDE,
    ONE,
    ZERO,
    Closest,
    closest_point,
    get_triangle,
    interpolate,
    unit_normal,
)
from plait.solver.contact.patch_kernels import Patches, box_distance

wp.set_module_options({"enable_backward": False})

# Touching places of a particle: three faces of a corner.
SLOTS = wp.constant(3)
# Skins face each other where the cosine between the particle's normal and the contact's is below this.
FACING = wp.constant(wp.float64(-0.2))
# Places of one skin whose normals differ less (cosine) are one.
SAME = wp.constant(wp.float64(0.9))
# Distances that differ by less, relatively, are the same.
SAME_DISTANCE = wp.constant(wp.float64(1.0e-9))
# [cells] Below this distance two points have no direction between them; and what is deeper is not led back out.
NO_DIRECTION = wp.constant(wp.float64(1.0e-6))
DEEPEST = wp.constant(wp.float64(1.0))
# What a particle may have moved in the substep before, at most, over what it may move in this one.
SLACK = wp.constant(wp.float64(1.5))


@wp.struct
class Skins:
    """All skins and their particles. Corners of triangles are particles."""

    triangles: wp.array(dtype=wp.vec3i)
    triangle_body: wp.array(dtype=wp.int32)
    first_triangle: wp.array(dtype=wp.int32)  # (body_count + 1,)
    ring_offsets: wp.array(dtype=wp.int32)  # triangles around each corner, across seams too
    ring: wp.array(dtype=wp.int32)
    welded: wp.array(dtype=wp.int32)  # of a corner, the first that lies in the same place at rest
    nodes: wp.array(dtype=wp.vec4i)
    rest: wp.array(dtype=wp.vec3d)  # [m] each body's rest space
    rest_normal: wp.array(dtype=wp.vec3d)
    body: wp.array(dtype=wp.int32)
    patch: wp.array(dtype=wp.int32)
    mesh: wp.array(dtype=wp.uint64)  # search tree of each body's skin, at the substep's start
    together_offsets: wp.array(dtype=wp.int32)  # (particle_count + 1,) bodies each is drawn together with
    together: wp.array(dtype=wp.int32)
    cell: wp.float64  # [m]
    apart_at_rest: wp.float64  # [m] nearer parts of one body touch only where they face each other at rest


@wp.struct
class Touching:
    """Where particle q may touch a skin, at q * SLOTS + k."""

    triangle: wp.array(dtype=wp.int32)  # -1: nowhere
    weights: wp.array(dtype=wp.vec3d)  # of the triangle's corners
    normal: wp.array(dtype=wp.vec3d)  # out of the skin, towards the particle
    gap: wp.array(dtype=wp.float64)  # [m] at the substep's start, negative where they overlap


@wp.struct
class Place:
    """A touching place that was found."""

    found: bool
    triangle: int
    weights: wp.vec3d
    normal: wp.vec3d
    gap: wp.float64


@wp.func
def shares_node(skins: Skins, q: int, triangle: int) -> bool:
    """Whether one node carries both: such a pair moves as one."""
    mine = skins.nodes[q]
    corners = skins.triangles[triangle]
    for i in range(3):
        theirs = skins.nodes[corners[i]]
        for a in range(4):
            for b in range(4):
                if mine[a] == theirs[b]:
                    return True
    return False


@wp.func
def belong_together(skins: Skins, q: int, triangle: int) -> bool:
    """Whether a particle and a triangle of its own body are near at rest without facing each other there."""
    if shares_node(skins, q, triangle):
        return True
    at_rest = get_triangle(skins.triangles, skins.rest, triangle)
    x = skins.rest[q]
    between = interpolate(at_rest, closest_point(at_rest, x).weights) - x
    if wp.length(between) > skins.apart_at_rest:
        return False
    normal = skins.rest_normal[q]
    theirs = unit_normal(at_rest)
    return wp.dot(normal, between) <= ZERO or wp.dot(theirs, between) >= ZERO or wp.dot(normal, theirs) > FACING


@wp.func
def drawn_together(skins: Skins, q: int, body: int) -> bool:
    """Whether a particle lies where its body and another overlap as drawn."""
    for k in range(skins.together_offsets[q], skins.together_offsets[q + 1]):
        if skins.together[k] == body:
            return True
    return False


@wp.func
def is_nearest_around(
    skins: Skins, position: wp.array(dtype=wp.vec3d), triangle: int, nearest: Closest, x: wp.vec3d, d: wp.float64
) -> bool:
    """Whether no triangle that shares the closest point's edge or corner comes nearer to x."""
    if nearest.feature == INSIDE:
        return True
    corners = skins.triangles[triangle]
    # One corner of the feature; of an edge, the other is looked for among its triangles' corners.
    at = (nearest.feature - EDGE + 1) % 3
    on_edge = nearest.feature < EDGE + 3
    if not on_edge:
        at = nearest.feature - EDGE - 3
    other = skins.welded[corners[(at + 1) % 3]]
    v = corners[at]
    for k in range(skins.ring_offsets[v], skins.ring_offsets[v + 1]):
        t = skins.ring[k]
        if t != triangle:
            c = skins.triangles[t]
            shares = wp.bool(True)
            if on_edge:
                shares = skins.welded[c[0]] == other or skins.welded[c[1]] == other or skins.welded[c[2]] == other
            if shares:
                around = get_triangle(skins.triangles, position, t)
                y = interpolate(around, closest_point(around, x).weights)
                if wp.length(x - y) < d * (ONE - SAME_DISTANCE):
                    return False
    return True


@wp.func
def outward_at(
    skins: Skins,
    position: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d),
    triangle: int,
    nearest: Closest,
    face: wp.vec3d,
) -> wp.vec3d:
    """A direction out of the skin at a closest point: the face's, or the mean of those around."""
    if nearest.feature == INSIDE:
        return face
    corners = skins.triangles[triangle]
    if nearest.feature >= EDGE + 3:
        return normal[corners[nearest.feature - EDGE - 3]]
    at = (nearest.feature - EDGE + 1) % 3
    other = skins.welded[corners[(at + 1) % 3]]
    v = corners[at]
    total = wp.vec3d()
    for k in range(skins.ring_offsets[v], skins.ring_offsets[v + 1]):
        c = skins.triangles[skins.ring[k]]
        if skins.welded[c[0]] == other or skins.welded[c[1]] == other or skins.welded[c[2]] == other:
            total += unit_normal(get_triangle(skins.triangles, position, skins.ring[k]))
    return total


@wp.func
def came_in_there(
    skins: Skins, before: Touching, q: int, triangle: int, weights: wp.vec3d, normal: wp.vec3d, most: wp.float64
) -> bool:
    """Whether the particle may have come behind this part of a skin from where it was in the substep before.

    It was near there and on that side, its gap at most `most` [m].
    """
    x = interpolate(get_triangle(skins.triangles, skins.rest, triangle), weights)
    for k in range(SLOTS):
        at = q * SLOTS + k
        known = before.triangle[at]
        if known >= 0:
            if skins.triangle_body[known] == skins.triangle_body[triangle]:
                near = get_triangle(skins.triangles, skins.rest, known)
                y = interpolate(near, closest_point(near, x).weights)
                beside = wp.length(x - y) <= DEEPEST * skins.cell
                if beside and wp.dot(before.normal[at], normal) > ZERO and before.gap[at] <= most:
                    return True
    return False


@wp.func
def place_on(
    skins: Skins,
    position: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d),
    before: Touching,
    q: int,
    triangle: int,
    farthest: wp.float64,
    travel: wp.float64,
) -> Place:
    """The place of a triangle that the particle may touch: where it comes nearest, if it faces it there.

    A particle behind a skin is led back only to where it came from: what starts inside another stays.
    """
    place = Place()
    corners = get_triangle(skins.triangles, position, triangle)
    x = position[q]
    nearest = closest_point(corners, x)
    between = x - interpolate(corners, nearest.weights)
    d = wp.length(between)
    if d > farthest:
        return place
    face = unit_normal(corners)
    if wp.length_sq(face) == ZERO:
        return place
    if skins.triangle_body[triangle] == skins.body[q]:
        if belong_together(skins, q, triangle):
            return place
    if not is_nearest_around(skins, position, triangle, nearest, x, d):
        return place
    place.normal = face
    place.gap = d
    behind = wp.dot(between, outward_at(skins, position, normal, triangle, nearest, face)) < ZERO
    if behind:
        place.gap = -d
    if d > NO_DIRECTION * skins.cell:
        place.normal = between / place.gap
    if wp.dot(normal[q], place.normal) > FACING:
        return place
    if behind:
        if d > DEEPEST * skins.cell:
            return place
        if not came_in_there(skins, before, q, triangle, nearest.weights, place.normal, SLACK * travel - d):
            return place
    place.found = True
    place.triangle = triangle
    place.weights = nearest.weights
    return place


@wp.func
def comes_before(a_gap: wp.float64, a_triangle: int, b_gap: wp.float64, b_triangle: int) -> bool:
    return wp.abs(a_gap) < wp.abs(b_gap) or (wp.abs(a_gap) == wp.abs(b_gap) and a_triangle < b_triangle)


@wp.func
def put(skins: Skins, touching: Touching, q: int, place: Place):
    """Keeps a place among the particle's: the nearest of each skin and direction; behind a skin, the nearest."""
    slot = wp.int32(-1)
    free = wp.int32(-1)
    last = q * SLOTS
    for k in range(SLOTS):
        at = q * SLOTS + k
        t = touching.triangle[at]
        if t < 0:
            if free < 0:
                free = at
        else:
            same_skin = skins.triangle_body[t] == skins.triangle_body[place.triangle]
            both_behind = touching.gap[at] < ZERO and place.gap < ZERO
            if same_skin and (both_behind or wp.dot(touching.normal[at], place.normal) > SAME):
                slot = at
            if comes_before(touching.gap[last], touching.triangle[last], touching.gap[at], t):
                last = at
    if slot < 0:
        slot = free
    elif not comes_before(place.gap, place.triangle, touching.gap[slot], touching.triangle[slot]):
        return
    if slot < 0:
        if not comes_before(place.gap, place.triangle, touching.gap[last], touching.triangle[last]):
            return
        slot = last
    touching.triangle[slot] = place.triangle
    touching.weights[slot] = place.weights
    touching.normal[slot] = place.normal
    touching.gap[slot] = place.gap


@wp.func
def drop_far_sides(skins: Skins, touching: Touching, q: int):
    """A particle that lies before a skin is not behind another part of it, farther away: it looks through it."""
    for k in range(SLOTS):
        at = q * SLOTS + k
        if touching.triangle[at] >= 0 and touching.gap[at] < ZERO:
            for i in range(SLOTS):
                other = touching.triangle[q * SLOTS + i]
                if other >= 0:
                    gap = touching.gap[q * SLOTS + i]
                    same_skin = skins.triangle_body[other] == skins.triangle_body[touching.triangle[at]]
                    if same_skin and gap >= ZERO and gap < -touching.gap[at]:
                        touching.triangle[at] = -1
                        break


@wp.func
def to_float(x: wp.vec3d) -> wp.vec3f:
    return wp.vec3f(float(x[0]), float(x[1]), float(x[2]))


@wp.kernel
def find_places(
    first: int,
    body_count: int,
    skins: Skins,
    patches: Patches,
    reach: wp.array(dtype=wp.float64),
    margin: wp.float64,
    position: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d),
    before: Touching,
    touching: Touching,
):
    """The places that a particle may touch in a substep; one particle an item.

    position, normal: of the particles, at the substep's start.  reach: of the patches, see `find_near_patches`.
    before: of the substep before.
    """
    q = first + wp.tid()
    known = wp.bool(False)
    for k in range(SLOTS):
        touching.triangle[q * SLOTS + k] = -1
        if before.triangle[q * SLOTS + k] >= 0:
            known = True
    patch = skins.patch[q]
    if patch < 0:
        return
    if reach[patch] < ZERO:
        return
    travel = reach[patch] + margin
    farthest = travel
    if known:
        farthest = wp.max(farthest, DEEPEST * skins.cell)
    x = position[q]
    # The trees are of float32.
    size = farthest * wp.float64(1.00001) + wp.float64(1.0e-6) * wp.length(x)
    half = wp.vec3d(size, size, size)
    for b in range(body_count):
        meets = box_distance(x, x, patches.body_lower[b], patches.body_upper[b]) <= size
        if meets and not drawn_together(skins, q, b):
            query = wp.mesh_query_aabb(skins.mesh[b], to_float(x - half), to_float(x + half))
            face = wp.int32(0)
            while wp.mesh_query_aabb_next(query, face):
                triangle = skins.first_triangle[b] + face
                place = place_on(skins, position, normal, before, q, triangle, farthest, travel)
                if place.found:
                    put(skins, touching, q, place)
    drop_far_sides(skins, touching, q)
