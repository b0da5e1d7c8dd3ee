"""What is asked of both small shots."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, Vt

from plait.pipeline import config, driver
from plait.pipeline.compare import Comparison
from plait.pipeline.validate import validate, validator_findings


def simulated(shot: Path, output: Path, *assignments: str) -> Path:
    driver.simulate(shot, output, config.load(None, list(assignments)))
    return output


def largest(comparison: Comparison, path: str) -> float:
    """[m] how far any point of a prim is from the reference, over all frames."""
    (prim,) = [prim for prim in comparison.prims if prim.path == path]
    assert len(prim.codes) == 24 and not prim.problems
    return float(prim.largest.max())


def assert_valid(shot: Path, *caches: Path) -> None:
    assert validator_findings(Usd.Stage.Open(str(shot))) == []
    for cache in caches:
        assert validate(cache) == []


def nudged(shot: Path, copy: Path, path: str) -> Path:
    """A copy of a shot with every point of a prim moved by a rounding of float32."""
    copy.write_bytes(shot.read_bytes())
    stage = Usd.Stage.Open(str(copy))
    points = UsdGeom.PointBased(stage.GetPrimAtPath(path)).GetPointsAttr()
    drawn = np.array(points.Get(), np.float32)
    sign = np.random.default_rng(1).choice([-np.inf, np.inf], drawn.shape).astype(np.float32)
    points.Set(Vt.Vec3fArray.FromNumpy(np.nextafter(drawn, sign)))
    stage.Save()
    return copy
