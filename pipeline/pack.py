"""One file of a result: its samples in the top layer itself, over the source; or the whole stage flattened."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf, Usd, UsdUtils

from plait.pipeline import layers
from plait.pipeline.errors import InputError, UsageError
from plait.pipeline.write import OVERRIDES, SUFFIXES, cache_folder


def pack(cache: Path, output: Path, *, overwrite: bool = False, flatten: bool = False) -> None:
    """Writes `output`, which opens alike to `cache` and needs no chunks any more.

    It sublayers the source, as `cache` does, and holds the simulated attributes as plain time samples; with
    `flatten` it holds the source's prims too and stands alone, but for textures and the like.
    All samples are in memory at once.

    Raises InputError for a `cache` that is no result of plait, UsageError for an `output` that exists, is part of
    the cache or the shot, or has no USD suffix.
    """
    top = _open(cache)
    if output.suffix not in SUFFIXES:
        raise UsageError(f"-o {output}: give a file name that ends in {', '.join(SUFFIXES)}")
    stage = Usd.Stage.Open(top)
    used = {Path(layer.realPath).resolve() for layer in stage.GetUsedLayers() if layer.realPath}
    if output.resolve() in used or cache_folder(cache).resolve() in output.resolve().parents:
        raise UsageError(f"-o {output}: is part of what is to be packed; choose another name")
    if output.exists() and not overwrite:
        raise UsageError(f"{output} exists; --overwrite replaces it")
    packed = _packed(top, cache, output)
    layers.export(_flattened(packed, output) if flatten else packed, output)


def _open(cache: Path) -> Sdf.Layer:
    try:
        top = Sdf.Layer.FindOrOpen(str(cache))
    except Tf.ErrorException:
        top = None
    if top is None:
        raise InputError("cannot be opened as USD", file=cache, mend="give the OUT.usda of a simulation")
    if layers.RECORD not in top.customLayerData:
        raise InputError("is not a result of plait", file=cache, mend="give the OUT.usda of a simulation")
    return top


def _packed(top: Sdf.Layer, cache: Path, output: Path) -> Sdf.Layer:
    packed = Sdf.Layer.CreateAnonymous(output.suffix)
    sources = [Path(top.ComputeAbsolutePath(path)) for path in top.subLayerPaths]
    overrides = (cache_folder(cache) / OVERRIDES).resolve()
    if overrides in (path.resolve() for path in sources):
        sources = [path for path in sources if path.resolve() != overrides]
        packed.TransferContent(Sdf.Layer.FindOrOpen(str(overrides)))
        _samples_for_clips(packed, overrides.parent)
    _copy_metadata(top, packed, output, sources)
    return packed


def _samples_for_clips(packed: Sdf.Layer, folder: Path) -> None:
    """Puts the time samples of the chunks in the place of the clips that play them."""
    prims: list[Sdf.PrimSpec] = []
    packed.Traverse(Sdf.Path.absoluteRootPath, lambda path: _collect_clips(packed, path, prims))
    played: list[Any] = []
    for prim in prims:
        for clip_set in prim.GetInfo("clips").values():
            played += [asset.path for asset in clip_set["assetPaths"] if asset.path not in played]
        prim.ClearInfo("clips")
    for name in played:
        _copy_samples(Sdf.Layer.FindOrOpen(str(folder / name)), packed)


def _collect_clips(layer: Sdf.Layer, path: Sdf.Path, prims: list[Sdf.PrimSpec]) -> None:
    prim = layer.GetPrimAtPath(path) if path.IsPrimPath() else None
    if prim is not None and prim.HasInfo("clips"):
        prims.append(prim)


def _copy_samples(chunk: Sdf.Layer, packed: Sdf.Layer) -> None:
    paths: list[Sdf.Path] = []
    chunk.Traverse(Sdf.Path.absoluteRootPath, lambda path: paths.append(path) if path.IsPropertyPath() else None)
    for path in paths:
        for code in chunk.ListTimeSamplesForPath(path):
            layers.set_sample(packed, str(path.GetPrimPath()), path.name, code, chunk.QueryTimeSample(path, code))


def _copy_metadata(top: Sdf.Layer, packed: Sdf.Layer, output: Path, sources: Sequence[Path]) -> None:
    for key in top.pseudoRoot.ListInfoKeys():
        if key not in ("subLayers", "subLayerOffsets"):
            packed.pseudoRoot.SetInfo(key, layers.anchored(top.pseudoRoot.GetInfo(key), top, output.parent))
    packed.subLayerPaths[:] = [layers.asset_path(path, output.parent) for path in sources]


def _flattened(packed: Sdf.Layer, output: Path) -> Sdf.Layer:
    """All of the stage in one layer, asset paths relative to where it will lie."""
    folder = output.absolute().parent
    packed.subLayerPaths[:] = [str(folder / path) for path in packed.subLayerPaths]
    flat = Usd.Stage.Open(packed).Flatten(addSourceFileComment=False)
    UsdUtils.ModifyAssetPaths(flat, lambda path: _relative(path, folder))
    return flat


def _relative(path: str, folder: Path) -> str:
    return layers.asset_path(Path(path), folder) if Path(path).is_absolute() else path
