"""Sand and jelly bears are poured into a narrow cabinet and turn its pinwheels: a USD shot in, a USD cache out.

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
from plait.pipeline.preview import render
from plait.pipeline.tetrahedra.skin import Inside
from plait.pipeline.validate import validate

HERE = Path(__file__).parent
SHOT = runpy.run_path(str(HERE / "cabinet.py"))


@dataclass(frozen=True)
class Size:
    """frames: simulated.  wheels, bears: how many.  spacing: [m] of the grains.  poured: [s] how long sand runs.
    drawn: the frame of the picture."""

    frames: int
    wheels: int
    bears: int
    spacing: float
    poured: float
    drawn: int


SIZES = {
    "small": Size(16, 1, 0, 0.009, 1.0, 16),
    "default": Size(60, 3, 3, 0.006, 1.8, 18),
    "full": Size(60, 3, 3, 0.003, 1.8, 18),
}


@dataclass(frozen=True)
class Shown:
    """wheels: (frame_count, wheel_count, 4, 4), column vectors, of each wheel's own space to world [m].
    grains: of each frame, (grain_count, 3) [m].  bears: of each, (frame_count, point_count, 3) [m]."""

    wheels: np.ndarray
    grains: list[np.ndarray]
    bears: list[np.ndarray]

    @property
    def turned(self) -> np.ndarray:
        """(frame_count, wheel_count) [rad] counter-clockwise since the first frame."""
        angle = np.unwrap(np.arctan2(self.wheels[..., 1, 0], self.wheels[..., 0, 0]), axis=0)
        return angle - angle[0]


def run(folder: Path, size: Size) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "pinwheels_shot.usda", folder / "pinwheels.usda"
    shot.unlink(missing_ok=True)
    SHOT["write"](shot, size.frames, size.wheels, size.bears, size.spacing, size.poured)
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


def read(cache: Path) -> Shown:
    stage = Usd.Stage.Open(str(cache))
    codes, prims = frame_codes(stage), stage.GetPrimAtPath("/World").GetChildren()
    wheels, bears = ([p for p in prims if p.GetName().startswith(name)] for name in ("Wheel", "Bear"))
    places = [[UsdGeom.Xformable(p).ComputeLocalToWorldTransform(code) for p in wheels] for code in codes]
    starts = [np.array(UsdGeom.Xformable(p).ComputeLocalToWorldTransform(0.0).ExtractTranslation()) for p in bears]
    points = stage.GetPrimAtPath("/World/Sand_grains").GetAttribute("points")
    return Shown(
        np.swapaxes(np.array(places, dtype=float), -1, -2),
        [np.array(points.Get(code), dtype=float).reshape(-1, 3) for code in codes],
        [read_points(bear, codes) + start for bear, start in zip(bears, starts, strict=True)],
    )


def check(cache: Path, size: Size) -> None:
    """What must be seen in the cache; AssertionError if it is not."""
    assert validate(cache) == []
    shown = read(cache)
    check_wheels(shown)
    cell = 2.0 * size.spacing
    check_clear(shown, "grains", shown.grains, cell)
    for bear in shown.bears:
        check_clear(shown, "a bear", list(bear), 0.5 * SHOT["BEAR_EDGE"])


def check_wheels(shown: Shown) -> None:
    """Each goes round, on its axis and no other way, and in the sense that the side which sand falls on says.

    A heap that lies on a blade, and slides off no more, ends below the axis: so many blades as are passed in that
    half turn are the least that shows one blade after the other was driven.
    """
    count = shown.wheels.shape[1]
    turned = shown.turned[-1] * SHOT["senses"](count)
    off = np.linalg.norm(shown.wheels[..., :3, 3] - SHOT["axes"](count), axis=-1).max()
    lean = np.abs(shown.wheels[..., :3, 2] - [0.0, 0.0, 1.0]).max()
    print(f"wheels: turned by {np.round(turned, 1)} rad, off their axes by {off:.1g} m, which lean by {lean:.1g}")
    assert (turned > np.pi).all()
    assert max(off / SHOT["RADIUS"], lean) < 1e-3


def check_clear(shown: Shown, name: str, frames: list[np.ndarray], allowed: float) -> None:
    """Of points (n, 3) by frame, none is deeper in the walls or in a wheel than `allowed` [m].

    Of grains a cell of their grid, two spacings; of bears, as long as they are hit, half an edge of a tet.
    """
    points = np.concatenate(frames)
    out = np.maximum(np.abs(points[:, ::2]) - [SHOT["HALF_WIDTH"], SHOT["HALF_DEPTH"]], -points[:, 1:2]).max()
    solid, deepest = Inside(*SHOT["wheel"]()), 0.0
    for places, now in zip(shown.wheels, frames, strict=True):
        for place in places:
            local = (now - place[:3, 3]) @ place[:3, :3]
            near = local[np.hypot(local[:, 0], local[:, 1]) < 1.1 * SHOT["RADIUS"]]
            if len(near):
                deepest = max(deepest, -float(solid.query(near)[0].min()))
    print(f"{name}: {len(frames[-1])} points, by {1e3 * out:.1f} mm in walls, {1e3 * deepest:.1f} mm in wheels")
    assert out < allowed and deepest < allowed


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, checks, draws."""
    cache = run(folder, SIZES[size])
    check(cache, SIZES[size])
    if draw:
        frame = str(SIZES[size].drawn)
        render(cache, folder / "pinwheels.jpg", frames=frame, size="640x800", camera="/World/Camera")


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
