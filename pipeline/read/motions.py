"""How surfaces move: transforms, skeletons, point caches, each asked for its pose at any time.

All results are in scene coordinates. A surface's rest points are what its first frame's linear part makes of its
own points (see `Anchor`), so that they are metres of the world, whatever scale lies between.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel, Vt

from plait.pipeline.read import values
from plait.pipeline.read.source import Source
from plait.solver.scene import BlendShapes, Pose


class Placement:
    """A prim's transform to the world at any time code."""

    def __init__(self, source: Source, prim: Usd.Prim) -> None:
        self._source, self.prim = source, prim
        self.at_start = source.placed_at_start(prim)
        self.animated = _varies(prim)

    def matrix(self, code: float) -> np.ndarray:
        """(4, 4) float64, column vectors, stage units."""
        return self._source.local_to_world(self.prim, code) if self.animated else self.at_start

    def metric(self, code: float) -> np.ndarray:
        """The same, acting on metres, giving scene coordinates."""
        return self._source.metric(self.matrix(code))


@dataclass(frozen=True)
class Anchor:
    """From a prim's own space [stage units] to the rest points of its surface [m]: a linear map, no translation.

    linear: (3, 3), stage units to stage units: the placement of the first frame without its translation.
    meters_per_unit: scale to metres.
    """

    linear: np.ndarray
    meters_per_unit: float

    @staticmethod
    def of(placement: Placement, source: Source) -> Anchor:
        """The identity where the first frame's placement has no inverse: a prim hidden by a scale of zero."""
        linear = placement.at_start[:3, :3]
        regular = np.linalg.cond(linear) < 1e8 if np.any(linear) else False
        return Anchor(linear if regular else np.eye(3), source.units.meters_per_unit)

    def points(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) [stage units] to (n, 3) [m]."""
        return points @ self.linear.T * self.meters_per_unit

    @cached_property
    def inverse(self) -> np.ndarray:
        """(4, 4), rest points [m] to the prim's own axes, still in metres."""
        result = np.eye(4)
        result[:3, :3] = np.linalg.inv(self.linear)
        return result

    def undo(self, matrices: np.ndarray) -> np.ndarray:
        """(..., 4, 4) acting on metres in the prim's own axes, as they act on rest points."""
        return matrices @ self.inverse


@dataclass
class RigidMotion:
    """A surface moved by its prim's transform."""

    source: Source
    placement: Placement
    anchor: Anchor

    @property
    def animated(self) -> bool:
        return self.placement.animated

    def pose(self, time: float) -> Pose:
        return Pose(self.anchor.undo(self.placement.metric(self.source.code(time)))[None])


