"""The shot: sand poured on soft bunnies, slippery and rough. Metres, Y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
import warp
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from plait.assets.stages import add_camera, author_parameters, define_mesh, new_stage, read_triangles

RATE = 24.0
LENGTH, APART = 0.3, 0.42  # [m] of a bunny, and between two
FRICTIONS = (0.1, 0.9)  # of the skins, from the left
YOUNGS_MODULUS = 6e4  # [Pa]
CLEAR = 1e-3  # [m] between the bunnies and the floor as drawn
SPOUT = (0.05, 0.012, 0.03)  # [m] half the size of the boxes that sand starts in
FALL, SPEED = 0.06, 0.4  # [m] from there to the bunnies as drawn, and [m/s] that sand starts with
ASIDE = -0.02  # [m] the spout's place along the bunny
COLOURS = ((0.42, 0.28, 0.22), (0.25, 0.30, 0.36))  # linear RGB


def bunny() -> tuple[np.ndarray, np.ndarray]:
    """Warp's own, standing on y = 0 about the origin: points (n, 3) [m] and triangles (m, 3), closed."""
    stage = Usd.Stage.Open(str(Path(warp.__file__).parent / "examples/assets/bunny.usd"))
    prim = stage.GetPrimAtPath("/root/bunny")
    points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(), dtype=float)
    mesh = trimesh.Trimesh(LENGTH * points / np.ptp(points, axis=0).max(), read_triangles(prim))
    middle = mesh.bounds.mean(axis=0)
    return mesh.vertices - [middle[0], mesh.bounds[0, 1], middle[2]], mesh.faces


def middles(count: int) -> np.ndarray:
    """(count,) [m] x of each bunny."""
    return APART * (np.arange(count) - 0.5 * (count - 1))


def write(path: Path, frames: int, edge: float, spacing: float, poured: float) -> None:
    """frames: how long it lasts.  edge: [m] of the tets.  spacing: [m] of the grains.  poured: [s] sand runs."""
    stage = new_stage(path, (0, frames), RATE)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    _author_floor(stage)
    points, triangles = bunny()
    for index, (x, friction) in enumerate(zip(middles(len(FRICTIONS)), FRICTIONS, strict=True)):
        mesh = define_mesh(stage, f"/World/Bunny{index}", points, triangles, COLOURS[index])
        mesh.AddTranslateOp().Set(Gf.Vec3d(x, CLEAR, 0.0))
        values = {"youngsModulus": YOUNGS_MODULUS, "friction": friction, "tetEdge": edge, "stiffnessDamping": 0.02}
        author_parameters(mesh.GetPrim(), values, role="flesh")
        _author_spout(stage, index, float(x), points[:, 1].max(), spacing, poured)
    add_camera(stage, "/World/Camera", (0.0, 0.5, 2.1), 10.0)
    stage.Save()


def _author_floor(stage: Usd.Stage) -> None:
    """A slab that all may lie on."""
    floor = UsdGeom.Cube.Define(stage, "/World/Floor")
    floor.CreateDisplayColorAttr([Gf.Vec3f(0.30, 0.31, 0.33)])
    floor.AddTranslateOp().Set(Gf.Vec3d(0.0, -0.05, 0.0))
    floor.AddScaleOp().Set(Gf.Vec3f(0.7, 0.05, 0.4))
    UsdPhysics.CollisionAPI.Apply(floor.GetPrim())
    author_parameters(floor.GetPrim(), {"friction": 0.9})


def _author_spout(stage: Usd.Stage, index: int, x: float, top: float, spacing: float, poured: float) -> None:
    """As many grains as fill the stream as densely as they lie at rest."""
    spout = UsdGeom.Cube.Define(stage, f"/World/Sand{index}")
    spout.AddTranslateOp().Set(Gf.Vec3d(x + ASIDE, top + FALL, 0.0))
    spout.AddScaleOp().Set(Gf.Vec3f(*SPOUT))
    spout.CreateDisplayColorAttr([Gf.Vec3f(0.80, 0.62, 0.30)])
    rate = 4.0 * SPOUT[0] * SPOUT[2] * SPEED / spacing**3
    values = {
        "spacing": spacing,
        "rate": rate,
        "limit": np.ceil(rate * poured),
        "seed": index,
        "frictionAngle": 30.0,
    }
    author_parameters(spout.GetPrim(), values, role="sand")
    velocity = spout.GetPrim().CreateAttribute("plait:velocity", Sdf.ValueTypeNames.Float3)
    velocity.Set(Gf.Vec3f(0.0, -SPEED, 0.0))
