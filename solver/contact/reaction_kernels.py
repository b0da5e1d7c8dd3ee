"""Where the planes that hold strands stand on the bodies' skins."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import ZERO, closest_point, get_triangle
from plait.solver.contact.meeting_kernels import Bodies, to_float
from plait.solver.contact.planes import PLANES_A_NODE

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(1.0e6)  # [m]


@wp.kernel
def find_feet(
    first: int,
    pushed: wp.array(dtype=wp.int32),  # planes that push
    plane_body: wp.array(dtype=wp.int32),
    bodies: Bodies,
    position: wp.array(dtype=wp.vec3d),
    vertices_out: wp.array(dtype=wp.vec3i),
    weights_out: wp.array(dtype=wp.vec3d),
):
    """The point of its surface nearest to the node that a plane pushes: corners and weights. One plane an item."""
    i = first + wp.tid()
    plane = pushed[i]
    body = plane_body[plane]
    x = position[plane / PLANES_A_NODE]
    vertices_out[i] = wp.vec3i(0, 0, 0)
    weights_out[i] = wp.vec3d(ZERO, ZERO, ZERO)
    query = wp.mesh_query_point_no_sign(bodies.mesh_end[body], to_float(x), FAR)
    if query.result:
        index = bodies.first_triangle[body] + query.face
        vertices_out[i] = bodies.triangles[index]
        weights_out[i] = closest_point(get_triangle(bodies.triangles, bodies.points_end, index), x).weights
