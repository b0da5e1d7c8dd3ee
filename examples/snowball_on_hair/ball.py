"""The shot: a snowball thrown at a ball of hair, which then shakes. Metres, Y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from plait.assets.stages import (
    add_camera,
    author_parameters,
    author_roots,
    define_curves,
    define_mesh,
    make_smooth,
    new_stage,
)

RATE = 24.0
RADIUS, HAIR, WIDTH = 0.08, 0.05, 8e-4  # [m] of the ball, length and width of its hair
SNOWBALL, VELOCITY = 0.045, (2.0, -7.0, 0.0)  # [m] radius, [m/s]
START = (-0.08, 0.28, 0.0)  # [m] its middle at first
# Fresh snow: a blow of density times speed squared, twice its modulus, packs and tears it.
SNOW = {"youngsModulus": 1e4, "criticalCompression": 0.015, "criticalStretch": 0.002, "hardening": 5.0}
SHAKE, SHAKES, SWAY, TURN = 0.5, 4, 0.04, 1.2  # [s] from when, how often, [m] and [rad] how far to either side
SHAKEN = SHAKE + 0.7  # [s]


def moved(time: float) -> np.ndarray:
    """(4, 4), column vectors: where the ball is at `time` [s]: shaken up and down, and turned about y."""
    part = np.clip((time - SHAKE) / (SHAKEN - SHAKE), 0.0, 1.0)
    swing = np.sin(np.pi * part) * np.sin(2.0 * np.pi * SHAKES * part)
    transform = np.eye(4)
    c, s = np.cos(TURN * swing), np.sin(TURN * swing)
    transform[0, [0, 2]], transform[2, [0, 2]] = (c, s), (-s, c)
    transform[1, 3] = SWAY * swing
    return transform


def write(path: Path, frames: int, hairs: int, segments: int, spacing: float) -> None:
    """frames: how long it lasts.  hairs, segments: of each.  spacing: [m] of the grains of snow."""
    stage = new_stage(path, (0, frames), RATE)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    carrier = UsdGeom.Xform.Define(stage, "/World/Head")
    transform = carrier.AddTransformOp()
    for code in np.arange(0.0, frames + 0.25, 0.25):
        transform.Set(Gf.Matrix4d(moved(code / RATE).T.tolist()), float(code))
    ball = trimesh.creation.icosphere(4, RADIUS)
    mesh = define_mesh(stage, "/World/Head/Ball", ball.vertices, ball.faces, (0.30, 0.12, 0.09))
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    _author_hair(stage, ball, hairs, segments)
    snow = UsdGeom.Sphere.Define(stage, "/World/Snowball")
    snow.CreateRadiusAttr(SNOWBALL)
    snow.AddTranslateOp().Set(Gf.Vec3d(*START))
    snow.CreateDisplayColorAttr([Gf.Vec3f(0.85, 0.89, 0.95)])
    author_parameters(snow.GetPrim(), {"spacing": spacing, **SNOW}, role="snow")
    velocity = snow.GetPrim().CreateAttribute("plait:velocity", Sdf.ValueTypeNames.Float3)
    velocity.Set(Gf.Vec3f(*VELOCITY))
    add_camera(stage, "/World/Camera", (0.0, 0.09, 1.9), 2.0)
    stage.Save()


def _author_hair(stage: Usd.Stage, ball: trimesh.Trimesh, count: int, segments: int) -> None:
    """Hairs out of all of the ball; `skinprim` and `skinprimuv` say where each grows."""
    roots, faces = trimesh.sample.sample_surface_even(ball, count, seed=1)
    places = trimesh.triangles.points_to_barycentric(ball.triangles[faces], roots)
    along = np.linspace(0.0, HAIR, segments + 1)[:, None]
    points = roots[:, None] + along * ball.face_normals[faces][:, None]
    shade = np.random.default_rng(1).uniform(0.5, 1.2, (len(roots), 1))
    hair = define_curves(stage, "/World/Head/Hair", points[None], WIDTH, shade * [0.45, 0.20, 0.07])
    make_smooth(hair)
    prim = hair.GetPrim()
    prim.SetMetadata("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["PhysicsCurvesDeformableSimAPI"]))
    prim.CreateRelationship("plait:skin").SetTargets(["/World/Head/Ball"])
    author_parameters(prim, {"youngsModulus": 3e7, "damping": 12.0})
    author_roots(hair, faces, places)
