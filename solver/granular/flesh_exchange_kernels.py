"""Nodes of granular matter against skins of elastic bodies, which give way by the mass of their nodes."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.types import granular_types

ZERO = wp.constant(wp.float64(0.0))


@wp.struct
class Contacts:
    """Nodes of the grid in contact: contact c of grid node node[i], first[i] <= c < first[i + 1].

    A contact moves with nodes of tets: those of the corners of the triangle that its nearest point lies in.
    """

    first: wp.array(dtype=wp.int32)
    node: wp.array(dtype=wp.int32)
    of: wp.array(dtype=wp.int32)  # (contact_count,) the grid node
    height: wp.array(dtype=wp.float64)  # [m] above the skin at the substep's start
    normal: wp.array(dtype=wp.vec3d)  # unit, out of the skin
    velocity: wp.array(dtype=wp.vec3d)  # [m/s] of the skin
    friction: wp.array(dtype=wp.float64)
    tet_node: wp.array2d(dtype=wp.int32)  # (contact_count, 12) into `touched`
    weight: wp.array2d(dtype=wp.float64)  # (contact_count, 12) b_cp, rows sum to one


@wp.struct
class Touched:
    """Nodes of tets that some contact moves with."""

    node: wp.array(dtype=wp.int32)  # among all nodes of tets
    first: wp.array(dtype=wp.int32)  # (touched_count + 1,) into the two that follow
    contact: wp.array(dtype=wp.int32)
    weight: wp.array(dtype=wp.float64)  # b_cp


@wp.struct
class Nodes:
    """All nodes of tets."""

    inverse_mass: wp.array(dtype=wp.float64)  # [1/kg]; 0: pinned
    given: wp.array(dtype=wp.vec3d)  # [kg m/s] since the substep's start
    expected: wp.array(dtype=wp.vec3d)  # what the skin's velocity has in it already, spread over the substep


@cache
def flesh_exchange_kernels(real: type) -> SimpleNamespace:
    """Kernels for nodes of the grid in `real` (wp.float32 or wp.float64), called in this order."""
    module = f"plait_granular_flesh_exchange_{real.__name__}"
    vec4 = granular_types(real).vec4
    kernel, function = partial(wp.kernel, module=module, enable_backward=False), partial(wp.func, module=module)

    @function
    def behind(contacts: Contacts, c: int, since: wp.float64):
        return contacts.height[c] - since * wp.dot(contacts.velocity[c], contacts.normal[c]) <= ZERO

    @kernel
    def count_shares(
        first: int,
        contacts: Contacts,
        touched: Touched,
        since: wp.float64,
        velocity: wp.array(dtype=vec4),
        drawn_out: wp.array(dtype=wp.float64),
    ):
        """sum_c |b_cp| over the contacts that act: among so many a node's mass is shared. One touched node an item."""
        t = first + wp.tid()
        total = ZERO
        for k in range(touched.first[t], touched.first[t + 1]):
            c = touched.contact[k]
            if velocity[contacts.of[c]][3] > real(0.0) and behind(contacts, c, since):
                total += wp.abs(touched.weight[k])
        drawn_out[t] = total

    @function
    def gives_way(contacts: Contacts, touched: Touched, nodes: Nodes, c: int, part: wp.float64):
        """[m/s] by what the nodes have been given, beside what was expected."""
        v = wp.vec3d()
        for k in range(contacts.weight.shape[1]):
            p = touched.node[contacts.tet_node[c, k]]
            change = nodes.inverse_mass[p] * (nodes.given[p] - part * nodes.expected[p])
            v += contacts.weight[c, k] * change
        return v

    @function
    def response_of(contacts: Contacts, touched: Touched, nodes: Nodes, drawn: wp.array(dtype=wp.float64), c: int):
        """[1/kg] no less than by what all contacts at once, each given a unit impulse, would move this one."""
        total = ZERO
        for k in range(contacts.weight.shape[1]):
            t = contacts.tet_node[c, k]
            total += wp.abs(contacts.weight[c, k]) * drawn[t] * nodes.inverse_mass[touched.node[t]]
        return total

    @kernel
    def exchange(
        first: int,
        contacts: Contacts,
        touched: Touched,
        nodes: Nodes,
        drawn: wp.array(dtype=wp.float64),
        since: wp.float64,
        part: wp.float64,
        velocity: wp.array(dtype=vec4),
        impulse_out: wp.array(dtype=wp.vec3d),
    ):
        """Inelastic collisions with Coulomb friction; one grid node an item. impulse_out: on the skin, [kg m/s]."""
        i = first + wp.tid()
        held = velocity[contacts.node[i]]
        v = wp.vec3d(wp.float64(held[0]), wp.float64(held[1]), wp.float64(held[2]))
        for c in range(contacts.first[i], contacts.first[i + 1]):
            impulse_out[c] = wp.vec3d()
            if held[3] > real(0.0) and behind(contacts, c, since):
                n = contacts.normal[c]
                relative = v - contacts.velocity[c] - gives_way(contacts, touched, nodes, c, part)
                along = wp.dot(relative, n)
                if along < ZERO:
                    inverse = wp.float64(1.0) / wp.float64(held[3])
                    shared = inverse + response_of(contacts, touched, nodes, drawn, c)
                    across = relative - along * n
                    slid = wp.length(across)
                    stopped = -contacts.friction[c] * along
                    if slid > stopped:
                        across = (stopped / slid) * across
                    impulse = (along * n + across) / shared
                    impulse_out[c] = impulse
                    v -= inverse * impulse
        velocity[contacts.node[i]] = vec4(real(v[0]), real(v[1]), real(v[2]), held[3])

    @kernel
    def collect(first: int, touched: Touched, impulse: wp.array(dtype=wp.vec3d), nodes: Nodes):
        """What contacts gave to nodes of tets, by b_cp; one touched node an item."""
        t = first + wp.tid()
        total = wp.vec3d()
        for k in range(touched.first[t], touched.first[t + 1]):
            total += touched.weight[k] * impulse[touched.contact[k]]
        p = touched.node[t]
        nodes.given[p] = nodes.given[p] + total

    return SimpleNamespace(count_shares=count_shares, exchange=exchange, collect=collect)
