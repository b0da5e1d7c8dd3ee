"""The heavy elastica through the command line: a shot in, backward Euler to rest, the drop read from the cache."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from plait.pipeline.cli import main
from plait.pipeline.errors import EXIT_DONE

SEGMENTS, LENGTH = 100, 2.0  # [m]
DENSITY, THICKNESS = 1000.0, 0.004  # [kg/m3], [m]
GRAVITY = 9.81
TOLERANCE = 3e-4  # of the drop: the discretisation's own error at 100 segments, second order


def write_shot(path: Path, gamma: float) -> None:
    """A level rod clamped at its root; Gamma = rho A g L^3 / EI. Steps are long, so that Euler goes to rest."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(0.01)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(2)
    UsdPhysics.Scene.Define(stage, "/Physics").CreateGravityMagnitudeAttr(GRAVITY)
    rod = UsdGeom.BasisCurves.Define(stage, "/Rod")
    stage.SetDefaultPrim(rod.GetPrim())
    rod.CreateTypeAttr(UsdGeom.Tokens.linear)
    rod.CreateCurveVertexCountsAttr([SEGMENTS + 1])
    rod.CreatePointsAttr([Gf.Vec3f(x, 0, 0) for x in np.linspace(0.0, LENGTH, SEGMENTS + 1)])
    line_weight = DENSITY * np.pi * THICKNESS**2 / 4.0 * GRAVITY
    parameters = {
        "thickness": THICKNESS,
        "density": DENSITY,
        "bendStiffness": line_weight * LENGTH**3 / gamma,
        "stretchStiffness": 1e6 * line_weight * LENGTH,
    }
    for name, value in parameters.items():
        rod.GetPrim().CreateAttribute(f"plait:{name}", Sdf.ValueTypeNames.Double).Set(value)
    rod.GetPrim().CreateAttribute("plait:restShape", Sdf.ValueTypeNames.Token).Set("authored")
    stage.Save()


@pytest.mark.parametrize("gamma", [1.0, 10.0, 100.0, 1000.0])
def test_drop_of_a_cantilever_under_its_own_weight(shared, tmp_path, gamma):
    """Drop over length of `references/heavy_elastica_cantilever.csv`, within 3e-4 of it."""
    with open(shared / "references" / "heavy_elastica_cantilever.csv", newline="") as file:
        drop = {float(row[0]): float(row[1]) for row in list(csv.reader(file))[1:]}[gamma]
    shot, output = tmp_path / "shot.usda", tmp_path / "out.usda"
    write_shot(shot, gamma)
    settings = ["--set", "solver.strands.tolerance=1e-7", "--preroll", "20", "--substeps", "4"]
    assert main(["sim", str(shot), "-o", str(output), "--progress", "none", *settings]) == EXIT_DONE
    stage = Usd.Stage.Open(str(output))
    points = np.array(stage.GetPrimAtPath("/Rod").GetAttribute("points").Get(2))
    assert abs(-points[-1, 2] / LENGTH / drop - 1.0) < TOLERANCE
