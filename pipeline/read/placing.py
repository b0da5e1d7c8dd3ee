"""Where a surface's points are in a pose, on the host: for a groom's roots, before anything runs."""

from __future__ import annotations

import numpy as np
from pxr import Gf, UsdSkel, Vt

from plait.pipeline.read.motions import add_shapes, transform
from plait.solver.scene import Pose, Surface


def place_points(surface: Surface, pose: Pose, wanted: np.ndarray | slice = slice(None)) -> np.ndarray:
    """(n, 3) scene coordinates of the surface's points `wanted`, on the host."""
    if pose.points is not None:
        return pose.points[wanted]
    points = surface.points
    if surface.blend_shapes is not None:
        points = add_shapes(points, surface.blend_shapes, pose.blend_weights)
    points = points[wanted]
    if surface.skinning is None:
        return transform(pose.joint_transforms[0], points)
    joints, weights = surface.skinning.joint_indices[wanted], surface.skinning.joint_weights[wanted]
    if surface.skinning.method == "linear":
        result = np.zeros_like(points)
        for k in range(joints.shape[1]):
            matrices = pose.joint_transforms[joints[:, k]]
            moved = np.einsum("nij,nj->ni", matrices[:, :3, :3], points) + matrices[:, :3, 3]
            result += weights[:, k : k + 1] * moved
        return result
    return _skin_dual_quaternion(points, pose.joint_transforms, joints, weights)


def _skin_dual_quaternion(
    points: np.ndarray, transforms: np.ndarray, joints: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """By UsdSkel, in float32; relative to where the joints are, so that its digits suffice."""
    placed = Vt.Vec3fArray.FromNumpy(points.astype(np.float32))
    target = transforms[:, :3, 3].mean(axis=0)
    moved = transforms.copy()
    moved[:, :3, 3] -= target
    UsdSkel.SkinPoints(
        UsdSkel.Tokens.dualQuaternion,
        Gf.Matrix4d(1.0),
        Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(moved.transpose(0, 2, 1))),
        Vt.IntArray.FromNumpy(np.ascontiguousarray(joints.ravel().astype(np.int32))),
        Vt.FloatArray.FromNumpy(weights.ravel().astype(np.float32)),
        joints.shape[1],
        placed,
    )
    return np.array(placed, dtype=np.float64) + target
