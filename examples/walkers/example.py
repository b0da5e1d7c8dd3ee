"""Three people of different builds walk abreast: a USD shot in, a USD cache out, flesh that follows late.

`python example.py [small|default|full]` writes the shot, simulates it, checks it and draws it, all in `out/`.
"""

from __future__ import annotations

import runpy
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from pxr import Usd

from plait.assets.stages import frame_codes, pose_points, read_points, read_triangles
from plait.pipeline import config, driver
from plait.pipeline.preview import render_still
from plait.pipeline.tetrahedra.skin import Inside
from plait.pipeline.validate import validate

HERE = Path(__file__).parent
SHOT = runpy.run_path(str(HERE / "walkers.py"))


@dataclass(frozen=True)
class Size:
    """frames: simulated.  edge: [cm] of the tets.  builds: how many of the three walk, from the thinnest up."""

    frames: int
    edge: float
    builds: int


SIZES = {"small": Size(16, 6.0, 2), "default": Size(60, 5.0, 3), "full": Size(72, 2.4, 3)}


def run(folder: Path, size: Size) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "walkers_shot.usda", folder / "walkers.usda"
    SHOT["write"](shot, size.frames, size.edge, SHOT["BUILDS"][: size.builds])
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


@dataclass(frozen=True)
class Walker:
    """points, animated: (frame_count, point_count, 3) [cm], flesh and where the skeleton alone would put it."""

    name: str
    points: np.ndarray
    animated: np.ndarray
    triangles: np.ndarray

    @property
    def offset(self) -> np.ndarray:
        return self.points - self.animated

    @property
    def jiggle(self) -> float:
        """[cm] rms of what of the offset comes and goes."""
        return float(np.sqrt(np.square(self.offset - self.offset.mean(axis=0)).sum(axis=2).mean()))


def read(cache: Path) -> list[Walker]:
    """All that walk, from the thinnest up, where they are in the world."""
    stage = Usd.Stage.Open(str(cache))
    shot = Usd.Stage.Open(str(cache.with_name("walkers_shot.usda")))
    codes = frame_codes(stage)
    walkers = []
    for build in SHOT["BUILDS"]:
        path, place = f"/World/{build.name}", (SHOT["PLACES"][build.name], 0.0, 0.0)
        if stage.GetPrimAtPath(path):
            skin = stage.GetPrimAtPath(f"{path}/Skin")
            points, animated = read_points(skin, codes), pose_points(shot, path, codes)
            walkers.append(Walker(build.name, points + place, animated + place, read_triangles(skin)))
    return walkers


def overlap(frames: np.ndarray, triangles: np.ndarray, other: np.ndarray) -> float:
    """[cm] how deep points of the skin `other` get into the skin `frames`, each (frame_count, point_count, 3)."""
    return max(
        0.0, *(-Inside(mine, triangles).query(theirs)[0].min() for mine, theirs in zip(frames, other, strict=True))
    )


def lag(walker: Walker) -> int:
    """[frames] after the trunk's vertical acceleration, the opposite movement of its belly is strongest."""
    rest = walker.animated[0] - walker.animated[0].mean(axis=0)
    trunk = (np.abs(walker.animated[0, :, 1] - 103.0) < 6.0) & (np.abs(rest[:, 0]) < 6.0) & (rest[:, 2] > 0.0)
    push = -np.gradient(np.gradient(walker.animated[:, trunk, 1].mean(axis=1)))
    moved = walker.offset[:, trunk, 1].mean(axis=1)
    alike = [np.corrcoef(moved[k + 2 :], push[2 : len(push) - k])[0, 1] for k in range(6)]
    return int(np.argmax(alike))


def check(cache: Path) -> None:
    """What must be seen in the cache; AssertionError if it is not."""
    assert validate(cache) == []
    walkers = read(cache)
    for walker in walkers:
        assert np.isfinite(walker.points).all()
        # Flesh whips, but no point of it outruns the fastest part of the skeleton by more than half.
        speed, animated = (
            np.linalg.norm(np.diff(x, axis=0), axis=2).max() for x in (walker.points, walker.animated)
        )
        assert speed < 1.5 * animated, (walker.name, speed, animated)
    # Hands that the animation sends through each other touch, and give way.
    for one, other in pairwise(walkers):
        animated = overlap(one.animated, one.triangles, other.animated)
        deepest = overlap(one.points, one.triangles, other.points)
        print(f"{one.name}, {other.name}: overlap {deepest:.2f} cm, in the animation {animated:.2f} cm")
        assert deepest < 0.5 * animated
    # The heavier, the more of it jiggles ...
    jiggle = [walker.jiggle for walker in walkers]
    print("jiggle [cm]:", ", ".join(f"{walker.name} {walker.jiggle:.2f}" for walker in walkers))
    assert all(after > before for before, after in pairwise(jiggle)), jiggle
    # ... and late: flesh that went exactly with its bones would be in phase.
    if len(walkers[0].points) > 24:
        assert all(1 <= lag(walker) <= 5 for walker in walkers)


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, checks, draws."""
    cache = run(folder, SIZES[size])
    check(cache)
    if draw:
        render_still(cache, folder / "walkers.jpg", frame=min(SIZES[size].frames, 39), size=(800, 480))


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
