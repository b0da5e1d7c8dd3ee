"""The small shot against its reference cache, as `plait sim` and `plait compare` see them.

Tolerance: machines differ by rounding (libm, fused multiply-add), float32 at the coarsest: 4e-8 m in a skinned
point of this shot. The motion magnifies what its input is off by some tens of times, which
`test_rounding_of_the_input_stays_below` watches, so 1e-6 m is what to expect, and 1e-4 of a strand's length leaves
room. A change of the physics is far above: see `test_a_change_is_seen`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from plait.assets.small_scene import FOLDER, REFERENCE, SETTINGS, SHOT, write
from plait.pipeline.compare import compare

from .small_shots import assert_valid, largest, nudged, simulated

TOLERANCE = 1e-4 * 0.26  # [m]
HAIR = "/World/Hair"


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    return simulated(FOLDER / SHOT, tmp_path_factory.mktemp("small") / "out.usda", *SETTINGS)


def test_the_generator_writes_the_shot_that_ships(tmp_path):
    assert write(tmp_path).read_bytes() == (FOLDER / SHOT).read_bytes()


def test_same_as_the_reference(result):
    """`python -m plait.assets.small_scene --reference` makes it anew after an intended change."""
    comparison = compare(FOLDER / REFERENCE, result, TOLERANCE)
    assert comparison.ok, comparison.lines()


def test_shot_and_result_are_valid(result):
    assert_valid(FOLDER / SHOT, result, FOLDER / REFERENCE)


def test_the_strands_touch_the_ball(result):
    """Else the reference would not watch contact: points come within twice their radius, 1 mm, of the ball."""
    stage = Usd.Stage.Open(str(result))
    ball = UsdGeom.Sphere(stage.GetPrimAtPath("/World/Ball"))
    hair = UsdGeom.BasisCurves(stage.GetPrimAtPath(HAIR))
    touching = 0
    for code in range(1, 25):
        centre = UsdGeom.XformCache(code).GetLocalToWorldTransform(ball.GetPrim()).ExtractTranslation()
        distance = np.linalg.norm(np.array(hair.GetPointsAttr().Get(code)) - np.array(centre), axis=1)
        touching += int(np.sum(distance - ball.GetRadiusAttr().Get() < 0.1))
    assert touching > 10


@pytest.mark.parametrize("change", ["parameters.damping=2.1", "parameters.friction=0.33", "solver.substeps=9"])
def test_a_change_is_seen(result, tmp_path, change):
    """So that the comparison can fail: five or ten percent of one parameter, one substep more."""
    new = simulated(FOLDER / SHOT, tmp_path / "out.usda", *SETTINGS, change)
    assert largest(compare(result, new, TOLERANCE), HAIR) > 10.0 * TOLERANCE


def test_rounding_of_the_input_stays_below(result, tmp_path):
    """Every point of the drawn hair moved by a rounding of float32: a tenth of the tolerance at most."""
    new = simulated(nudged(FOLDER / SHOT, tmp_path / SHOT, HAIR), tmp_path / "out.usda", *SETTINGS)
    assert 0.0 < largest(compare(result, new, TOLERANCE), HAIR) < 0.1 * TOLERANCE
