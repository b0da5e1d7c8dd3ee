"""Fur on an arm that is flung about: a USD shot in, a USD cache out, settings from a file.

`python example.py` writes the shot, simulates it, checks the cache and draws it, all in `out/`.
"""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from plait.assets.stages import pose_points, read_roots, read_triangles
from plait.pipeline import config, driver
from plait.pipeline.compare import strand_lengths
from plait.pipeline.preview import render_still
from plait.pipeline.read.closest import closest_on_triangles
from plait.pipeline.validate import validate

HERE = Path(__file__).parent
ARM = runpy.run_path(str(HERE / "arm.py"))
FRAMES, HAIRS, POINTS, HAIR = ARM["FRAMES"], ARM["HAIRS"], ARM["POINTS"], ARM["HAIR"]
FUR_RADIUS = 5e-5  # [m]
LOOKED_INTO = (4, 7, 10, 13, 16, 60)  # frames at which no point may be inside the skin


def run(folder: Path) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "arm.usda", folder / "fur.usda"
    ARM["write"](shot)
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


def check(cache: Path) -> None:
    """What must be seen in the cache; AssertionError if it is not."""
    assert validate(cache) == []
    stage = Usd.Stage.Open(str(cache))
    fur = UsdGeom.BasisCurves(stage.GetPrimAtPath("/World/Fur"))
    drawn = np.array(fur.GetPointsAttr().Get(1)).reshape(HAIRS, POINTS, 3)
    counts = (POINTS,) * HAIRS
    length = strand_lengths(drawn.reshape(-1, 3), counts)
    skin = pose_points(stage, "/World/Arm", range(1, FRAMES + 1))
    triangles = read_triangles(stage.GetPrimAtPath("/World/Arm/Skin"))
    root_face, weights = read_roots(fur.GetPrim())
    lag = 0.0
    for code in range(1, FRAMES + 1):
        points = np.array(fur.GetPointsAttr().Get(code), float)
        hairs, placed = points.reshape(HAIRS, POINTS, 3), skin[code - 1]
        corners = placed[triangles]
        # Roots sit where the skin carries them, to the rounding of float32 in either file.
        grown = np.einsum("hk,hkd->hd", weights, corners[root_face])
        assert np.abs(hairs[:, 0] - grown).max() < 1e-6
        assert np.abs(strand_lengths(points, counts) / length - 1.0).max() < 0.01
        if code in LOOKED_INTO:
            assert _height(points, placed, triangles).reshape(HAIRS, POINTS)[:, 1:].min() > -FUR_RADIUS
        moved = np.linalg.norm(hairs[:, -1] - hairs[:, 0] - (drawn[:, -1] - drawn[:, 0]), axis=1)
        lag = max(lag, float(moved.max()))
    # The fling is felt, and when it is over the fur lies as it was drawn: it is at rest under gravity that way.
    assert lag > 0.5 * HAIR
    assert moved.max() < 0.02 * HAIR


def _height(points: np.ndarray, skin: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) [m] of points over the triangle closest to them; negative inside."""
    triangle, place, _ = closest_on_triangles(points, skin, triangles)
    corners = skin[triangles[triangle]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    offset = points - np.einsum("pk,pkd->pd", place, corners)
    return np.sum(offset * normal, axis=1) / np.linalg.norm(normal, axis=1)


def main(folder: Path, draw: bool = True) -> None:
    """Runs, checks, draws."""
    cache = run(folder)
    check(cache)
    if draw:
        render_still(cache, folder / "fur_on_a_moving_arm.jpg", frame=11, size=(640, 480))


if __name__ == "__main__":
    main(Path("out"))
