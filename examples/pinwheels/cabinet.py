"""The shot: jelly bears and sand poured into a narrow cabinet of pinwheels. Metres, Y up; the front is at +Z.

Each wheel hangs under the edge of the one above it, on the other side of the stream, so that they turn in turns.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from plait.assets import jelly
from plait.assets.stages import add_camera, author_parameters, define_mesh, new_stage

RATE = 24.0
HALF_WIDTH, HALF_DEPTH, WALL = 0.34, 0.05, 0.08  # [m] of the cabinet within, and how thick its walls are
RADIUS, HUB, HALF_BLADE, BLADES = 0.13, 0.034, 0.018, 4  # [m] of the wheels
GAP = 0.002  # [m] between a wheel and the panes
SIDES = (-0.14, 0.12, -0.085)  # [m] x of the axes, from the lowest up; the stream falls at 0
FIRST_AXIS, APART = 0.30, 0.26  # [m] y of the lowest axis, and from one to the next
SPOUT = (0.022, 0.02, 0.03)  # [m] half the size of the box that sand starts in
ABOVE = 0.24  # [m] of the spout above the highest axis
SPEED = 0.8  # [m/s] that sand is poured with
TILTS = (0.5, 0.3, 0.7)  # [rad] of the wheels at first
COLOURS = ((0.55, 0.10, 0.08), (0.09, 0.30, 0.42), (0.62, 0.38, 0.05))  # linear RGB, of the wheels
BEAR, BEAR_EDGE = 0.5, 0.016  # size, over that of `jelly.bear`; [m] of its tets
# x, y [m] where they start: clear of the spout, on the side of the highest axis that sand falls on.
BEARS = ((0.068, 1.22), (0.070, 1.55), (0.066, 1.95))
BEAR_COLOURS = ((0.45, 0.05, 0.20), (0.12, 0.40, 0.08), (0.60, 0.30, 0.02))  # linear RGB
SAND, WOOD, BACK = (0.72, 0.52, 0.28), (0.16, 0.09, 0.05), (0.55, 0.56, 0.58)


def axes(wheels: int) -> np.ndarray:
    """(wheels, 3) [m] middles of the wheels, from the lowest up; of fewer than all, as the highest stand."""
    sides = SIDES[len(SIDES) - wheels :]
    return np.array([(x, FIRST_AXIS + k * APART, 0.0) for k, x in enumerate(sides)])


def top(wheels: int) -> float:
    """[m] y of the spout's middle."""
    return FIRST_AXIS + (wheels - 1) * APART + ABOVE


def senses(wheels: int) -> np.ndarray:
    """(wheels,) +1 where the stream falls on the left of an axis, and turns it counter-clockwise, else -1."""
    return np.sign(axes(wheels)[:, 0])


def write(path: Path, frames: int, wheels: int, bears: int, spacing: float, poured: float) -> None:
    """frames: how long it lasts.  spacing: [m] of the grains.  poured: [s] how long sand runs."""
    stage = new_stage(path, (0, frames), RATE)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    _author_cabinet(stage, top(wheels) + 0.1)
    for index, axis in enumerate(axes(wheels)):
        _author_wheel(stage, index, axis)
    for index in range(bears):
        _author_bear(stage, index)
    _author_spout(stage, top(wheels), spacing, poured)
    height = top(wheels) + 0.1
    add_camera(stage, "/World/Camera", (0.0, 0.5 * height + 0.12, 2.75 * height), 2.5)
    stage.Save()


def outline() -> np.ndarray:
    """(n, 2) [m] a wheel seen along its axis, counter-clockwise: straight blades about a round hub."""
    reach = np.sqrt(HUB**2 - HALF_BLADE**2)
    between = np.linspace(np.arctan2(HALF_BLADE, reach), 2.0 * np.pi / BLADES - np.arctan2(HALF_BLADE, reach), 6)
    blade = np.array([(RADIUS, -HALF_BLADE), (RADIUS, HALF_BLADE)])
    hub = HUB * np.column_stack([np.cos(between), np.sin(between)])
    part, turns = np.concatenate([blade, hub]), 2.0 * np.pi / BLADES * np.arange(BLADES)
    return np.concatenate([part @ [[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]] for a in turns])


