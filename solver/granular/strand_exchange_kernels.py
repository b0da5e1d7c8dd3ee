"""Nodes of granular matter against strands, which give way by the mass of their nodes."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.exchange_kernels import ZERO, within_cone
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


@wp.struct
class Meetings:
    """Grid nodes that both have."""

    of_strands: wp.array(dtype=wp.int32)
    of_grains: wp.array(dtype=wp.int32)
    normal: wp.array(dtype=wp.vec3d)  # unit, out of the strands; zero within them
    friction: wp.array(dtype=wp.float64)


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
def present_velocities(first: int, strands: Strands, velocity_out: wp.array(dtype=wp.vec3d)):
    """[m/s] of strands' nodes with what they have been given so far."""
    k = first + wp.tid()
    p = strands.node[k]
    velocity_out[k] = strands.velocity[p] + strands.inverse_mass[p] * strands.given[p]


@wp.kernel
def collect(first: int, grid: Grid, strands: Strands, change: wp.array(dtype=wp.vec3d)):
    """What grid nodes gave, `change` [m/s] times their mass of strands, to the strands' nodes by w_iq m_q."""
    k = first + wp.tid()
    p = strands.node[k]
    strands.given[p] = strands.given[p] + strands.mass[k] * value_at(grid, k, change)


@cache
def strand_exchange_kernels(real: type) -> SimpleNamespace:
    """The kernel `exchange` for nodes of granular matter in `real` (wp.float32 or wp.float64)."""
    module = f"plait_granular_strand_exchange_{real.__name__}"
    vec4 = granular_types(real).vec4

    @wp.kernel(module=module, enable_backward=False)
    def exchange(
        first: int,
        meetings: Meetings,
        mass: wp.array(dtype=wp.float64),
        strand_velocity: wp.array(dtype=wp.vec3d),
        velocity: wp.array(dtype=vec4),
        change_out: wp.array(dtype=wp.vec3d),
    ):
        """Inelastic collisions with Coulomb friction; one meeting an item. change_out: [m/s] of the strands."""
        i = first + wp.tid()
        of_strands = meetings.of_strands[i]
        held = velocity[meetings.of_grains[i]]
        change_out[of_strands] = wp.vec3d()
        if held[3] > real(0.0):
            v = wp.vec3d(wp.float64(held[0]), wp.float64(held[1]), wp.float64(held[2]))
            stopped = v - strand_velocity[of_strands]
            n = meetings.normal[i]
            if wp.dot(n, n) > ZERO:
                stopped = within_cone(stopped, n, meetings.friction[i])
            together = wp.float64(held[3]) + mass[of_strands]
            lost = (mass[of_strands] / together) * stopped
            velocity[meetings.of_grains[i]] = held - vec4(real(lost[0]), real(lost[1]), real(lost[2]), real(0.0))
            change_out[of_strands] = (wp.float64(held[3]) / together) * stopped

    return SimpleNamespace(exchange=exchange)
