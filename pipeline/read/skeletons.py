"""What UsdSkel binds in a stage, and each binding as influences and blend shapes of the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from plait.pipeline.read import values
from plait.pipeline.read.motions import SkeletonState
from plait.pipeline.read.source import PREDICATE, Source
from plait.solver.scene import BlendShapes, SkinningMethod

# What half-float weights may lack to one.
ROUNDING = 2e-3
INFLUENCES = ("primvars:skel:jointIndices", "primvars:skel:jointWeights")


@dataclass(frozen=True)
class SkeletonBinding:
    """One prim as a skeleton moves it."""

    skeleton: SkeletonState
    query: UsdSkel.SkinningQuery


@dataclass(frozen=True)
class Influences:
    """Joints of each point, in a compact numbering.

    used: (n,) joints in the skeleton's order.  indices: (point_count, k) int32 into `used`.  weights: the same
    shape.  normal: they sum to one.  rigid: one joint moves all points, with weight one.
    """

    used: np.ndarray
    indices: np.ndarray
    weights: np.ndarray
    method: SkinningMethod
    normal: bool

    @property
    def rigid(self) -> bool:
        return len(self.used) == 1 and self.weights.shape[1] == 1 and bool(np.all(self.weights == 1.0))


class Skeletons:
    """Every skeletal binding of the stage, found by UsdSkel itself."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._cache = UsdSkel.Cache()
        self._bound: dict[str, SkeletonBinding] = {}
        self.hidden: dict[str, str] = {}
        roots = []
        prims = iter(Usd.PrimRange(source.stage.GetPseudoRoot(), PREDICATE))
        for prim in prims:
            if prim.IsA(UsdSkel.Root):
                roots.append(prim)
                prims.PruneChildren()
        for prim in roots:
            self._populate(UsdSkel.Root(prim))

    def find(self, prim: Usd.Prim) -> SkeletonBinding | None:
        return self._bound.get(str(prim.GetPath()))

    @property
    def count(self) -> int:
        return len({id(binding.skeleton) for binding in self._bound.values()})

    def _populate(self, root: UsdSkel.Root) -> None:
        self._check_targets(root.GetPrim())
        self._cache.Populate(root, PREDICATE)
        states: dict[str, SkeletonState] = {}
        for binding in self._cache.ComputeSkelBindings(root, PREDICATE):
            skeleton = binding.GetSkeleton()
            path = str(skeleton.GetPath())
            targets = [target for target in binding.GetSkinningTargets() if target]
            if not targets:
                continue
            if path not in states:
                query = self._cache.GetSkelQuery(skeleton)
                self._check_skeleton(skeleton, query)
                states[path] = SkeletonState(self._source, query)
            for target in targets:
                if target.HasJointInfluences() or target.HasBlendShapes():
                    self._bound[str(target.GetPrim().GetPath())] = SkeletonBinding(states[path], target)
        self._find_hidden(root.GetPrim())

    def _check_skeleton(self, skeleton: UsdSkel.Skeleton, query: UsdSkel.SkeletonQuery | None) -> None:
        prim = skeleton.GetPrim()
        joints = skeleton.GetJointsAttr().Get() or []
        if not query:
            raise self._source.error(
                "the joints are no valid hierarchy", prim, "joints", "list every parent before its children, once"
            )
        for attribute in (skeleton.GetBindTransformsAttr(), skeleton.GetRestTransformsAttr()):
            count = len(values.array(self._source, attribute))
            if count != len(joints) and (count or attribute == skeleton.GetBindTransformsAttr()):
                raise self._source.error(
                    f"has {count} matrices for {len(joints)} joints",
                    prim,
                    attribute.GetName(),
                    "author one a joint",
                )

    def _find_hidden(self, root: Usd.Prim) -> None:
        """UsdSkel stops at a prim without a type: bindings beneath are silently lost."""
        prims = iter(Usd.PrimRange(root, PREDICATE))
        for prim in prims:
            if prim.IsA(UsdGeom.Imageable) or prim == root or prim.IsA(UsdSkel.Animation):
                continue
            lost = [p for p in Usd.PrimRange(prim, PREDICATE) if p.HasAttribute(INFLUENCES[0])]
            prims.PruneChildren()
            if lost and not prim.GetTypeName():
                self.hidden |= {str(p.GetPath()): str(prim.GetPath()) for p in lost}
                self._source.warn(
                    f"has no type, so UsdSkel does not see the {len(lost)} skinned prims beneath it; "
                    "make it an Xform",
                    prim,
                )

    def _check_targets(self, root: Usd.Prim) -> None:
        """Raises InputError for a skeleton that is not there, or a skeleton or animation that is none."""
        for prim in Usd.PrimRange(root, PREDICATE):
            for name, schema in (("skel:skeleton", UsdSkel.Skeleton), ("skel:animationSource", UsdSkel.Animation)):
                relationship = prim.GetRelationship(name)
                for target in relationship.GetTargets() if relationship else ():
                    found = self._source.stage.GetPrimAtPath(target)
                    if not found and schema is UsdSkel.Animation:
                        # An asset without its shot: harmless, and usual.
                        self._source.warn(f"names <{target}>, which is not there; it stays at rest", prim, name)
                    elif not found or not found.IsA(schema):
                        kind = "Skeleton" if schema is UsdSkel.Skeleton else "SkelAnimation"
                        raise self._source.error(
                            f"names <{target}>, which is no {kind}", prim, name, f"name a {kind} prim"
                        )


