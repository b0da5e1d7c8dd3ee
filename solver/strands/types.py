"""The rods' device data, in the arithmetic precision asked for.

Layout: every strand has a ghost node behind its root, then its points, root first; node and edge slots share
global indices (edge k joins nodes k and k + 1, vertex k is the joint of edges k - 1 and k; a strand's last edge
slot is unused). All strands follow one another, strand s owning nodes first_node[s] to first_node[s + 1] - 1.
"""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

# An edge folded back on the one before has no curvature; closer than this to it, derivatives are taken as here.
LEAST_FOLD = 1.0e-6


def module_name(real: type) -> str:
    """The Warp module that holds all rod code of one precision, compiled once."""
    return f"plait_strands_{real.__name__}"


def coupled_module_name(real: type) -> str:
    """The module of what strands that meet need besides."""
    return f"plait_strands_coupled_{real.__name__}"


@cache
def rod_types(real: type) -> SimpleNamespace:
    """Vector, matrix and struct types for `real` (wp.float32 or wp.float64)."""
    module = module_name(real)
    structure = partial(wp.struct, module=module)
    vec2 = wp.types.vector(2, real)
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    mat43 = wp.types.matrix((4, 3), real)
    mat44 = wp.types.matrix((4, 4), real)

    @structure
    class Rods:
        """What is constant during a run."""

        first_node: wp.array(dtype=wp.int32)  # (strand_count + 1,)
        mass: wp.array(dtype=real)  # (node_count,) [kg] lumped
        force: wp.array(dtype=vec3)  # (node_count,) [N] weight and dead loads, world
        rest_length: wp.array(dtype=real)  # (node_count,) [m] of edge k
        inverse_rest_length: wp.array(dtype=real)  # (node_count,) [1/m]
        stretch: wp.array(dtype=real)  # (strand_count,) [N] EA, softened in float32 (`stretch.py`)
        stretch_beyond: wp.array(dtype=real)  # (strand_count,) [N] what EA has more beyond the bounded strain
        bend: wp.array(dtype=real)  # (node_count,) [N m] EI over vertex k's Voronoi length
        twist: wp.array(dtype=real)  # (node_count,) [N m] GJ over the same
        rest_curvature: wp.array(dtype=vec2)  # (node_count,) [1] integrated over vertex k
        rest_twist: wp.array(dtype=real)  # (node_count,) [rad]
        damping: wp.array(dtype=real)  # (strand_count,) [1/s]
        segment: wp.array(dtype=real)  # (strand_count,) [m] mean length
        slip: wp.array(dtype=real)  # (strand_count,) [m] least way at which friction is full
        ghost: wp.array(dtype=wp.vec3d)  # (strand_count,) [m] ghost node from the root, in the root's rest frame
        clamp_director: wp.array(dtype=wp.vec3d)  # (strand_count,) first edge's director, same frame
        free: wp.array(dtype=wp.int32)  # (strand_count,) 1: nothing holds the root
        turn_inertia: wp.array(dtype=real)  # (node_count,) [kg m2] of edge k about itself; empty: none is free

    @structure
    class RodState:
        """What evolves; world frame."""

        position: wp.array(dtype=wp.vec3d)  # (node_count,) [m]
        velocity: wp.array(dtype=wp.vec3d)  # (node_count,) [m/s]
        director: wp.array(dtype=wp.vec3d)  # (node_count,) unit, across edge k: material axis 1
        twist: wp.array(dtype=wp.float64)  # (node_count,) [rad] at vertex k, unwrapped
        tension: wp.array(dtype=wp.float64)  # (node_count,) [N] of edge k, the stretch's dual variable
        root_position: wp.array(dtype=wp.vec3d)  # (strand_count,) [m]
        root_rotation: wp.array(dtype=wp.mat33d)  # (strand_count,) rest space to world
        spin: wp.array(dtype=wp.float64)  # (node_count,) [rad/s] of edge k about itself; empty: no strand is free

    @structure
    class Roots:
        """Where the roots are at the end of the substep; of a free strand, its mass centre were it rigid."""

        position: wp.array(dtype=wp.vec3d)  # (strand_count,) [m]
        rotation: wp.array(dtype=wp.mat33d)  # (strand_count,)

    @structure
    class Method:
        """How a substep is solved."""

        step: wp.float64  # [s]; 0 asks for static equilibrium
        stages: wp.int32  # 1: backward Euler, 2: SDIRK2
        tolerance: real  # of a segment's length
        max_iterations: wp.int32
        warm: wp.int32  # 1: Newton starts from the result so far, 0: from the start carried rigidly
        max_pieces: wp.int32  # a strand that does not converge is stepped in 2, 4, ... parts, at most so many

    @structure
    class Scratch:
        """One strand's working set, reused by the strands of a chunk so that it stays in cache.

        Entry k of chunk c lies at c * chunk_stride + k * node_stride.
        """

        chunk_stride: wp.int32
        node_stride: wp.int32
        start: wp.array(dtype=vec3)  # positions at the piece's start, about the root at the substep's end
        start_velocity: wp.array(dtype=vec3)
        stage_velocity: wp.array(dtype=vec3)
        start_of_stage: wp.array(dtype=vec3)  # x0 of the implicit stage x = x0 + h v
        target: wp.array(dtype=vec3)  # where inertia alone would lead
        position: wp.array(dtype=vec3)
        director: wp.array(dtype=vec3)
        tangent: wp.array(dtype=vec3)  # of edge k, unit
        length: wp.array(dtype=real)  # [m] of edge k
        inverse_length: wp.array(dtype=real)  # [1/m]
        twist: wp.array(dtype=real)
        tension: wp.array(dtype=real)
        pressure: wp.array(dtype=real)  # [N] of each of a node's planes, in the solve before
        factor: wp.array(dtype=mat44)  # diagonal block's factor, see `blocks.py`
        lower1: wp.array(dtype=mat44)  # block towards the segment before
        lower2: wp.array(dtype=mat43)  # block towards the one before that, whose turn takes no part
        solution: wp.array(dtype=vec4)  # (angle, displacement) of segment k: its director, its end node
        # Of free strands: turns of edges about themselves since the piece's start, as positions above.
        start_director: wp.array(dtype=vec3)
        start_spin: wp.array(dtype=real)  # [rad/s]
        stage_spin: wp.array(dtype=real)
        turn_of_stage: wp.array(dtype=real)  # [rad]
        turn_target: wp.array(dtype=real)
        # Of strands that meet others (`strand_contact`), else empty; entry k as above.
        right: wp.array(dtype=vec4)  # the right-hand side of segment k, then what is left of it
        inverse: wp.array(dtype=mat44)  # of the diagonal block, see `substitution.py`
        left1: wp.array(dtype=mat44)  # the unit factor's block towards the segment before
        left2: wp.array(dtype=mat44)  # and towards the one before that
        meeting_block: wp.array(dtype=mat33)  # [N/m] stiffness that contacts give node k
        meeting_lower: wp.array(dtype=mat33)  # and between node k and the one before
        meeting_gradient: wp.array(dtype=vec3)  # [N] less their forces on node k

    @structure
    class Report:
        """What a substep did, a strand."""

        iterations: wp.array(dtype=wp.int32)  # Newton iterations, summed over stages and pieces
        unconverged: wp.array(dtype=wp.int32)  # 1 where even the shortest pieces did not converge
        pieces: wp.array(dtype=wp.int32)  # parts the substep was stepped in
        contacts: wp.array(dtype=wp.int32)  # nodes that a contact pushes
        reaction: wp.array(dtype=wp.vec3d)  # [N] of each of a node's planes on the node; empty: not asked for

    return SimpleNamespace(
        real=real,
        module=module,
        vec2=vec2,
        vec3=vec3,
        vec4=vec4,
        mat33=mat33,
        mat43=mat43,
        mat44=mat44,
        Rods=Rods,
        RodState=RodState,
        Roots=Roots,
        Method=Method,
        Scratch=Scratch,
        Report=Report,
    )
