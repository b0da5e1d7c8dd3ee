"""The sample shot's written cache, judged from the files alone: nothing here asks the solver how it did."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import vtk
from pxr import Usd, UsdGeom, UsdSkel
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

from plait.assets import generate
from plait.pipeline.cli import main
from plait.pipeline.errors import EXIT_DONE
from plait.pipeline.validate import validate

SHOT = Path(generate.__file__).parent / "sample" / "shot.usda"
HAIR, BODIES = "/World/Character/Hair", ("/World/Character/Skin", "/World/Character/Staff")
RADIUS = 0.5 * generate.THICKNESS  # [cm]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("sample") / "out.usda"
    assert main(["sim", str(SHOT), "-o", str(output), "--progress", "none"]) == EXIT_DONE
    return output


@pytest.fixture(scope="module")
def stage(result) -> Usd.Stage:
    return Usd.Stage.Open(str(result))


def hair(stage: Usd.Stage, code: float) -> np.ndarray:
    """(strand_count, point_count, 3) float64 [cm], world."""
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath(HAIR))
    points = np.array(curves.GetPointsAttr().Get(code), float)
    matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(curves.GetPrim()))
    counts = np.array(curves.GetCurveVertexCountsAttr().Get())
    return (points @ matrix[:3, :3] + matrix[3, :3]).reshape(len(counts), counts[0], 3)


@pytest.fixture(scope="module")
def baked() -> Usd.Stage:
    """The source with its skins posed by UsdSkel itself."""
    stage = Usd.Stage.Open(str(SHOT))
    stage.SetEditTarget(stage.GetSessionLayer())
    UsdSkel.BakeSkinning(stage.Traverse())
    return stage


def signed_distance(stage: Usd.Stage, path: str, code: float, points: np.ndarray) -> np.ndarray:
    """[cm] of `points` (n, 3) from the mesh at `code`, negative within, by VTK."""
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(path))
    matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(mesh.GetPrim()))
    corners = np.array(mesh.GetPointsAttr().Get(code), float) @ matrix[:3, :3] + matrix[3, :3]
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    surface, cells, places = vtk.vtkPolyData(), vtk.vtkCellArray(), vtk.vtkPoints()
    places.SetData(numpy_to_vtk(corners, deep=True))
    for face in np.split(indices, np.cumsum(counts)[:-1]):
        cells.InsertNextCell(len(face), [int(i) for i in face])
    surface.SetPoints(places)
    surface.SetPolys(cells)
    triangles = vtk.vtkTriangleFilter()
    triangles.SetInputData(surface)
    triangles.Update()
    distance = vtk.vtkImplicitPolyDataDistance()
    distance.SetInput(triangles.GetOutput())
    answer = vtk.vtkDoubleArray()
    distance.FunctionValue(numpy_to_vtk(points, deep=True), answer)
    return vtk_to_numpy(answer).copy()


def test_no_point_is_deeper_in_a_body_than_its_radius(stage, baked):
    """Every frame, every point but the roots, which the animation holds."""
    deep = {}
    for code in range(1001, 1098):
        points = hair(stage, code)[:, 1:].reshape(-1, 3)
        for path in BODIES:
            count = int((signed_distance(baked, path, code, points) < -RADIUS).sum())
            if count:
                deep[code, path] = count
    assert not deep


def test_hair_keeps_its_length_swings_and_comes_to_rest(stage):
    """Under 1 % of stretch; tips lift by more than 5 cm in the spin; nearly all rest a second after it."""
    frames = np.stack([hair(stage, code) for code in range(1001, 1098)])
    lengths = np.linalg.norm(np.diff(frames, axis=2), axis=3).sum(axis=2)
    assert np.abs(lengths / lengths[0] - 1.0).max() < 0.01
    roots, tips = frames[:, :, 0, 1], frames[:, :, -1, 1]
    lift = (tips - roots) - (tips - roots)[0]
    assert np.median(lift, axis=1).max() > 5.0
    last = np.linalg.norm(frames[-1, :, -1] - frames[-2, :, -1], axis=1)
    assert np.percentile(last, 95) < 0.5


def test_no_validator_finds_more_than_in_the_source_and_nothing_is_skinned_twice(result):
    assert validate(result) == []


def test_metrics_agree(result):
    """The solver's own count, by another method, is zero too; every frame is there."""
    metrics = json.loads(result.with_suffix(".metrics.json").read_text())
    assert len(metrics["frames"]) == 24 + 96
    assert all(frame["strands"]["penetrating"] == 0 for frame in metrics["frames"])
