"""A jelly bear is squeezed and let go, a hairy jelly ball is dropped: a USD shot in, a USD cache out.

`python example.py [small|default|full]` writes the shot, simulates it, checks it and draws it, all in `out/`.
"""

from __future__ import annotations

import runpy
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd

from plait.assets.jelly import off_shape
from plait.assets.stages import frame_codes, read_points, read_roots, read_triangles
from plait.pipeline import config, driver
from plait.pipeline.compare import strand_lengths
from plait.pipeline.preview import render
from plait.pipeline.tetrahedra.skin import Inside
from plait.pipeline.validate import validate

HERE = Path(__file__).parent
SHOT = runpy.run_path(str(HERE / "jelly.py"))
HAIR_RADIUS = 0.025  # [cm]
MICROMETRE = 1e-4  # [cm]


@dataclass(frozen=True)
class Size:
    """frames: simulated.  edge: [cm] of the tets.  hairs: on the ball."""

    frames: int
    edge: float
    hairs: int


SIZES = {"small": Size(12, 3.5, 40), "default": Size(66, 2.5, 200), "full": Size(90, 1.0, 1000)}
DRAWN = 24


def run(folder: Path, size: Size) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "jelly_shot.usda", folder / "jelly.usda"
    SHOT["write"](shot, size.frames, size.edge, size.hairs)
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


@dataclass(frozen=True)
class Shown:
    """Points (frame_count, point_count, 3) [cm], each prim in its own space, and triangles (triangle_count, 3).

    hair: (frame_count, strand_count, strand_point_count, 3) in the space of the ball.
    root_face, root_weights: where on the ball each strand grows.
    """

    bear: np.ndarray
    ball: np.ndarray
    hair: np.ndarray
    ball_triangles: np.ndarray
    root_face: np.ndarray
    root_weights: np.ndarray


def read(cache: Path) -> Shown:
    stage = Usd.Stage.Open(str(cache))
    codes = frame_codes(stage)
    bear, ball, hair = (stage.GetPrimAtPath(f"/World/{name}") for name in ("Bear", "Ball", "Hair"))
    root_face, root_weights = read_roots(hair)
    return Shown(
        read_points(bear, codes),
        read_points(ball, codes),
        read_points(hair, codes).reshape(len(codes), len(root_face), SHOT["POINTS"], 3),
        read_triangles(ball),
        root_face,
        root_weights,
    )


def check(cache: Path, size: Size) -> None:
    """What must be seen in the cache; AssertionError if it is not."""
    assert validate(cache) == []
    shown = read(cache)
    check_ball(shown)
    check_bear(shown, size)


def check_ball(shown: Shown) -> None:
    """The ball gives way where it lands; its hair goes with its skin, stays outside and is not stretched."""
    height = np.ptp(shown.ball[..., 1], axis=1)
    assert height.min() < 0.9 * height[0]
    corners = shown.ball[:, shown.ball_triangles[shown.root_face]]
    grown = np.einsum("hk,fhkd->fhd", shown.root_weights, corners)
    assert np.abs(shown.hair[:, :, 0] - grown).max() < MICROMETRE
    counts = (shown.hair.shape[2],) * shown.hair.shape[1]
    length = strand_lengths(shown.hair[0].reshape(-1, 3), counts)
    for ball, hair in zip(shown.ball, shown.hair, strict=True):
        assert np.abs(strand_lengths(hair.reshape(-1, 3), counts) / length - 1.0).max() < 0.01
        distance, _ = Inside(ball, shown.ball_triangles).query(hair[:, 1:].reshape(-1, 3))
        assert distance.min() > -HAIR_RADIUS


def check_bear(shown: Shown, size: Size) -> None:
    """The bear stays between the plates, which nearly halve it, and above the floor, and has its shape back."""
    width = np.abs(shown.bear[..., 0]).max(axis=1)
    times = np.arange(len(width)) / SHOT["RATE"]
    plates = np.array([SHOT["plate_face"](time) for time in times])
    # Overlaps: half an edge while things are hit, a tenth of one where they rest.
    beyond = np.maximum(width - plates, -shown.bear[..., 1].min(axis=1))
    print(f"bear: beyond plates and floor by {beyond.max():.2f} cm at most, {beyond[-1]:.2f} cm in the end")
    assert beyond.max() < 0.5 * size.edge
    if times[-1] < SHOT["OPENING"][1]:
        return
    left = [off_shape(shown.bear[0], points) for points in shown.bear]
    print(f"bear: off its shape by {max(left):.2f} of its size while squeezed, by {left[-1]:.3f} in the end")
    assert max(left) > 0.15 and left[-1] < 0.05
    assert beyond[-1] < 0.1 * size.edge


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, checks, draws."""
    cache = run(folder, SIZES[size])
    check(cache, SIZES[size])
    if draw:
        frame = str(min(DRAWN, SIZES[size].frames))
        render(cache, folder / "jelly.jpg", frames=frame, size="800x420", camera="/World/Camera")


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
