"""Which prims a result overrides, and what must be said about each outside its samples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, Vt

from plait.pipeline.shot import GrainOutput, GrainSurfaceOutput, Output, PrimOutput, Shot, TransformOutput

# The one operation that places a rigid prim; those that its source has stay authored, and out of the order.
TRANSFORM = "xformOp:transform:plait"

VALUE_TYPES = {
    "points": Sdf.ValueTypeNames.Point3fArray,
    "velocities": Sdf.ValueTypeNames.Vector3fArray,
    "extent": Sdf.ValueTypeNames.Float3Array,
    "normals": Sdf.ValueTypeNames.Normal3fArray,
    "primvars:normals": Sdf.ValueTypeNames.Normal3fArray,
    TRANSFORM: Sdf.ValueTypeNames.Matrix4d,
    "ids": Sdf.ValueTypeNames.Int64Array,
    "widths": Sdf.ValueTypeNames.FloatArray,
    "faceVertexCounts": Sdf.ValueTypeNames.IntArray,
    "faceVertexIndices": Sdf.ValueTypeNames.IntArray,
}


@dataclass(frozen=True)
class Constant:
    """An attribute and its one value. interpolation: of a primvar."""

    name: str
    value_type: Sdf.ValueTypeName
    value: Any
    uniform: bool = False
    interpolation: str = ""


@dataclass(frozen=True)
class Target:
    """One prim that the result overrides, and what its override must hold outside the clips.

    attributes: names that the clips give, keys of `VALUE_TYPES`.
    clip_set: a name that no clip set of the source has on this prim (dictionaries of equal name would merge).
    unbind: the prim is skinned in the source; `add_binding_api`: it does not say so by an applied schema.
    blocked: attributes of the source that are no longer true, with their types.
    operations: the prim's `xformOpOrder`, where its transform is written; empty where it is not.
    made: the type of a prim that the source does not have; empty for one that is overridden.
    constants: attributes that hold one value at all times.
    interpolations: of attributes that the clips give, by name.
    material: what a made prim is bound to.
    """

    path: str
    attributes: tuple[str, ...]
    clip_set: str = "plait"
    unbind: bool = False
    add_binding_api: bool = False
    blocked: tuple[tuple[str, Sdf.ValueTypeName], ...] = ()
    operations: tuple[str, ...] = ()
    made: str = ""
    constants: tuple[Constant, ...] = ()
    interpolations: tuple[tuple[str, str], ...] = ()
    material: tuple[str, ...] = ()


def transform_target(prim: Usd.Prim, output: TransformOutput) -> Target:
    """What placing `prim`, the source's own, takes."""
    operations = (UsdGeom.XformOpTypes.resetXformStack, TRANSFORM) if output.resets else (TRANSFORM,)
    return Target(output.prim_path, (TRANSFORM,), free_clip_set(prim), operations=operations)


def prim_target(prim: Usd.Prim, output: PrimOutput) -> Target:
    """What overriding `prim`, the source's own, takes.

    Attributes that belong to the source's own points and are not given anew are blocked.
    """
    attributes, stale = ["points", "velocities", "extent"], ["accelerations", "primvars:normals:indices"]
    normals = [name for name in ("primvars:normals", "normals") if _authored(prim, name)]
    if output.normals is not None:
        attributes.append(normals[0] if normals else "normals")
    else:
        stale += normals
    return Target(
        output.prim_path,
        tuple(attributes),
        free_clip_set(prim),
        output.skinned,
        output.skinned and not prim.HasAPI(UsdSkel.BindingAPI),
        _blocked(prim, stale),
    )


INVISIBLE = Constant("visibility", Sdf.ValueTypeNames.Token, UsdGeom.Tokens.invisible)
UNDIVIDED = Constant("subdivisionScheme", Sdf.ValueTypeNames.Token, UsdGeom.Tokens.none, uniform=True)
# What grains look like that no colour is authored for, linear.
COLOURS = {"sand": (0.52, 0.38, 0.22), "snow": (0.86, 0.9, 0.95)}


