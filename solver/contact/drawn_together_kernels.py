"""How deep points lie inside a closed or open surface, by its winding number."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(1.0e6)  # [m]


@wp.kernel
def find_depths(
    first: int, mesh: wp.uint64, points: wp.array(dtype=wp.vec3f), depth_out: wp.array(dtype=wp.float32)
):
    """[m] distance of each point from the surface, negative outside. One point an item."""
    i = first + wp.tid()
    depth_out[i] = -FAR
    query = wp.mesh_query_point_sign_winding_number(mesh, points[i], FAR)
    if query.result:
        foot = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        depth_out[i] = -query.sign * wp.length(points[i] - foot)
