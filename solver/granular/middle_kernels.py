"""Where, about each node, the matter lies that it carries."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.stencil import stencil_functions
from plait.solver.granular.types import TILE, TILE_NODES, granular_types

ROW, LAYER = TILE, TILE * TILE


@cache
def middle_kernels(real: type) -> SimpleNamespace:
    """The kernel `add_middles` for `real` (wp.float32 or wp.float64)."""
    module = f"plait_granular_middle_{real.__name__}"
    types = granular_types(real)
    Particles, Blocks, Step, Material = types.Particles, types.Blocks, types.Step, types.Material
    vec3, vec4 = types.vec3, types.vec4
    locate, spline = stencil_functions(real).locate, stencil_functions(real).spline

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
            corner, offset = locate(particles.position[q], step.cells)
            mass = materials[particles.material[q]].density * particles.volume[q]
            wx = spline(offset[0])
            wy = spline(offset[1])
            wz = spline(offset[2])
            node = corner - origin
            base = start + node[0] * LAYER + node[1] * ROW + node[2]
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        m = mass * wx[i] * wy[j] * wz[k]
                        at = base + i * LAYER + j * ROW + k
                        arm = m * step.cell_size * (offset - vec3(number[i], number[j], number[k]))
                        tile_out[at] = tile_out[at] + vec4(arm[0], arm[1], arm[2], m)

    return SimpleNamespace(add_middles=add_middles)
