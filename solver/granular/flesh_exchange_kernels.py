"""Nodes of granular matter against skins of elastic bodies, which give way by the mass of their nodes."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.exchange_kernels import ZERO, Heights, Moment, touches, within_cone
from plait.solver.granular.types import granular_types

wp.set_module_options({"enable_backward": False})


@wp.struct
class Contacts:
    """Nodes of the grid in contact: contact c of grid node node[i], first[i] <= c < first[i + 1].

    A contact moves with nodes of tets: those about the corners of the triangle that its nearest point lies in.
    """

    first: wp.array(dtype=wp.int32)
    node: wp.array(dtype=wp.int32)
    of: wp.array(dtype=wp.int32)  # (contact_count,) the grid node
    friction: wp.array(dtype=wp.float64)
    tet_node: wp.array2d(dtype=wp.int32)  # (contact_count, 12) into `touched`
    weight: wp.array2d(dtype=wp.float64)  # (contact_count, 12) b_cp, rows sum to one
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] on the skin, in a step
    change: wp.array(dtype=wp.vec3d)  # of that, in a pass


@wp.struct
class Touched:
    """Nodes of tets that some contact moves with."""

    node: wp.array(dtype=wp.int32)  # among all nodes of tets
    first: wp.array(dtype=wp.int32)  # (touched_count + 1,) into the two that follow
    contact: wp.array(dtype=wp.int32)
    weight: wp.array(dtype=wp.float64)  # b_cp
    shares: wp.array(dtype=wp.float64)  # (touched_count,) sum_c |b_cp| over the contacts that act


@wp.struct
class Nodes:
    """All nodes of tets."""

    inverse_mass: wp.array(dtype=wp.float64)  # [1/kg] with what answers with it; 0: pinned
    given: wp.array(dtype=wp.vec3d)  # [kg m/s] since the substep's start
    expected: wp.array(dtype=wp.vec3d)  # what the skin's velocity has in it already, spread over the substep


@cache
def flesh_exchange_kernels(real: type) -> SimpleNamespace:
    """Kernels for nodes of the grid in `real` (wp.float32 or wp.float64).

    `begin` and `share` once a step, then `exchange` once a pass; `collect` after `begin` and each `exchange`.
    """
    module = f"plait_granular_flesh_exchange_{real.__name__}"
    vec4 = granular_types(real).vec4
    kernel, function = partial(wp.kernel, module=module, enable_backward=False), partial(wp.func, module=module)

    @function
    def acts(contacts: Contacts, heights: Heights, c: int, since: wp.float64, velocity: wp.array(dtype=vec4)):
        return touches(heights, c, since) and velocity[contacts.of[c]][3] > real(0.0)

    @function
    def less(held: vec4, impulse: wp.vec3d):
        """A node's velocity when it has given an impulse away."""
        change = impulse / wp.float64(held[3])
        return held - vec4(real(change[0]), real(change[1]), real(change[2]), real(0.0))

    @kernel
    def begin(
        first: int,
        contacts: Contacts,
        heights: Heights,
        moment: wp.array(dtype=Moment),
        velocity: wp.array(dtype=vec4),
    ):
        """Gives what contacts bore in the last step; one grid node an item."""
        i = first + wp.tid()
        for c in range(contacts.first[i], contacts.first[i + 1]):
            impulse = wp.vec3d()
            if acts(contacts, heights, c, moment[0].since, velocity):
                impulse = moment[0].ratio * contacts.impulse[c]
                velocity[contacts.node[i]] = less(velocity[contacts.node[i]], impulse)
            contacts.impulse[c] = impulse
            contacts.change[c] = impulse

    @kernel
    def share(
        first: int,
        contacts: Contacts,
        heights: Heights,
        touched: Touched,
        moment: wp.array(dtype=Moment),
        velocity: wp.array(dtype=vec4),
    ):
        """Among how many contacts the mass of a node of tets is shared; one touched node an item."""
        t = first + wp.tid()
        total = ZERO
        for k in range(touched.first[t], touched.first[t + 1]):
            if acts(contacts, heights, touched.contact[k], moment[0].since, velocity):
                total += wp.abs(touched.weight[k])
        touched.shares[t] = total

    @function
    def gives_way(contacts: Contacts, touched: Touched, nodes: Nodes, c: int, part: wp.float64):
        """[m/s] by what the nodes have been given, beside what was expected."""
        v = wp.vec3d()
        for k in range(contacts.weight.shape[1]):
            p = touched.node[contacts.tet_node[c, k]]
            v += (contacts.weight[c, k] * nodes.inverse_mass[p]) * (nodes.given[p] - part * nodes.expected[p])
        return v

    @function
    def response_of(contacts: Contacts, touched: Touched, nodes: Nodes, c: int):
        """[1/kg] no less than by what all contacts at once, each given a unit impulse, would move this one."""
        total = ZERO
        for k in range(contacts.weight.shape[1]):
            t = contacts.tet_node[c, k]
            total += wp.abs(contacts.weight[c, k]) * touched.shares[t] * nodes.inverse_mass[touched.node[t]]
        return total

    @kernel
    def exchange(
        first: int,
        contacts: Contacts,
        heights: Heights,
        touched: Touched,
        nodes: Nodes,
        moment: wp.array(dtype=Moment),
        velocity: wp.array(dtype=vec4),
    ):
        """Each contact towards an inelastic collision with Coulomb friction; one grid node an item."""
        i = first + wp.tid()
        for c in range(contacts.first[i], contacts.first[i + 1]):
            contacts.change[c] = wp.vec3d()
            if acts(contacts, heights, c, moment[0].since, velocity):
                held = velocity[contacts.node[i]]
                v = wp.vec3d(wp.float64(held[0]), wp.float64(held[1]), wp.float64(held[2]))
                relative = v - heights.velocity[c] - gives_way(contacts, touched, nodes, c, moment[0].part)
                inverse = wp.float64(1.0) / wp.float64(held[3]) + response_of(contacts, touched, nodes, c)
                wanted = contacts.impulse[c] + relative / inverse
                impulse = within_cone(wanted, heights.normal[c], contacts.friction[c])
                change = impulse - contacts.impulse[c]
                contacts.change[c] = change
                contacts.impulse[c] = impulse
                velocity[contacts.node[i]] = less(held, change)

    @kernel
    def collect(first: int, contacts: Contacts, touched: Touched, nodes: Nodes):
        """What a pass gave to nodes of tets, by b_cp; one touched node an item."""
        t = first + wp.tid()
        total = wp.vec3d()
        for k in range(touched.first[t], touched.first[t + 1]):
            total += touched.weight[k] * contacts.change[touched.contact[k]]
        p = touched.node[t]
        nodes.given[p] = nodes.given[p] + total

    return SimpleNamespace(begin=begin, share=share, exchange=exchange, collect=collect)
