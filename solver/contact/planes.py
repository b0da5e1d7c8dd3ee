"""What a contact tells the rod solve: half-spaces that nodes must stay in."""

from __future__ import annotations

import warp as wp

# Two, so that hair in a crease (between arm and chest) does not flip from one side to the other.
PLANES_A_NODE = 2


@wp.struct
class ContactPlanes:
    """Half-spaces in force for one substep, plane k of node i at i * PLANES_A_NODE + k; world frame.

    The node must satisfy normal . x >= offset at the substep's end; Coulomb friction acts on its tangential
    distance from `anchor`, the place it would have if it stuck to the moving body. A part f of the substep before
    its end, plane and anchor lie back by f `drift`.
    """

    normal: wp.array(dtype=wp.vec3d)  # unit, pointing out of the body; zero where there is no contact
    offset: wp.array(dtype=wp.float64)  # [m]
    anchor: wp.array(dtype=wp.vec3d)  # [m] the node's start position carried along by the surface
    drift: wp.array(dtype=wp.vec3d)  # [m] how the body moves the node over the substep
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient


def allocate_planes(node_count: int, device: wp.Device) -> ContactPlanes:
    """No contacts yet, for `node_count` nodes."""
    planes = ContactPlanes()
    count = node_count * PLANES_A_NODE
    planes.normal = wp.zeros(count, dtype=wp.vec3d, device=device)
    planes.offset = wp.zeros(count, dtype=wp.float64, device=device)
    planes.anchor = wp.zeros(count, dtype=wp.vec3d, device=device)
    planes.drift = wp.zeros(count, dtype=wp.vec3d, device=device)
    planes.friction = wp.zeros(count, dtype=wp.float64, device=device)
    return planes
