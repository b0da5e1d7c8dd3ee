"""From a pose to points: the host side of skinning."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.scene import Pose, Surface

# A joint matrix whose smallest squared stretch is below this has no rotation (GfMatrix4d::Factor's own bound).
SINGULAR = 1e-10


class Deformer:
    """Places a surface's points, or some of them, for a pose: blend shapes, then skinning, or one transform.

    Sums are taken in float64 whatever the working precision: accuracy would otherwise be lost to the distance from
    the origin, and the cost is memory traffic, not arithmetic. Raises nothing; the scene has been checked.
    """

    def __init__(self, surface: Surface, launcher: Launcher, vertices: np.ndarray | None = None) -> None:
        """vertices: (n,) which of the surface's points; all of them if None."""
        self.launcher = launcher
        self.vertices = vertices
        self.count = len(surface.points) if vertices is None else len(vertices)
        device = launcher.device
        self._rest_points = wp.array(surface.points[_rows(vertices)], dtype=wp.vec3d, device=device)
        self._skin = _Skin(surface, launcher, vertices)
        self._shapes = None
        if surface.blend_shapes is not None and len(surface.blend_shapes.point_indices):
            self._shapes = _Shapes(surface, launcher, vertices)

    def place(self, pose: Pose, points_out: wp.array, query_points_out: wp.array) -> None:
        """Writes world points: (count,) vec3d, and the same rounded to vec3f unless that array is empty."""
        if pose.points is not None:
            points = np.ascontiguousarray(pose.points[_rows(self.vertices)], dtype=np.float64)
            points_out.assign(points)
            if len(query_points_out):
                query_points_out.assign(points.astype(np.float32))
            return
        rest_points = self._rest_points
        if self._shapes is not None and np.any(pose.blend_weights):
            rest_points = self._shapes.add(rest_points, pose.blend_weights)
        self._skin.place(rest_points, pose.joint_transforms, points_out, query_points_out)


class _Shapes:
    """Blend shapes, their entries gathered point by point so that items share no writes."""

    def __init__(self, surface: Surface, launcher: Launcher, vertices: np.ndarray | None) -> None:
        shapes = surface.blend_shapes
        self.launcher = launcher
        count = len(surface.points)
        entry_shapes = np.repeat(np.arange(len(shapes.shape_offsets) - 1), np.diff(shapes.shape_offsets))
        order = np.argsort(shapes.point_indices, kind="stable")
        offsets = np.searchsorted(shapes.point_indices[order], np.arange(count + 1))
        offsets, kept = _select_runs(offsets, vertices)
        order = order[kept]
        device = launcher.device
        self._offsets = wp.array(offsets, dtype=wp.int32, device=device)
        self._shapes = wp.array(entry_shapes[order], dtype=wp.int32, device=device)
        self._vectors = wp.array(shapes.point_offsets[order], dtype=wp.vec3d, device=device)
        self._weights = wp.zeros(len(shapes.shape_offsets) - 1, dtype=wp.float64, device=device)
        self._points = wp.empty(len(offsets) - 1, dtype=wp.vec3d, device=device)

    def add(self, rest_points: wp.array, weights: np.ndarray) -> wp.array:
        """The rest points with the shapes added."""
        from plait.solver.kinematics import blend_shape_kernels as kernels

        self._weights.assign(weights)
        self.launcher.launch(
            kernels.add_blend_shapes,
            len(self._points),
            [rest_points, self._offsets, self._shapes, self._vectors, self._weights],
            [self._points],
        )
        return self._points


