"""Pictures of any stage, off screen: a still, or a clip with the frame number in its corner."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Tf, UsdUtils

from plait.pipeline import layers
from plait.pipeline.config import Config
from plait.pipeline.errors import InputError, UsageError
from plait.pipeline.files import replacing
from plait.pipeline.frames import parse
from plait.pipeline.pictures import canvas, framing
from plait.pipeline.pictures.drawables import Shell, collect
from plait.pipeline.read.source import Source
from plait.pipeline.targets import TRANSFORM

STILLS = (".png", ".jpg", ".jpeg")
CLIPS = (".webp", ".gif")
LARGEST = 4096  # twice that is what many drivers can draw
# Frames that decide what must fit into the picture.
FRAMED = 9
TRANSLUCENT = 0.3


def probe() -> str:
    """What draws here, in one line. Raises PlaitError when nothing does."""
    return canvas.probe()


def render(
    cache: Path,
    output: Path,
    *,
    frames: str | None,
    size: str,
    camera: str | None,
    core: Config | None = None,
) -> None:
    """Draws `cache`, any USD stage, into `output`: a still (.png, .jpg) or a clip (.webp, .gif).

    frames: as `plait.pipeline.frames.parse` reads them; None for all of a clip, and for a still the middle one.
    size: WIDTHxHEIGHT [pixels].  camera: path of a camera prim; None for a view of all that moves.
    core: the configuration of `sim`: what is bone within flesh is shown through it; None for a plain picture.

    Raises UsageError for arguments, InputError for a stage that does not open or shows nothing, PlaitError where
    there is no OpenGL.
    """
    suffix = output.suffix.lower()
    if suffix not in (*STILLS, *CLIPS):
        raise UsageError(f"-o {output}: give a file name that ends in {', '.join((*STILLS, *CLIPS))}")
    pixels = _pixels(size)
    wanted = parse(frames).codes if frames else None
    if suffix in STILLS and wanted is not None and len(wanted) > 1:
        raise UsageError(f"--frames {frames}: a still shows one frame; for a clip end -o in .webp or .gif")
    shown = _Stage(cache, core)
    codes = wanted or (shown.codes if suffix in CLIPS else (shown.middle,))
    _write(shown, output, codes, pixels, camera)


def render_still(
    path: Path, output: Path, *, frame: float | None = None, size: tuple[int, int] = (960, 720)
) -> None:
    """Draws one frame of the stage at `path`, by default the middle one; raises as `render` does."""
    shown = _Stage(path)
    _write(shown, output, (shown.middle if frame is None else frame,), size, None)


def _pixels(size: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)x(\d+)", size.strip())
    if match is None or not all(16 <= int(side) <= LARGEST for side in match.groups()):
        raise UsageError(f"--size {size}: write WIDTHxHEIGHT in pixels, each from 16 to {LARGEST}, e.g. 960x720")
    return int(match[1]), int(match[2])


class _Stage:
    """A stage and what it shows."""

    def __init__(self, path: Path, core: Config | None = None) -> None:
        self._diagnostics = UsdUtils.CoalescingDiagnosticDelegate()  # USD's warnings are no part of a picture
        self.source = Source(path)
        missing = layers.missing_chunks(self.source.stage)
        if missing:
            raise self.source.error(
                f"{missing[0]} is missing, which holds frames of the result", mend="copy the whole result"
            )
        try:
            self.drawables, left_out = collect(self.source)
        except Tf.ErrorException as error:
            raise self.source.error(f"USD cannot evaluate it: {error}") from error
        for line in left_out:
            print(f"plait: not drawn: {line}", file=sys.stderr)
        if not self.drawables:
            raise InputError(
                "nothing to draw: no mesh, curves, points or simple shape with purpose default or render",
                file=path,
            )

        if core is not None:
            self._show_core(core)
        self.grounds = framing.grounds(self.drawables, self.middle)

    def _show_core(self, config: Config) -> None:
        """The bones within flesh, and that flesh translucent."""
        from plait.pipeline.pictures.bones import bones

        found = bones(self.source, config)
        for bone in found:
            count = len(bone.points(self.source.start))
            print(f"plait: {bone.prim.GetPath()}: {count or 'no'} nodes are bone", file=sys.stderr)
        flesh = {bone.prim for bone in found}
        self.drawables = [
            replace(shown, opacity=TRANSLUCENT) if isinstance(shown, Shell) and shown.prim in flesh else shown
            for shown in self.drawables
        ] + list(found)

    @property
    def codes(self) -> tuple[float, ...]:
        """Every frame of the stage's range; of a result, of the part of it that was simulated."""
        stage, info = self.source.stage, self.source.info
        simulated = [stage.GetPrimAtPath(path) for path in layers.simulated_prims(stage.GetRootLayer())]
        attributes = [prim.GetAttribute(name) for prim in simulated if prim for name in ("points", TRANSFORM)]
        samples = [code for attribute in attributes if attribute for code in attribute.GetTimeSamples()]
        start, end = (math.ceil(min(samples)), max(samples)) if samples else (info.start, info.end)
        return tuple(float(code) for code in np.arange(start, end + 1e-6))

    @property
    def middle(self) -> float:
        return self.codes[len(self.codes) // 2]

    def view(self, codes: Sequence[float], aspect: float) -> framing.View:
        """One that holds all but grounds at `codes`, of long ranges at some of them."""
        some = sorted({codes[round(i)] for i in np.linspace(0, len(codes) - 1, min(FRAMED, len(codes)))})
        seen: list[np.ndarray] = []
        for code in some:
            for drawable in self.drawables:
                if drawable in self.grounds or not drawable.visible(code):
                    continue
                if code == some[0] or drawable.animated:
                    points = drawable.points(code)
                    seen.append(points[:: max(1, len(points) // 20000)])
        points = np.concatenate(seen) if seen else np.zeros((0, 3))
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            raise InputError("nothing to draw: all is invisible or empty", file=self.source.path)
        return framing.around(points, self.source.info.up_axis, aspect)


def _write(shown: _Stage, output: Path, codes: Sequence[float], size: tuple[int, int], camera: str | None) -> None:
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with replacing(output) as aside:
            _encode(_pictures(shown, codes, size, camera), aside, codes, shown.source.units.time_codes_per_second)
    except OSError as error:
        raise UsageError(f"-o {output}: cannot be written: {error.strerror or error}") from error


def _pictures(shown: _Stage, codes: Sequence[float], size: tuple[int, int], camera: str | None) -> Iterator[Any]:
    """A PIL image a frame, drawn when asked for."""
    from PIL import Image

    aspect = size[0] / size[1]
    source = shown.source
    first = framing.through(source, camera, codes[0], aspect) if camera else shown.view(codes, aspect)
    ground = framing.level(shown.grounds, source.info.up_axis)
    paper = canvas.Canvas(size, shown.drawables, ground, first.axes)
    try:
        for code in codes:
            view = framing.through(source, camera, code, aspect) if camera else first
            picture = Image.fromarray(paper.draw(code, view))
            _number(picture, code)
            yield picture
    finally:
        paper.close()


def _number(picture: Any, code: float) -> None:
    """The frame number, bottom left."""
    from PIL import ImageDraw, ImageFont

    height = max(11, picture.height // 36)
    place = (0.6 * height, picture.height - 0.6 * height)
    ImageDraw.Draw(picture).text(
        place, f"{code:g}", fill=(70, 74, 80), font=ImageFont.load_default(height), anchor="ls"
    )


def _encode(pictures: Iterator[Any], path: Path, codes: Sequence[float], rate: float) -> None:
    suffix = path.suffix.lower()
    first = next(pictures)
    if suffix in STILLS:
        first.save(path, **({"optimize": True} if suffix == ".png" else {"quality": 92}))
        pictures.close()
        return
    # Rounded sums, not rounded differences, so that long clips keep their length.
    times = np.rint(1000.0 * (np.array(codes) - codes[0]) / rate).astype(int)
    last = times[-1] - times[-2] if len(times) > 1 else round(1000.0 / rate)
    options = {"duration": [*np.diff(times).tolist(), int(last)], "loop": 0}
    if suffix == ".webp":
        options |= {"quality": 88, "method": 4}
    first.save(path, save_all=True, append_images=pictures, **options)
