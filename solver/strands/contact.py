"""Contact inside a strand's Newton iteration: half-spaces as stiff one-sided springs, with Coulomb friction.

A node deeper than its plane by d is pushed out with N = k d, k a million times the strand's own stiffness (a
thousand times in float32), so that d stays far below the hair's radius. Friction is implicit and always
semi-definite: with s the tangential way from the sticking place, the force is -mu N s / max(|s|, slip), N and the
denominator taken from the current iterate; below `slip`, a hundredth of the radius, it acts as a spring.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.contact.planes import PLANES_A_NODE, ContactPlanes
from plait.solver.strands.types import module_name, rod_types


@cache
def contact_functions(real: type) -> SimpleNamespace:
    """Device functions `push`, `contact_stiffness`, `touching` for `real`."""
    types = rod_types(real)
    vec3, mat33, module = types.vec3, types.mat33, module_name(real)
    Rods = types.Rods
    stiffer = 1.0e6 if real == wp.float64 else 1.0e3

    @wp.func(module=module)
    def contact_stiffness(rods: Rods, strand: int, inertia: real):
        """Stiffness of a contact [N/m] against the bending and the inertia of a segment of this strand."""
        root = rods.first_node[strand] + 1
        length = rods.segment[strand]
        # The root's Voronoi length is half a segment: 6 B / l^2 is 12 EI / l^3.
        return real(stiffer) * (real(6.0) * rods.bend[root] / (length * length) + rods.mass[root + 1] * inertia)

    @wp.func(module=module)
    def push(planes: ContactPlanes, node: int, x: vec3, origin: wp.vec3d, stiffness: real, slip: real):
        """Stiffness block and energy gradient of node's contacts at x, a position about `origin`."""
        block = mat33()
        gradient = vec3()
        for i in range(PLANES_A_NODE):
            plane = node * PLANES_A_NODE + i
            n = vec3(planes.normal[plane])
            depth = real(planes.offset[plane] - wp.dot(planes.normal[plane], origin)) - wp.dot(n, x)
            if depth > real(0.0) and wp.dot(n, n) > real(0.5):
                force = stiffness * depth
                nn = wp.outer(n, n)
                across = wp.identity(n=3, dtype=real) - nn
                way = across * (x - vec3(planes.anchor[plane] - origin))
                friction = real(planes.friction[plane]) * force / wp.max(wp.length(way), slip)
                block += stiffness * nn + friction * across
                gradient += friction * way - force * n
        return block, gradient

    @wp.func(module=module)
    def touching(planes: ContactPlanes, node: int, x: wp.vec3d):
        """Whether a contact pushes the node at x [m], world."""
        found = wp.bool(False)
        for i in range(PLANES_A_NODE):
            plane = node * PLANES_A_NODE + i
            n = planes.normal[plane]
            found = found or (
                wp.dot(n, n) > wp.float64(0.5) and planes.offset[plane] - wp.dot(n, x) > wp.float64(0.0)
            )
        return found

    return SimpleNamespace(contact_stiffness=contact_stiffness, push=push, touching=touching)
