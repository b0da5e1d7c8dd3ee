"""A bundle of hair falls across another one, which holds it; and passes through it without contact of strands.

`python example.py [small|default|full]` runs it with contact, with the one of Han 2019 and without, prints and
checks what passes through, and leaves `out/hair_tubes.usdc` with a picture.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import warp as wp
from pxr import Usd, UsdGeom, Vt

from plait.assets.stages import new_stage
from plait.pipeline.benchmarks.scenes import Fibre, rods
from plait.pipeline.preview import render_still
from plait.solver.build import build
from plait.solver.scene import Scene
from plait.solver.settings import Settings, StrandContactSettings
from plait.solver.strand_contact.missed import MissedCollisions

FRAMES_PER_SECOND, SUBSTEPS = 24, 8
HAIR = Fibre(radius=0.3e-3, density=1300.0, youngs_modulus=1e8)
THICKNESS = 0.4e-3  # [m] kept between strands, beside their radii
LENGTH, DROP = 0.3, 0.05  # [m]
METHODS = {"implicit": "contact", "paper": "Han 2019", "none": "no contact"}
COLOURS = {"lower": (0.32, 0.14, 0.05), "upper": (0.62, 0.42, 0.16)}  # linear RGB
BESIDE = 0.36  # [m] between the runs in the picture


@dataclass(frozen=True)
class Size:
    """strands: of both bundles together.  segments: a strand.  frames: simulated."""

    strands: int
    segments: int
    frames: int


SIZES = {"small": Size(16, 24, 8), "default": Size(90, 60, 36), "full": Size(270, 175, 100)}


@dataclass(frozen=True)
class Result:
    """Of one method. points: bundle to (frame_count, strand_count, node_count, 3) [m].
    missed: pairs of segments that passed through each other, over all substeps.
    strain: the largest of all frames.  seconds: of computation, a frame."""

    points: dict[str, np.ndarray]
    missed: int
    strain: float
    seconds: float


def places(count: int) -> np.ndarray:
    """(count, 2) [m]: a bundle's section, packed hexagonally a tenth looser than strands can be."""
    reach = np.arange(-count, count + 1)
    column, row = (one.ravel() for one in np.meshgrid(reach, reach))
    packed = 1.1 * (2.0 * HAIR.radius + THICKNESS) * np.stack([column + 0.5 * row, np.sqrt(0.75) * row], axis=1)
    return packed[np.argsort(np.linalg.norm(packed, axis=1), kind="stable")[:count]]


def scene(size: Size) -> Scene:
    """The lower bundle, along x, is clamped at one end and drawn tight at the other by ten times its weight.

    The upper one, along z, is clamped at one end too, and swings down onto it.
    """
    count, along = size.strands // 2, np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, size.segments + 1)
    # Hair is never quite parallel: ends are off by up to a third of the play between neighbours.
    random = np.random.default_rng(1).uniform(-3e-5, 3e-5, (2, count, 2, 2))
    part = np.linspace(0.0, 1.0, size.segments + 1)[:, None]
    across = places(count)[:, None] + (1.0 - part) * random[..., :1, :] + part * random[..., 1:, :]
    lower = [np.column_stack([along, one]) for one in across[0]]
    upper = [np.column_stack([one[:, 1], DROP + one[:, 0], along]) for one in across[1]]
    weight = 9.81 * HAIR.density * HAIR.area * LENGTH
    loads = np.zeros((count, size.segments + 1, 3))
    loads[:, -1] = 10.0 * weight, 0.5 * weight, 0.0
    made = [
        rods("lower", lower, HAIR, rest_shape="authored", loads=loads.reshape(-1, 3), surface=0),
        rods("upper", upper, HAIR, rest_shape="authored", surface=1),
    ]
    surfaces, strands = zip(*made, strict=True)
    return Scene(surfaces=surfaces, strands=tuple(replace(one, thickness=THICKNESS) for one in strands))


def run(size: Size, method: str) -> Result:
    """method: of `StrandContactSettings`."""
    contact = StrandContactSettings(method=method)
    simulation = build(scene(size), Settings(substeps=1, strand_contact=contact))
    stage = simulation.model.parts["strands"]
    judge = MissedCollisions(simulation.model.launcher, stage.layout)
    position = simulation.state.arrays["strands/position"]
    before = wp.clone(position)
    points, missed, strain, seconds = {"lower": [], "upper": []}, 0, 0.0, 0.0
    for substep in range(size.frames * SUBSTEPS + 1):
        if substep:
            started = time.perf_counter()
            metrics = simulation.advance_frame(substep / (FRAMES_PER_SECOND * SUBSTEPS))
            seconds += time.perf_counter() - started
            missed += judge.count(before, position)
            wp.copy(before, position)
            strain = max(strain, metrics["strands"]["strain_max"])
        if substep % SUBSTEPS == 0:
            for prim, frames in enumerate(points.values()):
                frames.append(stage.points(prim).reshape(size.strands // 2, -1, 3))
    simulation.close()
    found = {name: np.array(frames) for name, frames in points.items()}
    return Result(found, missed, strain, seconds / size.frames)


def check(results: dict[str, Result]) -> None:
    """What must be seen; AssertionError if it is not."""
    count = len(results["none"].points["upper"][0])
    # Without contact every upper strand falls through every lower one; with it none does.
    assert results["none"].missed >= count**2
    assert results["implicit"].missed == 0
    # Ten times a strand's weight on EA = 28 N are .04 %.
    assert results["implicit"].strain < 0.02
    # What is held hangs over the lower bundle: at its middle it has not fallen below where that is.
    middle = results["implicit"].points["upper"][-1]
    assert middle[:, middle.shape[1] // 2, 1].min() > -0.25 * LENGTH


def write(results: dict[str, Result], path: Path) -> None:
    """All frames as a USD stage: the methods side by side."""
    stage = new_stage(path)
    stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(results["none"].points["lower"]) - 1)
    for place, (method, result) in enumerate(results.items()):
        for bundle, frames in result.points.items():
            _curves(stage, f"/{method}_{bundle}", COLOURS[bundle], frames + np.array([BESIDE * place, 0, 0]))
    stage.Save()


def _curves(stage: Usd.Stage, path: str, colour: tuple[float, float, float], frames: np.ndarray) -> None:
    curves = UsdGeom.BasisCurves.Define(stage, path)
    curves.CreateTypeAttr(UsdGeom.Tokens.linear)
    curves.CreateCurveVertexCountsAttr([frames.shape[2]] * frames.shape[1])
    curves.CreateWidthsAttr([2.0 * HAIR.radius + THICKNESS])
    curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    curves.CreateDisplayColorAttr([colour])
    for frame, points in enumerate(frames):
        curves.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points.reshape(-1, 3).astype(np.float32)), frame)


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, prints, checks, writes, draws."""
    folder.mkdir(parents=True, exist_ok=True)
    results = {}
    for method, name in METHODS.items():
        results[method] = found = run(SIZES[size], method)
        strain = f"largest strain {100.0 * found.strain:.2g} %"
        print(f"{name}: {found.missed} passed through, {strain}, {found.seconds:.2g} s a frame")
    check(results)
    path = folder / "hair_tubes.usdc"
    write(results, path)
    if draw:
        render_still(path, path.with_suffix(".jpg"), frame=min(14, SIZES[size].frames), size=(960, 400))


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
