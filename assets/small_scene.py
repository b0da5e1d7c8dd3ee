"""The small shot of the tests: twelve strands on a nodding head that brush a ball, in centimetres, Y up.

`python -m plait.assets.small_scene` writes `small/shot.usda` beside this file; with `--reference` it simulates the
shot too, each strand for itself, and writes the reference cache `small/reference.usdc`.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdSkel, Vt

from plait.assets.stages import make_smooth

FOLDER = Path(__file__).parent / "small"
SHOT, REFERENCE = "shot.usda", "reference.usdc"
# Where strands meet, a rounding of the input grows to millimetres in a second: nothing to compare machines by.
SETTINGS = ("solver.strand_contact.method=none",)
FRAMES, RATE = 24, 24.0

RADIUS, HEIGHT = 9.0, 36.0  # [cm] of the head: a capsule that stands on the origin
AROUND, UP = 16, 15
JOINTS = ("Base", "Base/Middle", "Base/Middle/Top")
JOINT_HEIGHTS = (4.0, 14.0, 24.0)  # [cm]
STRANDS, POINTS, LENGTH = 12, 12, 26.0  # length [cm]
DIGITS = 4  # written: a micrometre, the same on machines whose sines differ in the last place


def write(folder: Path) -> Path:
    """Writes `folder`/shot.usda, always the same bytes, and returns its path."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = open_stage(layer)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    root = UsdSkel.Root.Define(stage, "/World/Head")
    root.CreateExtentAttr(Vt.Vec3fArray([(-40, -5, -40), (40, 50, 40)]))
    skeleton = _skeleton(stage)
    points, faces = capsule(RADIUS, HEIGHT, AROUND, UP)
    points = np.round(points, DIGITS)
    _skin(stage, skeleton, points, faces)
    _strands(stage, points, faces)
    _ball(stage)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / SHOT
    layer.Export(str(path))
    return path


def open_stage(layer: Sdf.Layer) -> Usd.Stage:
    """The stage of a layer, with this shot's units and range."""
    stage = Usd.Stage.Open(layer)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(FRAMES)
    stage.SetTimeCodesPerSecond(RATE)
    stage.SetFramesPerSecond(RATE)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    return stage


def write_reference(folder: Path, settings: tuple[str, ...] = SETTINGS) -> Path:
    """Simulates `folder`/shot.usda and packs the result into `folder`/reference.usdc, whose path it returns.

    settings: assignments over the defaults.
    """
    from plait.pipeline import config, driver, pack

    with tempfile.TemporaryDirectory() as work:
        output = Path(work) / "out.usda"
        driver.simulate(folder / SHOT, output, config.load(None, list(settings)))
        pack.pack(output, folder / REFERENCE, overwrite=True)
    return folder / REFERENCE


