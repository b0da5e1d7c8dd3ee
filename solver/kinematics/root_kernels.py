"""The frames that carry strand roots."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# Twice a triangle's area, relative to its squared edges, below which it has no normal to speak of.
FLAT = wp.constant(wp.float64(1e-10))


@wp.struct
class RootTriangles:
    """Where each strand grows; one entry a strand."""

    vertices: wp.array(dtype=wp.vec3i)  # into the root vertices
    barycentric: wp.array(dtype=wp.vec3d)
    offset: wp.array(dtype=wp.vec3d)  # [m] root from that place at rest, rest space of the surface
    rest_frame: wp.array(dtype=wp.mat33d)  # columns: first edge's direction, normal x it, normal
    rest_edges_inverse: wp.array(dtype=wp.mat22d)  # of the two edges in that frame, columns


@wp.kernel
def pick_points(
    first: int,
    picked: wp.array(dtype=wp.int32),
    points: wp.array(dtype=wp.vec3d),
    points_out: wp.array(dtype=wp.vec3d),
):
    """points_out = points[picked], one entry an item."""
    i = first + wp.tid()
    points_out[i] = points[picked[i]]


@wp.kernel
def place_roots(
    first: int,
    roots: RootTriangles,
    vertices: wp.array(dtype=wp.vec3d),
    position_out: wp.array(dtype=wp.vec3d),
    rotation_out: wp.array(dtype=wp.mat33d),
):
    """One strand an item: the rotation is that of the polar decomposition of its triangle's deformation.

    Being the rotation nearest to the deformation it favours no edge. A triangle that has collapsed in this pose
    keeps the rotation it had.
    """
    s = first + wp.tid()
    corners = roots.vertices[s]
    a = vertices[corners[0]]
    edge1 = vertices[corners[1]] - a
    edge2 = vertices[corners[2]] - a
    normal = wp.cross(edge1, edge2)
    area = wp.length(normal)
    rotation = rotation_out[s]
    if area > FLAT * (wp.length_sq(edge1) + wp.length_sq(edge2)):
        normal = normal / area
        tangent = wp.normalize(edge1)
        bitangent = wp.cross(normal, tangent)
        edges = wp.mat22d(
            wp.dot(edge1, tangent), wp.dot(edge2, tangent), wp.dot(edge1, bitangent), wp.dot(edge2, bitangent)
        )
        # In the plane the polar rotation has a closed form: the angle of (G00 + G11, G10 - G01).
        in_plane = edges * roots.rest_edges_inverse[s]
        turn = wp.normalize(
            wp.vec2d(in_plane[0, 0] + in_plane[1, 1], in_plane[1, 0] - in_plane[0, 1]),
        )
        turned = turn[0] * tangent + turn[1] * bitangent
        rotation = wp.matrix_from_cols(turned, wp.cross(normal, turned), normal) * wp.transpose(
            roots.rest_frame[s]
        )
    weights = roots.barycentric[s]
    position_out[s] = a + weights[1] * edge1 + weights[2] * edge2 + rotation * roots.offset[s]
    rotation_out[s] = rotation
