"""Flesh through the command line: a jelly and a tet mesh fall, a limb follows its skeleton, hair rides along."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from plait.assets.stages import new_world
from plait.pipeline import preview
from plait.pipeline.cli import main
from plait.pipeline.compare import compare
from plait.pipeline.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_FAILED, EXIT_STOPPED, PlaitError
from plait.pipeline.validate import validate, validator_findings
from plait.solver.diagnostics import Diverged
from plait.solver.step import Simulation

RATE, FRAMES = 24.0, 5
LIMB, BLOB, HAIR = "/World/Body/Limb", "/World/Blob", "/World/Body/Hair"


def write_shot(path: Path) -> Path:
    """In centimetres: a limb on two joints that swings, hair on it, and a tet mesh that falls beside it."""
    stage = new_world(path, (1, FRAMES), RATE, meters=0.01)
    root = UsdSkel.Root.Define(stage, "/World/Body")
    root.CreateExtentAttr([(-20, -20, -20), (20, 20, 20)])
    _limb(stage, _skeleton(stage))
    _blob(stage)
    hair = UsdGeom.BasisCurves.Define(stage, HAIR)
    hair.CreateTypeAttr("linear")
    hair.CreateCurveVertexCountsAttr([3])
    hair.CreatePointsAttr([(0, 20, 0), (0, 23, 0), (0, 26, 0)])
    hair.CreateWidthsAttr([0.01])
    hair.SetWidthsInterpolation("constant")
    hair.CreateExtentAttr([(-1, 19, -1), (1, 27, 1)])
    _role(hair, "strands")
    stage.Save()
    return path


def _role(schema: UsdGeom.Imageable, role: str) -> None:
    schema.GetPrim().CreateAttribute("plait:role", Sdf.ValueTypeNames.Token).Set(role)


def _skeleton(stage: Usd.Stage) -> UsdSkel.Skeleton:
    skeleton = UsdSkel.Skeleton.Define(stage, "/World/Body/Rig")
    joints, heights = ["A", "A/B", "A/B/C"], (-20.0, 0.0, 20.0)
    skeleton.CreateJointsAttr(joints)
    binds = [Gf.Matrix4d().SetTranslate((0, y, 0)) for y in heights]
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray(binds))
    rests = [binds[0], *(Gf.Matrix4d().SetTranslate((0, 20, 0)) for _ in range(2))]
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray(rests))
    animation = UsdSkel.Animation.Define(stage, "/World/Body/Rig/Swing")
    animation.CreateJointsAttr(joints)
    animation.CreateTranslationsAttr([(0, -20, 0), (0, 20, 0), (0, 20, 0)])
    animation.CreateScalesAttr(Vt.Vec3hArray([(1, 1, 1)] * 3))
    turns = animation.CreateRotationsAttr()
    for code in range(1, FRAMES + 1):
        turn = Gf.Quatf(Gf.Rotation((0, 0, 1), 6.0 * (code - 1)).GetQuat())
        turns.Set([Gf.Quatf(1.0), turn, Gf.Quatf(1.0)], code)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    return skeleton


def _limb(stage: Usd.Stage, skeleton: UsdSkel.Skeleton) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    points = ball.vertices * [7.0, 20.0, 7.0]
    mesh = UsdGeom.Mesh.Define(stage, LIMB)
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([3] * len(ball.faces))
    mesh.CreateFaceVertexIndicesAttr(ball.faces.ravel().tolist())
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(ball.vertices.astype(np.float32)))
    mesh.SetNormalsInterpolation("vertex")
    upper = np.clip(0.5 + points[:, 1] / 10.0, 0.0, 1.0)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(False, 2).Set(Vt.IntArray([0, 1] * len(points)))
    weights = np.stack([1.0 - upper, upper], axis=1).ravel().astype(np.float32)
    binding.CreateJointWeightsPrimvar(False, 2).Set(Vt.FloatArray.FromNumpy(weights))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    mesh.GetPrim().CreateAttribute("plait:tetEdge", Sdf.ValueTypeNames.Float).Set(4.0)
    _role(mesh, "flesh")


def _blob(stage: Usd.Stage) -> None:
    mesh = UsdGeom.TetMesh.Define(stage, BLOB)
    mesh.CreatePointsAttr([(0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10), (10, 10, 10)])
    mesh.CreateTetVertexIndicesAttr([(0, 1, 2, 3), (1, 2, 3, 4)])
    mesh.CreateSurfaceFaceVertexIndicesAttr(UsdGeom.TetMesh.ComputeSurfaceFaces(mesh))
    mesh.CreateExtentAttr([(0, 0, 0), (10, 10, 10)])
    mesh.AddTranslateOp().Set((60, 0, 0))
    mesh.AddRotateYOp().Set(30)
    _role(mesh, "flesh")


def sim(shot: Path, output: Path, *more: str) -> int:
    arguments = ["--progress", "none", "--preroll", "0", "--substeps", "2", "--chunk", "2", *more]
    return main(["sim", str(shot), "-o", str(output), *arguments])


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> Path:
    return write_shot(tmp_path_factory.mktemp("flesh") / "shot.usda")


@pytest.fixture(scope="module")
def result(shot, tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("result") / "out.usda"
    assert sim(shot, output) == EXIT_DONE
    return output


def points(stage: Usd.Stage, path: str, code: float, name: str = "points") -> np.ndarray:
    return np.array(stage.GetPrimAtPath(path).GetAttribute(name).Get(code), float)


def samples(path: Path) -> dict[tuple[str, float], bytes]:
    """Bits of every simulated value."""
    stage, found = Usd.Stage.Open(str(path)), {}
    for prim in (LIMB, BLOB, HAIR):
        for name in ("points", "velocities", "extent", "normals"):
            attribute = stage.GetPrimAtPath(prim).GetAttribute(name)
            for code in attribute.GetTimeSamples() if attribute else ():
                found[f"{prim}.{name}", code] = np.asarray(attribute.Get(code)).tobytes()
    return found


def test_the_first_frame_is_as_drawn(shot, result):
    """Without pre-roll: the skin in the pose of the first frame, to 1e-5 of its size, and the tets' own points."""
    before, after = Usd.Stage.Open(str(shot)), Usd.Stage.Open(str(result))
    for path, size in ((LIMB, 40.0), (BLOB, 17.0)):
        np.testing.assert_allclose(points(after, path, 1), points(before, path, 1), atol=1e-5 * size)
    np.testing.assert_allclose(points(after, LIMB, 1, "normals"), points(before, LIMB, 1, "normals"), atol=1e-5)


