"""Seconds a frame of two million grains on two soft bunnies of 201,000 tets, as in table 1 of Han et al. 2019.

    python tests/benchmarks/bunnies_cost.py [--threads N] [--frames N]

The shot is that of `examples/sand_on_bunnies`, with a lump of a million grains over the back of each bunny, so
that all of them are there from the start. Takes ten minutes and 1.8 GB.
"""

import argparse
import json
import runpy
import tempfile
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom

from plait.pipeline import config, driver

SHOT = runpy.run_path(str(Path(__file__).parents[2] / "examples/sand_on_bunnies/bunnies.py"))
EDGE, SPACING = 0.0084, 0.0011  # [m] of the tets and of the grains
LUMP, GAP, ASIDE = 0.11, 0.003, 0.03  # [m] a lump's side, how far over the back, and how far along it
SPEED = 1.0  # [m/s] down


def write(path: Path, frames: int) -> None:
    SHOT["write"](path, frames, EDGE, SPACING, poured=1.0)
    stage = Usd.Stage.Open(str(path))
    points, _ = SHOT["bunny"]()
    below = (np.abs(points[:, [0, 2]] - [ASIDE, 0.0]) < 0.5 * LUMP).all(axis=1)
    top = points[below, 1].max()
    for index, middle in enumerate(SHOT["middles"](len(SHOT["FRICTIONS"]))):
        lump = stage.GetPrimAtPath(f"/World/Sand{index}")
        for emitting in ("plait:rate", "plait:limit"):
            lump.RemoveProperty(emitting)
        place = UsdGeom.XformCommonAPI(lump)
        place.SetTranslate(Gf.Vec3d(middle + ASIDE, top + GAP + 0.5 * LUMP, 0.0))
        place.SetScale(Gf.Vec3f(0.5 * LUMP))
        lump.GetAttribute("plait:velocity").Set(Gf.Vec3f(0.0, -SPEED, 0.0))
    stage.Save()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--frames", type=int, default=2)
    options = parser.parse_args()
    settings = ["preroll=0", "solver.substeps=12", f"solver.threads={options.threads}"]
    with tempfile.TemporaryDirectory() as folder:
        shot, cache = Path(folder) / "shot.usda", Path(folder) / "cache.usda"
        write(shot, options.frames)
        driver.simulate(shot, cache, config.load(None, settings))
        metrics = json.loads(cache.with_suffix(".metrics.json").read_text())
    for frame in metrics["frames"]:
        if "granular" in frame:
            seconds = {name: round(spent, 1) for name, spent in frame["seconds"].items()}
            count, steps = frame["granular"]["particles"], frame["granular"]["steps"]
            print(
                f"frame {frame['code']:g}: {frame['wall_seconds']:.1f} s, {count} grains, {steps} steps, {seconds}"
            )
    print(f"{metrics['run']['peak_memory_bytes'] / 1e9:.1f} GB")


if __name__ == "__main__":
    main()
