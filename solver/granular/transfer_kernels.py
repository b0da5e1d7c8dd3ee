"""Particles to grid and back: moving least squares MPM (Hu et al. 2018) with affine transfers (Jiang et al. 2015).

Particle q carries velocity v_q and its gradient C_q; with quadratic B-splines w_iq and D = dx^2/4
    m_i v_i = sum_q w_iq (m_q v_q + (m_q C_q - dt/D V_q tau_q) (x_i - x_q)),
    v_q = sum_i w_iq v_i,   C_q = sum_i w_iq v_i (x_i - x_q)^T / D.
A block of particles adds to a tile of nodes of its own, in the order the particles lie; a block of nodes adds up
the tiles that hold it, always in the same order: the same bits with any number of threads.
"""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.laws import law_functions
from plait.solver.granular.stencil import stencil_functions
from plait.solver.granular.types import BLOCK, BLOCK_NODES, TILE, TILE_NODES, granular_types
from plait.solver.materials.symmetric import symmetric_functions
from plait.solver.scene import GranularLaw

ROW, LAYER = TILE, TILE * TILE
TILE_ROWS = TILE_NODES // BLOCK
# A speed that is not finite is told as this.
LOST = 1.0e30


@cache
def transfer_kernels(laws: tuple[GranularLaw, ...], real: type) -> SimpleNamespace:
    """Kernels for the laws in use, in `real` (wp.float32 or wp.float64)."""
    module = f"plait_granular_transfer_{'_'.join(laws)}_{real.__name__}"
    kernel, function = partial(wp.kernel, module=module, enable_backward=False), partial(wp.func, module=module)
    types, law, functions = granular_types(real), law_functions(laws, real), symmetric_functions(real)
    Particles, Blocks, Step, Material = types.Particles, types.Blocks, types.Step, types.Material
    vec3, vec4, row, mat33 = types.vec3, types.vec4, types.row, types.mat33
    kirchhoff, return_map, wave_modulus = law.kirchhoff, law.return_map, law.wave_modulus
    to_matrix, trace_of, deform = functions.to_matrix, functions.trace_of, functions.deform
    locate, spline = stencil_functions(real).locate, stencil_functions(real).spline
    one, two = real(1.0), real(2.0)

    @function
    def along_row(w: vec3):
        """Weights of a stencil's nodes along z, for each of the four numbers that a node holds."""
        o = real(0.0)
        return row(w[0], w[0], w[0], w[0], w[1], w[1], w[1], w[1], w[2], w[2], w[2], w[2], o, o, o, o)

    @function
    def repeated(a: real, b: real, c: real, d: real):
        """The same for every node along z."""
        return row(a, b, c, d, a, b, c, d, a, b, c, d, a, b, c, d)

    @function
    def node_of(values: row, k: int):
        return vec4(values[4 * k], values[4 * k + 1], values[4 * k + 2], values[4 * k + 3])

    @function
    def node_in_tile(node: wp.vec3i):
        """Where a node, counted from a tile's first, is in the tile."""
        return node[0] * LAYER + node[1] * ROW + node[2]

    @kernel
    def to_tiles(
        first: int,
        chosen: wp.array(dtype=wp.int32),
        particles: Particles,
        blocks: Blocks,
        materials: wp.array(dtype=Material),
        step: Step,
        tile_out: wp.array(dtype=row),
    ):
        """Momentum [kg m/s] and mass [kg] of each chosen block's particles on its tile; one block an item."""
        block = chosen[first + wp.tid()]
        start = block * TILE_NODES
        for n in range(TILE_ROWS):
            tile_out[start + n * BLOCK] = row()
        origin = blocks.origin[block]
        for q in range(blocks.first[block], blocks.first[block + 1]):
            corner, offset = locate(particles.position[q], step.cells)
            material = materials[particles.material[q]]
            volume = particles.volume[q]
            mass = material.density * volume
            tau = kirchhoff(particles.strain[q], particles.memory[q], material)
            pull = real(4.0) * step.length * volume / step.cell_size
            A = (mass * step.cell_size) * particles.affine[q] - pull * to_matrix(tau)
            p = mass * particles.velocity[q] - A * offset
            wx = spline(offset[0])
            wy = spline(offset[1])
            wz = spline(offset[2])
            weights = along_row(wz)
            along_z = along_row(vec3(real(0.0), wz[1], two * wz[2]))
            value = wp.cw_mul(weights, repeated(p[0], p[1], p[2], mass)) + wp.cw_mul(
                along_z, repeated(A[0, 2], A[1, 2], A[2, 2], real(0.0))
            )
            along_x = wp.cw_mul(weights, repeated(A[0, 0], A[1, 0], A[2, 0], real(0.0)))
            along_y = wp.cw_mul(weights, repeated(A[0, 1], A[1, 1], A[2, 1], real(0.0)))
            base = start + node_in_tile(corner - origin)
            for i in range(3):
                here = wx[i] * value
                change = wx[i] * along_y
                n = base + i * LAYER
                tile_out[n] = tile_out[n] + wy[0] * here
                tile_out[n + ROW] = tile_out[n + ROW] + wy[1] * (here + change)
                tile_out[n + 2 * ROW] = tile_out[n + 2 * ROW] + wy[2] * (here + two * change)
                value = value + along_x

    @kernel
    def to_nodes(
        first: int,
        chosen: wp.array(dtype=wp.int32),
        blocks: Blocks,
        tile: wp.array(dtype=row),
        node_out: wp.array(dtype=row),
    ):
        """Momentum and mass of the nodes, from the tiles that hold them; one chosen block of nodes an item."""
        block = chosen[first + wp.tid()]
        start = block * BLOCK_NODES
        for r in range(BLOCK * BLOCK):
            total = row()
            for s in range(blocks.source.shape[1]):
                source = blocks.source[block, s]
                if source >= 0:
                    total += tile[source + (r / BLOCK) * LAYER + (r % BLOCK) * ROW]
            node_out[start + r * BLOCK] = total

    @kernel
    def to_velocities(
        first: int,
        chosen: wp.array(dtype=wp.int32),
        node: wp.array(dtype=vec4),
        step: Step,
        velocity_out: wp.array(dtype=vec4),
    ):
        """Velocity [m/s] of the nodes after gravity, and their mass; one chosen block of nodes an item."""
        start = chosen[first + wp.tid()] * BLOCK_NODES
        g = step.length * step.gravity
        for n in range(start, start + BLOCK_NODES):
            held = node[n]
            if held[3] > real(0.0):
                v = (one / held[3]) * held
                velocity_out[n] = vec4(v[0] + g[0], v[1] + g[1], v[2] + g[2], held[3])
            else:
                velocity_out[n] = vec4()

    @function
    def fill_tile(
        start: int, block: int, blocks: Blocks, velocity: wp.array(dtype=row), tile: wp.array(dtype=row)
    ):
        """Copies the velocities of a block's eight blocks of nodes to its tile, which starts at `start`."""
        for s in range(blocks.corner.shape[1]):
            source = blocks.corner[block, s] * BLOCK_NODES
            to = start + (s / 4) * BLOCK * LAYER + ((s / 2) % 2) * BLOCK * ROW + (s % 2) * BLOCK
            for r in range(BLOCK * BLOCK):
                tile[to + (r / BLOCK) * LAYER + (r % BLOCK) * ROW] = velocity[source + r * BLOCK]

    @function
    def gather(base: int, offset: vec3, cell_size: real, tile: wp.array(dtype=row)):
        """v and, by columns, C of a particle whose stencil starts at node `base` of `tile`."""
        number = vec3(real(0.0), one, two)
        wx = spline(offset[0])
        wy = spline(offset[1])
        rows = row()
        rows_x = row()
        rows_y = row()
        for i in range(3):
            n = base + i * LAYER
            middle = wy[1] * tile[n + ROW]
            last = wy[2] * tile[n + 2 * ROW]
            layer = wx[i] * (wy[0] * tile[n] + middle + last)
            rows += layer
            rows_x += number[i] * layer
            rows_y += wx[i] * (middle + two * last)
        weights = along_row(spline(offset[2]))
        rows = wp.cw_mul(weights, rows)
        middle_node = node_of(rows, 1)
        last_node = node_of(rows, 2)
        v = node_of(rows, 0) + middle_node + last_node
        rows_x = wp.cw_mul(weights, rows_x)
        along_x = node_of(rows_x, 0) + node_of(rows_x, 1) + node_of(rows_x, 2)
        rows_y = wp.cw_mul(weights, rows_y)
        along_y = node_of(rows_y, 0) + node_of(rows_y, 1) + node_of(rows_y, 2)
        along_z = middle_node + two * last_node
        scale = real(4.0) / cell_size
        along_x = scale * (along_x - offset[0] * v)
        along_y = scale * (along_y - offset[1] * v)
        along_z = scale * (along_z - offset[2] * v)
        C = mat33(
            along_x[0], along_y[0], along_z[0],
            along_x[1], along_y[1], along_z[1],
            along_x[2], along_y[2], along_z[2],
        )  # fmt: skip
        return vec3(v[0], v[1], v[2]), C

    @kernel
    def to_particles(
        first: int,
        chosen: wp.array(dtype=wp.int32),
        particles: Particles,
        blocks: Blocks,
        materials: wp.array(dtype=Material),
        step: Step,
        velocity: wp.array(dtype=row),
        tile: wp.array(dtype=row),
        told_out: wp.array(dtype=wp.vec3d),
    ):
        """Moves and deforms each chosen block's particles; `tile` is room to work in. One block an item.

        told_out: of the block [m/s] the largest part of a velocity along an axis, [m/s] the fastest sound, and
        [s] how long all of it has been at rest.
        """
        block = chosen[first + wp.tid()]
        start = block * TILE_NODES
        fill_tile(start, block, blocks, velocity, tile)
        origin = blocks.origin[block]
        fastest = real(0.0)
        sound = real(0.0)
        least_rest = two * real(LOST)  # itself, LOST would change with it: Warp gives both one place
        for q in range(blocks.first[block], blocks.first[block + 1]):
            corner, offset = locate(particles.position[q], step.cells)
            v, C = gather(start + node_in_tile(corner - origin), offset, step.cell_size, tile)
            material = materials[particles.material[q]]
            trial = deform(particles.strain[q], step.length * C)
            strain, memory = return_map(trial, particles.memory[q], material)
            way = step.length * v
            particles.position[q] = particles.position[q] + wp.vec3d(
                wp.float64(way[0]), wp.float64(way[1]), wp.float64(way[2])
            )
            particles.velocity[q] = v
            particles.affine[q] = C
            particles.strain[q] = strain
            particles.memory[q] = memory
            speed = wp.max(wp.max(wp.abs(v[0]), wp.abs(v[1])), wp.abs(v[2]))
            if not (speed + wp.abs(trace_of(strain)) < real(LOST)):
                speed = real(LOST)
            rest = real(0.0)
            if step.still > real(0.0):
                mean = particles.mean_velocity[q] + step.mean_part * (v - particles.mean_velocity[q])
                particles.mean_velocity[q] = mean
                if wp.max(wp.max(wp.abs(mean[0]), wp.abs(mean[1])), wp.abs(mean[2])) < step.still:
                    rest = particles.rest[q] + step.length
                particles.rest[q] = rest
            fastest = wp.max(fastest, speed)
            sound = wp.max(sound, wave_modulus(memory, material) / material.density)
            least_rest = wp.min(least_rest, rest)
        told_out[block] = wp.vec3d(wp.float64(fastest), wp.float64(wp.sqrt(sound)), wp.float64(least_rest))

    @kernel
    def stop(first: int, chosen: wp.array(dtype=wp.int32), particles: Particles, blocks: Blocks):
        """Takes all velocity from what falls asleep, that it may push no one on; one chosen block an item."""
        block = chosen[first + wp.tid()]
        for q in range(blocks.first[block], blocks.first[block + 1]):
            particles.velocity[q] = vec3()
            particles.affine[q] = mat33()

    return SimpleNamespace(
        to_tiles=to_tiles, to_nodes=to_nodes, to_velocities=to_velocities, to_particles=to_particles, stop=stop
    )
