"""The rigid motion nearest to a free strand's own."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))


@wp.struct
class FreeStrandsData:
    """The strands that nothing holds, and what is constant of all."""

    strands: wp.array(dtype=wp.int32)  # (free_count,)
    first_node: wp.array(dtype=wp.int32)  # (strand_count + 1,)
    mass: wp.array(dtype=wp.float64)  # (node_count,) [kg]
    turn_inertia: wp.array(dtype=wp.float64)  # (node_count,) [kg m2] of edge k about itself


@wp.func
def mean_of(free: FreeStrandsData, strand: int, values: wp.array(dtype=wp.vec3d)) -> wp.vec3d:
    """Mean over a strand's mass."""
    total = wp.vec3d()
    mass = ZERO
    for node in range(free.first_node[strand] + 1, free.first_node[strand + 1]):
        total += free.mass[node] * values[node]
        mass += free.mass[node]
    return total / mass


@wp.kernel
def lead(
    first: int,
    free: FreeStrandsData,
    length: wp.float64,
    gained: wp.float64,
    position: wp.array(dtype=wp.vec3d),
    velocity: wp.array(dtype=wp.vec3d),
    spin: wp.array(dtype=wp.float64),
    root_rotation: wp.array(dtype=wp.mat33d),
    acceleration: wp.array(dtype=wp.vec3d),
    mean_velocity_out: wp.array(dtype=wp.vec3d),
    start_out: wp.array(dtype=wp.vec3d),
    position_out: wp.array(dtype=wp.vec3d),
    rotation_out: wp.array(dtype=wp.mat33d),
):
    """Where a substep of `length` [s] would take a free strand if it were rigid; one free strand an item.

    By its momentum, angular momentum and last `acceleration`; start_out, position_out: of its mass centre.
    gained: part of the speed that the substep adds by which the integrator moves it.
    """
    strand = free.strands[first + wp.tid()]
    centre = mean_of(free, strand, position)
    mean = mean_of(free, strand, velocity)
    momentum = wp.vec3d()
    inertia = wp.mat33d()
    identity = wp.identity(n=3, dtype=wp.float64)
    end = free.first_node[strand + 1]
    for node in range(free.first_node[strand] + 1, end):
        r = position[node] - centre
        m = free.mass[node]
        momentum += m * wp.cross(r, velocity[node] - mean)
        inertia += m * (wp.dot(r, r) * identity - wp.outer(r, r))
        if node < end - 1:
            t = wp.normalize(position[node + 1] - position[node])
            about = free.turn_inertia[node]
            momentum += (about * spin[node]) * t
            inertia += about * wp.outer(t, t)
    turn = (length * wp.inverse(inertia)) * momentum
    angle = wp.length(turn)
    rotation = identity
    if angle > ZERO:
        rotation = wp.quat_to_matrix(wp.quat_from_axis_angle(turn / angle, angle))
    mean_velocity_out[strand] = mean
    start_out[strand] = centre
    position_out[strand] = centre + length * (mean + gained * length * acceleration[strand])
    rotation_out[strand] = rotation * root_rotation[strand]


@wp.kernel
def note_acceleration(
    first: int,
    free: FreeStrandsData,
    length: wp.float64,
    mean_velocity: wp.array(dtype=wp.vec3d),
    velocity: wp.array(dtype=wp.vec3d),
    acceleration_out: wp.array(dtype=wp.vec3d),
):
    """Of the mass centre, in the substep that ends with `velocity`; one free strand an item."""
    strand = free.strands[first + wp.tid()]
    acceleration_out[strand] = (mean_of(free, strand, velocity) - mean_velocity[strand]) / length
