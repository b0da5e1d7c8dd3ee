"""Transfers between particles and a sparse grid by quadratic B-splines, both as gathers: the same bits always."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# Nodes along a block's side. Blocks have slots; node n is number n % BLOCK_NODES of slot n / BLOCK_NODES.
BLOCK = wp.constant(4)
BLOCK_NODES = wp.constant(64)
# Nodes along the side of a particle's stencil.
STENCIL = wp.constant(3)


@wp.struct
class Grid:
    """The blocks that particles reach, and where each particle lies.

    A particle's stencil are the nodes base + (0..2, 0..2, 0..2), of which the middle one is nearest.
    """

    after: wp.array2d(dtype=wp.int32)  # (block_count, 8) slot at offset (i, j, k), 0 or 1 each; -1: not active
    before: wp.array2d(dtype=wp.int32)  # (block_count, 8) slot at offset (-i, -j, -k)
    base: wp.array(dtype=wp.int32)  # (particle_count,) base node
    offset: wp.array(dtype=wp.vec3d)  # (particle_count,) [cells] from the base node, 0.5 to 1.5
    cell_first: wp.array(dtype=wp.int32)  # (node_count + 1,) into particles, those whose base the node is
    particles: wp.array(dtype=wp.int32)  # by base node, ascending


@wp.func
def spline(offset: wp.float64, node: int) -> wp.float64:
    """The quadratic B-spline of node 0, 1 or 2 of a stencil, `offset` cells behind the point."""
    d = offset - wp.float64(node)
    if node == 1:
        return wp.float64(0.75) - d * d
    a = wp.float64(1.5) - wp.abs(d)
    return wp.float64(0.5) * a * a


@wp.func
def spline_slope(offset: wp.float64, node: int) -> wp.float64:
    """The derivative of `spline` by `offset`, [1/cells]."""
    d = offset - wp.float64(node)
    if node == 1:
        return wp.float64(-2.0) * d
    return wp.where(d < wp.float64(0.0), wp.float64(1.5) + d, d - wp.float64(1.5))


@wp.func
def weight_of(offset: wp.vec3d, i: int, j: int, k: int) -> wp.float64:
    """w_iq of node (i, j, k) of a particle's stencil."""
    return spline(offset[0], i) * spline(offset[1], j) * spline(offset[2], k)


@wp.func
def gradient_of(offset: wp.vec3d, i: int, j: int, k: int) -> wp.vec3d:
    """The gradient of w_iq by the particle's place, [1/cells]."""
    x = spline(offset[0], i)
    y = spline(offset[1], j)
    z = spline(offset[2], k)
    return wp.vec3d(
        spline_slope(offset[0], i) * y * z, x * spline_slope(offset[1], j) * z, x * y * spline_slope(offset[2], k)
    )


@wp.func
def arm_of(offset: wp.vec3d, i: int, j: int, k: int) -> wp.vec3d:
    """From a particle to node (i, j, k) of its stencil, [cells]."""
    return wp.vec3d(wp.float64(i), wp.float64(j), wp.float64(k)) - offset


@wp.func
def node_after(grid: Grid, node: int, i: int, j: int, k: int) -> int:
    """The node (i, j, k), each 0 to 2, further; -1 where its block is not active."""
    local = node % BLOCK_NODES
    x = local / (BLOCK * BLOCK) + i
    y = (local / BLOCK) % BLOCK + j
    z = local % BLOCK + k
    slot = grid.after[node / BLOCK_NODES, (x / BLOCK) * 4 + (y / BLOCK) * 2 + z / BLOCK]
    if slot < 0:
        return -1
    return slot * BLOCK_NODES + (x % BLOCK) * BLOCK * BLOCK + (y % BLOCK) * BLOCK + z % BLOCK


