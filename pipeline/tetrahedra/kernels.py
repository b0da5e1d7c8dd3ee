"""Questions to a triangle mesh."""

from __future__ import annotations

import warp as wp

FAR = wp.constant(1.0e3)  # places are in units of the mesh's size
ACCURACY = wp.constant(2.0)
INSIDE = wp.constant(0.5)


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
