"""The shot: a jelly bear squeezed between two plates, and a hairy ball of jelly that is dropped.

Centimetres, Y up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, Vt

from plait.assets import generate, jelly, walk
from plait.assets.stages import add_camera, author_parameters, author_roots

FIRST, RATE = 1.0, generate.RATE
CENTIMETRES = 100.0
UP = np.array([0.0, 1.0, 0.0])
COLOURS = {"Bear": (0.42, 0.10, 0.06), "Ball": (0.10, 0.30, 0.42)}  # linear RGB
BEAR_X, BALL_X = -16.0, 14.0
BALL, DROP = 7.0, 9.0  # [cm] its radius, and how far its lowest point is above the ground
POINTS, HAIR = 10, 5.0  # length [cm]
PLATE, OPEN, SHUT = (
    (1.5, 20.0, 18.0),
    12.0,
    4.5,
)  # [cm] its size, and how far from the bear's middle its face stands
CLOSING, OPENING = (0.3, 0.9), (1.2, 1.6)  # [s]

# In kilograms, centimetres and seconds: 3e4 Pa, as heavy as water.
JELLY = {"youngsModulus": 300.0, "poissonsRatio": 0.45, "density": 1e-3, "friction": 0.4}


def write(path: Path, frames: int, edge: float, hairs: int) -> None:
    """frames: how long it lasts.  edge: [cm] mean edge of the tets.  hairs: on the ball."""
    last = FIRST + frames

    def author(stage: Usd.Stage) -> None:
        UsdGeom.Xform.Define(stage, generate.WORLD)
        _author_floor(stage)
        points, triangles = jelly.bear()
        bear = CENTIMETRES * (points - np.array([0.0, points[:, 1].min(), 0.0])) + UP * 0.05
        _author_jelly(stage, "Bear", bear, triangles, edge, BEAR_X)
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            _author_plate(stage, side, sign, np.arange(FIRST, last + 1e-6, 0.5))
        points, triangles = jelly.ball(BALL)
        ball = points + UP * (BALL + DROP)
        _author_jelly(stage, "Ball", ball, triangles, edge, BALL_X)
        _author_hair(stage, trimesh.Trimesh(ball, triangles, process=False), hairs)
        _author_camera(stage)

    generate.write(path, author, frames=(FIRST, last))


def plate_face(time: float) -> float:
    """[cm] from the bear's middle to either plate."""
    shut = walk.smooth(np.array([time]), *CLOSING)[0] - walk.smooth(np.array([time]), *OPENING)[0]
    return float(OPEN + shut * (SHUT - OPEN))


def _author_jelly(
    stage: Usd.Stage, name: str, points: np.ndarray, triangles: np.ndarray, edge: float, x: float
) -> None:
    mesh = generate.define_mesh(stage, generate.WORLD.AppendChild(name), points, triangles)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*COLOURS[name])])
    mesh.AddTranslateOp().Set(Gf.Vec3d(x, 0.0, 0.0))
    author_parameters(mesh.GetPrim(), {**JELLY, "tetEdge": edge}, role="flesh")


def _author_floor(stage: Usd.Stage) -> None:
    floor = UsdGeom.Mesh.Define(stage, generate.WORLD.AppendChild("Floor"))
    floor.CreatePointsAttr([(-45, 0, -35), (-45, 0, 35), (45, 0, 35), (45, 0, -35)])
    floor.CreateFaceVertexCountsAttr([4])
    floor.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    floor.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    floor.CreateExtentAttr([(-45, 0, -35), (45, 0, 35)])
    floor.CreateDisplayColorAttr([Gf.Vec3f(0.35, 0.36, 0.38)])
    UsdPhysics.CollisionAPI.Apply(floor.GetPrim())


def _author_plate(stage: Usd.Stage, side: str, sign: float, codes: np.ndarray) -> None:
    plate = UsdGeom.Cube.Define(stage, generate.WORLD.AppendChild(f"{side}Plate"))
    plate.CreateSizeAttr(1.0)
    plate.CreateExtentAttr([(-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)])
    plate.CreateDisplayColorAttr([Gf.Vec3f(0.25, 0.25, 0.27)])
    UsdPhysics.CollisionAPI.Apply(plate.GetPrim())
    place = plate.AddTranslateOp()
    plate.AddScaleOp().Set(Gf.Vec3f(*PLATE))
    for code in codes:
        x = plate_face((code - FIRST) / RATE) + 0.5 * PLATE[0]
        place.Set(Gf.Vec3d(BEAR_X + sign * x, 0.5 * PLATE[1] + 0.2, 1.0), code)


def _author_hair(stage: Usd.Stage, ball: trimesh.Trimesh, count: int) -> None:
    """Hairs out of the ball's upper half; `skinprim` and `skinprimuv` say where each grows."""
    upper = (ball.triangles_center[:, 1] > BALL + DROP + 0.3).astype(float)
    roots, faces = trimesh.sample.sample_surface(ball, count, face_weight=upper, seed=1)
    places = trimesh.triangles.points_to_barycentric(ball.triangles[faces], roots)
    along = np.linspace(0.0, HAIR, POINTS)[:, None]
    points = [
        root + along * normal - 0.06 * along**2 * UP
        for root, normal in zip(roots, ball.face_normals[faces], strict=True)
    ]
    hair = UsdGeom.BasisCurves.Define(stage, generate.WORLD.AppendChild("Hair"))
    hair.CreateTypeAttr(UsdGeom.Tokens.linear)
    hair.CreateCurveVertexCountsAttr([POINTS] * count)
    hair.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.concatenate(points).astype(np.float32)))
    hair.CreateWidthsAttr([0.05])
    hair.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    hair.CreateDisplayColorAttr([(0.22, 0.12, 0.05)])
    hair.AddTranslateOp().Set(Gf.Vec3d(BALL_X, 0.0, 0.0))
    prim = hair.GetPrim()
    prim.SetMetadata("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["PhysicsCurvesDeformableSimAPI"]))
    prim.CreateRelationship("plait:skin").SetTargets([generate.WORLD.AppendChild("Ball")])
    author_roots(hair, faces, places)


def _author_camera(stage: Usd.Stage) -> None:
    """Before the bear's face, a little above."""
    camera = add_camera(stage, "/World/Camera", (-1.0, 54.0, 146.0), 17.0)
    camera.CreateClippingRangeAttr(Gf.Vec2f(1.0, 1000.0))
