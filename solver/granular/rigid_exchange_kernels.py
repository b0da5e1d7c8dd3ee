"""Nodes of granular matter against rigid bodies, which give way."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.types import granular_types

ZERO = wp.constant(wp.float64(0.0))
vec6d = wp.types.vector(length=6, dtype=wp.float64)
mat66d = wp.types.matrix(shape=(6, 6), dtype=wp.float64)


@wp.struct
class Contacts:
    """Nodes in contact, in ascending order."""

    node: wp.array(dtype=wp.int32)
    height: wp.array(dtype=wp.float64)  # [m] above the surface at the substep's start
    normal: wp.array(dtype=wp.vec3d)  # unit, out of the surface
    velocity: wp.array(dtype=wp.vec3d)  # [m/s] of the surface
    friction: wp.array(dtype=wp.float64)
    body: wp.array(dtype=wp.int32)
    lever: wp.array(dtype=wp.vec3d)  # [m] from the body's centre of mass


@wp.struct
class Bodies:
    """Entries of six: a velocity and a spin, or an impulse and a moment about the centre of mass; world."""

    mobility: wp.array(dtype=mat66d)
    given: wp.array(dtype=vec6d)  # to the body since the substep's start
    expected: wp.array(dtype=vec6d)  # what the surface's velocity has in it already, spread over the substep


@wp.func
def wrench(impulse: wp.vec3d, lever: wp.vec3d) -> vec6d:
    moment = wp.cross(lever, impulse)
    return vec6d(impulse[0], impulse[1], impulse[2], moment[0], moment[1], moment[2])


@wp.func
def velocity_at(motion: vec6d, lever: wp.vec3d) -> wp.vec3d:
    return wp.vec3d(motion[0], motion[1], motion[2]) + wp.cross(wp.vec3d(motion[3], motion[4], motion[5]), lever)


@cache
def rigid_exchange_kernels(real: type) -> SimpleNamespace:
    """The kernel `exchange` for nodes in `real` (wp.float32 or wp.float64)."""
    module = f"plait_granular_rigid_exchange_{real.__name__}"
    vec4 = granular_types(real).vec4
    function = partial(wp.func, module=module)

    @function
    def respond(bodies: Bodies, b: int, lever: wp.vec3d, impulse: wp.vec3d):
        """[m/s] what an impulse changes of the velocity of the place it acts on."""
        return velocity_at(bodies.mobility[b] * wrench(impulse, lever), lever)

    @function
    def strike(contacts: Contacts, bodies: Bodies, c: int, since: wp.float64, part: wp.float64, mass: wp.float64,
               v: wp.vec3d):  # fmt: skip
        """[kg m/s] the impulse on a node's matter that goes into the body: inelastic, with Coulomb friction."""
        n = contacts.normal[c]
        surface = contacts.velocity[c]
        if contacts.height[c] - since * wp.dot(surface, n) > ZERO:
            return wp.vec3d()
        b = contacts.body[c]
        lever = contacts.lever[c]
        gives_way = velocity_at(bodies.mobility[b] * (bodies.given[b] - part * bodies.expected[b]), lever)
        relative = v - surface - gives_way
        along = wp.dot(relative, n)
        if along >= ZERO:
            return wp.vec3d()
        changed = n / mass + respond(bodies, b, lever, n)
        normal = -along / wp.dot(n, changed)
        relative += normal * changed
        across = relative - wp.dot(relative, n) * n
        speed = wp.length(across)
        if speed == ZERO:
            return normal * n
        way = across / speed
        stopping = speed / (wp.float64(1.0) / mass + wp.dot(way, respond(bodies, b, lever, way)))
        return normal * n - wp.min(contacts.friction[c] * normal, stopping) * way

    @wp.kernel(module=module, enable_backward=False)
    def exchange(
        first: int,
        contacts: Contacts,
        count: int,
        bodies: Bodies,
        since: wp.float64,
        part: wp.float64,
        velocity: wp.array(dtype=vec4),
    ):
        """All contacts one after the other, forwards and back, as each changes what the others meet. One item."""
        for sweep in range(2):
            for k in range(count):
                c = wp.where(sweep == 0, k, count - 1 - k)
                held = velocity[contacts.node[c]]
                if held[3] > real(0.0):
                    mass = wp.float64(held[3])
                    v = wp.vec3d(wp.float64(held[0]), wp.float64(held[1]), wp.float64(held[2]))
                    impulse = strike(contacts, bodies, c, since, part, mass, v)
                    if wp.dot(impulse, impulse) > ZERO:
                        v += impulse / mass
                        velocity[contacts.node[c]] = vec4(real(v[0]), real(v[1]), real(v[2]), held[3])
                        b = contacts.body[c]
                        bodies.given[b] = bodies.given[b] - wrench(impulse, contacts.lever[c])

    return SimpleNamespace(exchange=exchange)