@wp.func
def node_before(grid: Grid, node: int, i: int, j: int, k: int) -> int:
    """The node (i, j, k), each 0 to 2, back; -1 where its block is not active."""
    local = node % BLOCK_NODES
    x = local / (BLOCK * BLOCK) - i + BLOCK
    y = (local / BLOCK) % BLOCK - j + BLOCK
    z = local % BLOCK - k + BLOCK
    slot = grid.before[node / BLOCK_NODES, (1 - x / BLOCK) * 4 + (1 - y / BLOCK) * 2 + 1 - z / BLOCK]
    if slot < 0:
        return -1
    return slot * BLOCK_NODES + (x % BLOCK) * BLOCK * BLOCK + (y % BLOCK) * BLOCK + z % BLOCK


@wp.kernel
def to_grid(
    first: int,
    grid: Grid,
    particle_mass: wp.array(dtype=wp.float64),
    particle_velocity: wp.array(dtype=wp.vec3d),
    mass_out: wp.array(dtype=wp.float64),
    velocity_out: wp.array(dtype=wp.vec3d),
):
    """m_i = sum_q w_iq m_q and v_i = sum_q w_iq m_q v_q / m_i (Han 2019 (17), (18)); one node an item."""
    node = first + wp.tid()
    mass = wp.float64(0.0)
    momentum = wp.vec3d()
    for i in range(STENCIL):
        for j in range(STENCIL):
            for k in range(STENCIL):
                base = node_before(grid, node, i, j, k)
                if base >= 0:
                    for at in range(grid.cell_first[base], grid.cell_first[base + 1]):
                        q = grid.particles[at]
                        m = weight_of(grid.offset[q], i, j, k) * particle_mass[q]
                        mass += m
                        momentum += m * particle_velocity[q]
    mass_out[node] = mass
    if mass > wp.float64(0.0):
        velocity_out[node] = momentum / mass
    else:
        velocity_out[node] = wp.vec3d()


@wp.kernel
def to_grid_affine(
    first: int,
    grid: Grid,
    cell_size: wp.float64,
    particle_mass: wp.array(dtype=wp.float64),
    particle_velocity: wp.array(dtype=wp.vec3d),
    particle_affine: wp.array(dtype=wp.mat33d),
    mass_out: wp.array(dtype=wp.float64),
    velocity_out: wp.array(dtype=wp.vec3d),
):
    """As `to_grid`, v_i = sum_q w_iq m_q (v_q + C_q (x_i - x_q)) / m_i (APIC, Jiang et al. 2015)."""
    node = first + wp.tid()
    mass = wp.float64(0.0)
    momentum = wp.vec3d()
    for i in range(STENCIL):
        for j in range(STENCIL):
            for k in range(STENCIL):
                base = node_before(grid, node, i, j, k)
                if base >= 0:
                    for at in range(grid.cell_first[base], grid.cell_first[base + 1]):
                        q = grid.particles[at]
                        m = weight_of(grid.offset[q], i, j, k) * particle_mass[q]
                        mass += m
                        arm = cell_size * arm_of(grid.offset[q], i, j, k)
                        momentum += m * (particle_velocity[q] + particle_affine[q] * arm)
    mass_out[node] = mass
    if mass > wp.float64(0.0):
        velocity_out[node] = momentum / mass
    else:
        velocity_out[node] = wp.vec3d()


@wp.func
def value_at(grid: Grid, q: int, of_nodes: wp.array(dtype=wp.vec3d)) -> wp.vec3d:
    """sum_i w_iq y_i at particle q (Han 2019 (19))."""
    total = wp.vec3d()
    for i in range(STENCIL):
        for j in range(STENCIL):
            for k in range(STENCIL):
                weight = weight_of(grid.offset[q], i, j, k)
                total += weight * of_nodes[node_after(grid, grid.base[q], i, j, k)]
    return total


@wp.kernel
def from_grid(
    first: int,
    grid: Grid,
    node_velocity: wp.array(dtype=wp.vec3d),
    particle_velocity_out: wp.array(dtype=wp.vec3d),
):
    """v_q = sum_i w_iq v_i; one particle an item."""
    q = first + wp.tid()
    particle_velocity_out[q] = value_at(grid, q, node_velocity)
