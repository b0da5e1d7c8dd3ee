"""Skinned points against UsdSkel's own skinning of the same arrays."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from pxr import Gf, UsdSkel, Vt

from plait.solver.kinematics.deformer import Deformer, split_rotation
from plait.solver.launch import Launcher
from plait.solver.scene import BlendShapes, Pose, Skinning, Surface

JOINTS, POINTS, INFLUENCES = 7, 400, 5
USDSKEL = {"linear": UsdSkel.Tokens.classicLinear, "dual-quaternion": UsdSkel.Tokens.dualQuaternion}


def rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    matrices = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    return matrices * np.sign(np.linalg.det(matrices))[:, None, None]


def joint_transforms(rng: np.random.Generator, kind: str) -> np.ndarray:
    transforms = np.tile(np.eye(4), (JOINTS, 1, 1))
    transforms[:, :3, :3] = rotations(rng, JOINTS)
    if kind != "rigid":
        transforms[:, :3, :3] *= rng.uniform(0.5, 2.0, (JOINTS, 1, 3))
    if kind == "sheared":
        transforms[:, :3, :3] += 0.3 * rng.normal(size=(JOINTS, 3, 3))
    if kind == "mirrored":
        transforms[::2, :3, 0] *= -1.0
    transforms[:, :3, 3] = rng.normal(size=(JOINTS, 3))
    return transforms


def influences(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Float32 weights, some zero, some equal, and some points with a single joint."""
    weights = rng.random((POINTS, INFLUENCES)).astype(np.float32)
    weights[rng.random((POINTS, INFLUENCES)) < 0.3] = 0.0
    weights[:20] = 1.0
    weights[20:60] = 0.0
    weights[:, 0][weights.sum(axis=1) == 0.0] = 1.0
    weights /= weights.sum(axis=1, keepdims=True)
    return rng.integers(0, JOINTS, (POINTS, INFLUENCES)).astype(np.int32), weights


def usdskel_points(points, joints, weights, transforms, method) -> np.ndarray:
    out = Vt.Vec3fArray.FromNumpy(points.astype(np.float32))
    matrices = Vt.Matrix4dArray([Gf.Matrix4d(m.T.tolist()) for m in transforms])
    done = UsdSkel.SkinPoints(
        USDSKEL[method],
        Gf.Matrix4d(1.0),
        matrices,
        Vt.IntArray.FromNumpy(joints.ravel()),
        Vt.FloatArray.FromNumpy(weights.ravel()),
        joints.shape[1],
        out,
    )
    assert done
    return np.array(out)


def place(surface: Surface, pose: Pose, vertices=None) -> tuple[np.ndarray, np.ndarray]:
    launcher = Launcher("cpu", 2)
    deformer = Deformer(surface, launcher, vertices)
    points = wp.zeros(deformer.count, dtype=wp.vec3d, device="cpu")
    query_points = wp.zeros(deformer.count, dtype=wp.vec3f, device="cpu")
    deformer.place(pose, points, query_points)
    launcher.close()
    return points.numpy(), query_points.numpy()


