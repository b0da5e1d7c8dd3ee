"""What the kernels of Han 2019 §6 share: particles, what bodies have at nodes, the grid."""

from __future__ import annotations

import warp as wp

from plait.solver.grid.transfer_kernels import Grid
from plait.solver.rigid.motion_kernels import Masses, Motion
from plait.solver.rigid.types import Start, Step

wp.set_module_options({"enable_backward": False})


@wp.struct
class Skin:
    """Collision particles of bodies, constant but for the director; axes of rest space."""

    body: wp.array(dtype=wp.int32)
    normal: wp.array(dtype=wp.vec3d)  # unit, outward
    volume: wp.array(dtype=wp.float64)  # [m3]
    director: wp.array(dtype=wp.vec3d)  # d of F; the normal where no other body is seen
    density: wp.array(dtype=wp.float64)  # (body_count,) [kg/m2] of its surface
    stiffness: wp.float64  # [Pa] k^c


@wp.struct
class Placed:
    """The particles on the grid: those of bodies first, a body's together, then those of what is animated."""

    particle: wp.array(dtype=wp.int32)  # into `Skin`
    body: wp.array(dtype=wp.int32)  # -1: moved by the animation
    lever: wp.array(dtype=wp.vec3d)  # [m] from the centre of mass of its body, world
    velocity: wp.array(dtype=wp.vec3d)  # [m/s] of what is animated
    mass: wp.array(dtype=wp.float64)  # [kg]; of what is animated its area [m2]
    friction: wp.array(dtype=wp.float64)  # negative: not told
    normal: wp.array(dtype=wp.vec3d)  # unit, world
    director: wp.array(dtype=wp.vec3d)  # world
    facing: wp.array(dtype=wp.vec3d)  # unit, the way to what is seen
    pull: wp.array(dtype=wp.vec3d)  # [N m] V_q dpsi/dd
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] I_q
    seen: wp.array(dtype=wp.float64)  # sum of w_iq times the part of a node's mass that others have; 0 facing none
    animated: wp.array(dtype=wp.float64)  # of that, the part of what is animated
    met_friction: wp.array(dtype=wp.float64)  # mean Coulomb coefficient with what is seen


@wp.struct
class Layers:
    """What each body has at nodes of the blocks that its particles reach; entry layer * BLOCK_NODES + local."""

    first: wp.array(dtype=wp.int32)  # (block_count + 1,)
    body: wp.array(dtype=wp.int32)  # (layer_count,) -1: animated
    block: wp.array(dtype=wp.int32)
    mass: wp.array(dtype=wp.float64)  # [kg]; of what is animated area [m2]
    velocity: wp.array(dtype=wp.vec3d)  # [m/s] of what is animated
    normal: wp.array(dtype=wp.vec3d)  # sum of normals, each with the mass it counts for
    force: wp.array(dtype=wp.vec3d)  # [N]
    friction: wp.array(dtype=wp.float64)  # negative: not told


@wp.struct
class Field:
    """The grid with all that is on it."""

    grid: Grid
    cell_size: wp.float64  # [m]
    step: wp.array(dtype=Step)  # (1,)
    motion: Motion
    masses: Masses
    start: Start
    skin: Skin
    placed: Placed
    layers: Layers


@wp.struct
class View:
    """A node as a body sees it."""

    part: wp.float64  # of the mass that others have
    animated: wp.float64  # of the mass that what is animated has
    velocity: wp.vec3d  # [m/s] of the node, less the body's own there
    acceleration: wp.vec3d  # [m/s2] by the potential
    normal: wp.vec3d  # of the others, times their part
    friction: wp.float64  # coefficients with the others, each times its part