def grain_target(prim: Usd.Prim, output: GrainOutput | GrainSurfaceOutput) -> Target:
    """What writing grains, or the surface about them, takes; `prim` is that of the source with the role."""
    if isinstance(output, GrainSurfaceOutput):
        return Target(
            output.prim_path,
            ("points", "velocities", "extent", "normals", "faceVertexCounts", "faceVertexIndices"),
            made="Mesh",
            constants=(UNDIVIDED, _colour(prim, output)),
            interpolations=(("normals", "vertex"),),
            material=_material(prim),
        )
    grains = Target(
        output.prim_path,
        ("points", "velocities", "extent", "ids", "widths"),
        constants=(INVISIBLE,) if output.hidden else (),
        interpolations=(("widths", "vertex"),),
    )
    if output.prim_path != output.source_path:
        looks = (*grains.constants, _colour(prim, output))
        return replace(grains, made="Points", constants=looks, material=_material(prim))
    stale = ("accelerations", "normals", "primvars:normals", "primvars:widths", "primvars:widths:indices")
    return replace(grains, clip_set=free_clip_set(prim), blocked=_blocked(prim, stale))


def _blocked(prim: Usd.Prim, names: Iterable[str]) -> tuple[tuple[str, Sdf.ValueTypeName], ...]:
    return tuple((name, prim.GetAttribute(name).GetTypeName()) for name in names if _authored(prim, name))


