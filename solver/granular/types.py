"""What the kernels of granular matter work on."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.material import material_type
from plait.solver.materials.symmetric import symmetric_functions

# Cells along a block's side; a block of particles scatters to a tile of twice as many nodes a side, eight blocks
# of nodes. Its first node is one before the first that the block's cells reach, so that particles may drift by a
# cell before they are sorted again.
BLOCK = 4
BLOCK_NODES = BLOCK**3
TILE = 2 * BLOCK
# Kernels take a stencil's nodes along z four at a time, the last of which is not the stencil's: room for it.
TILE_NODES = TILE**3 + BLOCK


@cache
def granular_types(real: type) -> SimpleNamespace:
    """Structs for `real` (wp.float32 or wp.float64), and the types they are made of."""
    structure = partial(wp.struct, module=f"plait_granular_types_{real.__name__}")
    vec3, vec4, mat33 = wp.types.vector(3, real), wp.types.vector(4, real), wp.types.matrix((3, 3), real)
    sym, Material = symmetric_functions(real).sym, material_type(real).Material

    @structure
    class Particles:
        """All particles, those of a block in a run; world frame."""

        position: wp.array(dtype=wp.vec3d)  # [m]
        velocity: wp.array(dtype=vec3)  # [m/s]
        affine: wp.array(dtype=mat33)  # [1/s] C of APIC, the gradient of velocity
        strain: wp.array(dtype=sym)  # Hencky's, elastic
        memory: wp.array(dtype=real)  # of the law
        mean_velocity: wp.array(dtype=vec3)  # [m/s] of late: what swings in place has none
        rest: wp.array(dtype=real)  # [s] for how long that has been less than `Step.still`
        volume: wp.array(dtype=real)  # [m3] at rest
        material: wp.array(dtype=wp.int32)  # index into Scene.granular
        number: wp.array(dtype=wp.int32)  # as given, which sorting does not change

    @structure
    class Blocks:
        """Blocks of cells that hold particles, and blocks of nodes that these reach."""

        first: wp.array(dtype=wp.int32)  # (block_count + 1,) into the particles
        origin: wp.array(dtype=wp.vec3i)  # (block_count,) [cells] the first node of the block's tile
        corner: wp.array2d(dtype=wp.int32)  # (block_count, 8) the blocks of nodes of its tile
        source: wp.array2d(dtype=wp.int32)  # (node_block_count, 8) its first node in each tile; -1: no tile
        node_origin: wp.array(dtype=wp.vec3i)  # (node_block_count,) [cells] its first node

    @structure
    class Step:
        cell_size: real  # [m]
        cells: wp.float64  # [1/m] cells to a metre
        length: real  # [s]
        gravity: vec3  # [m/s2]
        still: real  # [m/s] what is slower along each axis, in the mean, is at rest; 0: nothing is
        mean_part: real  # of the velocity now in the mean of late

    return SimpleNamespace(
        Particles=Particles,
        Blocks=Blocks,
        Step=Step,
        Material=Material,
        vec3=vec3,
        vec4=vec4,
        row=wp.types.vector(4 * BLOCK, real),
        mat33=mat33,
        sym=sym,
    )


def rows_of(nodes: wp.array, row: type) -> wp.array:
    """`nodes`, an array of vec4, seen as overlapping rows of four: entry n holds nodes n to n + 3."""
    return wp.array(
        ptr=nodes.ptr,
        dtype=row,
        shape=max(0, len(nodes) - BLOCK + 1),
        strides=(wp.types.type_size_in_bytes(nodes.dtype),),
        device=nodes.device,
    )
