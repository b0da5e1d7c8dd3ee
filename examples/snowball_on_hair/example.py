"""A snowball lands in a ball of hair, which shakes it off in pieces: a USD shot in, a USD cache out.

`python example.py [small|default|full]` writes the shot, simulates it, checks it and draws it, all in `out/`.
"""

from __future__ import annotations

import runpy
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from plait.assets.stages import frame_codes, read_points
from plait.pipeline import config, driver
from plait.pipeline.compare import strand_lengths
from plait.pipeline.preview import render
from plait.pipeline.validate import validate

HERE = Path(__file__).parent
GRAVITY = 9.81
SHOT = runpy.run_path(str(HERE / "ball.py"))


@dataclass(frozen=True)
class Size:
    """frames: simulated.  hairs, segments: of each.  spacing: [m] of the grains.  drawn: frame of the picture."""

    frames: int
    hairs: int
    segments: int
    spacing: float
    drawn: int

    @property
    def shaken(self) -> bool:
        """Whether it goes on until the ball has shaken."""
        return self.frames / SHOT["RATE"] > SHOT["SHAKEN"] + 0.2

    @property
    def landed(self) -> int:
        """The last frame before the ball shakes."""
        return int(min(SHOT["SHAKE"] * SHOT["RATE"], self.frames))


SIZES = {
    "small": Size(6, 60, 6, 0.012, 6),
    "default": Size(36, 700, 10, 0.006, 19),
    "full": Size(36, 20000, 20, 0.003, 19),
}


@dataclass(frozen=True)
class Shown:
    """In the ball's own space [m]. hair: (frame_count, strand_count, point_count, 3).
    speeds: (frame_count, strand_count) [m/s] root mean square over its points.
    snow: of each frame (grain_count, 3)."""

    hair: np.ndarray
    speeds: np.ndarray
    snow: list[np.ndarray]


def run(folder: Path, size: Size) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "snowball_shot.usda", folder / "snowball.usda"
    shot.unlink(missing_ok=True)
    SHOT["write"](shot, size.frames, size.hairs, size.segments, size.spacing)
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


def read(cache: Path, size: Size) -> Shown:
    stage = Usd.Stage.Open(str(cache))
    codes = frame_codes(stage)
    prim = stage.GetPrimAtPath("/World/Head/Hair")
    hair, velocities = read_points(prim, codes), UsdGeom.PointBased(prim).GetVelocitiesAttr()
    squares = np.array([(np.array(velocities.Get(code)) ** 2).sum(axis=1) for code in codes])
    speeds = np.sqrt(squares.reshape(len(codes), -1, size.segments + 1).mean(axis=2))
    grains = UsdGeom.Points(stage.GetPrimAtPath("/World/Snowball_grains")).GetPointsAttr()
    snow = []
    for code in codes:
        back = np.linalg.inv(SHOT["moved"](code / SHOT["RATE"]))
        snow.append(np.array(grains.Get(code), dtype=float) @ back[:3, :3].T + back[:3, 3])
    return Shown(hair.reshape(len(codes), -1, size.segments + 1, 3), speeds, snow)


def check(cache: Path, size: Size) -> None:
    """What must be seen in the cache; AssertionError if it is not."""
    assert validate(cache) == []
    shown = read(cache, size)
    check_hair(shown, size)
    check_snow(shown, size)


def check_hair(shown: Shown, size: Size) -> None:
    """It stays on its roots, is not stretched, is pushed aside where the snow hits, and comes back."""
    counts = (shown.hair.shape[2],) * shown.hair.shape[1]
    length = strand_lengths(shown.hair[0].reshape(-1, 3), counts)
    strains = [np.abs(strand_lengths(hair.reshape(-1, 3), counts) / length - 1.0).max() for hair in shown.hair]
    leaning, (hit, far) = leanings(shown.hair), struck(shown.hair[0, :, 0])
    before = slice(size.landed + 1)  # what leans later may have been shaken
    aside, fastest = leaning[before, hit].max(), shown.speeds[before].max()
    print(f"hair: stretched by {100.0 * max(strains):.2f} % at most, pushed aside by up to {aside:.0f} degrees")
    print(f"    at up to {fastest:.1f} m/s; {leaning[-1].mean():.1f} degrees aside in the end")
    assert max(strains) < 0.03
    assert np.abs(shown.hair[:, :, 0] - shown.hair[0, :, 0]).max() < 1e-5
    assert aside > 30.0 and leaning[before, far].max() < 1.0
    # What hits a hair gives it no more than its own speed, and a tip that whips has its energy from the rest.
    assert fastest**2 < np.square(SHOT["VELOCITY"]).sum() + 2.0 * GRAVITY * SHOT["START"][1]
    assert leaning[-1].mean() < 0.25 * leaning.mean(axis=1).max() or not size.shaken


def leanings(hair: np.ndarray) -> np.ndarray:
    """(frame_count, strand_count) [degrees] between the way from root to tip and how that was at first."""
    along = hair[:, :, -1] - hair[:, :, 0]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    return np.degrees(np.arccos(np.clip(np.einsum("fsd,sd->fs", along, along[0]), -1.0, 1.0)))


def struck(roots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(strand_count,) bool each: which hairs are in the snowball's way, and which grow on the half turned away."""
    way = np.array(SHOT["VELOCITY"]) / np.linalg.norm(SHOT["VELOCITY"])
    off = np.linalg.norm(np.cross(roots - SHOT["START"], way), axis=1)
    return (roots @ way < 0.0) & (off < SHOT["SNOWBALL"]), roots @ way > 0.0


def check_snow(shown: Shown, size: Size) -> None:
    """The ball of snow is flattened where it lands, goes nowhere into the other, and is shaken off in pieces."""
    spread = [float(np.linalg.norm(snow - np.median(snow, axis=0), axis=1).max()) for snow in shown.snow]
    depth = SHOT["RADIUS"] - min(np.linalg.norm(snow, axis=1).min() for snow in shown.snow)
    stays = [float((np.linalg.norm(snow, axis=1) < SHOT["RADIUS"] + SHOT["HAIR"]).mean()) for snow in shown.snow]
    print(f"snow: {1e2 * spread[0]:.1f} cm to its farthest grain at first, {1e2 * max(spread):.0f} cm at most")
    print(
        f"    {1e3 * depth:.1f} mm in the ball at most, {100 * max(stays):.0f} % on it and {100 * stays[-1]:.0f} %"
    )
    assert depth < size.spacing  # half a cell
    assert spread[size.landed] > 1.1 * spread[0]  # flat where it was a ball
    assert stays[size.landed] > 0.5
    if size.shaken:
        assert stays[-1] < 0.1 and spread[-1] > 5.0 * spread[0]


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, checks, draws."""
    cache = run(folder, SIZES[size])
    check(cache, SIZES[size])
    if draw:
        frame = str(SIZES[size].drawn)
        render(cache, folder / "snowball_on_hair.jpg", frames=frame, size="800x420", camera="/World/Camera")


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