@pytest.mark.parametrize("method", ["linear", "dual-quaternion"])
@pytest.mark.parametrize("kind", ["rigid", "scaled", "sheared", "mirrored"])
def test_skinning_agrees_with_usdskel(method: str, kind: str) -> None:
    """1e-6 of the size, UsdSkel itself working in float32."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (POINTS, 3)).astype(np.float32).astype(np.float64)
    joints, weights = influences(rng)
    transforms = joint_transforms(rng, kind)
    reference = usdskel_points(points, joints, weights, transforms, method)
    surface = Surface("s", points, np.zeros((0, 3), int), skinning=Skinning(joints, weights.astype(float), method))
    placed, rounded = place(surface, Pose(transforms))
    size = np.ptp(reference, axis=0).max()
    assert np.abs(placed - reference).max() < 1e-6 * size
    assert np.abs(rounded - reference).max() < 1e-6 * size


def test_a_joint_without_rotation_counts_as_usdskel_counts_it() -> None:
    """A flattened joint has no rotation: UsdSkel gives it a zero dual quaternion and no stretch."""
    rng = np.random.default_rng(4)
    points = rng.uniform(-1.0, 1.0, (POINTS, 3)).astype(np.float32).astype(np.float64)
    joints, weights = influences(rng)
    transforms = joint_transforms(rng, "rigid")
    transforms[2, :3, 1] = 0.0
    reference = usdskel_points(points, joints, weights, transforms, "dual-quaternion")
    skinning = Skinning(joints, weights.astype(float), "dual-quaternion")
    placed, _ = place(Surface("s", points, np.zeros((0, 3), int), skinning=skinning), Pose(transforms))
    assert np.abs(placed - reference).max() < 1e-6 * np.ptp(reference, axis=0).max()


def test_split_rotation_rebuilds_the_matrix() -> None:
    """M = R S with R a rotation and S symmetric, to rounding, mirrored matrices included."""
    matrices = np.random.default_rng(5).normal(size=(50, 3, 3))
    rotation, stretch, regular = split_rotation(matrices)
    assert np.all(regular)
    np.testing.assert_allclose(rotation @ stretch, matrices, atol=1e-13)
    np.testing.assert_allclose(stretch, np.swapaxes(stretch, 1, 2), atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-13)


def shapes(rng: np.random.Generator) -> BlendShapes:
    counts = [30, 0, 55]
    indices = np.concatenate([rng.choice(POINTS, count, replace=False) for count in counts])
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return BlendShapes(offsets.astype(np.int32), indices.astype(np.int32), rng.normal(size=(85, 3)))


@pytest.mark.parametrize("method", ["linear", "dual-quaternion"])
def test_blend_shapes_come_before_skinning(method: str) -> None:
    """x' = skin(x + sum_s w_s d_s), UsdSkel's order; whole and for some of the points."""
    rng = np.random.default_rng(6)
    points = rng.uniform(-1.0, 1.0, (POINTS, 3))
    joints, weights = influences(rng)
    blend = shapes(rng)
    shape_weights = np.array([0.7, 0.4, -0.2])
    moved = points.copy()
    for s, weight in enumerate(shape_weights):
        run = slice(*blend.shape_offsets[s : s + 2])
        moved[blend.point_indices[run]] += weight * blend.point_offsets[run]
    transforms = joint_transforms(rng, "rigid")
    reference = usdskel_points(moved, joints, weights, transforms, method)
    skinning = Skinning(joints, weights.astype(float), method)
    surface = Surface("s", points, np.zeros((0, 3), int), skinning=skinning, blend_shapes=blend)
    size = np.ptp(reference, axis=0).max()
    pose = Pose(transforms, shape_weights)
    assert np.abs(place(surface, pose)[0] - reference).max() < 1e-6 * size
    some = np.array([5, 3, 250, 399])
    assert np.abs(place(surface, pose, some)[0] - reference[some]).max() < 1e-6 * size


def test_one_transform_and_cached_points() -> None:
    """A rigid surface follows its transform; a point cache is taken as it is."""
    rng = np.random.default_rng(7)
    points = rng.normal(size=(10, 3))
    transform = joint_transforms(rng, "scaled")[:1]
    surface = Surface("s", points, np.zeros((0, 3), int))
    placed, _ = place(surface, Pose(transform))
    np.testing.assert_allclose(placed, points @ transform[0, :3, :3].T + transform[0, :3, 3], atol=1e-14)
    cached = rng.normal(size=(10, 3))
    np.testing.assert_array_equal(place(surface, Pose(transform, points=cached))[0], cached)
    np.testing.assert_array_equal(
        place(surface, Pose(transform, points=cached), np.array([4, 1]))[0], cached[[4, 1]]
    )