def wheel() -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) [m] about the middle of a wheel, and its triangles (m, 3): a closed prism along z."""
    flat, half = outline(), HALF_DEPTH - GAP
    count = len(flat)
    here, after = np.arange(count), (np.arange(count) + 1) % count
    back, front = (np.column_stack([flat, np.full(count, z)]) for z in (-half, half))
    points = np.concatenate([back, front, [(0.0, 0.0, -half), (0.0, 0.0, half)]])
    triangles = [(after, here, 2 * count), (count + here, count + after, 2 * count + 1)]
    triangles += [(here, after, count + after), (here, count + after, count + here)]
    return points, np.concatenate([np.column_stack(np.broadcast_arrays(*corners)) for corners in triangles])


def _author_wheel(stage: Usd.Stage, index: int, axis: np.ndarray) -> None:
    mesh = define_mesh(stage, f"/World/Wheel{index}", *wheel(), COLOURS[index])
    mesh.AddTranslateOp().Set(Gf.Vec3d(*axis))
    mesh.AddRotateZOp().Set(float(np.degrees(TILTS[index])))
    prim = mesh.GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(prim)
    UsdPhysics.CollisionAPI.Apply(prim)
    UsdPhysics.MassAPI.Apply(prim).CreateDensityAttr(600.0)
    author_parameters(prim, {"friction": 0.4})
    joint = UsdPhysics.RevoluteJoint.Define(stage, f"/World/Axle{index}")
    joint.CreateBody1Rel().SetTargets([prim.GetPath()])
    joint.CreateAxisAttr("Z")
    joint.CreateLocalPos0Attr(Gf.Vec3f(*axis))


def _author_bear(stage: Usd.Stage, index: int) -> None:
    points, triangles = jelly.bear(1200)
    points = BEAR * (points - 0.5 * (points.min(axis=0) + points.max(axis=0)))
    mesh = define_mesh(stage, f"/World/Bear{index}", points, triangles, BEAR_COLOURS[index])
    mesh.AddTranslateOp().Set(Gf.Vec3d(*BEARS[index], 0.0))
    values = {"youngsModulus": 1e4, "poissonsRatio": 0.4, "density": 1000.0, "friction": 0.3, "tetEdge": BEAR_EDGE}
    author_parameters(mesh.GetPrim(), values, role="flesh")


def _author_cabinet(stage: Usd.Stage, height: float) -> None:
    """A floor and four walls, of which the front is a pane of glass.

    They overlap where they meet: faces hidden in a seam hold nothing back.
    """
    x, z, half = HALF_WIDTH, HALF_DEPTH, 0.5 * WALL
    wide, deep = x + WALL, z + WALL
    middle, tall = 0.5 * (height - WALL), 0.5 * (height + WALL)
    parts = {
        "Floor": ((0.0, -half, 0.0), (wide, half, deep), WOOD),
        "Left": ((-x - half, middle, 0.0), (half, tall, deep), WOOD),
        "Right": ((x + half, middle, 0.0), (half, tall, deep), WOOD),
        "Back": ((0.0, middle, -z - half), (wide, tall, half), BACK),
        "Pane": ((0.0, middle, z + half), (wide, tall, half), BACK),
    }
    for name, (place, size, colour) in parts.items():
        cube = UsdGeom.Cube.Define(stage, f"/World/Cabinet/{name}")
        cube.CreateDisplayColorAttr([Gf.Vec3f(*colour)])
        cube.AddTranslateOp().Set(Gf.Vec3d(*place))
        cube.AddScaleOp().Set(Gf.Vec3f(*size))
        UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
        author_parameters(cube.GetPrim(), {"friction": 0.2})
        if name == "Pane":
            cube.CreateVisibilityAttr("invisible")


def _author_spout(stage: Usd.Stage, height: float, spacing: float, poured: float) -> None:
    """As many grains as fill the stream as densely as they lie at rest."""
    spout = UsdGeom.Cube.Define(stage, "/World/Sand")
    spout.CreateDisplayColorAttr([Gf.Vec3f(*SAND)])
    spout.AddTranslateOp().Set(Gf.Vec3d(0.0, height, 0.0))
    spout.AddScaleOp().Set(Gf.Vec3f(*SPOUT))
    rate = 4.0 * SPOUT[0] * SPOUT[2] * SPEED / spacing**3
    prim = spout.GetPrim()
    author_parameters(prim, {"spacing": spacing, "rate": rate, "limit": rate * poured}, role="sand")
    prim.CreateAttribute("plait:velocity", Sdf.ValueTypeNames.Float3).Set(Gf.Vec3f(0.0, -SPEED, 0.0))