def read_geom_bind(source: Source, binding: SkeletonBinding) -> np.ndarray:
    """(4, 4), column vectors: the prim's own space to its skeleton's, both in stage units."""
    matrix = np.array(binding.query.GetGeomBindTransform(source.start)).T
    if not np.all(np.isfinite(matrix)) or not np.any(matrix[:3, :3]):
        raise source.error(
            "is no transform", binding.query.GetPrim(), "primvars:skel:geomBindTransform", "author a finite matrix"
        )
    return matrix


def read_influences(source: Source, binding: SkeletonBinding, point_count: int) -> Influences:
    """The prim's joints and weights; constant ones are given to every point.

    Raises InputError for counts that do not fit, joints that do not exist, weights that are not finite.
    """
    query = binding.query
    prim = query.GetPrim()
    for name in INFLUENCES:
        values.array(source, prim.GetAttribute(name))
    size = query.GetNumInfluencesPerComponent()
    found = query.ComputeJointInfluences(source.start)
    if not found or size < 1:
        raise source.error(
            "does not fit primvars:skel:jointWeights",
            prim,
            INFLUENCES[0],
            "author the same count and elementSize for both",
        )
    rows = 1 if query.IsRigidlyDeformed() else point_count
    arrays = [np.array(values_, dtype=float) for values_ in found]
    for name, given in zip(INFLUENCES, arrays, strict=True):
        if len(given) != rows * size:
            raise source.error(
                f"has {len(given)} entries for {rows} x {size} influences", prim, name, "author one set a point"
            )
    indices = arrays[0].reshape(rows, size).astype(np.int64)
    weights = arrays[1].reshape(rows, size)
    joints = _mapped_joints(source, binding, indices)
    weights, normal = _normalised(source, prim, weights)
    # A joint without weight moves nothing; pointing it at one that does keeps the list of used joints short.
    heaviest = np.take_along_axis(joints, np.argmax(weights, axis=1)[:, None], axis=1)
    joints = np.where(weights == 0.0, heaviest, joints)
    used, compact = np.unique(joints, return_inverse=True)
    compact = compact.reshape(joints.shape)
    if len(used) == 1 and normal:
        compact, weights = np.zeros((rows, 1), int), np.ones((rows, 1))
    method = "dual-quaternion" if query.GetSkinningMethod() == UsdSkel.Tokens.dualQuaternion else "linear"
    return Influences(
        used,
        np.broadcast_to(compact, (point_count, compact.shape[1])).astype(np.int32),
        np.broadcast_to(weights, (point_count, weights.shape[1])).astype(np.float64),
        method,
        normal,
    )


def _mapped_joints(source: Source, binding: SkeletonBinding, indices: np.ndarray) -> np.ndarray:
    """The prim's joint numbers in the skeleton's order."""
    query, prim = binding.query, binding.query.GetPrim()
    skeleton_order = list(binding.skeleton.query.GetJointOrder())
    order = list(query.GetJointOrder() or []) or skeleton_order
    if indices.size and (indices.min() < 0 or indices.max() >= len(order)):
        raise source.error(
            f"names joint {int(indices.min() if indices.min() < 0 else indices.max())} of {len(order)}",
            prim,
            INFLUENCES[0],
            f"use 0 to {len(order) - 1}",
        )
    number = {str(joint): i for i, joint in enumerate(skeleton_order)}
    missing = [joint for joint in order if str(joint) not in number]
    mapped = np.array([number.get(str(joint), -1) for joint in order])
    joints = mapped[indices]
    if (joints < 0).any():
        raise source.error(f"names {missing[0]}, which the skeleton lacks", prim, "skel:joints", "name its joints")
    return joints


