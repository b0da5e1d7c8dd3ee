"""Questions to a triangle mesh."""

from __future__ import annotations

import warp as wp

FAR = wp.constant(1.0e3)  # places are in units of the mesh's size
ACCURACY = wp.constant(2.0)
INSIDE = wp.constant(0.5)


@wp.func
def is_inside(mesh: wp.uint64, place: wp.vec3) -> wp.bool:
    return wp.mesh_query_point_sign_winding_number(mesh, place, FAR, ACCURACY, INSIDE).sign < 0.0


@wp.kernel(enable_backward=False)
def signed_distance(
    mesh: wp.uint64,
    places: wp.array(dtype=wp.vec3),
    distance_out: wp.array(dtype=wp.float32),
    face_out: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, places[i], FAR, ACCURACY, INSIDE)
    closest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    distance_out[i] = query.sign * wp.length(closest - places[i])
    face_out[i] = query.face


@wp.kernel(enable_backward=False)
def length_inside(
    mesh: wp.uint64,
    starts: wp.array(dtype=wp.vec3),
    ends: wp.array(dtype=wp.vec3),
    step: wp.float32,
    share_out: wp.array(dtype=wp.float32),
    middle_out: wp.array(dtype=wp.float32),
):
    """The part of a line that is inside, and the middle of the longest run of it, from 0 at the start to 1."""
    i = wp.tid()
    along = ends[i] - starts[i]
    length = wp.length(along)
    direction = along / length
    start = wp.float32(0.0)
    travelled = wp.float32(0.0)
    total = wp.float32(0.0)
    longest = wp.float32(0.0)
    middle = wp.float32(0.0)
    while travelled < length:
        query = wp.mesh_query_ray(mesh, starts[i] + travelled * direction, direction, length - travelled)
        end = wp.where(query.result, travelled + query.t, length)
        if is_inside(mesh, starts[i] + 0.5 * (start + end) * direction):
            total += end - start
            if end - start > longest:
                longest = end - start
                middle = 0.5 * (start + end)
        start = end
        travelled = end + step
    share_out[i] = total / length
    middle_out[i] = middle / length


@wp.kernel(enable_backward=False)
def holding_tet(
    tree: wp.uint64,
    corners: wp.array(dtype=wp.vec3),
    places: wp.array(dtype=wp.vec3),
    tet_out: wp.array(dtype=wp.int32),
):
    """The tet whose least barycentric coordinate at the place is largest; -1 outside all."""
    i = wp.tid()
    place = places[i]
    best = wp.int32(-1)
    best_least = wp.float32(-1.0e-3)
    query = wp.bvh_query_aabb(tree, place, place)
    tet = wp.int32(0)
    while wp.bvh_query_next(query, tet):
        origin = corners[4 * tet]
        edges = wp.matrix_from_cols(
            corners[4 * tet + 1] - origin, corners[4 * tet + 2] - origin, corners[4 * tet + 3] - origin
        )
        inner = wp.inverse(edges) @ (place - origin)
        least = wp.min(wp.min(inner), 1.0 - inner[0] - inner[1] - inner[2])
        if least > best_least:
            best = tet
            best_least = least
    tet_out[i] = best


@wp.kernel(enable_backward=False)
def first_hit(
    mesh: wp.uint64,
    starts: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    face_out: wp.array(dtype=wp.int32),
    distance_out: wp.array(dtype=wp.float32),
):
    """The triangle a ray meets first and how far away; -1 and nothing else for none."""
    i = wp.tid()
    query = wp.mesh_query_ray(mesh, starts[i], directions[i], FAR)
    face_out[i] = wp.where(query.result, query.face, wp.int32(-1))
    distance_out[i] = query.t


@wp.kernel(enable_backward=False)
def stays_inside(
    mesh: wp.uint64,
    starts: wp.array(dtype=wp.vec3),
    ends: wp.array(dtype=wp.vec3),
    step: wp.float32,
    open_out: wp.array(dtype=wp.bool),
):
    """Whether a line between two places inside never leaves: it may cross skin that has inside behind it too."""
    i = wp.tid()
    along = ends[i] - starts[i]
    length = wp.length(along)
    direction = along / length
    travelled = wp.float32(0.0)
    inside = wp.bool(True)
    while inside and travelled < length:
        query = wp.mesh_query_ray(mesh, starts[i] + travelled * direction, direction, length - travelled)
        if query.result:
            travelled += query.t + step
            inside = is_inside(mesh, starts[i] + travelled * direction) or travelled >= length
        else:
            travelled = length
    open_out[i] = inside
