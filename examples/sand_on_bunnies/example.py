"""Sand slides off a slippery bunny and lies on a rough one, and sticks in plain MPM: a USD shot in, a cache out.

`python example.py [small|default|full]` writes the shot, simulates it, checks it and draws it, all in `out/`.
"""

from __future__ import annotations

import runpy
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from plait.assets.stages import read_points, read_triangles
from plait.pipeline import config, driver
from plait.pipeline.preview import render
from plait.pipeline.tetrahedra.skin import Inside
from plait.pipeline.validate import validate

HERE = Path(__file__).parent
SHOT = runpy.run_path(str(HERE / "bunnies.py"))


@dataclass(frozen=True)
class Size:
    """frames: simulated.  edge: [m] of the tets.  spacing: [m] of the grains.  poured: [s] sand runs.
    compared: with plain MPM.  drawn: the frame of the picture."""

    frames: int
    edge: float
    spacing: float
    poured: float
    compared: bool
    drawn: int


SIZES = {
    "small": Size(5, 0.05, 0.014, 0.08, False, 5),
    "default": Size(48, 0.02, 0.006, 0.6, True, 24),
    "full": Size(48, 0.005, 0.0011, 0.6, False, 24),
}


@dataclass(frozen=True)
class Bunny:
    """One of them in the last frame, in its own space [m]. drawn, points: (point_count, 3) at first and now.
    triangles: (triangle_count, 3).  grains: (grain_count, 3) poured on it."""

    drawn: np.ndarray
    points: np.ndarray
    triangles: np.ndarray
    grains: np.ndarray

    @property
    def held(self) -> float:
        """The part of its grains that have it below them."""
        down = np.tile([0.0, -1.0, 0.0], (len(self.grains), 1))
        return float((Inside(self.points, self.triangles).first_hit(self.grains, down)[0] >= 0).mean())

    @property
    def deepest(self) -> float:
        """[m] how far a grain is within it; below 0 where none is."""
        return float(-Inside(self.points, self.triangles).query(self.grains)[0].min())


def run(folder: Path, size: Size) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "bunnies_shot.usda", folder / "bunnies.usda"
    shot.unlink(missing_ok=True)
    SHOT["write"](shot, size.frames, size.edge, size.spacing, size.poured)
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


def read(cache: Path) -> list[Bunny]:
    """All of them, from the left."""
    stage = Usd.Stage.Open(str(cache))
    first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    shown = []
    for index in range(len(SHOT["FRICTIONS"])):
        mesh = stage.GetPrimAtPath(f"/World/Bunny{index}")
        place = np.array(UsdGeom.Xformable(mesh).ComputeLocalToWorldTransform(last).ExtractTranslation())
        grains = read_points(stage.GetPrimAtPath(f"/World/Sand{index}_grains"), [last])[0] - place
        shown.append(Bunny(*read_points(mesh, (first, last)), read_triangles(mesh), grains))
    return shown


def check(cache: Path, size: Size) -> None:
    """What must be seen in the cache; AssertionError if it is not."""
    assert validate(cache) == []
    slippery, rough = read(cache)
    for bunny, friction in zip((slippery, rough), SHOT["FRICTIONS"], strict=True):
        given, deepest = f"{100.0 * bunny.held:.0f} % of {len(bunny.grains)} grains", 1e3 * bunny.deepest
        print(f"friction {friction}: {given} lie on it, the deepest {deepest:.1f} mm in it")
        assert bunny.deepest < 0.5 * size.spacing  # a quarter of a cell
        assert np.abs(bunny.points - bunny.drawn).max() < 0.2 * SHOT["LENGTH"]
    assert rough.held > 0.0
    if not size.compared:
        return
    assert slippery.held < 0.5 * rough.held
    stuck = runpy.run_path(str(HERE / "plain_mpm.py"))["share_left"](size.frames, size.spacing, size.poured)
    print(f"plain MPM: {100.0 * stuck:.0f} % lie on it, whatever its friction")
    assert stuck > 1.2 * slippery.held


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, checks, draws."""
    cache = run(folder, SIZES[size])
    check(cache, SIZES[size])
    if draw:
        frame = str(SIZES[size].drawn)
        render(cache, folder / "sand_on_bunnies.jpg", frames=frame, size="900x420", camera="/World/Camera")


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
