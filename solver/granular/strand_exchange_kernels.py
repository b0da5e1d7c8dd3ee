"""Nodes of granular matter against strands, which give way by the mass of their nodes."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.exchange_kernels import ZERO, Moment, within_cone
from plait.solver.granular.types import granular_types
from plait.solver.grid.transfer_kernels import STENCIL, Grid, gradient_of, node_before, value_at

wp.set_module_options({"enable_backward": False})

# Where the strands' mass rises by less than this part of itself over a cell, they are all around.
EVEN = wp.constant(wp.float64(0.5))


@wp.struct
class Strands:
    """Nodes of strands among the grains, by index k of node[k] among all."""

    node: wp.array(dtype=wp.int32)
    mass: wp.array(dtype=wp.float64)  # [kg]
    friction: wp.array(dtype=wp.float64)
    inverse_mass: wp.array(dtype=wp.float64)  # (node_count,) [1/kg] of all; 0: prescribed
    velocity: wp.array(dtype=wp.vec3d)  # (node_count,) [m/s] of all
    given: wp.array(dtype=wp.vec3d)  # (node_count,) [kg m/s] since the substep's start
    expected: wp.array(dtype=wp.vec3d)  # what the velocity has in it already, spread over the substep


@wp.struct
class Meetings:
    """Grid nodes that both have."""

    of_strands: wp.array(dtype=wp.int32)
    of_grains: wp.array(dtype=wp.int32)
    normal: wp.array(dtype=wp.vec3d)  # unit, out of the strands; zero within them
    friction: wp.array(dtype=wp.float64)
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] on the strands, in a step


@wp.kernel
def find_normals(first: int, grid: Grid, strands: Strands, meetings: Meetings):
    """Of each meeting the way in which the strands' mass falls (Han 2019 (45)), and their friction."""
    i = first + wp.tid()
    mass = ZERO
    fall = wp.vec3d()
    friction = ZERO
    for x in range(STENCIL):
        for y in range(STENCIL):
            for z in range(STENCIL):
                base = node_before(grid, meetings.of_strands[i], x, y, z)
                if base >= 0:
                    for at in range(grid.cell_first[base], grid.cell_first[base + 1]):
                        k = grid.particles[at]
                        slope = gradient_of(grid.offset[k], x, y, z)
                        # The slope by the particle's place is that by the node's, reversed.
                        fall += strands.mass[k] * slope
                        weight = strands.mass[k] * wp.length(slope)
                        mass += weight
                        friction += weight * strands.friction[k]
    size = wp.length(fall)
    meetings.normal[i] = wp.vec3d()
    if size > EVEN * mass:
        meetings.normal[i] = fall / size
    if mass > ZERO:
        meetings.friction[i] = friction / mass


@wp.kernel
def present_velocities(
    first: int, strands: Strands, moment: wp.array(dtype=Moment), velocity_out: wp.array(dtype=wp.vec3d)
):
    """[m/s] of strands' nodes with what they have been given so far, beside what was expected."""
    k = first + wp.tid()
    p = strands.node[k]
    change = strands.inverse_mass[p] * (strands.given[p] - moment[0].part * strands.expected[p])
    velocity_out[k] = strands.velocity[p] + change


@wp.kernel
def collect(first: int, grid: Grid, strands: Strands, change: wp.array(dtype=wp.vec3d)):
    """What grid nodes gave, `change` [m/s] times their mass of strands, to the strands' nodes by w_iq m_q."""
    k = first + wp.tid()
    p = strands.node[k]
    strands.given[p] = strands.given[p] + strands.mass[k] * value_at(grid, k, change)


@cache
def strand_exchange_kernels(real: type) -> SimpleNamespace:
    """Kernels for nodes of granular matter in `real` (wp.float32 or wp.float64).

    `begin` once a step, then `exchange` once a pass; `collect` after each.
    """
    module = f"plait_granular_strand_exchange_{real.__name__}"
    vec4 = granular_types(real).vec4
    kernel, function = partial(wp.kernel, module=module, enable_backward=False), partial(wp.func, module=module)

    @function
    def give(
        meetings: Meetings,
        i: int,
        change: wp.vec3d,
        mass: wp.array(dtype=wp.float64),
        velocity: wp.array(dtype=vec4),
        change_out: wp.array(dtype=wp.vec3d),
    ):
        """An impulse [kg m/s] to the strands at a meeting, from the grains there."""
        held = velocity[meetings.of_grains[i]]
        lost = change / wp.float64(held[3])
        velocity[meetings.of_grains[i]] = held - vec4(real(lost[0]), real(lost[1]), real(lost[2]), real(0.0))
        change_out[meetings.of_strands[i]] = change / mass[meetings.of_strands[i]]

    @kernel
    def begin(
        first: int,
        meetings: Meetings,
        moment: wp.array(dtype=Moment),
        mass: wp.array(dtype=wp.float64),
        velocity: wp.array(dtype=vec4),
        change_out: wp.array(dtype=wp.vec3d),
    ):
        """Gives what meetings bore in the last step; one an item. change_out: [m/s] of the strands."""
        i = first + wp.tid()
        meetings.impulse[i] = moment[0].ratio * meetings.impulse[i]
        change_out[meetings.of_strands[i]] = wp.vec3d()
        if velocity[meetings.of_grains[i]][3] > real(0.0):
            give(meetings, i, meetings.impulse[i], mass, velocity, change_out)
        else:
            meetings.impulse[i] = wp.vec3d()

    @kernel
    def exchange(
        first: int,
        meetings: Meetings,
        mass: wp.array(dtype=wp.float64),
        strand_velocity: wp.array(dtype=wp.vec3d),
        velocity: wp.array(dtype=vec4),
        change_out: wp.array(dtype=wp.vec3d),
    ):
        """Towards inelastic collisions with Coulomb friction; one meeting an item. change_out: as of `begin`."""
        i = first + wp.tid()
        of_strands = meetings.of_strands[i]
        held = velocity[meetings.of_grains[i]]
        change_out[of_strands] = wp.vec3d()
        if held[3] > real(0.0):
            v = wp.vec3d(wp.float64(held[0]), wp.float64(held[1]), wp.float64(held[2]))
            inverse = wp.float64(1.0) / wp.float64(held[3]) + wp.float64(1.0) / mass[of_strands]
            impulse = meetings.impulse[i] + (v - strand_velocity[of_strands]) / inverse
            n = meetings.normal[i]
            if wp.dot(n, n) > ZERO:
                impulse = within_cone(impulse, n, meetings.friction[i])
            give(meetings, i, impulse - meetings.impulse[i], mass, velocity, change_out)
            meetings.impulse[i] = impulse

    return SimpleNamespace(begin=begin, exchange=exchange)
