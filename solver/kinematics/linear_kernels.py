"""Linear blend skinning, and the single transform of a rigid or a static surface."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

mat34d = wp.types.matrix(shape=(3, 4), dtype=wp.float64)


@wp.kernel
def skin_linear(
    first: int,
    rest_points: wp.array(dtype=wp.vec3d),
    influence_offsets: wp.array(dtype=wp.int32),
    influence_joints: wp.array(dtype=wp.int32),
    influence_weights: wp.array(dtype=wp.float64),
    joint_transforms: wp.array(dtype=mat34d),
    points_out: wp.array(dtype=wp.vec3d),
    query_points_out: wp.array(dtype=wp.vec3f),
):
    """x' = sum_j w_j M_j x; one point an item.

    Without influences (empty `influence_offsets`) every point follows joint 0. `query_points_out` may be empty.
    """
    i = first + wp.tid()
    x = rest_points[i]
    blended = joint_transforms[0]
    if influence_offsets.shape[0] > 0:
        blended = mat34d()
        for k in range(influence_offsets[i], influence_offsets[i + 1]):
            blended += influence_weights[k] * joint_transforms[influence_joints[k]]
    placed = blended * wp.vec4d(x[0], x[1], x[2], wp.float64(1.0))
    points_out[i] = placed
    if query_points_out.shape[0] > 0:
        query_points_out[i] = wp.vec3f(float(placed[0]), float(placed[1]), float(placed[2]))
