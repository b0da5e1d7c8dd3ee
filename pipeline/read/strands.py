"""A groom and its parameters as `Strands` of the scene, and the way back."""

from __future__ import annotations

import numpy as np

from plait.pipeline.read.curves import Curves, Polylines, read_widths, stub_length
from plait.pipeline.read.motions import WorldToLocal
from plait.pipeline.read.parameters import Given
from plait.pipeline.read.roots import Rooted
from plait.pipeline.read.source import Source
from plait.solver.scene import RootBinding, Strands

# [m] diameter where none is drawn: a human hair's.
DEFAULT_THICKNESS = 80e-6
# [m] what is drawn thicker than this was drawn for its looks; horsehair, the thickest, has 0.2 mm.
THICKEST_HAIR = 0.3e-3
# rho A g L^3 / EI of strands drawn so: they hang and swing as locks of their length do.
LOCK_GRAVITY_NUMBER = 10.0
EARTH = 9.81
# [1/s] what neighbours take, and air from a hair of the default thickness.
LOCK_DAMPING, AIR_DAMPING = 2.0, 8.0
# Least radius along a strand over its mean: drawn tips may taper to nothing, but have a mass.
LEAST_RADIUS = 0.1


def build(
    source: Source,
    curves: Curves,
    lines: Polylines,
    rooted: Rooted,
    binding: RootBinding,
    given: Given,
    free: np.ndarray | None,
) -> Strands:
    """The groom in the scene."""
    WorldToLocal(source, curves.prim)(source.start / source.units.time_codes_per_second)
    strand_of = np.repeat(np.arange(len(lines.curves)), np.diff(lines.offsets))
    points = _points(curves, lines, rooted)
    radius = _radii(source, curves, lines, rooted, given, strand_of)
    count = len(lines.curves)
    stiffness = _stiffness(source, curves, points, lines, radius, strand_of, given)
    return Strands(
        name=curves.path,
        points=points,
        offsets=lines.offsets,
        roots=binding,
        radius=radius,
        density=np.full(count, given["density"]),
        stretch_stiffness=stiffness[0],
        bend_stiffness=stiffness[1],
        twist_stiffness=stiffness[2],
        damping=_damping(given, radius, strand_of),
        friction=np.full(count, given["friction"]),
        rest_shape=given["restShape"],
        rest_transform=rooted.rest_to_world,
        thickness=given["clearance"],
        pic_fraction=given["picFraction"],
        free=free,
    )


def unsimulated(source: Source, curves: Curves, lines: Polylines, rooted: Rooted, binding: RootBinding) -> Strands:
    """Curves that follow guides: their shape and what they grow on; no material, which plays no part."""
    WorldToLocal(source, curves.prim)(source.start / source.units.time_codes_per_second)
    points, none = _points(curves, lines, rooted), np.zeros(len(lines.curves))
    return Strands(
        name=curves.path,
        points=points,
        offsets=lines.offsets,
        roots=binding,
        radius=np.zeros(len(points)),
        density=none,
        stretch_stiffness=none,
        bend_stiffness=none,
        twist_stiffness=none,
        damping=none,
        friction=none,
        rest_transform=rooted.rest_to_world,
    )


def _points(curves: Curves, lines: Polylines, rooted: Rooted) -> np.ndarray:
    """(point_count, 3) as `Strands.points`."""
    strand_of = np.repeat(np.arange(len(lines.curves)), np.diff(lines.offsets))
    drawn = curves.nodes[lines.source_points]
    drawn[lines.stub_tips, 2] += stub_length(curves) if len(lines.stub_tips) else 0.0
    return np.einsum("nij,nj->ni", rooted.to_rest[strand_of, :3, :3], drawn) + rooted.to_rest[strand_of, :3, 3]


def _damping(given: Given, radius: np.ndarray, strand_of: np.ndarray) -> np.ndarray:
    """(strand_count,) [1/s] as given; else that of neighbours and of still air.

    Air drags on a thin cylinder with about 4 pi viscosity / 3 per length and speed, at any radius (Lamb 1911),
    so the rate goes with one over the thickness squared: 10 /s at 80 um.
    """
    count = int(strand_of[-1]) + 1
    if "damping" in given:
        return np.full(count, given["damping"])
    mean = np.bincount(strand_of, radius) / np.bincount(strand_of)
    return LOCK_DAMPING + AIR_DAMPING * (0.5 * DEFAULT_THICKNESS / mean) ** 2


def _radii(
    source: Source,
    curves: Curves,
    lines: Polylines,
    rooted: Rooted,
    given: Given,
    strand_of: np.ndarray,
) -> np.ndarray:
    """(point_count,) [m]"""
    if "thickness" in given:
        return np.full(len(lines.source_points), 0.5 * given["thickness"])
    widths = read_widths(source, curves)
    if widths is None or not np.any(widths):
        source.warn(f"not authored, taken as {DEFAULT_THICKNESS:g} m", curves.prim, "widths")
        return np.full(len(lines.source_points), 0.5 * DEFAULT_THICKNESS)
    scale = np.abs(np.linalg.det(rooted.to_rest[:, :3, :3])) ** (1.0 / 3.0)
    radius = 0.5 * widths[lines.source_points] * scale[strand_of]
    count = np.bincount(strand_of)
    mean = np.bincount(strand_of, radius) / count
    none = mean <= 0.0
    if none.any():
        source.warn(f"zero along {int(none.sum())} strands, which get the others' mean", curves.prim, "widths")
        mean[none] = mean[~none].mean()
    return np.maximum(radius, LEAST_RADIUS * mean[strand_of])


def _stiffness(
    source: Source,
    curves: Curves,
    points: np.ndarray,
    lines: Polylines,
    radius: np.ndarray,
    strand_of: np.ndarray,
    given: Given,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """EA [N], EI [N m2], GJ [N m2], (strand_count,) each: authored, or of a round section of the mean radius."""
    count = np.bincount(strand_of)
    area = np.pi * np.bincount(strand_of, radius**2) / count
    second_moment = 0.25 * np.pi * np.bincount(strand_of, radius**4) / count
    stretch = np.full(len(area), given["stretchStiffness"]) if "stretchStiffness" in given else (
        given["youngsModulus"] * area)  # fmt: skip
    if "bendStiffness" in given:
        bend = np.full(len(area), given["bendStiffness"])
    else:
        bend = given["youngsModulus"] * second_moment
        thickest = 2.0 * float(radius.max())
        if thickest > THICKEST_HAIR and "youngsModulus" not in given:
            lengths = _lengths(points, lines)
            lock = given["density"] * area * EARTH * np.median(lengths) ** 3 / LOCK_GRAVITY_NUMBER
            if np.any(lock < bend):
                bend = np.minimum(bend, lock)
                source.warn(
                    f"drawn {thickest:.2g} m thick with no stiffness authored: bendStiffness is taken in "
                    f"proportion to length and weight, {np.median(bend):.3g} N m2",
                    curves.prim,
                    "widths",
                )
    twist = np.full(len(area), given["twistStiffness"]) if "twistStiffness" in given else (
        bend / (1.0 + given["poissonsRatio"]))  # fmt: skip
    return stretch, bend, twist


def _lengths(points: np.ndarray, lines: Polylines) -> np.ndarray:
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    step[lines.offsets[1:-1] - 1] = 0.0
    return np.add.reduceat(np.append(step, 0.0), lines.offsets[:-1])