class SkeletonState:
    """One skeleton's joints, shared by all that it moves; the last time asked for is remembered."""

    def __init__(self, source: Source, query: UsdSkel.SkeletonQuery) -> None:
        self.source, self.query = source, query
        self.prim = query.GetPrim()
        self.placement = Placement(source, self.prim)
        self.animation = query.GetAnimQuery()
        moving = bool(self.animation) and self.animation.JointTransformsMightBeTimeVarying()
        self.animated = moving or self.placement.animated
        self._code, self._joints, self._still = None, np.zeros((0, 4, 4)), None

    def joints(self, code: float) -> np.ndarray:
        """(joint_count, 4, 4) float64: skinning transforms in skeleton space, column vectors, stage units."""
        if code != self._code:
            matrices = self.query.ComputeSkinningTransforms(code)
            if matrices is None:
                raise self.source.error(
                    "UsdSkel cannot pose it",
                    self.prim,
                    "bindTransforms",
                    "give each joint a bind and rest transform",
                )
            joints = np.array(matrices, dtype=np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
            if not np.all(np.isfinite(joints)):
                raise self.source.error(
                    f"joint transforms at time code {code:g} are not finite",
                    self.animation.GetPrim() if self.animation else self.prim,
                    "translations, rotations, scales",
                    "author finite numbers",
                )
            self._code, self._joints = code, joints
        return self._joints

    def metric_joints(self, code: float, used: np.ndarray) -> np.ndarray:
        """(len(used), 4, 4): chosen joints in the world, acting on metres of skeleton space."""
        joints = self.joints(code)[used].copy()
        joints[:, :3, 3] *= self.source.units.meters_per_unit
        return self._placed(code) @ joints

    def _placed(self, code: float) -> np.ndarray:
        if self.placement.animated or self._still is None:
            self._still = self.placement.metric(code)
        return self._still


@dataclass
class SkinnedMotion:
    """A surface moved by the joints it uses, and by blend shapes.

    used: (n,) indices of those joints in the skeleton's order.
    """

    skeleton: SkeletonState
    anchor: Anchor
    used: np.ndarray
    blend_weights: Callable[[float], np.ndarray] | None = None
    animated: bool = field(init=False)

    def __post_init__(self) -> None:
        self.animated = self.skeleton.animated or self.blend_weights is not None

    def pose(self, time: float) -> Pose:
        code = self.skeleton.source.code(time)
        joints = self.anchor.undo(self.skeleton.metric_joints(code, self.used))
        if self.blend_weights is None:
            return Pose(joints)
        return Pose(joints, self.blend_weights(code))


@dataclass
class BlendedMotion:
    """A surface that blend shapes deform in its own space and its prim's transform moves: no joints."""

    source: Source
    placement: Placement
    anchor: Anchor
    blend_weights: Callable[[float], np.ndarray]
    animated: bool = True

    def pose(self, time: float) -> Pose:
        code = self.source.code(time)
        return Pose(self.anchor.undo(self.placement.metric(code))[None], self.blend_weights(code))


class ShapedMotion:
    """A surface whose points are found on the host, in a space of their own that is then placed.

    kept: (n,) which of the prim's points it has.
    """

    source: Source
    kept: np.ndarray
    animated: bool = True

    @property
    def placed_by(self) -> Placement:
        """What takes that space to the world."""
        raise NotImplementedError

    @property
    def samples(self) -> list[float]:
        """Time codes between which `shape` is linear in time; none where it is not."""
        return []

    def shape(self, code: float) -> np.ndarray:
        """(n, 3) [m]"""
        raise NotImplementedError

    def pose(self, time: float) -> Pose:
        code = self.source.code(time)
        return Pose(np.eye(4)[None], points=transform(self.placed_by.metric(code), self.shape(code)))


@dataclass
class PointsMotion(ShapedMotion):
    """A surface whose points are themselves animated."""

    source: Source
    attribute: Usd.Attribute
    placement: Placement
    point_count: int
    kept: np.ndarray

    @property
    def placed_by(self) -> Placement:
        return self.placement

    @property
    def samples(self) -> list[float]:
        return list(self.attribute.GetTimeSamples())

    def shape(self, code: float) -> np.ndarray:
        points = values.vectors(self.source, self.attribute, code)
        values.check_count(self.source, self.attribute, code, points, self.point_count)
        return points[self.kept] * self.source.units.meters_per_unit


@dataclass
class DeformedMotion(ShapedMotion):
    """A surface that UsdSkel itself skins, on the host, because joint matrices cannot say how it moves.

    So it is with weights that do not sum to one, and with dual quaternions under an uneven scale.

    points: (n, 3) float64, the prim's own [stage units]; blended: those with blend shapes added, at a time code.
    """

    skeleton: SkeletonState
    query: UsdSkel.SkinningQuery
    points: np.ndarray
    kept: np.ndarray
    blended: Callable[[float], np.ndarray] | None = None

    @property
    def source(self) -> Source:
        return self.skeleton.source

    @property
    def placed_by(self) -> Placement:
        return self.skeleton.placement

    def shape(self, code: float) -> np.ndarray:
        points = self.points if self.blended is None else self.blended(code)
        skinned = Vt.Vec3fArray.FromNumpy(points.astype(np.float32))
        self.query.ComputeSkinnedPoints(self.skeleton.query.ComputeSkinningTransforms(code), skinned, code)
        return np.array(skinned, dtype=np.float64)[self.kept] * self.source.units.meters_per_unit


@dataclass
class InnerMotion:
    """What lies inside a skin whose points are found on the host: it follows them.

    follow: (n, 3) points of the skin to (m, 3) within, linear; asked for once for each of the skin's time samples,
    where it has some.
    """

    skin: ShapedMotion
    follow: Callable[[np.ndarray], np.ndarray]
    animated: bool = True
    _held: dict[float, np.ndarray] = field(default_factory=dict, repr=False)

    def pose(self, time: float) -> Pose:
        skin = self.skin
        code = skin.source.code(time)
        return Pose(np.eye(4)[None], points=transform(skin.placed_by.metric(code), self._shape(code)))

    def _shape(self, code: float) -> np.ndarray:
        samples = self.skin.samples
        if not samples:
            return self._at(code)
        upper = bisect.bisect_left(samples, code)
        before, after = samples[max(upper - 1, 0)], samples[min(upper, len(samples) - 1)]
        if code <= before or code >= after:
            return self._at(before if code <= before else after)
        share = (code - before) / (after - before)
        return (1.0 - share) * self._at(before) + share * self._at(after)

    def _at(self, code: float) -> np.ndarray:
        if code not in self._held:
            kept = list(self._held.items())[-1:]  # the sample before, which the next pose too lies after
            self._held = {**dict(kept), code: self.follow(self.skin.shape(code))}
        return self._held[code]


@dataclass(frozen=True)
class WorldToLocal:
    """time [s] -> (4, 4), scene coordinates [m] to a prim's own space [stage units]."""

    source: Source
    prim: Usd.Prim

    def __call__(self, time: float) -> np.ndarray:
        source = self.source
        code = source.code(time)
        local = source.local_to_world(self.prim, code)
        if not np.all(np.isfinite(local)) or np.linalg.cond(local[:3, :3]) > 1e12:
            raise source.error(
                f"the transform to world at time code {code:g} has no inverse",
                self.prim,
                "xformOpOrder",
                "scale by more than zero",
            )
        to_world = np.eye(4) / source.units.meters_per_unit
        to_world[:3, 3] = source.origin / source.units.meters_per_unit
        to_world[3, 3] = 1.0
        return np.linalg.inv(local) @ to_world


def add_shapes(points: np.ndarray, shapes: BlendShapes, weights: np.ndarray) -> np.ndarray:
    """(n, 3) points with the shapes added at (shape_count,) weights."""
    result = points.copy()
    each = np.repeat(weights, np.diff(shapes.shape_offsets))
    np.add.at(result, shapes.point_indices, each[:, None] * shapes.point_offsets)
    return result


def transform(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 3) points through a (4, 4) column-vector matrix."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def is_similarity(linear: np.ndarray) -> bool:
    """Whether a (3, 3) matrix is a rotation and one scale, to float32 rounding."""
    gram = linear.T @ linear
    size = np.trace(gram) / 3.0
    return bool(size > 0.0 and np.allclose(gram, size * np.eye(3), atol=1e-5 * size))


def _varies(prim: Usd.Prim) -> bool:
    while prim and not prim.IsPseudoRoot():
        xformable = UsdGeom.Xformable(prim)
        if xformable:
            if xformable.TransformMightBeTimeVarying():
                return True
            if xformable.GetResetXformStack():
                return False
        prim = prim.GetParent()
    return False
