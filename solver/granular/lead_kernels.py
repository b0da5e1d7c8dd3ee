"""Grains that have come to lie behind a surface are led out, without a change of velocity."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.types import BLOCK, BLOCK_NODES, granular_types
from plait.solver.grid.transfer_kernels import STENCIL, weight_of


@cache
def lead_kernels(real: type) -> SimpleNamespace:
    """The kernel `lead_out` for particles in `real` (wp.float32 or wp.float64)."""
    types = granular_types(real)
    Particles, Blocks = types.Particles, types.Blocks

    @wp.kernel(module=f"plait_granular_lead_{real.__name__}", enable_backward=False)
    def lead_out(
        first: int,
        chosen: wp.array(dtype=wp.int32),
        blocks: Blocks,
        cells: wp.float64,
        length: wp.float64,
        speed: wp.array(dtype=wp.vec3d),
        particles: Particles,
    ):
        """Moves particles by the mean of the nodes' `speed` [m/s] by w_iq; one block of those `chosen` an item."""
        block = chosen[first + wp.tid()]
        origin = blocks.origin[block]
        for q in range(blocks.first[block], blocks.first[block + 1]):
            place = particles.position[q] * cells
            x = wp.int32(wp.floor(place[0] - wp.float64(0.5)))
            y = wp.int32(wp.floor(place[1] - wp.float64(0.5)))
            z = wp.int32(wp.floor(place[2] - wp.float64(0.5)))
            offset = place - wp.vec3d(wp.float64(x), wp.float64(y), wp.float64(z))
            way = wp.vec3d()
            for i in range(STENCIL):
                for j in range(STENCIL):
                    for k in range(STENCIL):
                        a = x - origin[0] + i
                        b = y - origin[1] + j
                        c = z - origin[2] + k
                        corner = blocks.corner[block, (a / BLOCK) * 4 + (b / BLOCK) * 2 + c / BLOCK]
                        local = ((a % BLOCK) * BLOCK + b % BLOCK) * BLOCK + c % BLOCK
                        way += weight_of(offset, i, j, k) * speed[corner * BLOCK_NODES + local]
            particles.position[q] = particles.position[q] + length * way

    return SimpleNamespace(lead_out=lead_out)
