"""What all parts of the contact of elastic bodies share on the device."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def take_up(
    first: int,
    velocity_before: wp.array(dtype=wp.vec3d),
    velocity: wp.array(dtype=wp.vec3d),
    displacement_per_velocity: wp.float64,
    position: wp.array(dtype=wp.vec3d),
):
    """Moves a node by what its velocity changed; one node an item."""
    p = first + wp.tid()
    change = velocity[p] - velocity_before[p]
    position[p] = position[p] + displacement_per_velocity * change