def _normalised(source: Source, prim: Usd.Prim, weights: np.ndarray) -> tuple[np.ndarray, bool]:
    """Weights whose rows sum to one exactly, and whether they did but for rounding."""
    if np.any(weights < 0.0):
        source.warn(f"{int((weights < 0.0).sum())} weights are negative", prim, INFLUENCES[1])
    sums = weights.sum(axis=1, keepdims=True)
    off = np.abs(sums[:, 0] - 1.0) > ROUNDING
    if off.any():
        source.warn(
            f"the weights of {int(off.sum())} of {len(off)} points do not sum to one; UsdSkel skins it as it is",
            prim,
            INFLUENCES[1],
        )
        return weights, False
    return weights / sums, True


def read_blend_shapes(
    source: Source, binding: SkeletonBinding, point_count: int, linear: np.ndarray
) -> tuple[BlendShapes, Callable[[float], np.ndarray]] | None:
    """The prim's shapes and inbetweens, and their weights at any time code; None where it has none.

    linear: (3, 3), from the prim's offsets to those of the rest points [m].
    Each inbetween is a shape of its own: UsdSkel turns the weight of a shape into those of the two beside it.
    """
    query, prim = binding.query, binding.query.GetPrim()
    animation = binding.skeleton.animation
    if not query.HasBlendShapes() or not animation:
        return None
    shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
    mapper = query.GetBlendShapeMapper()

    def weights(code: float) -> np.ndarray:
        result = np.zeros(shapes.GetNumSubShapes())
        authored = animation.ComputeBlendShapeWeights(code)
        authored = mapper.Remap(authored) if mapper else authored
        sub_weights, _, sub_shapes = shapes.ComputeSubShapeWeights(authored)
        np.add.at(result, np.array(sub_shapes, dtype=np.int64), np.array(sub_weights, dtype=np.float64))
        if not np.all(np.isfinite(result)):
            raise source.error(
                f"is not finite at time code {code:g}",
                animation.GetPrim(),
                "blendShapeWeights",
                "author finite numbers",
            )
        return result

    return _sub_shapes(source, prim, shapes, point_count, linear), weights


def _sub_shapes(
    source: Source, prim: Usd.Prim, shapes: UsdSkel.BlendShapeQuery, point_count: int, linear: np.ndarray
) -> BlendShapes:
    indices, offsets = shapes.ComputeBlendShapePointIndices(), shapes.ComputeSubShapePointOffsets()
    runs, all_points, all_offsets = [0], [], []
    for k in range(shapes.GetNumSubShapes()):
        moved = np.array(offsets[k], dtype=np.float64).reshape(-1, 3)
        own = np.array(indices[shapes.GetBlendShapeIndex(k)], dtype=np.int64)
        if not len(own) or not len(moved):  # All points move, or (the shape at weight zero) none.
            own = np.arange(len(moved))
        shape = shapes.GetBlendShape(shapes.GetBlendShapeIndex(k)).GetPrim()
        if len(own) != len(moved):
            raise source.error(
                f"has {len(moved)} offsets for {len(own)} points",
                shape,
                "offsets",
                "author one a pointIndices entry",
            )
        if len(own) and (own.min() < 0 or own.max() >= point_count):
            raise source.error(
                f"names a point that {prim.GetPath()} lacks", shape, "pointIndices", f"use 0 to {point_count - 1}"
            )
        if not np.all(np.isfinite(moved)):
            raise source.error("is not finite", shape, "offsets", "author finite numbers")
        all_points.append(own)
        all_offsets.append(moved @ linear.T)
        runs.append(runs[-1] + len(own))
    return BlendShapes(
        np.array(runs, dtype=np.int32),
        np.concatenate(all_points).astype(np.int32) if all_points else np.zeros(0, np.int32),
        np.concatenate(all_offsets) if all_offsets else np.zeros((0, 3)),
    )
