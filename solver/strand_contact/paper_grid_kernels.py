"""Strands as matter on a grid that resists being pressed together (Han 2019, 5.2); float64."""

import warp as wp

from plait.solver.grid.transfer_kernels import (
    STENCIL,
    Grid,
    arm_of,
    gradient_of,
    node_after,
    node_before,
    weight_of,
)
from plait.solver.materials.drucker_prager import drucker_prager
from plait.solver.materials.hencky import hencky

wp.set_module_options({"enable_backward": False})

first_piola = hencky(wp.float64).first_piola
project = drucker_prager(wp.float64).project


@wp.struct
class Matter:
    """The strands' nodes as particles: what is constant; arrays are (node_count,)."""

    mass: wp.array(dtype=wp.float64)  # [kg]; zero at ghosts
    cone: wp.array(dtype=wp.float64)  # alpha of the friction cone, see `drucker_prager.py`
    pic_fraction: wp.array(dtype=wp.float64)  # xi
    prescribed: wp.array(dtype=wp.int32)  # 1: the node goes where it is told


@wp.struct
class MatterState:
    """What evolves; arrays are (node_count,)."""

    affine: wp.array(dtype=wp.mat33d)  # C [1/s]
    elastic: wp.array(dtype=wp.mat33d)  # F^E of phi^d
    gained: wp.array(dtype=wp.float64)  # ln of the volume gained under tension: the plastic state


@wp.struct
class Law:
    """Lame parameters over the density [m2/s2], the substep [s] and the grid's spacing [m]."""

    mu: wp.float64
    lam: wp.float64
    step: wp.float64
    cell_size: wp.float64


@wp.kernel
def evaluate_impulses(
    first: int,
    law: Law,
    mass: wp.array(dtype=wp.float64),
    elastic: wp.array(dtype=wp.mat33d),
    impulse_out: wp.array(dtype=wp.mat33d),
):
    """dt V_p^0 P F^T [kg m2/s], what (31) multiplies with grad w_ip; one particle an item."""
    p = first + wp.tid()
    F = elastic[p]
    impulse_out[p] = (law.step * mass[p]) * (first_piola(F, law.mu, law.lam) * wp.transpose(F))


@wp.kernel
def change_nodes(
    first: int,
    grid: Grid,
    cell_size: wp.float64,
    node_mass: wp.array(dtype=wp.float64),
    particle_impulse: wp.array(dtype=wp.mat33d),
    change_out: wp.array(dtype=wp.vec3d),
):
    """v_i^{n+1} - v_i = -1/m_i sum_p dt V_p^0 P F^T grad w_ip (31), alpha = 0; one grid node an item."""
    node = first + wp.tid()
    total = wp.vec3d()
    for i in range(STENCIL):
        for j in range(STENCIL):
            for k in range(STENCIL):
                base = node_before(grid, node, i, j, k)
                if base >= 0:
                    for at in range(grid.cell_first[base], grid.cell_first[base + 1]):
                        p = grid.particles[at]
                        total += particle_impulse[p] * gradient_of(grid.offset[p], i, j, k)
    if node_mass[node] > wp.float64(0.0):
        change_out[node] = -total / (cell_size * node_mass[node])
    else:
        change_out[node] = wp.vec3d()


@wp.kernel
def return_to_strands(
    first: int,
    grid: Grid,
    law: Law,
    matter: Matter,
    node_velocity: wp.array(dtype=wp.vec3d),  # before the stress
    node_change: wp.array(dtype=wp.vec3d),
    velocity_out: wp.array(dtype=wp.vec3d),
    state_out: MatterState,
    overturned_out: wp.array(dtype=wp.int32),
):
    """Blended velocity (33), C as in APIC, and F^E by (32) returned to its cone; one particle an item, ghosts not.

    overturned_out: 1 where the grid has turned over, so that F^E begins anew.
    """
    p = first + wp.tid()
    overturned_out[p] = 0
    if matter.mass[p] == wp.float64(0.0):
        return
    velocity = wp.vec3d()
    change = wp.vec3d()
    affine = wp.mat33d()
    gradient = wp.mat33d()
    offset = grid.offset[p]
    for i in range(STENCIL):
        for j in range(STENCIL):
            for k in range(STENCIL):
                node = node_after(grid, grid.base[p], i, j, k)
                weight = weight_of(offset, i, j, k)
                v = node_velocity[node] + node_change[node]
                velocity += weight * v
                change += weight * node_change[node]
                affine += wp.outer(weight * v, arm_of(offset, i, j, k))
                gradient += wp.outer(v, gradient_of(offset, i, j, k))
    # sum_i w_ip (x_i - x_p)(x_i - x_p)^T = cell_size^2 / 4 of quadratic splines (Jiang et al. 2016, 5.3).
    state_out.affine[p] = wp.float64(4.0) / law.cell_size * affine
    if matter.prescribed[p] == 0:
        part = matter.pic_fraction[p]
        velocity_out[p] = (wp.float64(1.0) - part) * (velocity_out[p] + change) + part * velocity
    F = state_out.elastic[p] + (law.step / law.cell_size) * (gradient * state_out.elastic[p])
    elastic, gained, upright = project(F, state_out.gained[p], law.mu, law.lam, matter.cone[p])
    state_out.elastic[p] = elastic
    state_out.gained[p] = gained
    overturned_out[p] = wp.where(upright, 0, 1)
