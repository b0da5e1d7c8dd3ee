"""The small shot of flesh against its reference cache, as `plait sim` and `plait compare` see them.

Tolerance: 1e-4 of the bodies' size. Flesh is solved to a thousandth of the imbalance of each substep, in
float32 about float64 places, so that machines that round otherwise may stop an iteration sooner or later; a change
of the physics by a few per cent is far above: see `test_a_change_is_seen`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from plait.assets.small_flesh_scene import FOLDER, HEAD, JELLY, SETTINGS, write
from plait.assets.small_scene import REFERENCE, SHOT
from plait.pipeline.compare import compare

from .small_shots import assert_valid, largest, nudged, simulated

TOLERANCE = 1e-4 * 0.36  # [m]


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    return simulated(FOLDER / SHOT, tmp_path_factory.mktemp("small_flesh") / "out.usda", *SETTINGS)


def test_the_generator_writes_the_shot_that_ships(tmp_path):
    assert write(tmp_path).read_bytes() == (FOLDER / SHOT).read_bytes()


def test_same_as_the_reference(result):
    """`python -m plait.assets.small_flesh_scene --reference` makes it anew after an intended change."""
    comparison = compare(FOLDER / REFERENCE, result, TOLERANCE)
    assert comparison.ok, comparison.lines()


def test_shot_and_result_are_valid(result):
    assert_valid(FOLDER / SHOT, result, FOLDER / REFERENCE)


def test_flesh_is_left_behind_and_touches(result):
    """Else the reference would watch neither jiggle nor contact: the head moves unevenly, the jelly comes down
    to the ground and no further below than a tenth of a cell."""
    stage, source = Usd.Stage.Open(str(result)), Usd.Stage.Open(str(FOLDER / SHOT))
    jelly = [np.array(UsdGeom.PointBased(stage.GetPrimAtPath(JELLY)).GetPointsAttr().Get(c)) for c in range(1, 25)]
    height = UsdGeom.XformCache().GetLocalToWorldTransform(source.GetPrimAtPath(JELLY))[3][1]
    lowest = [float(points[:, 1].min()) + height for points in jelly]
    assert lowest[0] > 3.9 and -0.6 < min(lowest) < 0.2
    head = np.array([UsdGeom.Mesh(stage.GetPrimAtPath(HEAD)).GetPointsAttr().Get(c) for c in range(1, 25)])
    assert np.linalg.norm(np.diff(head, n=2, axis=0), axis=2).max() > 0.1


@pytest.mark.parametrize(
    ("change", "prim"),
    [
        (f"prim.'{HEAD}'.youngsModulus=2.2e4", HEAD),
        (f"prim.'{HEAD}'.coreDepth=0.6", HEAD),
        (f"prim.'{JELLY}'.youngsModulus=1.1e4", JELLY),
        ("solver.flesh.integrator=backward-euler", HEAD),
    ],
)
def test_a_change_is_seen(result, tmp_path, change, prim):
    """So that the comparison can fail: ten percent of a stiffness, another integrator."""
    new = simulated(FOLDER / SHOT, tmp_path / "out.usda", *SETTINGS, change)
    assert largest(compare(result, new, TOLERANCE), prim) > 10.0 * TOLERANCE


def test_rounding_of_the_input_stays_below(result, tmp_path):
    """Every node of the jelly moved by a rounding of float32: a tenth of the tolerance at most."""
    folder = tmp_path / "small_flesh"
    folder.mkdir()
    (tmp_path / "small").symlink_to(FOLDER.parent / "small")
    new = simulated(nudged(FOLDER / SHOT, folder / SHOT, JELLY), tmp_path / "out.usda", *SETTINGS)
    assert 0.0 < largest(compare(result, new, TOLERANCE), JELLY) < 0.1 * TOLERANCE
