"""The shot: sand of three colours, one after the other, poured on jellies of different stiffness. Metres, Y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from plait.assets.implicit import polygonise, relax, simplify
from plait.assets.stages import add_camera, author_parameters, define_mesh, new_stage

RATE = 24.0
RADIUS, TAPER, HEIGHT, ROUND = 0.085, 0.12, 0.08, 0.022  # [m] of a jelly at its foot, and how it narrows upwards
APART = 0.27  # [m] between the middles of jellies
YOUNGS_MODULI = (2e3, 6e3, 2e4)  # [Pa] from the left
POISSONS_RATIO, JELLY_DENSITY, JELLY_FRICTION = 0.45, 1000.0, 0.6
SAND_DENSITY, FRICTION_ANGLE, FLOOR_FRICTION = 1600.0, 34.0, 0.6  # [kg/m3], [degrees], 1
SPOUT = (0.026, 0.01, 0.026)  # [m] half the size of the boxes that sand starts in
FALL, SPEED = 0.075, 0.25  # [m] from there to the jellies as drawn, and [m/s] that sand starts with
CLEAR = 5e-4  # [m] between the jellies and the floor as drawn
GREENS = ((0.20, 0.42, 0.05), (0.06, 0.33, 0.14), (0.03, 0.18, 0.20))  # linear RGB, of the jellies
SANDS = {"Red": (0.60, 0.07, 0.05), "White": (0.80, 0.74, 0.62), "Blue": (0.06, 0.16, 0.50)}


def middles(jellies: int) -> np.ndarray:
    """(jellies,) [m] x of each."""
    return APART * (np.arange(jellies) - 0.5 * (jellies - 1))


def write(path: Path, frames: int, moduli: tuple[float, ...], edge: float, spacing: float, layer: float) -> None:
    """frames: how long it lasts.  moduli: [Pa] Young's, of the jellies.  edge: [m] of their tets.
    spacing: [m] of the grains.  layer: [s] how long each colour is poured."""
    stage = new_stage(path, (0, frames), RATE)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    _author_floor(stage)
    points, triangles = jelly()
    for index, x in enumerate(middles(len(moduli))):
        mesh = define_mesh(stage, f"/World/Jelly{index}", points, triangles, GREENS[index])
        mesh.AddTranslateOp().Set(Gf.Vec3d(x, CLEAR, 0.0))
        values = {"youngsModulus": moduli[index], "poissonsRatio": POISSONS_RATIO, "density": JELLY_DENSITY}
        values |= {"friction": JELLY_FRICTION, "tetEdge": edge, "stiffnessDamping": 0.02}
        author_parameters(mesh.GetPrim(), values, role="flesh")
        for turn, (name, colour) in enumerate(SANDS.items()):
            spout = _author_spout(stage, f"/World/{name}{index}", x, spacing, layer, seed=3 * index + turn)
            spout.CreateDisplayColorAttr([Gf.Vec3f(*colour)])
            emit = spout.GetPrim().CreateAttribute("plait:emit", Sdf.ValueTypeNames.Bool)
            for time, on in ((0.0, turn == 0), (turn * layer, True), ((turn + 1) * layer, False)):
                emit.Set(on, time * RATE)
    camera = (0.0, 0.42, 2.3 * (APART * len(moduli) + 0.1))
    add_camera(stage, "/World/Camera", camera, float(np.degrees(np.arctan2(camera[1] - 0.06, camera[2]))))
    stage.Save()


def jelly() -> tuple[np.ndarray, np.ndarray]:
    """A turned-out pudding that stands on y = 0: points (n, 3) [m] and triangles (m, 3), closed."""
    low, high = (-RADIUS - 0.01, -0.01, -RADIUS - 0.01), (RADIUS + 0.01, HEIGHT + 0.01, RADIUS + 0.01)
    points, triangles = simplify(*polygonise(distance, low, high, 0.003), 1600)
    return relax(distance, points, triangles, 4), triangles


def distance(points: np.ndarray) -> np.ndarray:
    """(n,) [m] to the pudding: a cone's frustum with a rounded rim above and a sharper one below."""
    round_here = np.where(points[:, 1] < 0.5 * HEIGHT, 0.3 * ROUND, ROUND)
    radius = RADIUS - TAPER * np.clip(points[:, 1], 0.0, HEIGHT)
    across = np.hypot(points[:, 0], points[:, 2]) - radius + round_here
    along = np.abs(points[:, 1] - 0.5 * HEIGHT) - 0.5 * HEIGHT + round_here
    outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
    return outside + np.minimum(np.maximum(across, along), 0.0) - round_here


def _author_floor(stage: Usd.Stage) -> None:
    """A slab that all may lie on."""
    floor = UsdGeom.Cube.Define(stage, "/World/Floor")
    floor.CreateDisplayColorAttr([Gf.Vec3f(0.30, 0.31, 0.33)])
    floor.AddTranslateOp().Set(Gf.Vec3d(0.0, -0.05, 0.0))
    floor.AddScaleOp().Set(Gf.Vec3f(0.6, 0.05, 0.35))
    UsdPhysics.CollisionAPI.Apply(floor.GetPrim())
    author_parameters(floor.GetPrim(), {"friction": FLOOR_FRICTION})


def _author_spout(stage: Usd.Stage, path: str, x: float, spacing: float, layer: float, seed: int) -> UsdGeom.Cube:
    """As many grains as fill the stream as densely as they lie at rest."""
    spout = UsdGeom.Cube.Define(stage, path)
    spout.AddTranslateOp().Set(Gf.Vec3d(x, HEIGHT + FALL, 0.0))
    spout.AddScaleOp().Set(Gf.Vec3f(*SPOUT))
    rate = 4.0 * SPOUT[0] * SPOUT[2] * SPEED / spacing**3
    values = {"spacing": spacing, "rate": rate, "limit": np.ceil(rate * layer), "seed": seed}
    values |= {"density": SAND_DENSITY, "frictionAngle": FRICTION_ANGLE}
    author_parameters(spout.GetPrim(), values, role="sand")
    velocity = spout.GetPrim().CreateAttribute("plait:velocity", Sdf.ValueTypeNames.Float3)
    velocity.Set(Gf.Vec3f(0.0, -SPEED, 0.0))
    return spout