def test_a_free_tet_mesh_falls(result):
    """Nothing near it: its centre of mass goes g t^2 / 2 down but for the step, h g t / 2 at most.

    A tet shares its mass among its nodes; the second has twice the volume. To a hundredth: that units, axes and
    rates are right is what is looked at here.
    """
    stage = Usd.Stage.Open(str(result))
    mass = np.array([1.0, 3.0, 3.0, 3.0, 2.0]) / 12.0
    for code in range(1, FRAMES + 1):
        time, step = (code - 1) / RATE, 0.5 / RATE
        way = mass @ (points(stage, BLOB, code) - points(stage, BLOB, 1))
        np.testing.assert_allclose(way[[0, 2]], 0.0, atol=0.14)
        assert abs(way[1] + 981.0 * time**2 / 2.0) <= 981.0 * time * step / 2.0 + 0.14
        np.testing.assert_allclose(mass @ points(stage, BLOB, code, "velocities"), [0, -981.0 * time, 0], atol=1.6)


def test_a_limb_follows_its_skeleton_and_hair_the_limb(result):
    """The joint turns 24 degrees: the limb's end goes along to within a quarter of the way, the hair with it."""
    stage = Usd.Stage.Open(str(result))
    first, last = points(stage, LIMB, 1), points(stage, LIMB, FRAMES)
    tip = int(np.argmax(first[:, 1]))
    way = last[tip] - first[tip]
    expected = 20.0 * np.array([-np.sin(np.radians(24.0)), np.cos(np.radians(24.0)) - 1.0, 0.0])
    assert np.linalg.norm(way - expected) < 0.25 * np.linalg.norm(expected)
    root = points(stage, HAIR, FRAMES)[0] - points(stage, HAIR, 1)[0]
    np.testing.assert_allclose(root, way, atol=0.05)


def test_what_is_written_is_sound(shot, result):
    """Nothing is skinned twice, extents hold, no validator finds more than in the source; sizes do not change."""
    assert validator_findings(Usd.Stage.Open(str(shot))) == []
    assert validate(result) == []
    before, after = Usd.Stage.Open(str(shot)), Usd.Stage.Open(str(result))
    for name in ("tetVertexIndices", "surfaceFaceVertexIndices"):
        assert np.array_equal(points(before, BLOB, 1, name), points(after, BLOB, 1, name))
    assert len(points(after, LIMB, 3)) == len(points(before, LIMB, 1))
    metrics = json.loads(result.with_suffix(".metrics.json").read_text())
    assert all({"tets", "strands"} <= frame.keys() for frame in metrics["frames"])


