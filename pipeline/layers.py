"""The layers of a result: a top layer over the source, overrides with value clips, and the chunks those play.

Nothing here touches a file but `export`; who writes what and when is `write.py`'s.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdUtils, Vt

from plait.pipeline.errors import InputError, PlaitError
from plait.pipeline.files import replacing
from plait.pipeline.shot import StageInfo
from plait.pipeline.targets import TRANSFORM, VALUE_TYPES, Target

# Where the layer says how it was made: customLayerData["plait"].
RECORD = "plait"

# What the source says of itself or says as well from where it is sublayered.
_NOT_COPIED = frozenset(
    {"subLayers", "subLayerOffsets", "layerRelocates", "customLayerData", "comment", "documentation"}
)


@dataclass(frozen=True)
class Sample:
    """What all simulated prims are at one time code.

    values: (prim path, attribute name) -> an array as `VALUE_TYPES` asks for, e.g. (n, 3) float32, in the prim's
        own space and units; a transform (4, 4) float64, row vectors.
    """

    code: float
    values: dict[tuple[str, str], np.ndarray]


def asset_path(target: Path, folder: Path) -> str:
    """How a layer in `folder` names `target`: relative, absolute only where no relative path exists (drives).

    Links are left as they are given: USD too takes '..' off the text of a path, not off what it links to.
    """
    try:
        relative = Path(os.path.relpath(target, folder)).as_posix()
    except ValueError:
        return target.absolute().as_posix()
    return relative if relative.startswith("../") else f"./{relative}"


def top_layer(
    source: Sdf.Layer,
    info: StageInfo,
    output: Path,
    sublayers: Sequence[Path],
    record: Mapping[str, Any],
    codes: Sequence[float] = (),
) -> Sdf.Layer:
    """The layer that opens the result: `sublayers` (strongest first), and all that USD reads of a root layer only.

    That is the source's stage metadata: units, axis, rates, range, default prim, render settings, expression
    variables, custom data; asset paths among it are anchored anew. `record` becomes customLayerData['plait'].
    codes: time codes that were simulated, the range for a source that has none.
    """
    folder = output.parent
    layer = Sdf.Layer.CreateAnonymous(output.suffix)
    root, source_root = layer.pseudoRoot, source.pseudoRoot
    for key in source_root.ListInfoKeys():
        if key not in _NOT_COPIED:
            root.SetInfo(key, anchored(source_root.GetInfo(key), source, folder))
    root.SetInfo("metersPerUnit", info.meters_per_unit)
    root.SetInfo("upAxis", info.up_axis)
    layer.timeCodesPerSecond = info.time_codes_per_second
    layer.framesPerSecond = info.frames_per_second
    if codes and not source.HasStartTimeCode() and not source.HasEndTimeCode():
        layer.startTimeCode, layer.endTimeCode = codes[0], codes[-1]
    held = anchored(dict(source.customLayerData), source, folder)
    layer.customLayerData = {**held, RECORD: recordable(record)}
    layer.subLayerPaths[:] = [asset_path(path, folder) for path in sublayers]
    return layer


def anchored(value: Any, source: Sdf.Layer, folder: Path) -> Any:
    """`value` of a layer's metadata as a layer in `folder` must say it: relative asset paths stay true."""
    if isinstance(value, Sdf.AssetPath) and value.path.startswith("."):
        return Sdf.AssetPath(asset_path(Path(source.ComputeAbsolutePath(value.path)), folder))
    if isinstance(value, dict):
        return {key: anchored(held, source, folder) for key, held in value.items()}
    return value


def recordable(record: Mapping[str, Any]) -> dict[str, Any]:
    """`record` as a layer can hold and give back: keys with ':' nest, what is no scalar or string becomes JSON."""
    tree: dict[str, Any] = {}
    for key, value in record.items():
        *groups, leaf = str(key).split(":")
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        if isinstance(value, Mapping):
            branch[leaf] = recordable(value)
        else:
            branch[leaf] = value if isinstance(value, str | bool | int | float) else json.dumps(value)
    return tree