def _skeleton(stage: Usd.Stage) -> UsdSkel.Skeleton:
    """Three joints up the middle; the upper two nod forward, hold, and turn back, leaning sideways meanwhile."""
    skeleton = UsdSkel.Skeleton.Define(stage, "/World/Head/Skeleton")
    heights = np.array(JOINT_HEIGHTS)
    steps = np.diff(heights, prepend=0.0)
    skeleton.CreateJointsAttr(JOINTS)
    skeleton.CreateBindTransformsAttr(_lifts(heights))
    skeleton.CreateRestTransformsAttr(_lifts(steps))
    animation = UsdSkel.Animation.Define(stage, "/World/Head/Skeleton/Nod")
    animation.CreateJointsAttr(JOINTS)
    animation.CreateTranslationsAttr(Vt.Vec3fArray([(0.0, float(step), 0.0) for step in steps]))
    animation.CreateScalesAttr(Vt.Vec3hArray([(1.0, 1.0, 1.0)] * len(JOINTS)))
    rotations = animation.CreateRotationsAttr()
    for code in range(1, FRAMES + 1):
        along = (code - 1) / (FRAMES - 1)
        nod = 24.0 * np.sin(np.pi * min(1.0, 1.6 * along)) ** 2
        lean = 9.0 * np.sin(2.0 * np.pi * along) * along
        turn = _quaternion(nod, (1, 0, 0)) * _quaternion(lean, (0, 0, 1))
        rotations.Set(Vt.QuatfArray([Gf.Quatf(1.0), turn, turn]), code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    return skeleton


def _lifts(heights: np.ndarray) -> Vt.Matrix4dArray:
    return Vt.Matrix4dArray([Gf.Matrix4d().SetTranslate(Gf.Vec3d(0, float(height), 0)) for height in heights])


def _quaternion(degrees: float, axis: tuple[int, int, int]) -> Gf.Quatf:
    half = np.radians(degrees) / 2.0
    vector = [float(np.round(component * np.sin(half), 7)) for component in axis]
    return Gf.Quatf(float(np.round(np.cos(half), 7)), Gf.Vec3f(*vector))


def fans(faces: list[list[int]]) -> np.ndarray:
    """(n, 3) int32: triangles of faces, round the first corner of each."""
    return np.array([[face[0], *face[k : k + 2]] for face in faces for k in range(1, len(face) - 1)], np.int32)


def capsule(radius: float, height: float, around: int, rings: int) -> tuple[np.ndarray, list[list[int]]]:
    """((n, 3) points, faces counter-clockwise from outside) of a capsule that stands on the origin along Y.

    A pole, rings of `around` points, a pole. Rings lie evenly along the outline.
    """
    cap, side = 0.5 * np.pi * radius, height - 2.0 * radius
    along = (2.0 * cap + side) * np.arange(1, rings + 1) / (rings + 1)
    polar = np.where(along < cap, along, np.where(along > cap + side, along - side, cap)) / radius
    level = radius - radius * np.cos(polar) + np.clip(along - cap, 0.0, side)
    angle = 2.0 * np.pi * np.arange(around) / around
    circle = np.stack([np.sin(angle), np.zeros(around), np.cos(angle)], axis=1)
    body = circle * (radius * np.sin(polar))[:, None, None] + np.array([0.0, 1.0, 0.0]) * level[:, None, None]
    points = np.concatenate([[[0.0, 0.0, 0.0]], body.reshape(-1, 3), [[0.0, height, 0.0]]])

    def at(ring: int, column: int) -> int:
        return 1 + ring * around + column % around

    last = len(points) - 1
    faces = [[0, at(0, k + 1), at(0, k)] for k in range(around)]
    faces += [
        [at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)]
        for ring in range(rings - 1)
        for k in range(around)
    ]
    return points, faces + [[at(rings - 1, k), at(rings - 1, k + 1), last] for k in range(around)]


def _skin(stage: Usd.Stage, skeleton: UsdSkel.Skeleton, points: np.ndarray, faces: list[list[int]]) -> None:
    """The capsule, bound to the two joints about each point's height; weights blend from one to the next."""
    mesh = UsdGeom.Mesh.Define(stage, "/World/Head/Skin")
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreatePointsAttr(_vectors(points))
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([corner for face in faces for corner in face])
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
    mesh.CreateDisplayColorAttr([(0.80, 0.58, 0.46)])
    place = np.interp(points[:, 1], JOINT_HEIGHTS, np.arange(len(JOINTS)))
    lower = np.minimum(place.astype(int), len(JOINTS) - 2)
    share = place - lower
    weight = np.round(share * share * (3.0 - 2.0 * share), DIGITS)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(False, 2).Set(Vt.IntArray(np.stack([lower, lower + 1], 1).ravel().tolist()))
    binding.CreateJointWeightsPrimvar(False, 2).Set(
        Vt.FloatArray(np.stack([1.0 - weight, weight], 1).ravel().tolist())
    )
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))


