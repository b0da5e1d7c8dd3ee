"""The shot: an arm that flings its elbow shut and open, and fur bound to its skin. Metres, Y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from plait.assets.small_scene import capsule, fans
from plait.assets.stages import author_roots, define_mesh, make_smooth, new_stage

FRAMES, RATE = 60, 30.0
LENGTH, RADIUS = 0.6, 0.05  # [m] of the arm: a capsule along X, the elbow in its middle
HAIRS, POINTS, HAIR = 400, 8, 0.06  # length [m]
BENT = 100.0  # degrees
JOINTS = ("Shoulder", "Shoulder/Elbow")


def write(path: Path) -> None:
    """Writes the shot to `path`."""
    stage = new_stage(path, (1, FRAMES), RATE)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    UsdSkel.Root.Define(stage, "/World/Arm")
    points, faces = capsule(RADIUS, LENGTH, around=16, rings=28)
    points = points[:, [1, 2, 0]] - (LENGTH / 2.0, 0.0, 0.0)  # from standing on the origin to lying about it
    skin = trimesh.Trimesh(points, fans(faces), process=False)
    _add_skin(stage, skin, _add_skeleton(stage))
    _add_fur(stage, skin)
    stage.Save()


def bend(code: float) -> float:
    """[degrees] the elbow's angle: shut within a quarter of a second, open again, then still."""
    seconds = (code - 1.0) / RATE
    return BENT * float(np.sin(np.pi * np.clip(seconds / 0.5, 0.0, 1.0)) ** 2)


def _add_skeleton(stage: Usd.Stage) -> UsdSkel.Skeleton:
    places = [Gf.Vec3d(-LENGTH / 2.0, 0, 0), Gf.Vec3d(0, 0, 0)]
    steps = [places[0], places[1] - places[0]]
    skeleton = UsdSkel.Skeleton.Define(stage, "/World/Arm/Skeleton")
    skeleton.CreateJointsAttr(JOINTS)
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d().SetTranslate(place) for place in places])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d().SetTranslate(step) for step in steps])
    fling = UsdSkel.Animation.Define(stage, "/World/Arm/Skeleton/Fling")
    fling.CreateJointsAttr(JOINTS)
    fling.CreateTranslationsAttr([Gf.Vec3f(step) for step in steps])
    fling.CreateScalesAttr(Vt.Vec3hArray([(1, 1, 1)] * len(JOINTS)))
    for code in range(1, FRAMES + 1):
        turn = Gf.Rotation(Gf.Vec3d(0, 0, 1), bend(code)).GetQuat()
        fling.CreateRotationsAttr().Set([Gf.Quatf(1.0), Gf.Quatf(turn)], code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([fling.GetPath()])
    return skeleton


def _add_skin(stage: Usd.Stage, skin: trimesh.Trimesh, skeleton: UsdSkel.Skeleton) -> None:
    mesh = define_mesh(stage, "/World/Arm/Skin", skin.vertices, skin.faces, (0.55, 0.36, 0.28))
    second = np.clip(0.5 + skin.vertices[:, 0] / (3.0 * RADIUS), 0.0, 1.0)
    weights = np.stack([1.0 - second, second], axis=1).astype(np.float32)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * len(skin.vertices))
    binding.CreateJointWeightsPrimvar(False, 2).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))


def _add_fur(stage: Usd.Stage, skin: trimesh.Trimesh) -> None:
    """Hairs out of the skin, combed along the arm; `skinprim` and `skinprimuv` say where each grows."""
    roots, faces = trimesh.sample.sample_surface(skin, HAIRS, seed=1)
    places = trimesh.triangles.points_to_barycentric(skin.triangles[faces], roots)
    along = np.linspace(0.0, HAIR, POINTS)[:, None]
    points = [
        root + along * normal + 4.0 * along**2 * np.array([1.0, -0.6, 0.0])
        for root, normal in zip(roots, skin.face_normals[faces], strict=True)
    ]
    fur = UsdGeom.BasisCurves.Define(stage, "/World/Fur")
    make_smooth(fur)
    fur.CreateCurveVertexCountsAttr([POINTS] * HAIRS)
    fur.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.concatenate(points).astype(np.float32)))
    fur.CreateWidthsAttr([1e-4])
    fur.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    fur.CreateDisplayColorAttr([(0.22, 0.12, 0.05)])
    author_roots(fur, faces, places)
