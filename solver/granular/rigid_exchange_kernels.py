"""Nodes of granular matter against rigid bodies, which give way."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.exchange_kernels import ZERO, Heights, Moment, touches, within_cone
from plait.solver.granular.types import granular_types

wp.set_module_options({"enable_backward": False})

vec6d = wp.types.vector(length=6, dtype=wp.float64)
mat66d = wp.types.matrix(shape=(6, 6), dtype=wp.float64)


@wp.struct
class Contacts:
    """Nodes in contact, in ascending order."""

    node: wp.array(dtype=wp.int32)
    friction: wp.array(dtype=wp.float64)
    body: wp.array(dtype=wp.int32)
    lever: wp.array(dtype=wp.vec3d)  # [m] from the body's centre of mass
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] on the body, in a step


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
    def push(contacts: Contacts, bodies: Bodies, c: int, impulse: wp.vec3d, velocity: wp.array(dtype=vec4)):
        """Gives an impulse to a contact's body, and its opposite to the node."""
        if wp.dot(impulse, impulse) > ZERO:
            b = contacts.body[c]
            bodies.given[b] = bodies.given[b] + wrench(impulse, contacts.lever[c])
            held = velocity[contacts.node[c]]
            change = impulse / wp.float64(held[3])
            velocity[contacts.node[c]] = held - vec4(real(change[0]), real(change[1]), real(change[2]), real(0.0))

    @function
    def acts(contacts: Contacts, heights: Heights, c: int, since: wp.float64, velocity: wp.array(dtype=vec4)):
        return touches(heights, c, since) and velocity[contacts.node[c]][3] > real(0.0)

    @function
    def respond(bodies: Bodies, b: int, lever: wp.vec3d, way: wp.vec3d):
        """[1/kg] what a unit impulse along `way` changes of the velocity there along it."""
        return wp.dot(way, velocity_at(bodies.mobility[b] * wrench(way, lever), lever))

    @function
    def strike(
        contacts: Contacts,
        heights: Heights,
        bodies: Bodies,
        c: int,
        part: wp.float64,
        velocity: wp.array(dtype=vec4),
    ):
        """One contact's impulse, given what all others have done."""
        held = velocity[contacts.node[c]]
        b = contacts.body[c]
        lever = contacts.lever[c]
        n = heights.normal[c]
        v = wp.vec3d(wp.float64(held[0]), wp.float64(held[1]), wp.float64(held[2]))
        gives_way = velocity_at(bodies.mobility[b] * (bodies.given[b] - part * bodies.expected[b]), lever)
        relative = v - heights.velocity[c] - gives_way
        inverse = wp.float64(1.0) / wp.float64(held[3])
        along = wp.dot(relative, n)
        wanted = contacts.impulse[c] + (along / (inverse + respond(bodies, b, lever, n))) * n
        across = relative - along * n
        speed = wp.length(across)
        if speed > ZERO:
            way = across / speed
            wanted += (speed / (inverse + respond(bodies, b, lever, way))) * way
        impulse = within_cone(wanted, n, contacts.friction[c])
        push(contacts, bodies, c, impulse - contacts.impulse[c], velocity)
        contacts.impulse[c] = impulse

    @wp.kernel(module=module, enable_backward=False)
    def exchange(
        first: int,
        contacts: Contacts,
        heights: Heights,
        count: int,
        bodies: Bodies,
        moment_at: wp.array(dtype=Moment),
        passes: int,
        velocity: wp.array(dtype=vec4),
    ):
        """All contacts one after the other, forwards and back, as each changes what the others meet. One item."""
        moment = moment_at[0]
        for c in range(count):
            impulse = wp.vec3d()
            if acts(contacts, heights, c, moment.since, velocity):
                impulse = moment.ratio * contacts.impulse[c]
            contacts.impulse[c] = impulse
            push(contacts, bodies, c, impulse, velocity)
        for sweep in range(passes):
            for k in range(count):
                c = wp.where(sweep % 2 == 0, k, count - 1 - k)
                if acts(contacts, heights, c, moment.since, velocity):
                    strike(contacts, heights, bodies, c, moment.part, velocity)

    return SimpleNamespace(exchange=exchange)
