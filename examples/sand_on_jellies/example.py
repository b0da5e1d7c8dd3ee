"""Sand of three colours is poured on three jellies of different stiffness: a USD shot in, a USD cache out.

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
SHOT = runpy.run_path(str(HERE / "table.py"))
GRAVITY = 9.81


@dataclass(frozen=True)
class Size:
    """frames: simulated.  moduli: [Pa] Young's, of the jellies, the softest first.  edge: [m] of their tets.
    spacing: [m] of the grains.  layer: [s] how long each colour is poured.  drawn: the frame of the picture."""

    frames: int
    moduli: tuple[float, ...]
    edge: float
    spacing: float
    layer: float
    drawn: int

    @property
    def at_rest(self) -> bool:
        """Whether it goes on long enough after the last grain, for a second, to be looked at as lying still."""
        return self.frames / SHOT["RATE"] > 3.0 * self.layer + 1.0


MODULI = SHOT["YOUNGS_MODULI"]
SIZES = {
    "small": Size(7, MODULI[::2], 0.034, 0.009, 0.08, 7),
    "default": Size(54, MODULI, 0.018, 0.006, 0.4, 26),
    "full": Size(54, MODULI, 0.012, 0.003, 0.4, 26),
}


@dataclass(frozen=True)
class Jelly:
    """One of them in the last frame, in its own space [m].

    drawn, points: (point_count, 3) at first and now; triangles: (triangle_count, 3).
    grains: (grain_count, 3) poured on it, of all colours.
    """

    drawn: np.ndarray
    points: np.ndarray
    triangles: np.ndarray
    grains: np.ndarray

    @property
    def lowered(self) -> float:
        """[m] how far its highest point has come down."""
        return float(self.drawn[:, 1].max() - self.points[:, 1].max())

    @property
    def kept(self) -> float:
        """Its volume, over that as drawn."""
        return volume(self.points, self.triangles) / volume(self.drawn, self.triangles)

    def lying(self) -> np.ndarray:
        """(grain_count,) bool: which grains have it below them."""
        down = np.tile([0.0, -1.0, 0.0], (len(self.grains), 1))
        return Inside(self.points, self.triangles).first_hit(self.grains, down)[0] >= 0

    @property
    def held(self) -> float:
        """The part of its grains that have it below them."""
        return float(self.lying().mean())

    def depths(self) -> np.ndarray:
        """(grain_count,) [m] of grains within it; below 0 outside."""
        return -Inside(self.points, self.triangles).query(self.grains)[0]


def run(folder: Path, size: Size) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "jellies_shot.usda", folder / "jellies.usda"
    shot.unlink(missing_ok=True)
    SHOT["write"](shot, size.frames, size.moduli, size.edge, size.spacing, size.layer)
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


def read(cache: Path) -> list[Jelly]:
    """All of them, from the left."""
    stage = Usd.Stage.Open(str(cache))
    first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    shown = []
    while mesh := stage.GetPrimAtPath(f"/World/Jelly{len(shown)}"):
        place = np.array(UsdGeom.Xformable(mesh).ComputeLocalToWorldTransform(last).ExtractTranslation())
        poured = [stage.GetPrimAtPath(f"/World/{name}{len(shown)}_grains") for name in SHOT["SANDS"]]
        grains = np.concatenate([read_points(prim, [last])[0] for prim in poured]) - place
        shown.append(Jelly(*read_points(mesh, (first, last)), read_triangles(mesh), grains))
    return shown


def volume(points: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.einsum("na,na->", a, np.cross(b, c)) / 6.0)


def check(cache: Path, size: Size) -> None:
    """What must be seen in the cache; AssertionError if it is not."""
    assert validate(cache) == []
    shown = read(cache)
    for jelly, modulus in zip(shown, size.moduli, strict=True):
        check_jelly(jelly, modulus, size)
    # The softer, the further it gives way, and the more its dish holds of what slides off a dome.
    lowered, held = ([getattr(jelly, name) for jelly in shown] for name in ("lowered", "held"))
    assert lowered == sorted(lowered, reverse=True) and lowered[-1] > 0.0
    assert not size.at_rest or held == sorted(held, reverse=True)


def check_jelly(jelly: Jelly, modulus: float, size: Size) -> None:
    """Sand lies on it and not in it, and it has lost no more of its volume than its bulk modulus allows."""
    deepest, quarter = float(jelly.depths().max()), 0.5 * size.spacing  # of a cell, two spacings
    held, count = 100.0 * jelly.held, len(jelly.grains)
    print(f"{modulus:.0f} Pa: {1e3 * jelly.lowered:.1f} mm lower, {100.0 * (1.0 - jelly.kept):.2f} % smaller")
    print(f"    {held:.1f} % of {count} grains on it, the deepest {1e3 * deepest:.1f} mm in it")
    assert jelly.held > 0.0
    assert deepest < quarter
    if size.at_rest:
        loss, allowed = 1.0 - jelly.kept, largest_loss(jelly, modulus, size)
        print(f"    of its volume {100.0 * allowed:.2f} % may be lost")
        assert 0.0 < loss < allowed


def largest_loss(jelly: Jelly, modulus: float, size: Size) -> float:
    """The part of its volume that a body at rest loses at most to what acts on it, in linear elasticity.

    Its mean stress is the mean of all forces times where they act, over its volume, and the trace of that over
    three times the bulk modulus E / (3 (1 - 2 nu)) is the loss. There act: its own weight; that of the sand on
    it; the floor's friction, at most its coefficient of both, by the radius; and sand beside it, which before it
    gives way presses sideways with tan^2(45 deg + phi / 2) times the weight above (Rankine 1857, passive) at most.
    """
    passive = float(np.tan(np.pi / 4.0 + 0.5 * np.radians(SHOT["FRICTION_ANGLE"])) ** 2)
    sand, radius = GRAVITY * SHOT["SAND_DENSITY"], float(np.hypot(*jelly.points[:, ::2].T).max())
    whole, height = volume(jelly.drawn, jelly.triangles), float(jelly.points[:, 1].max())
    own = GRAVITY * SHOT["JELLY_DENSITY"] * whole
    load = sand * size.spacing**3 * float(jelly.lying().sum())
    beside = float(jelly.grains[~jelly.lying(), 1].max())
    moments = load * height + own * 0.5 * height + passive * np.pi * sand * (radius * beside) ** 2
    moments += SHOT["FLOOR_FRICTION"] * (load + own) * radius
    return (1.0 - 2.0 * SHOT["POISSONS_RATIO"]) * moments / (modulus * whole)


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, checks, draws."""
    cache = run(folder, SIZES[size])
    check(cache, SIZES[size])
    if draw:
        frame = str(SIZES[size].drawn)
        render(cache, folder / "sand_on_jellies.jpg", frames=frame, size="960x420", camera="/World/Camera")


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
