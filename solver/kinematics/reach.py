"""Bounds of a moving surface without skinning it, and what strands can touch in a frame."""

from __future__ import annotations

import itertools

import numpy as np

from plait.solver.kinematics.deformer import split_rotation
from plait.solver.scene import Pose, Surface

# Weights may miss one by rounding in the file (float32).
WEIGHT_SUM_TOLERANCE = 1e-4


class SurfaceBounds:
    """A box that holds a surface's points in a given pose, from boxes of the points each joint moves.

    Linear blending gives convex combinations of x' = M_j x, so the union of the joints' boxes holds them. Dual
    quaternion blending swings along arcs: between two motions of a point the arc leaves the chord by at most half
    of it (a half turn), so the box grows by the largest distance between the places that joints sharing a point
    would give it. Joints that stretch as well: the box of the joints' images of the centroid, with that same
    margin, grown by the stretched radius.
    """

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        points = surface.points
        self._box = np.stack([points.min(axis=0), points.max(axis=0)])
        self._shape_reach = _shape_reach(surface)
        self._corners = _box_corners(self._box[None])
        self._joints = np.zeros(1, dtype=int)
        self._pairs, self._pair_corners = np.zeros((0, 2), dtype=int), np.zeros((0, 8, 3))
        self.bounded = True
        if surface.skinning is not None:
            weights = surface.skinning.joint_weights
            self.bounded = bool(
                np.all(weights >= 0.0) and np.all(np.abs(weights.sum(axis=1) - 1.0) < WEIGHT_SUM_TOLERANCE)
            )
            self._joints, self._corners = _joint_boxes(surface)
            if surface.skinning.method == "dual-quaternion":
                self._pairs, self._pair_corners = _pair_boxes(surface)

    def at(self, pose: Pose) -> np.ndarray:
        """(2, 3) lower and upper corner [m], world; infinite where weights allow no bound."""
        if pose.points is not None:
            return np.stack([pose.points.min(axis=0), pose.points.max(axis=0)])
        if not self.bounded:
            return np.array([[-np.inf] * 3, [np.inf] * 3])
        transforms = pose.joint_transforms
        grow = np.zeros(3)
        if len(self._shape_reach):
            grow = np.abs(pose.blend_weights) @ self._shape_reach
        if self.surface.skinning is not None and self.surface.skinning.method == "dual-quaternion":
            return self._at_dual_quaternion(transforms, grow)
        return _bounds(_transform(transforms[self._joints], _grown(self._corners, grow)))

    def _at_dual_quaternion(self, transforms: np.ndarray, grow: np.ndarray) -> np.ndarray:
        rotation, stretch, _ = split_rotation(transforms[self._joints][:, :3, :3])
        if np.allclose(stretch, np.eye(3), atol=1e-6):
            box = _bounds(_transform(transforms[self._joints], _grown(self._corners, grow)))
            corners = _grown(self._pair_corners, grow)
            apart = _transform(transforms[self._pairs[:, 0]], corners) - _transform(
                transforms[self._pairs[:, 1]], corners
            )
            margin = np.linalg.norm(apart, axis=-1).max(initial=0.0)
            return box + np.array([[-margin], [margin]])
        centre = self._box.mean(axis=0)
        stretched = np.einsum("jab,cb->jca", stretch, _grown(_box_corners(self._box[None]), grow)[0])
        radius = np.linalg.norm(stretched - centre, axis=-1).max()
        box = _bounds(rotation @ centre + transforms[self._joints][:, :3, 3])
        margin = radius + np.linalg.norm(box[1] - box[0])
        return box + np.array([[-margin], [margin]])


def sweep(boxes: np.ndarray) -> np.ndarray:
    """(2, 3) box that holds a motion sampled at equal times, from (sample_count, 2, 3) boxes at those times.

    The samples' union holds motion along chords. Between samples a path of acceleration a leaves its chord by at
    most a h²/8, and the samples' second difference is a h²; it is added whole, eight times what smooth motion
    needs.
    """
    bounds = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    if len(boxes) > 2 and np.all(np.isfinite(boxes)):
        bend = np.abs(boxes[2:] - 2.0 * boxes[1:-1] + boxes[:-2]).max(axis=(0, 1))
        bounds += np.stack([-bend, bend])
    return bounds


def touches(box: np.ndarray, centre_boxes: np.ndarray, reach: np.ndarray) -> bool:
    """Whether any of (n, 2, 3) boxes of centres, each with a reach (n,) [m] about it, comes to `box` (2, 3)."""
    gap = np.maximum(np.maximum(centre_boxes[:, 0] - box[1], box[0] - centre_boxes[:, 1]), 0.0)
    return bool(np.any(np.einsum("nd,nd->n", gap, gap) <= reach**2))


def _shape_reach(surface: Surface) -> np.ndarray:
    """(shape_count, 3) the largest offset of each blend shape, by axis."""
    shapes = surface.blend_shapes
    if shapes is None:
        return np.zeros((0, 3))
    runs = itertools.pairwise(shapes.shape_offsets)
    return np.array([np.abs(shapes.point_offsets[a:b]).max(axis=0, initial=0.0) for a, b in runs]).reshape(-1, 3)


def _joint_boxes(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """The joints that move points, and the (n, 8, 3) corners of the box of the points each moves."""
    used = surface.skinning.joint_weights != 0.0
    joints = surface.skinning.joint_indices[used]
    points = surface.points[np.nonzero(used)[0]]
    return _grouped_boxes(joints[:, None], points)


def _pair_boxes(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """The (n, 2) pairs of joints that share points, and the corners of the box of the points they share."""
    joints, used = surface.skinning.joint_indices, surface.skinning.joint_weights != 0.0
    keys, points = [], []
    for a, b in itertools.combinations(range(joints.shape[1]), 2):
        both = used[:, a] & used[:, b]
        keys.append(joints[both][:, [a, b]])
        points.append(surface.points[both])
    if not keys:
        return np.zeros((0, 2), dtype=int), np.zeros((0, 8, 3))
    return _grouped_boxes(np.concatenate(keys), np.concatenate(points))


def _grouped_boxes(keys: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unique rows of `keys`, squeezed, and the corners of the box of the points under each."""
    unique, group = np.unique(keys, axis=0, return_inverse=True)
    boxes = np.empty((len(unique), 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
    np.minimum.at(boxes[:, 0], group.ravel(), points)
    np.maximum.at(boxes[:, 1], group.ravel(), points)
    return (unique[:, 0] if unique.shape[1] == 1 else unique), _box_corners(boxes)


def _box_corners(boxes: np.ndarray) -> np.ndarray:
    """(n, 8, 3), the corners in the order that `_grown` relies on."""
    picks = np.array(list(itertools.product((0, 1), repeat=3)))
    return boxes[:, picks, np.arange(3)]


def _grown(corners: np.ndarray, grow: np.ndarray) -> np.ndarray:
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    return corners + signs * grow


def _transform(transforms: np.ndarray, corners: np.ndarray) -> np.ndarray:
    return np.einsum("jab,jcb->jca", transforms[:, :3, :3], corners) + transforms[:, None, :3, 3]


def _bounds(points: np.ndarray) -> np.ndarray:
    points = points.reshape(-1, 3)
    return np.stack([points.min(axis=0), points.max(axis=0)])