def test_again_and_resumed_it_ends_in_the_same_bits(shot, result, tmp_path, monkeypatch):
    """A run stopped after its first chunk goes on from its checkpoint: all of the bodies' state is in it."""
    output = tmp_path / "out.usda"
    command = [sys.executable, "-m", "plait.pipeline.cli", "sim", str(shot), "-o", str(output), "--preroll", "0"]
    command += ["--substeps", "2", "--chunk", "2", "--progress", "openjd"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            if "frame 3" in line:
                process.terminate()
                break
        process.communicate()
    assert process.returncode == EXIT_STOPPED
    expected = samples(result)
    assert 0 < len(samples(output)) < len(expected)
    assert sim(shot, output, "--resume") == EXIT_DONE
    assert samples(output) == expected


@pytest.mark.parametrize("prim", [LIMB, BLOB])
def test_points_that_faces_miss_are_found(result, tmp_path, prim):
    """A cache that lost points does not pass."""
    stage = Usd.Stage.Open(str(result))
    attribute = stage.GetPrimAtPath(prim).GetAttribute("points")
    short = Vt.Vec3fArray(list(attribute.Get(2))[:-1])
    over = Sdf.Layer.CreateAnonymous(".usda")
    over.TransferContent(stage.GetRootLayer())
    over.subLayerPaths = [str(result.parent / path) for path in over.subLayerPaths]
    spec = Sdf.AttributeSpec(Sdf.CreatePrimInLayer(over, prim), "points", Sdf.ValueTypeNames.Point3fArray)
    over.SetTimeSample(spec.path, 2.0, short)
    over.Export(str(tmp_path / "spoilt.usda"))
    assert "plait:Count" in {finding.check for finding in validate(tmp_path / "spoilt.usda")}


def test_packed_and_compared_it_is_the_same(result, tmp_path):
    packed = tmp_path / "packed.usdc"
    assert main(["pack", str(result), "-o", str(packed)]) == EXIT_DONE
    comparison = compare(result, packed, 0.0)
    assert comparison.ok
    of_limb = next(prim for prim in comparison.prims if prim.path == LIMB)
    assert len(of_limb.codes) == FRAMES and of_limb.length_change is None


def test_shutter_samples(shot, tmp_path):
    output = tmp_path / "out.usda"
    assert sim(shot, output, "-f", "1:2", "--set", "output.shutter=[-0.25, 0.25]") == EXIT_DONE
    stage = Usd.Stage.Open(str(output))
    codes = stage.GetPrimAtPath(LIMB).GetAttribute("points").GetTimeSamples()
    assert codes == [0.75, 1.0, 1.25, 1.75, 2.0, 2.25]


def test_divergence_is_told_in_one_line(shot, tmp_path, capsys, monkeypatch):
    def diverge(self, end, substeps=None):
        raise Diverged("position", f"{LIMB}, node 3 of its tets", end)

    monkeypatch.setattr(Simulation, "advance_frame", diverge)
    assert sim(shot, tmp_path / "out.usda") == EXIT_FAILED
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{LIMB}, node 3" in line and "frame 2" in line and "softer flesh" in line


@pytest.mark.parametrize("which", ["shot", "result"])
def test_bones_are_shown_through_the_skin(which, tmp_path, request, capsys):
    """Blue dots where without `--core` there are none, on the shot and on its result; how many are told."""
    try:
        preview.probe()
    except PlaitError as error:
        pytest.skip(str(error))
    path, counts = request.getfixturevalue(which), []
    for more in ([], ["--core"]):
        picture = tmp_path / f"{len(more)}.png"
        assert main(["preview", str(path), "-o", str(picture), "-f", "3", "--size", "320x240", *more]) == EXIT_DONE
        red, _, blue = np.moveaxis(np.asarray(Image.open(picture).convert("RGB")).astype(int), 2, 0)
        counts.append(int((blue > red + 60).sum()))
    assert counts[0] == 0 and counts[1] > 50
    lines = capsys.readouterr().err.splitlines()
    assert any(LIMB in line and "nodes are bone" in line for line in lines)
    assert any(BLOB in line and "no nodes are bone" in line for line in lines)


def test_bones_of_a_shot_without_flesh_are_refused(tmp_path, capsys):
    stage = Usd.Stage.CreateNew(str(tmp_path / "bare.usda"))
    UsdGeom.Sphere.Define(stage, "/Ball")
    stage.Save()
    command = ["preview", str(tmp_path / "bare.usda"), "-o", str(tmp_path / "bare.png"), "--core"]
    assert main(command) == EXIT_BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert "has no flesh" in line and not (tmp_path / "bare.png").exists()
