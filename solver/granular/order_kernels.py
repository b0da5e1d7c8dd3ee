"""Kernels that put particles in the order of the cells they lie in."""

import warp as wp

from plait.solver.granular.types import BLOCK

wp.set_module_options({"enable_backward": False})

# Particles whose bounds are taken by one item.
CHUNK = wp.constant(4096)


@wp.func
def base_cell(position: wp.vec3d, cells: wp.float64) -> wp.vec3i:
    """The first node of a particle's stencil."""
    return wp.vec3i(
        wp.int32(wp.floor(position[0] * cells - wp.float64(0.5))),
        wp.int32(wp.floor(position[1] * cells - wp.float64(0.5))),
        wp.int32(wp.floor(position[2] * cells - wp.float64(0.5))),
    )


@wp.kernel
def bound(
    first: int,
    position: wp.array(dtype=wp.vec3d),
    count: int,
    cells: wp.float64,
    lower_out: wp.array(dtype=wp.vec3i),
    upper_out: wp.array(dtype=wp.vec3i),
):
    """The least and largest base cells of CHUNK particles; one chunk an item."""
    chunk = first + wp.tid()
    lower = base_cell(position[chunk * CHUNK], cells)
    upper = lower
    for q in range(chunk * CHUNK, wp.min((chunk + 1) * CHUNK, count)):
        cell = base_cell(position[q], cells)
        lower = wp.min(lower, cell)
        upper = wp.max(upper, cell)
    lower_out[chunk] = lower
    upper_out[chunk] = upper


@wp.kernel
def find_keys(
    first: int,
    position: wp.array(dtype=wp.vec3d),
    cells: wp.float64,
    lower: wp.vec3i,
    shape: wp.vec3i,
    key_out: wp.array(dtype=wp.int64),
    order_out: wp.array(dtype=wp.int32),
):
    """The number of a particle's block in a box of `shape` blocks from the cell `lower`, then of its cell."""
    q = first + wp.tid()
    cell = base_cell(position[q], cells) - lower
    block = wp.vec3i(cell[0] / BLOCK, cell[1] / BLOCK, cell[2] / BLOCK)
    within = cell - BLOCK * block
    number = (wp.int64(block[0]) * wp.int64(shape[1]) + wp.int64(block[1])) * wp.int64(shape[2]) + wp.int64(
        block[2]
    )
    local = (within[0] * BLOCK + within[1]) * BLOCK + within[2]
    key_out[q] = number * wp.int64(BLOCK * BLOCK * BLOCK) + wp.int64(local)
    order_out[q] = q


@wp.kernel
def reorder(
    first: int,
    order: wp.array(dtype=wp.int32),
    words: int,
    values: wp.array(dtype=wp.int32),
    values_out: wp.array(dtype=wp.int32),
):
    """values_out[i] = values[order[i]] of values of so many 4 byte words; one value an item."""
    i = first + wp.tid()
    to = wp.int64(i) * wp.int64(words)
    at = wp.int64(order[i]) * wp.int64(words)
    for w in range(words):
        values_out[to + wp.int64(w)] = values[at + wp.int64(w)]
