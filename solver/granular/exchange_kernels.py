"""What kernels of exchanges between grains and others have in common."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.types import granular_types

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))


@wp.struct
class Moment:
    """Where in a substep of the simulation a step of the grains is."""

    since: wp.float64  # [s] from the substep's start to the step's
    length: wp.float64  # [s] of the step
    part: wp.float64  # of the substep that has passed when the step ends
    ratio: wp.float64  # of the step's length to the last one's, with whose impulses it begins; 0: none are known


@wp.struct
class Heights:
    """Of each node in contact how far the matter there is above the surface; it touches at zero and below."""

    height: wp.array(dtype=wp.float64)  # [m] of the node at the substep's start; or of its matter, now
    by_matter: wp.array(dtype=wp.int32)
    normal: wp.array(dtype=wp.vec3d)  # unit, out of the surface
    velocity: wp.array(dtype=wp.vec3d)  # [m/s] of the surface


@wp.func
def touches(heights: Heights, c: int, since: wp.float64) -> wp.bool:
    if heights.by_matter[c] == 1:
        return heights.height[c] <= ZERO
    return heights.height[c] - since * wp.dot(heights.velocity[c], heights.normal[c]) <= ZERO


@wp.func
def within_cone(impulse: wp.vec3d, n: wp.vec3d, friction: wp.float64) -> wp.vec3d:
    """The impulse on a surface of outward normal n, as far as contact and Coulomb friction can give it."""
    along = wp.dot(impulse, n)
    if along >= ZERO:
        return wp.vec3d()
    across = impulse - along * n
    size = wp.length(across)
    most = -friction * along
    if size > most:
        across = (most / size) * across
    return along * n + across


@wp.kernel
def expect(
    first: int,
    inverse_mass: wp.array(dtype=wp.float64),
    velocity: wp.array(dtype=wp.vec3d),
    gravity: wp.vec3d,
    length: wp.float64,
    velocity_before: wp.array(dtype=wp.vec3d),
    given: wp.array(dtype=wp.vec3d),
    expected_out: wp.array(dtype=wp.vec3d),
):
    """What nodes will bear of a further impulse like the last one, by how they bore that; one node an item.

    In the substep of `length` h [s] that took up J, other forces than gravity g gave it R = m (v - v_before - h g)
    - J. As far as that was against J, up to the whole of it, it will be again: what is held up stays so, and what
    nothing holds gives way freely. given: J, and zero from here on.
    """
    p = first + wp.tid()
    J = given[p]
    expected_out[p] = wp.vec3d()
    size = wp.dot(J, J)
    if size > ZERO and inverse_mass[p] > ZERO:
        change = velocity[p] - velocity_before[p] - length * gravity
        R = change / inverse_mass[p] - J
        expected_out[p] = wp.clamp(-wp.dot(R, J) / size, ZERO, wp.float64(1.0)) * J
    velocity_before[p] = velocity[p]
    given[p] = wp.vec3d()


@cache
def follow_kernels(real: type) -> SimpleNamespace:
    """The kernel `follow` for nodes of the grid in `real` (wp.float32 or wp.float64)."""
    module = f"plait_granular_follow_{real.__name__}"
    vec4 = granular_types(real).vec4

    @wp.kernel(module=module, enable_backward=False)
    def follow(
        first: int,
        heights: Heights,
        node: wp.array(dtype=wp.int32),
        moment: wp.array(dtype=Moment),
        velocity: wp.array(dtype=vec4),
    ):
        """Takes matter's heights to the step's end; one contact an item."""
        c = first + wp.tid()
        if heights.by_matter[c] == 1:
            held = velocity[node[c]]
            v = wp.vec3d(wp.float64(held[0]), wp.float64(held[1]), wp.float64(held[2]))
            rise = wp.dot(v - heights.velocity[c], heights.normal[c])
            heights.height[c] = heights.height[c] + moment[0].length * rise

    return SimpleNamespace(follow=follow)
