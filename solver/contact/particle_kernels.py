"""Collision particles on the device: where they are and how they move."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import ZERO

wp.set_module_options({"enable_backward": False})

vec4i = wp.vec4i


@wp.kernel
def gather(
    first: int,
    particle_nodes: wp.array(dtype=vec4i),
    particle_weights: wp.array(dtype=wp.vec4d),
    of_nodes: wp.array(dtype=wp.vec3d),
    of_particles_out: wp.array(dtype=wp.vec3d),
):
    """y_q = sum_p b_pq y_p (Han 2019 (15), (16)); one particle an item."""
    q = first + wp.tid()
    node = particle_nodes[q]
    weight = particle_weights[q]
    y = weight[0] * of_nodes[node[0]]
    for k in range(1, 4):
        y += weight[k] * of_nodes[node[k]]
    of_particles_out[q] = y


@wp.kernel
def face_areas(
    first: int,
    triangles: wp.array(dtype=wp.vec3i),
    position: wp.array(dtype=wp.vec3d),
    area_vector_out: wp.array(dtype=wp.vec3d),
):
    """Twice each triangle's area along its outward normal; one triangle an item."""
    t = first + wp.tid()
    corner = triangles[t]
    a = position[corner[0]]
    area_vector_out[t] = wp.cross(position[corner[1]] - a, position[corner[2]] - a)


@wp.kernel
def particle_normals(
    first: int,
    triangle_offsets: wp.array(dtype=wp.int32),
    particle_triangles: wp.array(dtype=wp.int32),
    area_vector: wp.array(dtype=wp.vec3d),
    normal_out: wp.array(dtype=wp.vec3d),
):
    """The mean normal, by area, of the triangles a particle lies on; zero for none; one particle an item."""
    q = first + wp.tid()
    total = wp.vec3d()
    for k in range(triangle_offsets[q], triangle_offsets[q + 1]):
        total += area_vector[particle_triangles[k]]
    length = wp.length(total)
    if length > ZERO:
        total = total / length
    normal_out[q] = total
