"""Normals of flesh turn with the skin: as a whole, across what shears, and on their own side of a crease."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom
from scipy.spatial.transform import Rotation

from plait.pipeline.config import Config
from plait.pipeline.read import read_shot
from plait.pipeline.shot import MeshNormals
from plait.pipeline.surface_normals import SurfaceNormals

DOUBLE, FLOAT32 = 1e-13, 1e-6
# A unit cube: points, quads, and the normal of each.
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
SIDES = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], float)


def cube(folder: Path, normals: np.ndarray, interpolation: str) -> MeshNormals:
    """The normals of a cube of flesh, as they are read."""
    stage = Usd.Stage.CreateNew(str(folder / f"{interpolation}.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/Cube")
    mesh.CreatePointsAttr(CORNERS)
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(QUADS.ravel().tolist())
    mesh.CreateNormalsAttr(normals)
    mesh.SetNormalsInterpolation(interpolation)
    for name, kind, value in (
        ("role", Sdf.ValueTypeNames.Token, "flesh"),
        ("tetEdge", Sdf.ValueTypeNames.Float, 0.6),
    ):
        mesh.GetPrim().CreateAttribute(f"plait:{name}", kind).Set(value)
    stage.Save()
    (output,) = read_shot(folder / f"{interpolation}.usda", Config()).meshes
    return output.normals


CREASED = np.repeat(SIDES, 4, axis=0)
SMOOTH = (CORNERS - 0.5) * 2.0 / np.sqrt(3.0)


@pytest.mark.parametrize(
    ("interpolation", "values"),
    [("vertex", SMOOTH), ("varying", SMOOTH), ("faceVarying", CREASED), ("uniform", SIDES)],
)
def test_they_turn_with_the_whole(tmp_path, interpolation, values):
    """At rest as authored; under x -> R x + t they are R n, exactly, creases and all."""
    held = cube(tmp_path, values, interpolation)
    carried = SurfaceNormals(held)
    np.testing.assert_allclose(carried.at(held.rest), values, atol=FLOAT32)
    turn = Rotation.random(rng=np.random.default_rng(1)).as_matrix()
    found = carried.at(held.rest @ turn.T + [3.0, 2.0, 1.0])
    np.testing.assert_allclose(found, carried.at(held.rest) @ turn.T, atol=DOUBLE)


@pytest.mark.parametrize(("interpolation", "values"), [("faceVarying", CREASED), ("uniform", SIDES)])
def test_they_stay_across_what_shears(tmp_path, interpolation, values):
    """Under x -> F x a flat side's normal is along F^-T n (Nanson)."""
    held = cube(tmp_path, values, interpolation)
    deform = np.array([[1.3, 0.4, 0.0], [0.0, 0.8, 0.3], [0.2, 0.0, 1.1]])
    expected = values @ np.linalg.inv(deform)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(SurfaceNormals(held).at(held.rest @ deform.T), expected, atol=FLOAT32)


def test_a_lid_that_opens_turns_its_own_side_of_the_crease(tmp_path):
    """The top's far edge lifted: its corners tilt, all alike along the edge; those of the bottom stay."""
    held = cube(tmp_path, CREASED, "faceVarying")
    lifted = held.rest.copy()
    far = (held.rest[:, 1] == 1.0) & (held.rest[:, 0] == 1.0)
    lifted[far, 1] += 1.0
    found = SurfaceNormals(held).at(lifted).reshape(6, 4, 3)
    np.testing.assert_allclose(found[3], np.tile([-np.sqrt(0.5), np.sqrt(0.5), 0.0], (4, 1)), atol=FLOAT32)
    np.testing.assert_allclose(found[2], np.tile([0.0, -1.0, 0.0], (4, 1)), atol=FLOAT32)


def test_what_has_no_area_keeps_a_unit_normal(tmp_path):
    held = cube(tmp_path, SMOOTH, "vertex")
    found = SurfaceNormals(held).at(np.zeros_like(held.rest))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=DOUBLE)


def test_normals_that_fit_nothing_are_dropped(tmp_path):
    assert cube(tmp_path, SMOOTH[:3], "vertex") is None
