"""Frame ranges, as USD writes them (`1:240`, `1:240x2`) and as farms do (`1-240`), and the times to step to."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass

from plait.pipeline.errors import UsageError

_NUMBER = r"-?\d+(?:\.\d+)?"
_RANGE = re.compile(rf"^({_NUMBER})(?:\s*[:-]\s*({_NUMBER})(?:x(\d+(?:\.\d+)?))?)?$")
MAX_FRAMES = 1_000_000


@dataclass(frozen=True)
class FrameRange:
    """Time codes start, start + stride, ... up to end, both ends included."""

    start: float
    end: float
    stride: float = 1.0

    @property
    def codes(self) -> tuple[float, ...]:
        count = math.floor((self.end - self.start) / self.stride + 1e-9) + 1
        return tuple(self.start + self.stride * i for i in range(count))


def parse(text: str) -> FrameRange:
    """Raises UsageError for text that is no range, runs backwards, or asks for more than a million frames."""
    match = _RANGE.match(text.strip())
    if match is None:
        raise UsageError(f"--frames {text}: write 1001, 1001:1100, 1001:1100x2 or 1001-1100")
    start = float(match[1])
    end = float(match[2]) if match[2] else start
    stride = float(match[3]) if match[3] else 1.0
    if end < start:
        raise UsageError(f"--frames {text}: ends before it starts; time only runs forwards")
    if stride <= 0.0:
        raise UsageError(f"--frames {text}: the stride must be greater than 0")
    if (end - start) / stride >= MAX_FRAMES:
        raise UsageError(f"--frames {text}: more than {MAX_FRAMES} frames")
    return FrameRange(start, end, stride)


@dataclass(frozen=True)
class Leg:
    """One stretch of simulation: step to time code `code` in `substeps` equal substeps.

    frame: the frame that the sample at `code` belongs to (its shutter samples come beside it), None in pre-roll.
    last_of_frame: the frame is complete once this leg is done.
    """

    code: float
    substeps: int
    frame: float | None
    last_of_frame: bool


def schedule(
    frames: FrameRange, preroll: int, substeps: int, shutter: tuple[float, ...] = ()
) -> tuple[float, tuple[Leg, ...]]:
    """The time code to start from, at rest, and every leg from there to the last frame.

    Legs are at most a frame long, so that metrics, checkpoints and reach tests come once a frame, and
    get their share of `substeps` by length. The first frame's own pose is reached by the pre-roll; without one the
    run starts on the first sample, which is then written as it is: a leg of no substeps.
    """
    samples = [(code + offset, code) for code in frames.codes for offset in sorted({0.0, *shutter})]
    samples.sort()
    for (earlier, frame), (later, next_frame) in itertools.pairwise(samples):
        if later - earlier < 1e-9 or next_frame < frame:
            raise UsageError("shutter samples of neighbouring frames meet: choose offsets within half a stride")
    last_of = {frame: code for code, frame in samples}
    begin = samples[0][0] - preroll
    legs: list[Leg] = []
    now = begin
    for code, frame in samples:
        pieces = max(1, math.ceil(code - now - 1e-9))
        for piece in range(1, pieces):
            stop = now + (code - now) * piece / pieces
            legs.append(Leg(stop, _share(substeps, (code - now) / pieces), None, False))
        legs.append(Leg(code, _share(substeps, (code - now) / pieces), frame, last_of[frame] == code))
        now = code
    return begin, tuple(legs)


def sample_codes(legs: tuple[Leg, ...]) -> list[tuple[float, ...]]:
    """Time codes that are written, a tuple a frame (more than one with shutter samples)."""
    codes: dict[float, list[float]] = {}
    for leg in legs:
        if leg.frame is not None:
            codes.setdefault(leg.frame, []).append(leg.code)
    return [tuple(group) for group in codes.values()]


def _share(substeps: int, length: float) -> int:
    return math.ceil(substeps * length - 1e-9) if length > 0.0 else 0
