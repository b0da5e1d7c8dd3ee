"""What impulses do to a body, and how its places move; a body of -1 is none, and does not."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.motion_kernels import Masses, Motion
from plait.solver.rigid.types import Start

wp.set_module_options({"enable_backward": False})


@wp.func
def place_velocity(
    velocity: wp.array(dtype=wp.vec3d), spin: wp.array(dtype=wp.vec3d), b: int, lever: wp.vec3d
) -> wp.vec3d:
    """Of a body's place so far from its centre of mass, in the unit of `velocity`."""
    if b < 0:
        return wp.vec3d()
    return velocity[b] + wp.cross(spin[b], lever)


@wp.func
def push_body(
    masses: Masses,
    motion: Motion,
    start: Start,
    spin: wp.array(dtype=wp.vec3d),
    b: int,
    impulse: wp.vec3d,
    moment: wp.vec3d,
):
    """Gives an impulse [kg m/s] and an angular impulse [kg m2/s] about the centre of mass."""
    if b < 0:
        return
    motion.velocity[b] = motion.velocity[b] + impulse / masses.mass[b]
    motion.angular_momentum[b] = motion.angular_momentum[b] + moment
    spin[b] = spin[b] + start.inertia_inverse[b] * moment