def _colour(prim: Usd.Prim, output: GrainOutput | GrainSurfaceOutput) -> Constant:
    """The colour of a prim that is made for `prim`: its own, one that varies as its mean."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    held = primvar.Get(Usd.TimeCode.EarliestTime()) if primvar and primvar.HasValue() else None
    colour = np.array(held, dtype=np.float64).reshape(len(held), -1).mean(axis=0) if held else np.zeros(0)
    if colour.shape != (3,) or not np.isfinite(colour).all():
        colour = COLOURS[output.law]
    value = Vt.Vec3fArray([Gf.Vec3f(*map(float, colour))])
    return Constant("primvars:displayColor", Sdf.ValueTypeNames.Color3fArray, value, interpolation="constant")


def _material(prim: Usd.Prim) -> tuple[str, ...]:
    """What is bound to `prim` itself; what is bound above it holds beside it too."""
    bound = UsdShade.MaterialBindingAPI(prim).GetDirectBindingRel()
    return tuple(map(str, bound.GetTargets())) if bound else ()


def free_clip_set(prim: Usd.Prim) -> str:
    """'plait', or the first 'plait2', 'plait3', ... that `prim` has no clips under: a source may be a result."""
    taken = Usd.ClipsAPI(prim).GetClips() or {}
    name, number = "plait", 1
    while name in taken:
        number += 1
        name = f"plait{number}"
    return name


def ancestor_targets(stage: Usd.Stage, outputs: Iterable[Output]) -> tuple[Target, ...]:
    """Prims above the simulated ones whose authored bounds no longer hold.

    A SkelRoot's `extent` stands for all beneath it, so it is written anew; an `extentsHint` is only a shortcut,
    and is blocked: readers then look at the prims themselves.
    """
    paths = {prefix for output in outputs for prefix in Sdf.Path(output.prim_path).GetPrefixes()[:-1]}
    targets = []
    for path in sorted(paths):
        prim = stage.GetPrimAtPath(path)
        bounded = prim.IsA(UsdSkel.Root) and _authored(prim, "extent")
        hinted = _authored(prim, "extentsHint")
        if bounded or hinted:
            attributes = ("extent",) if bounded else ()
            blocked = (("extentsHint", Sdf.ValueTypeNames.Float3Array),) if hinted else ()
            targets.append(Target(str(path), attributes, free_clip_set(prim), blocked=blocked))
    return tuple(targets)


def instances_above(stage: Usd.Stage, paths: Iterable[str]) -> tuple[str, ...]:
    """The instances that hide `paths` from overrides, outermost first; nested ones included."""
    prefixes = {prefix for path in paths for prefix in Sdf.Path(path).GetPrefixes()[:-1]}
    return tuple(str(prefix) for prefix in sorted(prefixes) if stage.GetPrimAtPath(prefix).IsInstance())


def _authored(prim: Usd.Prim, name: str) -> bool:
    attribute = prim.GetAttribute(name)
    return bool(attribute) and attribute.HasAuthoredValue()


class Overridden:
    """The part of the source stage that a result overrides.

    outputs, bounds: the simulated prims, and those above whose bounds are written anew or blocked.
    hidden: prims that others are drawn for.
    instances: see `instances_above`.  counts: authored points of each simulated prim, None where they change.
    layers: files that these prims come from.
    """

    def __init__(self, shot: Shot) -> None:
        """Opens the stage with the simulated prims alone. Raises ValueError for a prim it does not have."""
        self.counts = {output.prim_path: output.point_count for output in shot.outputs}
        sources = {output.prim_path: getattr(output, "source_path", output.prim_path) for output in shot.outputs}
        mask = Usd.StagePopulationMask([Sdf.Path(path) for path in sources.values()])
        self._stage = Usd.Stage.OpenMasked(str(shot.info.path), mask)
        missing = [path for path in sources.values() if not self._stage.GetPrimAtPath(path)]
        if missing:
            raise ValueError(f"{shot.info.path} has no prim {missing[0]}")
        self.root_layer = self._stage.GetRootLayer()
        self.outputs = tuple(
            target(self._stage.GetPrimAtPath(sources[output.prim_path]), output)
            for target, outputs in (
                (prim_target, (*shot.curves, *shot.meshes)),
                (transform_target, shot.props),
                (grain_target, shot.grains),
            )
            for output in outputs
        )
        replaced = dict.fromkeys(o.source_path for o in shot.grains if o.source_path not in self.counts)
        self.hidden = tuple(Target(path, (), constants=(INVISIBLE,)) for path in replaced)
        self.bounds = ancestor_targets(self._stage, shot.outputs)
        self.instances = instances_above(self._stage, self.counts)
        self.layers = tuple(Path(layer.realPath) for layer in self._stage.GetUsedLayers() if layer.realPath)

    @property
    def targets(self) -> tuple[Target, ...]:
        return (*self.outputs, *self.hidden, *self.bounds)

    def bounds_above(self, code: float, extents: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """(2, 3) float32 `extent` of each SkelRoot above: its own at `code`, grown by `extents` of prims beneath.

        extents: prim path -> (2, 3), in the prim's own space; the result is in the root's.
        """
        transforms = UsdGeom.XformCache(code)
        found = {}
        for target in self.bounds:
            if "extent" not in target.attributes:
                continue
            root = self._stage.GetPrimAtPath(target.path)
            low, high = UsdGeom.Boundable(root).GetExtentAttr().Get(code)
            box = Gf.Range3d(Gf.Vec3d(low), Gf.Vec3d(high))
            from_world = transforms.GetLocalToWorldTransform(root).GetInverse()
            for path, extent in extents.items():
                if Sdf.Path(path).HasPrefix(target.path):
                    to_world = transforms.GetLocalToWorldTransform(self._holder(path))
                    own = Gf.Range3d(*(Gf.Vec3d(*map(float, corner)) for corner in extent))
                    box.UnionWith(Gf.BBox3d(own, to_world * from_world).ComputeAlignedRange())
            found[target.path] = np.array([box.GetMin(), box.GetMax()], np.float32)
        return found

    def _holder(self, path: str) -> Usd.Prim:
        """The prim in whose space that at `path` is: itself, or of one that is made the one above."""
        return self._stage.GetPrimAtPath(path) or self._stage.GetPrimAtPath(Sdf.Path(path).GetParentPath())
