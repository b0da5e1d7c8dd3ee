"""A bundle of hair falls across another one, which holds it; and passes through it without contact of strands.

`python example.py [small|default|full]` runs it with contact, with the one of Han 2019 and without, prints and
checks what passes through, and leaves `out/hair_tubes.usdc` with a picture.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from plait.assets.stages import define_curves, new_stage
from plait.assets.strands import FRAMES_PER_SECOND, Played, play
from plait.pipeline.benchmarks.scenes import Fibre, rods
from plait.pipeline.benchmarks.strand_scenes import bundle_places
from plait.pipeline.preview import render_still
from plait.solver.scene import Scene

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


def scene(size: Size) -> Scene:
    """The lower bundle, along x, is clamped at one end and drawn tight at the other by ten times its weight.

    The upper one, along z, is clamped at one end too, and swings down onto it.
    """
    count, along = size.strands // 2, np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, size.segments + 1)
    # Hair is never quite parallel: ends are off by up to a third of the play between neighbours.
    random = np.random.default_rng(1).uniform(-3e-5, 3e-5, (2, count, 2, 2))
    part = np.linspace(0.0, 1.0, size.segments + 1)[:, None]
    # A section packed hexagonally, a tenth looser than strands can be.
    places = bundle_places(count, 1.1 * (2.0 * HAIR.radius + THICKNESS))
    across = places[:, None] + (1.0 - part) * random[..., :1, :] + part * random[..., 1:, :]
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


def check(results: dict[str, Played]) -> None:
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


def write(results: dict[str, Played], path: Path) -> None:
    """All frames as a USD stage: the methods side by side."""
    stage = new_stage(path, (0, len(results["none"].points["lower"]) - 1), FRAMES_PER_SECOND)
    for place, (method, result) in enumerate(results.items()):
        for bundle, frames in result.points.items():
            moved = frames + np.array([BESIDE * place, 0.0, 0.0])
            define_curves(stage, f"/{method}_{bundle}", moved, 2.0 * HAIR.radius + THICKNESS, COLOURS[bundle])
    stage.Save()


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, prints, checks, writes, draws."""
    folder.mkdir(parents=True, exist_ok=True)
    results = {}
    for method, name in METHODS.items():
        results[method] = found = play(scene(SIZES[size]), method, SIZES[size].frames)
        strain = f"largest strain {100.0 * found.strain:.2g} %"
        print(f"{name}: {found.missed} passed through, {strain}, {found.seconds:.2g} s a frame")
    check(results)
    path = folder / "hair_tubes.usdc"
    write(results, path)
    if draw:
        render_still(path, path.with_suffix(".jpg"), frame=min(14, SIZES[size].frames), size=(960, 400))


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
