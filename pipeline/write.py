"""Frames to cache layers, so that whatever has been finished opens in USD after a kill at any moment.

    OUT.usda             top layer: OUT.cache/overrides.usda over the source
    OUT.cache/
        overrides.usda   value-clip metadata and what must hold at all times; replaced whole when a chunk is added
        manifest.usda    which attributes the clips give
        chunk.0001.usdc  time samples of so many frames; replaced whole
        checkpoint.npz   the driver's, to resume from

A chunk begins with the last sample of the one before it and plays from there: USD interpolates within a clip,
never across two, and so motion is the same between chunks as within them.
"""

from __future__ import annotations

import bisect
import hashlib
import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf

from plait.pipeline import layers
from plait.pipeline.errors import InputError, PlaitError, UsageError
from plait.pipeline.layers import Sample
from plait.pipeline.shot import PrimFrame, Shot, TransformFrame
from plait.pipeline.targets import TRANSFORM, Overridden

OVERRIDES, MANIFEST = "overrides.usda", "manifest.usda"
# What a resumed run goes on from lies with its chunks, and goes when they go.
CHECKPOINT = "checkpoint.npz"
SUFFIXES = (".usda", ".usd", ".usdc")


def cache_folder(top_layer: Path) -> Path:
    """OUT.usda -> OUT.cache, where the chunks lie."""
    return top_layer.with_suffix(".cache")


