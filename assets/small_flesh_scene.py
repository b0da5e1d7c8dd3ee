"""The small shot of flesh of the tests: the nodding head of the small shot as flesh, its hair on it, and a jelly.

A layer over `small/shot.usda`. `python -m plait.assets.small_flesh_scene` writes `small_flesh/shot.usda` beside
this file; with `--reference` it simulates the shot too and writes the cache `small_flesh/reference.usdc`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdPhysics

from plait.assets import small_scene
from plait.assets.small_scene import SHOT
from plait.assets.stages import author_parameters

FOLDER = Path(__file__).parent / "small_flesh"
HEAD, JELLY, GROUND = "/World/Head/Skin", "/World/Jelly", "/World/Ground"
# Beside the defaults, in the test too.
SETTINGS = (*small_scene.SETTINGS, "preroll=0")
JELLY_SIZE, JELLY_CELLS, DROP = 12.0, 2, 4.0  # [cm] edge and height above the ground; cells an edge


def write(folder: Path) -> Path:
    """Writes `folder`/shot.usda, always the same bytes, and returns its path."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = small_scene.open_stage(layer)
    stage.SetDefaultPrim(stage.OverridePrim("/World"))
    head = {"tetEdge": 6.0, "youngsModulus": 200.0, "stiffnessDamping": 0.002}
    author_parameters(stage.OverridePrim(HEAD), head, role="flesh")
    _jelly(stage)
    _ground(stage)
    del stage  # an anonymous layer cannot find its neighbours
    layer.subLayerPaths = [f"../{small_scene.FOLDER.name}/{SHOT}"]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / SHOT
    layer.Export(str(path))
    return path


def _jelly(stage: Usd.Stage) -> None:
    """A cube of tets, five a cell, every other cell mirrored; it falls on the ground beside the head."""
    count = JELLY_CELLS + 1
    axis = np.linspace(-0.5, 0.5, count) * JELLY_SIZE
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    tets = []
    for i, j, k in np.ndindex(*(JELLY_CELLS,) * 3):
        corner = [((i + x) * count + j + y) * count + k + z for x in (0, 1) for y in (0, 1) for z in (0, 1)]
        if (i + j + k) % 2:  # mirrored along the first axis, so that faces of neighbours match
            corner = corner[4:] + corner[:4]
        five = [(0, 3, 5, 6), (1, 0, 3, 5), (2, 0, 6, 3), (4, 0, 5, 6), (7, 3, 6, 5)]
        tets += [[corner[v] for v in tet] for tet in five]
    tets = np.array(tets)
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    wrong = np.linalg.det(edges) < 0.0
    tets[wrong] = tets[wrong][:, [0, 2, 1, 3]]
    mesh = UsdGeom.TetMesh.Define(stage, JELLY)
    mesh.CreatePointsAttr([tuple(point) for point in points.tolist()])
    mesh.CreateTetVertexIndicesAttr([tuple(tet) for tet in tets.tolist()])
    mesh.CreateSurfaceFaceVertexIndicesAttr(UsdGeom.TetMesh.ComputeSurfaceFaces(mesh))
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
    mesh.CreateDisplayColorAttr([(0.75, 0.25, 0.30)])
    mesh.AddTranslateOp().Set((40.0, 0.5 * JELLY_SIZE + DROP, 0.0))
    author_parameters(mesh.GetPrim(), {"youngsModulus": 100.0}, role="flesh")


def _ground(stage: Usd.Stage) -> None:
    ground = UsdGeom.Mesh.Define(stage, GROUND)
    ground.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    ground.CreatePointsAttr([(20.0, 0.0, -60.0), (20.0, 0.0, 60.0), (140.0, 0.0, 60.0), (140.0, 0.0, -60.0)])
    ground.CreateFaceVertexCountsAttr([4])
    ground.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    ground.CreateExtentAttr([(20.0, 0.0, -60.0), (140.0, 0.0, 60.0)])
    UsdPhysics.CollisionAPI.Apply(ground.GetPrim())


if __name__ == "__main__":
    small_scene.main(__doc__, FOLDER, write, SETTINGS)
