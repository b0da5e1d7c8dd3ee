"""Fabricated results on small sources and on real ones, so that writing is tested without simulating."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from plait.pipeline.shot import CurveOutput, Normals, PrimFrame, Shot, StageInfo
from plait.pipeline.write import CacheWriter
from plait.solver.scene import Scene

WIDTH = 0.02
MADE = {"version:plait": "0.1.0", "configuration": "0123456789abcdef", "seed": 0, "device": "cpu"}


def curve_source(
    path: Path, *, strands: int = 2, per_strand: int = 3, prims: Sequence[str] = ("/World/hair",)
) -> Path:
    """A source of straight strands with authored points, extent and widths, 24 codes a second, frames 1 to 10."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(10)
    stage.SetTimeCodesPerSecond(24)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    for name in prims:
        define_curves(stage, name, strands, per_strand)
    stage.Save()
    return path


def define_curves(stage: Usd.Stage, path: str, strands: int = 2, per_strand: int = 3) -> UsdGeom.BasisCurves:
    curves = UsdGeom.BasisCurves.Define(stage, path)
    points = np.zeros((strands, per_strand, 3), np.float32)
    points[..., 0], points[..., 1] = np.arange(strands)[:, None], np.arange(per_strand)
    curves.CreateTypeAttr("linear")
    curves.CreatePointsAttr(points.reshape(-1, 3))
    curves.CreateCurveVertexCountsAttr([per_strand] * strands)
    curves.CreateWidthsAttr([WIDTH])
    curves.SetWidthsInterpolation("constant")
    curves.CreateExtentAttr(UsdGeom.Curves.ComputeExtent(curves.GetPointsAttr().Get(), [WIDTH]))
    return curves


def shot_of(
    path: Path,
    prims: Sequence[str] = ("/World/hair",),
    *,
    skinned: Collection[str] = (),
    has_normals: bool = False,
) -> Shot:
    """A shot that simulates `prims` of the stage at `path`, of which a skeleton drives `skinned` in the source."""
    stage = Usd.Stage.Open(str(path))
    info = StageInfo(
        path,
        UsdGeom.GetStageMetersPerUnit(stage),
        UsdGeom.GetStageUpAxis(stage),
        stage.GetTimeCodesPerSecond(),
        stage.GetFramesPerSecond(),
        stage.GetStartTimeCode(),
        stage.GetEndTimeCode(),
    )
    curves = []
    for index, name in enumerate(prims):
        points = stage.GetPrimAtPath(name).GetAttribute("points").Get(Usd.TimeCode.EarliestTime())
        count = len(points)
        curves.append(
            CurveOutput(
                name,
                lambda _: np.eye(4),
                index,
                np.full(count, WIDTH),
                point_map=np.arange(count, dtype=np.int32),
                skinned=name in skinned,
                normals=Normals(np.eye(3)[np.full(count, 2)], np.zeros(count, np.int64)) if has_normals else None,
            )
        )
    return Shot(info, Scene(), tuple(curves), ())


def result(output: CurveOutput, code: float, width: float = WIDTH, normals: bool = False) -> PrimFrame:
    """Made-up values that differ at every code, prim and point, the same on every call."""
    count = len(output.point_map)
    seed = np.arange(3 * count, dtype=np.float64).reshape(count, 3) + 17.0 * output.strands
    points = (np.sin(seed) + 0.1 * code).astype(np.float32)
    extent = np.stack([points.min(axis=0) - width, points.max(axis=0) + width])
    velocities = (np.cos(seed) * code).astype(np.float32)
    return PrimFrame(output.prim_path, points, velocities, extent, velocities + 1 if normals else None)


def results(shot: Shot, code: float, **how: float) -> list[PrimFrame]:
    return [result(output, code, **how) for output in shot.curves]


def write(out: Path, shot: Shot, samples: Sequence[Sequence[float]], chunk: int = 3, **how: float) -> Path:
    """A whole result, from the first sample to the last."""
    with CacheWriter(out, shot, samples=samples, chunk=chunk, provenance=MADE) as writer:
        for frame in samples:
            for code in frame:
                writer.add(code, results(shot, code, **how))
    return out


def frames(first: float, last: float, stride: float = 1.0) -> list[tuple[float, ...]]:
    return [(float(code),) for code in np.arange(first, last + 0.5 * stride, stride)]


def values(stage: Usd.Stage, path: str, name: str, code: float) -> np.ndarray:
    return np.array(stage.GetPrimAtPath(path).GetAttribute(name).Get(code))


def contents(folder: Path) -> dict[str, bytes]:
    """Name and bytes of every file in `folder`."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="session")
def fabricated() -> SimpleNamespace:
    """The functions of this file."""
    return SimpleNamespace(
        curve_source=curve_source,
        define_curves=define_curves,
        shot_of=shot_of,
        result=result,
        results=results,
        write=write,
        frames=frames,
        values=values,
        contents=contents,
    )
