"""The shot: three people of different builds who walk abreast, near enough to touch. Centimetres, Y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from plait.assets import generate, mannequin
from plait.assets.mannequin import AVERAGE, HEAVY, THIN, Build
from plait.assets.stages import author_parameters

FIRST, RATE = 1.0, generate.RATE
SAMPLES_PER_FRAME = 2
# [cm] from one's middle to the next one's.
PLACES = {THIN.name: -69.3, AVERAGE.name: 0.0, HEAVY.name: 79.0}
# [Hz] at which flesh would swing about its animated place were it held there by nothing but its springs: fat lies
# looser than muscle.
HELD = {THIN.name: 5.0, AVERAGE.name: 4.0, HEAVY.name: 2.5}
DENSITY = 1e-3  # [kg/cm3]
# In kilograms, centimetres and seconds: 1e4 Pa, nearly incompressible.
TISSUE = {"youngsModulus": 100.0, "poissonsRatio": 0.45, "density": DENSITY, "stiffnessDamping": 0.005}
BUILDS = (THIN, AVERAGE, HEAVY)
STEPS = 5


def write(path: Path, frames: int, edge: float, builds: tuple[Build, ...] = BUILDS, steps: int = STEPS) -> None:
    """frames: how long it lasts.  edge: [cm] mean edge of the tets of their flesh."""
    last = FIRST + frames
    codes = np.arange(FIRST, last + 1e-6, 1.0 / SAMPLES_PER_FRAME)

    def author(stage: Usd.Stage) -> None:
        UsdGeom.Xform.Define(stage, generate.WORLD)
        generate.author_ground(stage)
        for build in builds:
            # Out of step, so that arms that swing meet.
            first = "Left" if build is AVERAGE else "Right"
            plan = mannequin.straight_walk(steps, fat=build.fat, first=first)
            place = generate.WORLD.AppendChild(build.name)
            skin = mannequin.author(stage, place, build, codes, plan, PLACES[build.name])
            held = DENSITY * (2.0 * np.pi * HELD[build.name]) ** 2
            author_parameters(skin.GetPrim(), {**TISSUE, "attachStiffness": held, "tetEdge": edge})

    generate.write(path, author, frames=(FIRST, last))
