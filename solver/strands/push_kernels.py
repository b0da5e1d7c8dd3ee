"""Impulses on strands' nodes."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def take_up(
    first: int,
    inverse_mass: wp.array(dtype=wp.float64),
    impulse_out: wp.array(dtype=wp.vec3d),
    velocity_out: wp.array(dtype=wp.vec3d),
):
    """Turns impulses [kg m/s] into velocity [m/s]; one node an item."""
    k = first + wp.tid()
    velocity_out[k] = velocity_out[k] + inverse_mass[k] * impulse_out[k]
    impulse_out[k] = wp.vec3d()
