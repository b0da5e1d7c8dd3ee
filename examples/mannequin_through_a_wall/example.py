"""Someone walks through a wall of soft planks: a USD shot in, a USD cache out.

`python example.py [small|default|full]` writes the shot, simulates it, checks it and draws it, all in `out/`.
"""

from __future__ import annotations

import json
import runpy
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd

from plait.assets.stages import frame_codes, pose_points, read_points
from plait.pipeline import config, driver
from plait.pipeline.preview import render_still
from plait.pipeline.validate import validate

HERE = Path(__file__).parent
SHOT = runpy.run_path(str(HERE / "wall.py"))
BODY = "/World/Mannequin"
GRAVITY = 981.0  # [cm/s2]


@dataclass(frozen=True)
class Size:
    """frames: simulated.  flesh, foam: [cm] edges of the tets.  rows: of planks, from the lowest up.
    distance: [cm] to the wall.  drawn: the frame in the picture."""

    frames: int
    flesh: float
    foam: float
    rows: tuple[int, ...]
    distance: float
    drawn: int


SIZES = {
    "small": Size(18, 6.0, 10.0, (2,), 28.0, 17),
    "default": Size(66, 5.0, 8.0, tuple(range(6)), 75.0, 33),
    "full": Size(96, 2.5, 3.0, tuple(range(6)), 75.0, 33),
}


def run(folder: Path, size: Size) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "wall_shot.usda", folder / "wall.usda"
    SHOT["write"](shot, size.frames, size.flesh, size.foam, size.rows, size.distance)
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


@dataclass(frozen=True)
class Shown:
    """Points (frame_count, point_count, 3) [cm]: the mannequin, where its skeleton alone puts it, the planks."""

    flesh: np.ndarray
    animated: np.ndarray
    planks: list[np.ndarray]

    @property
    def deviation(self) -> np.ndarray:
        """(frame_count,) [cm] the largest of the flesh from its animated place."""
        return np.linalg.norm(self.flesh - self.animated, axis=2).max(axis=1)


def read(cache: Path) -> Shown:
    stage = Usd.Stage.Open(str(cache))
    codes = frame_codes(stage)
    planks = [read_points(prim, codes) for prim in stage.GetPrimAtPath("/World/Wall").GetChildren()]
    shot = Usd.Stage.Open(str(cache.with_name("wall_shot.usda")))
    flesh = read_points(stage.GetPrimAtPath(f"{BODY}/Skin"), codes)
    return Shown(flesh, pose_points(shot, BODY, codes), planks)


def speed(points: np.ndarray) -> float:
    """[m/s] of the fastest point."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=2).max()) * SHOT["RATE"] / 100.0


def check(cache: Path, size: Size) -> None:
    """What must be seen in the cache; AssertionError if it is not."""
    assert validate(cache) == []
    shown = read(cache)
    frames = [frame["tets"] for frame in json.loads(cache.with_suffix(".metrics.json").read_text())["frames"]]
    overlap = 100.0 * max(frame["skin_overlap"] for frame in frames)
    opened = max(float(np.abs(plank[..., 2] - plank[0, :, 2]).max()) for plank in shown.planks)
    fastest = max(speed(plank) for plank in shown.planks)
    print(f"planks open by {opened:.0f} cm, at up to {fastest:.1f} m/s; overlap at most {overlap:.1f} cm")
    print(f"flesh off its pose by {shown.deviation.max():.1f} cm at most, {shown.deviation[-1]:.1f} cm in the end")
    # Nothing explodes: flesh is faster than the skeleton by half at most, planks by what a push gives them.
    assert speed(shown.flesh) < 1.5 * speed(shown.animated)
    assert fastest < 3.0 * speed(shown.animated)
    # No one goes through a plank: overlaps are shallow beside its thickness.
    assert overlap < 0.5 * SHOT["THICK"]
    assert opened > 10.0
    if size.frames < 60:
        return
    # In the end he has passed and stands: the wall has closed, and the flesh has its shape back, but for its
    # weight, which springs of angular frequency w give way to by g / w^2, and for what is left of the swing.
    sag = GRAVITY / (2.0 * np.pi * SHOT["FLESH_HELD"]) ** 2
    assert shown.deviation[-1] < 2.0 * sag < 0.6 * shown.deviation.max()
    assert max(float(np.abs(plank[-1, :, 2] - plank[0, :, 2]).max()) for plank in shown.planks) < 0.2 * opened
    assert frames[-1]["inverted"] == 0


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, checks, draws."""
    cache = run(folder, SIZES[size])
    check(cache, SIZES[size])
    if draw:
        render_still(cache, folder / "wall.jpg", frame=SIZES[size].drawn, size=(800, 560))


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
