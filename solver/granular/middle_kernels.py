"""Where, about each node, the matter lies that it carries."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.types import TILE, TILE_NODES, granular_types

ROW, LAYER = TILE, TILE * TILE


@cache
def middle_kernels(real: type) -> SimpleNamespace:
    """The kernel `add_middles` for `real` (wp.float32 or wp.float64)."""
    module = f"plait_granular_middle_{real.__name__}"
    types = granular_types(real)
    Particles, Blocks, Step, Material = types.Particles, types.Blocks, types.Step, types.Material
    vec3, vec4 = types.vec3, types.vec4

    @wp.func(module=module)
    def spline(offset: real):
        """The weights of a stencil's three nodes, `offset` cells (0.5 to 1.5) after the first."""
        before = real(1.5) - offset
        after = offset - real(0.5)
        middle = offset - real(1.0)
        return vec3(real(0.5) * before * before, real(0.75) - middle * middle, real(0.5) * after * after)

    @wp.kernel(module=module, enable_backward=False)
    def add_middles(
        first: int,
        particles: Particles,
        blocks: Blocks,
        materials: wp.array(dtype=Material),
        step: Step,
        tile_out: wp.array(dtype=vec4),
    ):
        """sum_q w_iq m_q (x_q - x_i) [kg m] and sum_q w_iq m_q of each block's particles; one block an item."""
        block = first + wp.tid()
        start = block * TILE_NODES
        for n in range(TILE_NODES):
            tile_out[start + n] = vec4()
        origin = blocks.origin[block]
        number = vec3(real(0.0), real(1.0), real(2.0))
        for q in range(blocks.first[block], blocks.first[block + 1]):
            place = particles.position[q] * step.cells
            x = wp.int32(wp.floor(place[0] - wp.float64(0.5)))
            y = wp.int32(wp.floor(place[1] - wp.float64(0.5)))
            z = wp.int32(wp.floor(place[2] - wp.float64(0.5)))
            offset = vec3(
                real(place[0] - wp.float64(x)), real(place[1] - wp.float64(y)), real(place[2] - wp.float64(z))
            )
            mass = materials[particles.material[q]].density * particles.volume[q]
            wx = spline(offset[0])
            wy = spline(offset[1])
            wz = spline(offset[2])
            base = start + (x - origin[0]) * LAYER + (y - origin[1]) * ROW + z - origin[2]
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        m = mass * wx[i] * wy[j] * wz[k]
                        at = base + i * LAYER + j * ROW + k
                        arm = m * step.cell_size * (offset - vec3(number[i], number[j], number[k]))
                        tile_out[at] = tile_out[at] + vec4(arm[0], arm[1], arm[2], m)

    return SimpleNamespace(add_middles=add_middles)
