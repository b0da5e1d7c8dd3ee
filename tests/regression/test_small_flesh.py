"""The small shot of flesh against its reference cache, as `plait sim` and `plait compare` see them.

Tolerance: 1e-4 of the bodies' size. Flesh is solved to a thousandth of the imbalance of each substep, in
float32 about float64 places, so that machines that round otherwise may stop an iteration sooner or later; a change
of the physics by a few per cent is far above: see `test_a_change_is_seen`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, Vt

from plait.assets.small_flesh_scene import FOLDER, HEAD, JELLY, REFERENCE, SETTINGS, SHOT, write
from plait.pipeline import config, driver
from plait.pipeline.compare import Comparison, compare
from plait.pipeline.validate import validate, validator_findings

TOLERANCE = 1e-4 * 0.36  # [m]


def simulated(shot: Path, output: Path, *assignments: str) -> Path:
    driver.simulate(shot, output, config.load(None, [*SETTINGS, *assignments]))
    return output


def largest(comparison: Comparison, path: str) -> float:
    """[m] how far any point of a prim is from the reference."""
    (prim,) = [prim for prim in comparison.prims if prim.path == path]
    assert len(prim.codes) == 24 and not prim.problems
    return float(prim.largest.max())


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    return simulated(FOLDER / SHOT, tmp_path_factory.mktemp("small_flesh") / "out.usda")


def test_the_generator_writes_the_shot_that_ships(tmp_path):
    assert write(tmp_path).read_bytes() == (FOLDER / SHOT).read_bytes()


def test_same_as_the_reference(result):
    """`python -m plait.assets.small_flesh_scene --reference` makes it anew after an intended change."""
    comparison = compare(FOLDER / REFERENCE, result, TOLERANCE)
    assert comparison.ok, comparison.lines()


def test_shot_and_result_are_valid(result):
    assert validator_findings(Usd.Stage.Open(str(FOLDER / SHOT))) == []
    assert validate(result) == []
    assert validate(FOLDER / REFERENCE) == []


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
    new = simulated(FOLDER / SHOT, tmp_path / "out.usda", change)
    assert largest(compare(result, new, TOLERANCE), prim) > 10.0 * TOLERANCE


def test_rounding_of_the_input_stays_below(result, tmp_path):
    """Every node of the jelly moved by a rounding of float32: a tenth of the tolerance at most."""
    shot = tmp_path / "small_flesh" / SHOT
    shot.parent.mkdir()
    (tmp_path / "small").symlink_to(FOLDER.parent / "small")
    shot.write_bytes((FOLDER / SHOT).read_bytes())
    stage = Usd.Stage.Open(str(shot))
    points = UsdGeom.PointBased(stage.GetPrimAtPath(JELLY)).GetPointsAttr()
    drawn = np.array(points.Get(), np.float32)
    sign = np.random.default_rng(1).choice([-np.inf, np.inf], drawn.shape).astype(np.float32)
    points.Set(Vt.Vec3fArray.FromNumpy(np.nextafter(drawn, sign)))
    stage.Save()
    new = simulated(shot, tmp_path / "out.usda")
    assert 0.0 < largest(compare(result, new, TOLERANCE), JELLY) < 0.1 * TOLERANCE
