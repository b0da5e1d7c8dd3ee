"""Small line plots as SVG, for pages that need no other file."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

_WIDTH, _HEIGHT = 640, 240
_LEFT, _RIGHT, _TOP, _BOTTOM = 72, 630, 26, 208
_LEGEND = 130
_COLOURS = ("#1f5fa8", "#c77700", "#1b6e3c", "#7a3fa0")
_MARK, _GRID = "#b3261e", "#e4e4e4"


@dataclass(frozen=True)
class _Axes:
    """From values to places on the picture. low, high: of the vertical axis, powers of ten if logarithmic."""

    first: float
    last: float
    low: float
    high: float
    logarithmic: bool

    def across(self, x: float) -> float:
        return _LEFT + (_RIGHT - _LEFT) * (x - self.first) / ((self.last - self.first) or 1.0)

    def down(self, y: float) -> float:
        if self.logarithmic:
            y = math.log10(y) if y > 0.0 else self.low
        return _BOTTOM - (_BOTTOM - _TOP) * (y - self.low) / (self.high - self.low)

    def ticks(self) -> Sequence[float]:
        if not self.logarithmic:
            step = _round_step((self.high - self.low) / 4.0)
            first, last = math.ceil(self.low / step), math.floor(self.high / step)
            return [step * count for count in range(first, last + 1)]
        step = max(1, math.ceil((self.high - self.low) / 6))
        return [10.0**power for power in range(int(self.low), int(self.high) + 1, step)]


def line_plot(
    x: np.ndarray,
    series: Mapping[str, np.ndarray],
    label: str,
    *,
    x_label: str = "frame",
    logarithmic: bool = False,
    mark: tuple[str, float] | None = None,
) -> str:
    """An `svg` element with every one of `series` over `x`, (n,) each, and a dashed line at the value of `mark`.

    On a logarithmic axis zeros lie on its lower edge, a decade or more under the smallest value that is not zero.
    """
    values = np.concatenate([*series.values(), [] if mark is None else [mark[1]]])
    limits = _decades(values) if logarithmic else _limits(values)
    axes = _Axes(float(x[0]), float(x[-1]), *limits, logarithmic)
    parts = _frame(axes, x_label, label)
    if mark is not None:
        height = axes.down(mark[1])
        parts.append(_line(_LEFT, height, _RIGHT, height, _MARK, "stroke-dasharray='5 4'"))
        parts.append(_words(mark[0], _LEFT + _LEGEND * len(series), _TOP - 10, "start", f"fill='{_MARK}'"))
    for index, (name, held) in enumerate(series.items()):
        colour = _COLOURS[index % len(_COLOURS)]
        points = " ".join(f"{axes.across(a):.1f},{axes.down(b):.1f}" for a, b in zip(x, held, strict=True))
        parts.append(f"<polyline points='{points}' fill='none' stroke='{colour}' stroke-width='1.6'/>")
        parts.append(_words(name, _LEFT + _LEGEND * index, _TOP - 10, "start", f"fill='{colour}'"))
    return f"<svg viewBox='0 0 {_WIDTH} {_HEIGHT}' width='{_WIDTH}' height='{_HEIGHT}'>{''.join(parts)}</svg>"


def _decades(values: np.ndarray) -> tuple[float, float]:
    positive = values[values > 0.0]
    if len(positive) == 0:
        return -1.0, 0.0
    return math.floor(math.log10(positive.min())) - 1.0, math.floor(math.log10(positive.max())) + 1.0


def _round_step(step: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is no smaller than `step`."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= step)


def _limits(values: np.ndarray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    margin = 0.05 * ((high - low) or abs(high) or 1.0)
    return low - margin, high + margin


def _frame(axes: _Axes, x_label: str, label: str) -> list[str]:
    parts = []
    for tick in axes.ticks():
        parts.append(_line(_LEFT, axes.down(tick), _RIGHT, axes.down(tick), _GRID))
        shown = f"1e{math.log10(tick):.0f}" if axes.logarithmic else f"{tick:.4g}"
        parts.append(_words(shown, _LEFT - 6, axes.down(tick) + 4, "end"))
    middle = (_TOP + _BOTTOM) / 2
    return [
        *parts,
        _words(f"{axes.first:g}", _LEFT, _BOTTOM + 18, "middle"),
        _words(f"{axes.last:g}", _RIGHT, _BOTTOM + 18, "end"),
        _words(x_label, (_LEFT + _RIGHT) / 2, _BOTTOM + 18, "middle"),
        _words(label, 12, middle, "middle", f"transform='rotate(-90 12 {middle})'"),
    ]


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, extra: str = "") -> str:
    return f"<line x1='{x1}' y1='{y1:.1f}' x2='{x2}' y2='{y2:.1f}' stroke='{colour}' {extra}/>"


def _words(text: str, x: float, y: float, anchor: str, extra: str = "") -> str:
    return f"<text x='{x}' y='{y:.1f}' text-anchor='{anchor}' {extra}>{html.escape(text)}</text>"