class _Skin:
    """Linear blend or dual quaternion skinning; without influences, one transform."""

    def __init__(self, surface: Surface, launcher: Launcher, vertices: np.ndarray | None) -> None:
        self.launcher = launcher
        self.dual_quaternion = surface.skinning is not None and surface.skinning.method == "dual-quaternion"
        offsets, joints, weights = np.zeros(0), np.zeros(0), np.zeros(0)
        if surface.skinning is not None:
            offsets, joints, weights = _influences(surface, vertices)
        device = launcher.device
        self._influences = [
            wp.array(offsets, dtype=wp.int32, device=device),
            wp.array(joints, dtype=wp.int32, device=device),
            wp.array(weights, dtype=wp.float64, device=device),
        ]
        self._joints = None

    def place(
        self, rest_points: wp.array, transforms: np.ndarray, points: wp.array, query_points: wp.array
    ) -> None:
        if self.dual_quaternion:
            from plait.solver.kinematics.dual_quaternion_kernels import skin_dual_quaternion as kernel

            joints = self._upload_motions(transforms)
        else:
            from plait.solver.kinematics.linear_kernels import skin_linear as kernel

            joints = self._upload_transforms(transforms)
        inputs = [rest_points, *self._influences, joints]
        self.launcher.launch(kernel, len(points), inputs, [points, query_points])

    def _upload_transforms(self, transforms: np.ndarray) -> wp.array:
        from plait.solver.kinematics.linear_kernels import mat34d

        if self._joints is None:
            self._joints = wp.empty(len(transforms), dtype=mat34d, device=self.launcher.device)
        self._joints.assign(np.ascontiguousarray(transforms[:, :3, :], dtype=np.float64))
        return self._joints

    def _upload_motions(self, transforms: np.ndarray):
        from plait.solver.kinematics.dual_quaternion_kernels import JointMotions

        if self._joints is None:
            count, device = len(transforms), self.launcher.device
            self._joints = JointMotions()
            self._joints.real = wp.empty(count, dtype=wp.quatd, device=device)
            self._joints.dual = wp.empty(count, dtype=wp.quatd, device=device)
            self._joints.stretch = wp.empty(count, dtype=wp.mat33d, device=device)
        rotation, stretch, regular = split_rotation(transforms[:, :3, :3])
        real = np.where(regular[:, None], _quaternions(rotation), 0.0)
        shift, w = transforms[:, :3, 3], real[:, 3:]
        # Half of (t, 0) times the rotation.
        vector = w * shift + np.cross(shift, real[:, :3])
        dual = 0.5 * np.concatenate([vector, -np.sum(shift * real[:, :3], axis=1, keepdims=True)], axis=1)
        self._joints.real.assign(real)
        self._joints.dual.assign(dual)
        self._joints.stretch.assign(stretch)
        return self._joints


def split_rotation(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, 3, 3) matrices M = R S: rotations R, symmetric S, and which are regular (else R = S = 1).

    A reflection goes into S, as in GfMatrix4d::Factor, so that R is always a rotation.
    """
    u, sigma, vt = np.linalg.svd(matrices)
    sign = np.sign(np.linalg.det(u @ vt))[:, None, None]
    regular = sigma[:, 2] ** 2 > SINGULAR
    rotation = np.where(regular[:, None, None], sign * (u @ vt), np.eye(3))
    stretch = np.where(regular[:, None, None], np.swapaxes(rotation, 1, 2) @ matrices, np.eye(3))
    return rotation, stretch, regular


def _quaternions(rotation: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rotations to (n, 4) unit quaternions x, y, z, w, from the largest of the four (Shepperd 1978)."""
    diagonal = np.diagonal(rotation, axis1=1, axis2=2)
    trace = diagonal.sum(axis=1)
    # Row r of `outer` is 4 q_r q.
    outer = np.empty((len(rotation), 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        outer[:, i, i] = 1.0 + 2.0 * diagonal[:, i] - trace
        outer[:, i, j] = outer[:, j, i] = rotation[:, i, j] + rotation[:, j, i]
        outer[:, i, 3] = outer[:, 3, i] = rotation[:, k, j] - rotation[:, j, k]
    outer[:, 3, 3] = 1.0 + trace
    largest = np.argmax(np.diagonal(outer, axis1=1, axis2=2), axis=1)
    chosen = outer[np.arange(len(rotation)), largest]
    return chosen / np.linalg.norm(chosen, axis=1, keepdims=True)


def _influences(surface: Surface, vertices: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offsets, joints and weights of each point, largest weight first (ties in authored order), zeros left out."""
    joints = surface.skinning.joint_indices[_rows(vertices)]
    weights = surface.skinning.joint_weights[_rows(vertices)]
    order = np.argsort(-weights, axis=1, kind="stable")
    joints = np.take_along_axis(joints, order, axis=1)
    weights = np.take_along_axis(weights, order, axis=1)
    used = weights != 0.0
    offsets = np.concatenate([[0], np.cumsum(used.sum(axis=1))])
    return offsets, joints[used], weights[used]


def _select_runs(offsets: np.ndarray, rows: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Of runs offsets[i]:offsets[i + 1], those of `rows`: their new offsets and the entries kept."""
    if rows is None:
        return offsets, np.arange(offsets[-1])
    lengths = np.diff(offsets)[rows]
    new = np.concatenate([[0], np.cumsum(lengths)])
    entries = np.arange(new[-1]) - np.repeat(new[:-1], lengths) + np.repeat(offsets[:-1][rows], lengths)
    return new, entries


def _rows(vertices: np.ndarray | None) -> np.ndarray | slice:
    return slice(None) if vertices is None else vertices
