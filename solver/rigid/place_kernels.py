"""Surfaces that rigid bodies carry."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def place_points(
    first: int,
    points: wp.array(dtype=wp.vec3d),
    position: wp.array(dtype=wp.vec3d),
    orientation: wp.array(dtype=wp.quatd),
    body: int,
    points_out: wp.array(dtype=wp.vec3d),
    query_points_out: wp.array(dtype=wp.vec3f),
):
    """Points of a body, (n,) [m] about its centre of mass, in world, and rounded; one point an item."""
    i = first + wp.tid()
    placed = position[body] + wp.quat_rotate(orientation[body], points[i])
    points_out[i] = placed
    if query_points_out.shape[0] > 0:
        query_points_out[i] = wp.vec3f(float(placed[0]), float(placed[1]), float(placed[2]))