def _strands(stage: Usd.Stage, points: np.ndarray, faces: list[list[int]]) -> None:
    """A fringe all along the front of the upper half: out of the skin, over, and down."""
    columns = [(k - STRANDS // 4) % AROUND for k in range(STRANDS // 2)]
    grown = [(row, column) for row in (UP - 4, UP - 3) for column in columns]
    prims = [AROUND + row * AROUND + column for row, column in grown]
    places = [(0.25 + 0.04 * (k % 7), 0.70 - 0.05 * (k % 5)) for k in range(STRANDS)]
    drawn = np.concatenate([_drawn(points[faces[f]], *uv) for f, uv in zip(prims, places, strict=True)])
    curves = UsdGeom.BasisCurves.Define(stage, "/World/Hair")
    make_smooth(curves)
    curves.CreateCurveVertexCountsAttr([POINTS] * STRANDS)
    curves.CreatePointsAttr(_vectors(drawn))
    curves.CreateWidthsAttr([0.1])
    curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    curves.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(curves, Usd.TimeCode.Default()))
    curves.CreateDisplayColorAttr([(0.28, 0.15, 0.07)])
    curves.GetPrim().SetMetadata(
        "apiSchemas", Sdf.TokenListOp.Create(prependedItems=["PhysicsCurvesDeformableSimAPI"])
    )
    primvars = UsdGeom.PrimvarsAPI(curves)
    uniform = UsdGeom.Tokens.uniform
    primvars.CreatePrimvar("skinprim", Sdf.ValueTypeNames.IntArray, uniform).Set(prims)
    primvars.CreatePrimvar("skinprimuv", Sdf.ValueTypeNames.Float2Array, uniform).Set(places)
    # 1e8 Pa in kg / (cm s2): a bristle that gives way to its own weight, but not all of the way.
    curves.GetPrim().CreateAttribute("plait:youngsModulus", Sdf.ValueTypeNames.Float).Set(1e6)


def _drawn(corners: np.ndarray, u: float, v: float) -> np.ndarray:
    """(POINTS, 3) a strand from the place (u, v) of a quad: along its normal, turning down under its own arc."""
    c0, c1, c2, c3 = corners
    root = (1 - u) * (1 - v) * c0 + (1 - u) * v * c1 + u * v * c2 + u * (1 - v) * c3
    normal = np.cross(c2 - c0, c3 - c1)
    normal /= np.linalg.norm(normal)
    down = np.array([0.0, -1.0, 0.0])
    step = LENGTH / (POINTS - 1)
    line = [root]
    for k in range(POINTS - 1):
        turned = min(1.0, k / 3.0)
        direction = (1.0 - turned) * normal + turned * (down + 0.12 * normal)
        line.append(line[-1] + step * direction / np.linalg.norm(direction))
    return np.array(line)


def _ball(stage: Usd.Stage) -> None:
    """A ball in front of the fringe that is lifted into it and lowered again."""
    ball = UsdGeom.Sphere.Define(stage, "/World/Ball")
    ball.CreateRadiusAttr(5.0)
    ball.CreateExtentAttr(Vt.Vec3fArray([(-5, -5, -5), (5, 5, 5)]))
    ball.CreateDisplayColorAttr([(0.16, 0.36, 0.58)])
    UsdPhysics.CollisionAPI.Apply(ball.GetPrim())
    translate = ball.AddTranslateOp()
    for code in range(1, FRAMES + 1):
        along = np.sin(np.pi * (code - 1) / (FRAMES - 1)) ** 2
        place = np.round([-12.0 + 14.0 * along, 8.0 + 4.0 * along, 21.0 - 5.0 * along], DIGITS)
        translate.Set(Gf.Vec3d(*place.tolist()), code)


def _vectors(points: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray([tuple(point) for point in np.round(points, DIGITS).tolist()])


def main(
    description: str, folder: Path, write: Callable[[Path], Path], settings: tuple[str, ...] = SETTINGS
) -> None:
    """The command that writes a small shot into `folder`."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--reference", action="store_true", help="simulate it and write the reference cache too")
    options = parser.parse_args()
    print(write(folder))
    if options.reference:
        print(write_reference(folder, settings))


if __name__ == "__main__":
    main(__doc__, FOLDER, write)
