"""Curves as lines to draw: refined in their own basis, and shaded as fibres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from pxr import Usd, UsdGeom

PIECES = 6  # lines a cubic segment is drawn with

# Weights of four points in powers 1, t, t^2, t^3, a row a power.
_CUBIC = {
    "bezier": np.array([[1, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], float),
    "bspline": np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], float) / 6.0,
    "catmullRom": np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]], float) / 2.0,
}


@dataclass(frozen=True)
class Refinement:
    """From the points of a prim's curves to those that are drawn.

    counts: (curve_count,) authored.  groups: curves alike, (which curves, (drawn, authored) weights).
    """

    counts: np.ndarray
    groups: tuple[tuple[np.ndarray, np.ndarray], ...]

    @property
    def drawn_counts(self) -> np.ndarray:
        """(curve_count,) points drawn of each curve; none of what has no segment."""
        result = np.zeros(len(self.counts), dtype=np.int64)
        for curves, weights in self.groups:
            result[curves] = len(weights)
        return result

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """(drawn, k) of (authored point count, k), curve by curve in the authored order."""
        drawn = self.drawn_counts
        result = np.zeros((drawn.sum(), values.shape[1]))
        first, target = np.cumsum(self.counts) - self.counts, np.cumsum(drawn) - drawn
        for curves, weights in self.groups:
            held = values[first[curves][:, None] + np.arange(weights.shape[1])]
            result[target[curves][:, None] + np.arange(len(weights))] = np.einsum("da,cak->cdk", weights, held)
        return result


def refinement(prim: Usd.Prim, counts: np.ndarray) -> Refinement:
    """How the curves of a prim are drawn; what is not BasisCurves is drawn through its points."""
    kind, basis, wrap = "linear", "bezier", "nonperiodic"
    if prim.IsA(UsdGeom.BasisCurves):
        schema = UsdGeom.BasisCurves(prim)
        kind, basis, wrap = (
            str(a.Get()) for a in (schema.GetTypeAttr(), schema.GetBasisAttr(), schema.GetWrapAttr())
        )
    groups = []
    for count in np.unique(counts):
        weights = _weights(kind if basis in _CUBIC else "linear", basis, wrap, int(count))
        if len(weights):
            groups.append((np.nonzero(counts == count)[0], weights))
    return Refinement(counts, tuple(groups))


@cache
def _weights(kind: str, basis: str, wrap: str, count: int) -> np.ndarray:
    """(drawn, count) weights of a curve's points; no rows for a curve without a segment."""
    periodic = wrap == "periodic"
    if kind != "cubic":
        return np.eye(count)[np.arange(count + periodic) % count] if count > 1 else np.zeros((0, count))
    control = np.eye(count)
    if wrap == "pinned" and basis != "bezier" and count > 1:  # so that the curve ends at its end points
        before, after = 2.0 * control[0] - control[1], 2.0 * control[-1] - control[-2]
        control = np.concatenate([[before], control, [after]])
    step = 3 if basis == "bezier" else 1
    segments = count // step if periodic else (len(control) - 4) // step + 1
    if segments < 1 or count < 2:
        return np.zeros((0, count))
    powers = np.vander(np.arange(PIECES) / PIECES, 4, increasing=True) @ _CUBIC[basis]
    starts = step * np.arange(segments)
    rows = [powers @ control[(start + np.arange(4)) % len(control)] for start in starts]
    last = np.ones(4) @ _CUBIC[basis] @ control[(starts[-1] + np.arange(4)) % len(control)]
    return np.concatenate([*rows, [last]])


def tangents(points: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(n, 3) unit tangents of polylines of two points or more; zero where points coincide."""
    ends = np.cumsum(counts)
    forward = np.diff(points, axis=0, append=points[-1:])
    forward[ends - 1] = forward[ends - 2]
    backward = np.roll(forward, 1, axis=0)
    backward[ends - counts] = forward[ends - counts]
    mean = forward + backward
    return mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-30)


def shade(
    points: np.ndarray, counts: np.ndarray, colour: np.ndarray, to_light: np.ndarray, to_eye: np.ndarray
) -> np.ndarray:
    """(n, 3) linear RGB of fibres: diffuse and two highlights by Kajiya and Kay (1989), in each other's shadow.

    to_light, to_eye: (3,) unit vectors. Each strand is a little lighter or darker than the next, as hair is.
    """
    along = tangents(points, counts)
    strand = np.repeat(np.arange(len(counts)), counts)
    tone = np.random.default_rng(0).normal(1.0, 0.13, len(counts))[strand].clip(0.6, 1.4)
    cos_light, cos_eye = along @ to_light, along @ to_eye
    sin_light, sin_eye = (np.sqrt(np.maximum(0.0, 1.0 - c * c)) for c in (cos_light, cos_eye))
    mirrored = np.maximum(0.0, sin_light * sin_eye - cos_light * cos_eye)
    light = light_through(points, counts, to_light)
    diffuse = (0.22 + 0.85 * sin_light * light) * tone
    highlight = light * (0.045 * mirrored**40 + 0.03 * mirrored**8)
    return colour * diffuse[:, None] + highlight[:, None] * (0.35 + 0.65 * colour / max(colour.max(), 1e-6))


def light_through(points: np.ndarray, counts: np.ndarray, to_light: np.ndarray, cells: int = 48) -> np.ndarray:
    """(n,) part of the light that reaches each point past the hair before it: Beer's law through counted cells.

    The absorption is set so that the light falls by half within a fifth of an evenly filled volume.
    """
    side = np.linalg.svd(to_light[None])[2][1:]
    place = points @ np.vstack([side, to_light]).T
    low, size = place.min(axis=0), np.ptp(place, axis=0).max()
    cell = np.minimum((place - low) / max(size, 1e-30) * cells, cells - 1).astype(np.int64)
    flat = (cell[:, 0] * cells + cell[:, 1]) * cells + cell[:, 2]
    filled = np.bincount(flat, minlength=cells**3).reshape(cells, cells, cells).astype(float)
    before = np.cumsum(filled[:, :, ::-1], axis=2)[:, :, ::-1] - 0.5 * filled
    typical = max(float(np.mean(filled[filled > 0.0])), 1.0)
    return np.maximum(0.25, 0.5 ** (before.ravel()[flat] / (0.2 * cells * typical)))
