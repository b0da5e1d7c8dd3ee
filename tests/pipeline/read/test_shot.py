"""The shot as a whole: units, gravity, range, warnings; and every real sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from plait.pipeline import inspect
from plait.pipeline.config import Config
from plait.pipeline.errors import InputError
from plait.pipeline.read import read_shot
from plait.pipeline.shot import Shot

HAIR = """
def BasisCurves "Hair"
{
    uniform token type = "linear"
    int[] curveVertexCounts = [2]
    point3f[] points = [(0, 0, 0), (0, 10, 0)]
    float[] widths = [0.01] (interpolation = "constant")
}
"""


def _samples() -> list[str]:
    folder = Path(__file__).resolve().parents[4] / "shared" / "samples"
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*.usd*")) if folder.is_dir() else [""]


@pytest.mark.parametrize("sample", _samples())
def test_every_sample_is_read_or_refused_in_one_line(sample: str, shared: Path) -> None:
    """Finite and consistent with the scene's contract; or one line that says why not."""
    try:
        shot = read_shot(shared / "samples" / sample, Config())
    except InputError as error:
        assert "\n" not in str(error) and str(error).startswith(str(shared))
        return
    _assert_sound(shot)
    assert all(prim.reason for prim in shot.prims if prim.role == "skipped" or not prim.supported)


def _assert_sound(shot: Shot) -> None:
    for strands in shot.scene.strands:
        assert np.all(np.isfinite(strands.points)) and np.all(np.diff(strands.offsets) >= 2)
        assert np.all(strands.radius > 0.0) and len(strands.radius) == len(strands.points)
        for name in ("density", "stretch_stiffness", "bend_stiffness", "twist_stiffness"):
            assert np.all(getattr(strands, name) > 0.0) and len(getattr(strands, name)) == strands.strand_count
        surface = shot.scene.surfaces[strands.roots.surface]
        assert strands.roots.triangle.min() >= 0 and strands.roots.triangle.max() < len(surface.triangles)
        np.testing.assert_allclose(strands.roots.barycentric.sum(axis=1), 1.0, rtol=1e-9)
    for surface in shot.scene.surfaces:
        assert surface.triangles.min() >= 0 and surface.triangles.max() < len(surface.points)
        for code in (shot.info.start, 0.5 * (shot.info.start + shot.info.end) + 0.3, shot.info.end):
            pose = surface.motion.pose(code / shot.info.time_codes_per_second)
            assert np.all(np.isfinite(pose.joint_transforms))
    for output in shot.curves:
        strands = shot.scene.strands[output.strands]
        assert len(output.point_map) == len(output.widths)
        assert output.point_map.min() >= 0 and output.point_map.max() < len(strands.points)


def test_gravity(read) -> None:
    down = read(HAIR, up="Y").scene.gravity
    np.testing.assert_allclose(down, [0, -9.81, 0])
    np.testing.assert_allclose(read(HAIR, up="Z").scene.gravity, [0, 0, -9.81])
    scene = 'def PhysicsScene "P" {\n %s \n}\n'
    np.testing.assert_allclose(read(HAIR + scene % "", up="Z", meters=0.01).scene.gravity, [0, 0, -9.81])
    authored = scene % "float physics:gravityMagnitude = 162\n vector3f physics:gravityDirection = (0, 0, 2)"
    np.testing.assert_allclose(read(HAIR + authored, meters=0.01).scene.gravity, [0, 0, 1.62], rtol=1e-6)
    none = scene % "float physics:gravityMagnitude = 0"
    np.testing.assert_allclose(read(HAIR + none).scene.gravity, 0.0)


def test_of_several_scenes_that_which_owns_bodies_has_the_gravity(read) -> None:
    scenes = "".join(
        f'def PhysicsScene "{name}" {{\n float physics:gravityMagnitude = {size}\n}}\n'
        for name, size in (("First", 1), ("Second", 2))
    )
    owned = 'def Cube "Box" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"]) {{\n{}\n}}\n'
    for line, size in (("", 1), ("rel physics:simulationOwner = </Second>", 2)):
        shot = read(scenes + owned.format(line))
        np.testing.assert_allclose(shot.scene.gravity, [0, -size, 0])
        assert any("one of 2 physics scenes" in warning for warning in shot.warnings)


def test_what_is_not_authored_is_told(tmp_path: Path) -> None:
    path = tmp_path / "bare.usda"
    path.write_text("#usda 1.0\n" + HAIR)
    shot = read_shot(path, Config())
    for key in ("metersPerUnit", "upAxis", "timeCodesPerSecond", "startTimeCode and endTimeCode"):
        assert any(f"{key}: not authored" in warning for warning in shot.warnings)
    assert (shot.info.meters_per_unit, shot.info.up_axis, shot.info.time_codes_per_second) == (0.01, "Y", 24.0)
    assert (read_shot(path, Config(), (5.0, 9.0)).info.start) == 5.0


def test_frames_outside_the_range_are_told(write) -> None:
    path = write(HAIR)
    assert read_shot(path, Config(), (1.0, 10.0)).warnings == ()
    assert "asked for" in read_shot(path, Config(), (0.0, 12.0)).warnings[0]


def test_info_repeats_the_stage(read) -> None:
    info = read(HAIR, meters=0.01, up="Z").info
    assert (info.start, info.end, info.up_axis, info.meters_per_unit) == (1.0, 10.0, "Z", 0.01)
    assert (info.time_codes_per_second, info.frames_per_second) == (24.0, 24.0)


def test_reading_twice_gives_the_same_bits(shared: Path) -> None:
    path = shared / "samples/Autodesk_arnold-usd/testsuite/test_1814/data/test.usda"
    one, two = read_shot(path, Config()), read_shot(path, Config())
    for a, b in zip(one.scene.strands, two.scene.strands, strict=True):
        assert (
            a.points.tobytes() == b.points.tobytes() and a.bend_stiffness.tobytes() == b.bend_stiffness.tobytes()
        )
    assert one.scene.origin.tobytes() == two.scene.origin.tobytes()


def test_unsupported_roles_are_reported_not_refused(shared: Path) -> None:
    shot = read_shot(shared / "samples/newton-physics_newton/newton/tests/assets/deformables_mixed.usda", Config())
    roles = {prim.path: (prim.role, prim.supported) for prim in shot.prims}
    assert roles["/World/CableA/sim"] == ("strands", True)
    assert roles["/World/Cloth/sim"] == ("cloth", False)
    assert roles["/World/SoftA/sim"] == ("flesh", True)
    cable = shot.scene.strands[0]
    np.testing.assert_allclose(cable.bend_stiffness, 0.0023561945, rtol=1e-6)
    np.testing.assert_allclose(cable.stretch_stiffness, 628.31853, rtol=1e-6)
    np.testing.assert_allclose(cable.radius, 0.01, rtol=1e-6)


def test_inspect_as_data_and_as_text(write, capsys: pytest.CaptureFixture) -> None:
    path = write(HAIR + 'def Cube "Box" {}\n')
    data = inspect.as_data(read_shot(path, Config()))
    assert data["stages"] == ["kinematics", "strands"]
    assert data["sizes"]["strands"] == 1 and data["sizes"]["strand points"] == 2
    assert {prim["path"]: prim["role"] for prim in data["prims"]} == {"/Hair": "strands", "/Box": "skipped"}
    inspect.show(path, Config())
    text = capsys.readouterr().out
    assert "/Hair" in text and "neither skinned nor physics" in text and "kinematics, strands" in text


def test_inspect_of_a_shot_with_nothing_to_simulate(read) -> None:
    assert inspect.stages(read('def Cube "Box" {}\n')) == []
