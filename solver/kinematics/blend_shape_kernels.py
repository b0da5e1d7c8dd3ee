"""Blend shapes: weighted point offsets."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def add_blend_shapes(
    first: int,
    rest_points: wp.array(dtype=wp.vec3d),
    entry_offsets: wp.array(dtype=wp.int32),
    entry_shapes: wp.array(dtype=wp.int32),
    entry_vectors: wp.array(dtype=wp.vec3d),
    shape_weights: wp.array(dtype=wp.float64),
    points_out: wp.array(dtype=wp.vec3d),
):
    """x' = x + sum_s w_s d_s; one point an item, its entries gathered by `entry_offsets`."""
    i = first + wp.tid()
    x = rest_points[i]
    for k in range(entry_offsets[i], entry_offsets[i + 1]):
        x += shape_weights[entry_shapes[k]] * entry_vectors[k]
    points_out[i] = x
