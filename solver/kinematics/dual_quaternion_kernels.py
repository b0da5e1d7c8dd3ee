"""Dual quaternion skinning (Kavan et al. 2007), with the conventions of UsdSkel."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class JointMotions:
    """Joint transforms taken apart, M x = R S x + t with S symmetric (polar decomposition).

    A joint whose matrix has no inverse has a zero dual quaternion and S = 1, as UsdSkel has it.
    """

    real: wp.array(dtype=wp.quatd)  # rotation
    dual: wp.array(dtype=wp.quatd)  # half the translation times the rotation
    stretch: wp.array(dtype=wp.mat33d)  # S


@wp.kernel
def skin_dual_quaternion(
    first: int,
    rest_points: wp.array(dtype=wp.vec3d),
    influence_offsets: wp.array(dtype=wp.int32),
    influence_joints: wp.array(dtype=wp.int32),
    influence_weights: wp.array(dtype=wp.float64),
    joints: JointMotions,
    points_out: wp.array(dtype=wp.vec3d),
    query_points_out: wp.array(dtype=wp.vec3f),
):
    """One point an item: S blends linearly, rotation and translation as dual quaternions.

    Influences come largest weight first: the first one is the pivot, and a joint whose rotation lies in the other
    half of the quaternions' double cover counts with its sign turned (Kavan et al. 2007, section 4.1).
    `query_points_out` may be empty.
    """
    i = first + wp.tid()
    x = rest_points[i]
    begin = influence_offsets[i]
    end = influence_offsets[i + 1]
    real = wp.quatd()
    dual = wp.quatd()
    stretched = wp.vec3d()
    for k in range(begin, end):
        joint = influence_joints[k]
        weight = influence_weights[k]
        stretched += weight * (joints.stretch[joint] * x)
        if wp.dot(joints.real[joint], joints.real[influence_joints[begin]]) < wp.float64(0.0):
            weight = -weight
        real += weight * joints.real[joint]
        dual += weight * joints.dual[joint]
    placed = stretched
    length = wp.length(real)
    if length > wp.float64(0.0):
        real = real / length
        dual = dual / length
        # Twice the vector part of dual * conjugate(real); a part of `dual` along `real` adds to the scalar alone.
        shift = wp.float64(2.0) * (dual * wp.quat_inverse(real))
        placed = wp.quat_rotate(real, stretched) + wp.vec3d(shift[0], shift[1], shift[2])
    points_out[i] = placed
    if query_points_out.shape[0] > 0:
        query_points_out[i] = wp.vec3f(float(placed[0]), float(placed[1]), float(placed[2]))
