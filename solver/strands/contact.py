"""Contact inside a strand's Newton iteration: half-spaces as stiff one-sided springs, with Coulomb friction.

A node deeper than its plane by d is pushed out with N = k d, k a million times the strand's own stiffness (a
thousand times in float32), so that d stays far below the hair's radius.

Friction is implicit and always semi-definite: with s the tangential way from the sticking place, its force is
-mu N s / max(|s|, slip), the denominator taken from the current iterate and N from the solve before (lagged, as in
Li et al. 2020, Incremental Potential Contact, section 5). For given N each iteration then lowers a convex
dissipation, so nodes cannot flip between sticking and slipping. Below `slip`, a hundredth of the radius, it acts
as a spring. A node that has only just gone under has no N yet: k d would be the depth of a guess, far too large.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.contact.planes import PLANES_A_NODE, ContactPlanes
from plait.solver.strands.types import module_name, rod_types


@cache
def contact_functions(real: type) -> SimpleNamespace:
    """Device functions `contact_stiffness`, `release`, `push`, `plane_force`, `judge`, `touching` for `real`."""
    types = rod_types(real)
    vec3, mat33, module = types.vec3, types.mat33, module_name(real)
    Rods, Scratch = types.Rods, types.Scratch
    stiffer = 1.0e6 if real == wp.float64 else 1.0e3

    @wp.func(module=module)
    def contact_stiffness(rods: Rods, strand: int, inertia: real):
        """Stiffness of a contact [N/m] against the bending and the inertia of a segment of this strand."""
        root = rods.first_node[strand] + 1
        length = rods.segment[strand]
        # The root's Voronoi length is half a segment: 6 B / l^2 is 12 EI / l^3.
        return real(stiffer) * (real(6.0) * rods.bend[root] / (length * length) + rods.mass[root + 1] * inertia)

    @wp.func(module=module)
    def depth_under(planes: ContactPlanes, plane: int, x: vec3, origin: wp.vec3d, ahead: wp.float64):
        """How far x, a position about `origin`, is under the plane [m]; negative above it and without one.

        ahead: the part of the substep still to come.
        """
        n = planes.normal[plane]
        offset = planes.offset[plane] - wp.dot(n, origin + ahead * planes.drift[plane])
        depth = real(offset) - wp.dot(vec3(n), x)
        return wp.where(wp.dot(n, n) > wp.float64(0.5), depth, real(-1.0))

    @wp.func(module=module)
    def release(scratch: Scratch, count: int, base: int, stride: int):
        """Forgets the contact forces of the solve before."""
        for k in range(count):
            for i in range(PLANES_A_NODE):
                slot = (base + k * stride) * PLANES_A_NODE + i
                scratch.pressure[slot] = real(0.0)

    @wp.func(module=module)
    def push(
        planes: ContactPlanes,
        scratch: Scratch,
        node: int,
        slot: int,
        x: vec3,
        origin: wp.vec3d,
        ahead: wp.float64,
        stiffness: real,
        slip: real,
    ):
        """Stiffness block and energy gradient of a node's contacts at x, a position about `origin`."""
        block = mat33()
        gradient = vec3()
        for i in range(PLANES_A_NODE):
            plane = node * PLANES_A_NODE + i
            depth = depth_under(planes, plane, x, origin, ahead)
            if depth > real(0.0):
                n = vec3(planes.normal[plane])
                nn = wp.outer(n, n)
                across = wp.identity(n=3, dtype=real) - nn
                block += stiffness * nn
                gradient -= (stiffness * depth) * n
                way = across * (x - vec3(planes.anchor[plane] - ahead * planes.drift[plane] - origin))
                force = real(planes.friction[plane]) * scratch.pressure[slot * PLANES_A_NODE + i]
                spring = force / wp.max(wp.length(way), slip)
                block += spring * across
                gradient += spring * way
        return block, gradient

    @wp.func(module=module)
    def plane_force(planes: ContactPlanes, plane: int, pressure: real, x: vec3, origin: wp.vec3d, slip: real):
        """Force [N] of one plane on a node at x, a position about `origin`, at the substep's end; see `push`.

        By the pressure that `judge` left, not the depth: a node that the last step took a little under has none.
        """
        n = vec3(planes.normal[plane])
        way = x - vec3(planes.anchor[plane] - origin)
        way = way - wp.dot(way, n) * n
        return pressure * (n - real(planes.friction[plane]) / wp.max(wp.length(way), slip) * way)

    @wp.func(module=module)
    def judge(
        planes: ContactPlanes,
        scratch: Scratch,
        node: int,
        slot: int,
        before: vec3,
        x: vec3,
        origin: wp.vec3d,
        ahead: wp.float64,
        stiffness: real,
        slip: real,
    ):
        """Contact forces after a full step from `before` to x; whether one is new or the node just sank."""
        under = wp.bool(False)
        for i in range(PLANES_A_NODE):
            plane = node * PLANES_A_NODE + i
            entry = slot * PLANES_A_NODE + i
            depth = depth_under(planes, plane, x, origin, ahead)
            pressure = real(0.0)
            if depth > real(0.0):
                if depth_under(planes, plane, before, origin, ahead) > real(0.0):
                    pressure = stiffness * depth
                    under = under or scratch.pressure[entry] == real(0.0)
                elif depth > slip:
                    under = wp.bool(True)
            scratch.pressure[entry] = pressure
        return under

    @wp.func(module=module)
    def touching(planes: ContactPlanes, node: int, x: wp.vec3d):
        """Whether a contact pushes the node at x [m], world."""
        found = wp.bool(False)
        for i in range(PLANES_A_NODE):
            found = found or depth_under(planes, node * PLANES_A_NODE + i, vec3(), x, wp.float64(0.0)) > real(0.0)
        return found

    return SimpleNamespace(
        contact_stiffness=contact_stiffness,
        release=release,
        push=push,
        plane_force=plane_force,
        judge=judge,
        touching=touching,
    )