def manifest_layer(targets: Iterable[Target], rate: float) -> Sdf.Layer:
    """Which attributes the clips give: without it USD opens every chunk to find out."""
    layer = _plain_layer(".usda", rate)
    for target in targets:
        prim = Sdf.CreatePrimInLayer(layer, target.path)
        for name in target.attributes:
            Sdf.AttributeSpec(prim, name, VALUE_TYPES[name])
    return layer


def override_layer(
    targets: Iterable[Target],
    instances: Iterable[str],
    clips: Sequence[tuple[float, str]],
    manifest: str,
    rate: float,
) -> Sdf.Layer:
    """The ordinary layer over the source: clip metadata, and the opinions that hold at all times.

    clips: (time code from which it plays, file name) of each chunk, in order. Without any the layer is empty, so
    that a run stopped before its first chunk shows the source unchanged.
    instances: prims that must not be instances, since overrides inside an instance are ignored.
    """
    layer = _plain_layer(".usda", rate)
    if not clips:
        return layer
    targets = tuple(targets)
    author_constants(layer, targets, instances)
    for target in targets:
        if target.attributes:
            clip_set = {target.clip_set: _clip_set(target.path, clips, manifest)}
            layer.GetPrimAtPath(target.path).SetInfo("clips", clip_set)
    return layer


def _clip_set(path: str, clips: Sequence[tuple[float, str]], manifest: str) -> dict[str, Any]:
    codes = [(code, float(index)) for index, (code, _) in enumerate(clips)]
    return {
        "primPath": path,
        "assetPaths": Sdf.AssetPathArray([Sdf.AssetPath(f"./{name}") for _, name in clips]),
        "active": Vt.Vec2dArray(codes),
        "manifestAssetPath": Sdf.AssetPath(f"./{manifest}"),
    }


def author_constants(layer: Sdf.Layer, targets: Iterable[Target], instances: Iterable[str]) -> None:
    """What must hold at all times: no instancing above, no skinning, no attribute that is no longer true."""
    for path in instances:
        Sdf.CreatePrimInLayer(layer, path).SetInfo("instanceable", False)
    for target in targets:
        prim = Sdf.CreatePrimInLayer(layer, target.path)
        _author_made(prim, target)
        if target.unbind:
            skeleton = Sdf.RelationshipSpec(prim, "skel:skeleton", custom=False)
            skeleton.targetPathList.ClearEditsAndMakeExplicit()
        if target.add_binding_api:
            prim.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["SkelBindingAPI"]))
        if target.operations:
            # Clips give values only to what a layer declares.
            Sdf.AttributeSpec(prim, TRANSFORM, VALUE_TYPES[TRANSFORM])
            order = Sdf.AttributeSpec(prim, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, Sdf.VariabilityUniform)
            order.default = Vt.TokenArray(target.operations)
        for name, value_type in target.blocked:
            Sdf.AttributeSpec(prim, name, value_type).default = Sdf.ValueBlock()


def _author_made(prim: Sdf.PrimSpec, target: Target) -> None:
    """The type, the material and the constants of a prim."""
    if target.made:
        prim.specifier, prim.typeName = Sdf.SpecifierDef, target.made
    if target.material:
        prim.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["MaterialBindingAPI"]))
        bound = Sdf.RelationshipSpec(prim, "material:binding", custom=False)
        bound.targetPathList.explicitItems = target.material
    for held in target.constants:
        variability = Sdf.VariabilityUniform if held.uniform else Sdf.VariabilityVarying
        attribute = Sdf.AttributeSpec(prim, held.name, held.value_type, variability)
        attribute.default = held.value
        if held.interpolation:
            attribute.SetInfo("interpolation", held.interpolation)
    for name, interpolation in target.interpolations:
        Sdf.AttributeSpec(prim, name, VALUE_TYPES[name]).SetInfo("interpolation", interpolation)


def chunk_layer(samples: Iterable[Sample], rate: float) -> Sdf.Layer:
    """Time samples of every simulated attribute, for the clips to play. Same samples, same bytes."""
    layer = _plain_layer(".usdc", rate)
    for sample in samples:
        for (path, name), value in sample.values.items():
            set_sample(layer, path, name, sample.code, value)
    return layer


