"""What scenes and examples made by hand write on USD stages, and read from them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt


def new_stage(path: Path, frames: tuple[int, int] | None = None, rate: float = 24.0) -> Usd.Stage:
    """In metres, Y up.  frames: the first and the last, `rate` a second; None: nothing moves."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    if frames is not None:
        stage.SetTimeCodesPerSecond(rate)
        stage.SetStartTimeCode(frames[0])
        stage.SetEndTimeCode(frames[1])
    return stage


def new_world(
    path: Path, frames: tuple[int, int] | None = None, rate: float = 24.0, meters: float = 1.0
) -> Usd.Stage:
    """`new_stage` with units of so many metres, whose default prim is an Xform /World."""
    stage = new_stage(path, frames, rate)
    UsdGeom.SetStageMetersPerUnit(stage, meters)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    return stage


def define_mesh(
    stage: Usd.Stage, path: str, points: np.ndarray, triangles: np.ndarray, colour: Iterable[float]
) -> UsdGeom.Mesh:
    """points: (n, 3) [stage units].  triangles: (m, 3).  colour: linear RGB."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([3] * len(triangles))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.astype(np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*colour)])
    return mesh


def define_curves(
    stage: Usd.Stage, path: str, frames: np.ndarray, width: float, colour: np.ndarray | Iterable[float]
) -> UsdGeom.BasisCurves:
    """Polygons, from time code 0 on.

    frames: (frame_count, curve_count, point_count, 3) [stage units].  width: [stage units] they are drawn with.
    colour: linear RGB of all, (3,), or of each, (curve_count, 3).
    """
    curves = UsdGeom.BasisCurves.Define(stage, path)
    curves.CreateTypeAttr(UsdGeom.Tokens.linear)
    curves.CreateCurveVertexCountsAttr([frames.shape[2]] * frames.shape[1])
    curves.CreateWidthsAttr([width])
    curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    colours = np.array(colour, dtype=np.float32)
    curves.CreateDisplayColorAttr(Vt.Vec3fArray.FromNumpy(colours.reshape(-1, 3)))
    one = colours.ndim == 1
    curves.GetDisplayColorPrimvar().SetInterpolation(UsdGeom.Tokens.constant if one else UsdGeom.Tokens.uniform)
    for frame, points in enumerate(frames):
        curves.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points.reshape(-1, 3).astype(np.float32)), frame)
    return curves


def make_smooth(curves: UsdGeom.BasisCurves) -> None:
    """Drawn as Catmull-Rom splines through their points."""
    curves.CreateTypeAttr(UsdGeom.Tokens.cubic)
    curves.CreateBasisAttr(UsdGeom.Tokens.catmullRom)
    curves.CreateWrapAttr(UsdGeom.Tokens.pinned)


def add_camera(stage: Usd.Stage, path: str, place: Iterable[float], down: float) -> UsdGeom.Camera:
    """One that looks along -Z and `down` [degrees] from it."""
    camera = UsdGeom.Camera.Define(stage, path)
    camera.CreateFocalLengthAttr(50.0)
    camera.AddTranslateOp().Set(Gf.Vec3d(*place))
    camera.AddRotateXOp().Set(-down)
    return camera


def author_parameters(prim: Usd.Prim, values: Mapping[str, float], role: str | None = None) -> None:
    """`plait:` attributes of a prim."""
    if role is not None:
        prim.CreateAttribute("plait:role", Sdf.ValueTypeNames.Token).Set(role)
    for name, value in values.items():
        prim.CreateAttribute(f"plait:{name}", Sdf.ValueTypeNames.Float).Set(value)


def author_roots(curves: UsdGeom.BasisCurves, triangle: np.ndarray, weights: np.ndarray) -> None:
    """Where on a mesh of triangles each curve grows: (curve_count,), and (curve_count, 3) of its corners."""
    primvars, types = UsdGeom.PrimvarsAPI(curves), Sdf.ValueTypeNames
    faces = Vt.IntArray.FromNumpy(triangle.astype(np.int32))
    primvars.CreatePrimvar("skinprim", types.IntArray, UsdGeom.Tokens.uniform).Set(faces)
    uv = Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(weights[:, 1:], np.float32))
    primvars.CreatePrimvar("skinprimuv", types.Float2Array, UsdGeom.Tokens.uniform).Set(uv)


def read_roots(curves: Usd.Prim) -> tuple[np.ndarray, np.ndarray]:
    """What `author_roots` wrote."""
    uv = np.array(curves.GetAttribute("primvars:skinprimuv").Get(), dtype=float)
    return np.array(curves.GetAttribute("primvars:skinprim").Get()), np.column_stack([1.0 - uv.sum(axis=1), uv])


def frame_codes(stage: Usd.Stage) -> np.ndarray:
    """(frame_count,) all whole time codes of a stage."""
    return np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1e-6)


def read_points(prim: Usd.Prim, codes: Iterable[float]) -> np.ndarray:
    """(frame_count, point_count, 3) of a prim, in its own space."""
    points = UsdGeom.PointBased(prim).GetPointsAttr()
    return np.array([points.Get(code) for code in codes], dtype=float)


def read_triangles(mesh: Usd.Prim) -> np.ndarray:
    """(triangle_count, 3)."""
    return np.array(UsdGeom.Mesh(mesh).GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)


def pose_points(stage: Usd.Stage, path: str, codes: Iterable[float]) -> np.ndarray:
    """(frame_count, point_count, 3) where UsdSkel puts the mesh `Skin` of the SkelRoot at `path`.

    By that one's `Skeleton`, and in its space.
    """
    cache, prim = UsdSkel.Cache(), stage.GetPrimAtPath(f"{path}/Skin")
    cache.Populate(UsdSkel.Root(stage.GetPrimAtPath(path)), Usd.PrimDefaultPredicate)
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath(f"{path}/Skeleton")))
    query, frames = cache.GetSkinningQuery(prim), []
    for code in codes:
        points = UsdGeom.Mesh(prim).GetPointsAttr().Get()
        query.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(code), points, code)
        frames.append(np.array(points, dtype=float))
    return np.array(frames)
