"""Which places lie inside a closed surface."""

import warp as wp

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(wp.float32(1.0e10))


@wp.kernel
def find_inside(
    first: int,
    mesh: wp.uint64,
    places: wp.array(dtype=wp.vec3f),
    inside_out: wp.array(dtype=wp.int32),
):
    """1 where the winding number of the surface is above a half, else 0; one place an item."""
    i = first + wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, places[i], FAR)
    inside_out[i] = wp.where(query.result and query.sign < 0.0, 1, 0)