class CacheWriter:
    """Writes one run's result: every sample, in order, to `add`; `close` at the end or when stopping early.

        with CacheWriter(out, shot, samples=[(1.0,), (2.0,)], chunk=20, provenance=made) as writer:
            writer.add(1.0, [PrimFrame(...)])
            writer.add(2.0, [PrimFrame(...)])

    Leaving the `with` closes, also on an error, so that frames already simulated are kept.
    """

    def __init__(
        self,
        top_layer: Path,
        shot: Shot,
        *,
        samples: Sequence[Sequence[float]],
        chunk: int,
        provenance: Mapping[str, Any],
        inputs: Iterable[Path] = (),
        overwrite: bool = False,
        resume: bool = False,
    ) -> None:
        """Checks what can be checked; nothing is written before `open`, or entering the `with`.

        samples: time codes of each frame to write, in order; a frame has several when it has shutter samples.
        chunk: frames a file holds.  provenance: how the result is made, for customLayerData['plait'].
        inputs: files of the shot that must not be written to, beside those that the simulated prims come from.
        resume: go on after what an earlier run of the same kind finished; where there is none, start afresh.

        Raises UsageError for an output that exists (without `overwrite` or `resume`), that is of another run
        (`resume`) or has no USD suffix; InputError for one that is a layer of the shot.
        """
        self._shot = shot
        self.top_layer = top_layer.absolute()
        self.folder = cache_folder(self.top_layer)
        self._rate = shot.info.time_codes_per_second
        self._source = Overridden(shot)
        self._lay_plan(samples, chunk)
        self._record = {
            **provenance,
            "prims": sorted(self._source.counts),
            "plan": _digest([samples, chunk, sorted(self._source.counts.items())]),
        }
        self._refuse_inputs([shot.info.path, *self._source.layers, *inputs])
        exists = self.top_layer.exists() or self.folder.exists()
        if exists and not (overwrite or resume):
            raise UsageError(f"{self.top_layer} exists; --overwrite replaces it, --resume goes on with it")
        self._taken_up = resume and self.top_layer.exists() and self._take_up()

    def open(self) -> CacheWriter:
        """Writes a top layer that shows the source until a chunk is done. Raises UsageError where it cannot."""
        try:
            self._lay_out(self._shot, self._taken_up)
        except (OSError, PlaitError) as error:
            reason = (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
            raise UsageError(f"-o {self.top_layer}: nothing can be written there: {reason}") from error
        return self

    @property
    def frames_done(self) -> int:
        """How many frames, from the first, are whole on disk."""
        return bisect.bisect_right(self._frame_ends, self._on_disk)

    def add(self, code: float, results: Iterable[PrimFrame | TransformFrame]) -> None:
        """Takes the sample at time code `code`; writes a chunk when its last frame is complete.

        A sample that is on disk already is passed over: a resumed run may start from an earlier checkpoint.
        Raises PlaitError when a value is not finite or the disk does not take the chunk, ValueError for a code
        out of order, a prim missing or unknown, an array of the wrong size: mistakes of the caller.
        """
        if not self._source.outputs:
            return
        position = self._positions.get(float(code))
        if position is None or position > self._next:
            raise ValueError(f"the sample at {code} is not the one due")
        if position < self._next:
            return
        self._pending.append(self._sample(float(code), results))
        self._next += 1
        if self._next == self._chunk_ends[self._chunk]:
            self._write_chunk()
            self._chunk += 1
            self._pending = self._pending[-1:]

    def flush(self) -> None:
        """Writes the samples of a chunk that is not complete yet; a resumed run completes it to the same bytes."""
        if self._next > self._on_disk:
            self._write_chunk()

    def close(self) -> None:
        """All that was added is on disk afterwards."""
        self.flush()

    def __enter__(self) -> CacheWriter:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _lay_plan(self, samples: Sequence[Sequence[float]], chunk: int) -> None:
        """Numbers the samples: where frames and chunks end, and how far the run is."""
        codes = [float(code) for frame in samples for code in frame]
        if any(later <= earlier for earlier, later in itertools.pairwise(codes)):
            raise ValueError("samples must be in order, each time code once")
        self._codes = codes
        self._positions = {code: position for position, code in enumerate(codes)}
        self._frame_ends = list(itertools.accumulate(len(frame) for frame in samples))
        self._chunk_ends = [*self._frame_ends[chunk - 1 :: chunk]]
        if self._chunk_ends[-1:] != self._frame_ends[-1:]:
            self._chunk_ends.append(self._frame_ends[-1])
        self._chunk = self._next = self._on_disk = self._listed = 0
        self._pending: list[Sample] = []

    def _refuse_inputs(self, inputs: Iterable[Path]) -> None:
        if self.top_layer.suffix not in SUFFIXES:
            raise UsageError(f"-o {self.top_layer}: give a file name that ends in {', '.join(SUFFIXES)}")
        for path in {path.resolve() for path in inputs}:
            if path == self.top_layer.resolve() or self.folder.resolve() in path.parents:
                raise InputError(
                    "the result would overwrite this layer of the shot", file=path, mend="choose another -o"
                )

    def _sample(self, code: float, results: Iterable[PrimFrame | TransformFrame]) -> Sample:
        given = {result.prim_path: result for result in results}
        if given.keys() != self._source.counts.keys():
            raise ValueError(f"sample {code}: results for {sorted(given)}, not {sorted(self._source.counts)}")
        values: dict[tuple[str, str], np.ndarray] = {}
        for target in self._source.outputs:
            result, count = given[target.path], self._source.counts[target.path]
            if isinstance(result, TransformFrame):
                values[target.path, TRANSFORM] = result.transform
                continue
            held = {name: _array(result, name) for name in target.attributes}
            for name, size in _sizes(held, count).items():
                if len(held[name]) != size:
                    problem = f"{len(held[name])} values, not {size}"
                    raise ValueError(f"sample {code}, <{target.path}> {name}: {problem}")
            values |= {(target.path, name): value for name, value in held.items()}
        extents = {path: value for (path, name), value in values.items() if name == "extent"}
        values |= {(path, "extent"): box for path, box in self._source.bounds_above(code, extents).items()}
        _refuse_non_finite(code, values)
        return Sample(code, values)

    def _write_chunk(self) -> None:
        path = self._chunk_path(self._chunk)
        try:
            layers.export(layers.chunk_layer(self._pending, self._rate), path)
            if self._listed <= self._chunk:
                self._list_chunks(self._chunk + 1)
        except PlaitError as error:
            raise PlaitError(f"{error}; {self.frames_done} frames are kept") from error
        self._on_disk = self._next

    def _chunk_path(self, chunk: int) -> Path:
        return self.folder / f"chunk.{chunk + 1:04d}.usdc"

    def _list_chunks(self, count: int) -> None:
        """Replaces the override layer by one that plays the first `count` chunks."""
        begins = [0, *(end - 1 for end in self._chunk_ends)]
        clips = [(self._codes[begins[chunk]], self._chunk_path(chunk).name) for chunk in range(count)]
        overrides = layers.override_layer(
            self._source.targets, self._source.instances, clips, MANIFEST, self._rate
        )
        layers.export(overrides, self.folder / OVERRIDES)
        self._listed = count

    def _lay_out(self, shot: Shot, taken_up: bool) -> None:
        """Everything but the chunks, in an order that opens in USD at every moment; clears what is left over."""
        self.top_layer.parent.mkdir(parents=True, exist_ok=True)
        if not taken_up:
            (self.folder / CHECKPOINT).unlink(missing_ok=True)
        sublayers = [shot.info.path]
        if self._source.outputs:
            self.folder.mkdir(exist_ok=True)
            sublayers.insert(0, self.folder / OVERRIDES)
            layers.export(layers.manifest_layer(self._source.targets, self._rate), self.folder / MANIFEST)
            self._list_chunks(bisect.bisect_left(self._chunk_ends, self._on_disk) + 1 if self._on_disk else 0)
        if not taken_up:
            top = layers.top_layer(
                self._source.root_layer, shot.info, self.top_layer, sublayers, self._record, self._codes
            )
            layers.export(top, self.top_layer)
        for path in self.folder.glob("chunk.*.usdc"):
            if path not in map(self._chunk_path, range(self._listed)):
                path.unlink()
        for path in self.folder.glob(".*.writing.*"):
            path.unlink()

    def _take_up(self) -> bool:
        """Finds what an earlier run finished. Raises UsageError when that run was not the same as this one."""
        self._refuse_other_run()
        for chunk, end in enumerate(self._chunk_ends):
            begin = self._chunk_ends[chunk - 1] if chunk else 0
            carried = self._codes[begin - 1 : begin]
            count, held = self._read_chunk(self._chunk_path(chunk), [*carried, *self._codes[begin:end]])
            if count <= len(carried):
                break
            self._next = self._on_disk = begin + count - len(carried)
            self._chunk, self._pending = chunk + (self._on_disk == end), held
            if self._on_disk < end:
                break
        return True

    def _refuse_other_run(self) -> None:
        try:
            held = Sdf.Layer.OpenAsAnonymous(str(self.top_layer)).customLayerData.get(layers.RECORD, {})
        except (Tf.ErrorException, AttributeError) as error:
            raise InputError("cannot be read", file=self.top_layer, mend="start again with --overwrite") from error
        record = layers.recordable(self._record)
        other = sorted(key for key in held.keys() | record.keys() if held.get(key) != record.get(key))
        if other:
            raise UsageError(
                f"--resume: {self.top_layer} was made with another {', '.join(other)}; "
                "give the same, or start again with --overwrite"
            )

    def _read_chunk(self, path: Path, codes: list[float]) -> tuple[int, list[Sample]]:
        """How many of `codes` a chunk file has, and its samples; of a file that has all, the last one alone.

        A flushed chunk has the first few; one that is not there, damaged, or another's has none.
        """
        try:
            layer = Sdf.Layer.OpenAsAnonymous(str(path)) if path.exists() else None
        except Tf.ErrorException:
            layer = None
        if layer is None:
            return 0, []
        names = [f"{target.path}.{name}" for target in self._source.targets for name in target.attributes]
        held = {tuple(layer.ListTimeSamplesForPath(name)) for name in names}
        found = list(held.pop()) if len(held) == 1 else []
        if found != codes[: len(found)]:
            return 0, []
        wanted = found[-1:] if found == codes else found
        return len(found), layers.read_samples(layer, self._source.targets, wanted)


def _array(result: PrimFrame, name: str) -> np.ndarray:
    if name in result.others:
        return result.others[name]
    value = getattr(result, name.removeprefix("primvars:"))
    if value is None:
        raise ValueError(f"<{result.prim_path}> has authored normals: they must be refreshed")
    value = np.asarray(value, np.float32)
    if value.shape[1:] != (3,):
        raise ValueError(f"<{result.prim_path}> {name}: {value.shape}, not (n, 3)")
    return value


def _sizes(held: Mapping[str, np.ndarray], count: int | None) -> dict[str, int]:
    """How many values attributes must have. count: of points; None where it may change from sample to sample."""
    count = len(held["points"]) if count is None else count
    sizes = {"points": count, "velocities": count, "extent": 2}
    if "ids" in held:
        sizes |= {"ids": count, "widths": count}
    if "faceVertexCounts" in held:
        sizes |= {"normals": count, "faceVertexIndices": int(held["faceVertexCounts"].sum())}
    return sizes


def _refuse_non_finite(code: float, values: Mapping[tuple[str, str], np.ndarray]) -> None:
    for (path, name), value in values.items():
        fine = np.isfinite(value).all(axis=tuple(range(1, value.ndim)))
        wrong = int(np.count_nonzero(~fine))
        if wrong:
            raise PlaitError(f"frame {code:g}: <{path}> {name}: {wrong} of {len(value)} are not finite")


def _digest(plan: Any) -> str:
    return hashlib.sha256(repr(plan).encode()).hexdigest()[:16]