def set_sample(layer: Sdf.Layer, path: str, name: str, code: float, value: np.ndarray) -> None:
    attribute = Sdf.Path(path).AppendProperty(name)
    if not layer.GetAttributeAtPath(attribute):
        Sdf.AttributeSpec(Sdf.CreatePrimInLayer(layer, path), name, VALUE_TYPES[name])
    layer.SetTimeSample(attribute, code, _held(name, value))


def _held(name: str, value: Any) -> Any:
    """`value` as USD holds it."""
    if name == TRANSFORM:
        return Gf.Matrix4d(np.asarray(value, np.float64))
    array, dtype = _ARRAYS.get(VALUE_TYPES[name], (Vt.Vec3fArray, np.float32))
    return array.FromNumpy(np.ascontiguousarray(value, dtype)) if len(value) else array()


_ARRAYS = {
    Sdf.ValueTypeNames.Int64Array: (Vt.Int64Array, np.int64),
    Sdf.ValueTypeNames.IntArray: (Vt.IntArray, np.int32),
    Sdf.ValueTypeNames.FloatArray: (Vt.FloatArray, np.float32),
}


def read_samples(layer: Sdf.Layer, targets: Iterable[Target], codes: Iterable[float]) -> list[Sample]:
    """The samples of a chunk at `codes`, all of which it has."""
    names = [(target.path, name) for target in targets for name in target.attributes]
    return [
        Sample(
            code,
            {(path, name): np.array(layer.QueryTimeSample(f"{path}.{name}", code)) for path, name in names},
        )
        for code in codes
    ]


def _plain_layer(suffix: str, rate: float) -> Sdf.Layer:
    """USD scales the times of a layer whose rate is not the root layer's, so every layer states it."""
    layer = Sdf.Layer.CreateAnonymous(suffix)
    layer.timeCodesPerSecond = rate
    return layer


def export(layer: Sdf.Layer, path: Path) -> None:
    """Writes `layer` whole or not at all, synced. Raises PlaitError, one line, when the disk does not take it."""
    try:
        with replacing(path) as aside:
            layer.Export(str(aside))
    except (OSError, Tf.ErrorException) as error:
        raise PlaitError(f"{path}: cannot be written: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    if isinstance(error, OSError):
        return error.strerror or str(error)
    found = re.search(r": '(?:Error occurred writing file: )?([^'\n]*)", str(error))
    return found[1] if found else "USD gave no reason"


def open_stage(path: Path) -> Usd.Stage:
    """The stage at `path`; InputError when there is none."""
    try:
        return Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise InputError("cannot be opened as USD", file=path) from error


def open_whole(path: Path) -> Usd.Stage:
    """The stage at `path`, InputError when any of it is missing: USD itself opens what is left."""
    warnings = UsdUtils.CoalescingDiagnosticDelegate()  # what they say is said below, in one line
    stage = open_stage(path)
    warnings.TakeUncoalescedDiagnostics()
    errors = [" ".join(str(error).split()) for error in stage.GetCompositionErrors()]
    lost = errors or [f"{name} is missing, which holds frames of the result" for name in missing_chunks(stage)]
    if lost:
        raise InputError(lost[0], file=path, mend="copy the whole result, with its cache folder and its source")
    return stage


def missing_chunks(stage: Usd.Stage) -> list[str]:
    """Files that the clips of the simulated prims name and that are not there."""
    missing: dict[str, None] = {}
    for path in simulated_prims(stage.GetRootLayer()):
        prim = stage.GetPrimAtPath(path)
        clips = Usd.ClipsAPI(prim)
        for name in (clips.GetClips() or {}) if prim else ():
            missing |= dict.fromkeys(
                asset.path for asset in clips.GetClipAssetPaths(name) if not asset.resolvedPath
            )
    return list(missing)


def source_path(layer: Sdf.Layer) -> Path | None:
    """The shot that a result lies over: its weakest sublayer. None for what is no result, or a flattened one."""
    if RECORD not in layer.customLayerData or not layer.subLayerPaths:
        return None
    return Path(layer.ComputeAbsolutePath(layer.subLayerPaths[-1]))


def simulated_prims(layer: Sdf.Layer) -> tuple[str, ...]:
    """Paths of the prims that a result overrides, from its top layer's record; none for any other layer."""
    record = layer.customLayerData.get(RECORD, {})
    return tuple(json.loads(record.get("prims", "[]"))) if isinstance(record, dict) else ()
