"""Han 2019 (20) to (25), as printed."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import ZERO

wp.set_module_options({"enable_backward": False})


@wp.kernel
def change_particles(
    first: int,
    normal: wp.array(dtype=wp.vec3d),
    friction: wp.array(dtype=wp.float64),
    particle_velocity: wp.array(dtype=wp.vec3d),
    grid_velocity: wp.array(dtype=wp.vec3d),
    change_out: wp.array(dtype=wp.vec3d),
):
    """Delta v_q = I_q n_q / m_q + min(|v_t|, -mu I_q / m_q) v_t / |v_t| where v_r . n_q < 0; one particle an item.

    v_r is the grid's velocity less the particle's (20), I_q = 2 m_q v_r . n_q the elastic impulse (22), v_t the
    part of v_r across the normal (23).
    """
    q = first + wp.tid()
    n = normal[q]
    relative = grid_velocity[q] - particle_velocity[q]
    along = wp.dot(relative, n)
    change = wp.vec3d()
    if along < ZERO:
        impulse_over_mass = wp.float64(2.0) * along
        change = impulse_over_mass * n
        across = relative - along * n
        length = wp.length(across)
        if length > ZERO:
            change += wp.min(length, -friction[q] * impulse_over_mass) * across / length
    change_out[q] = change


@wp.kernel
def change_nodes(
    first: int,
    node_offsets: wp.array(dtype=wp.int32),
    node_particles: wp.array(dtype=wp.int32),
    node_weights: wp.array(dtype=wp.float64),
    mass: wp.array(dtype=wp.float64),
    change: wp.array(dtype=wp.vec3d),
    mobile: wp.array(dtype=wp.float64),
    velocity: wp.array(dtype=wp.vec3d),
    node_change_out: wp.array(dtype=wp.vec3d),
):
    """v_p += sum_q b_pq m_q Delta v_q / sum_r b_pr m_r (24), (25); one node an item."""
    p = first + wp.tid()
    total = wp.vec3d()
    shares = ZERO
    for k in range(node_offsets[p], node_offsets[p + 1]):
        q = node_particles[k]
        share = node_weights[k] * mass[q]
        shares += share
        total += share * change[q]
    node_change = wp.vec3d()
    if shares > ZERO and mobile[p] > ZERO:
        node_change = total / shares
    velocity[p] = velocity[p] + node_change
    node_change_out[p] = node_change
