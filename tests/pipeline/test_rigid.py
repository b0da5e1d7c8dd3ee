"""Rigid props through the command line: what falls, spins and collides comes back as transforms."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from plait.assets.stages import new_stage, new_world
from plait.pipeline import driver
from plait.pipeline.cli import main
from plait.pipeline.compare import compare
from plait.pipeline.errors import EXIT_DONE, EXIT_STOPPED
from plait.pipeline.pack import pack
from plait.pipeline.stopping import StopRequest
from plait.pipeline.validate import validate

RATE, FRAMES = 24.0, 4
BALL, BRICK, HELD = "/World/Set/Ball", "/World/Set/Brick", "/World/Set/Brick/Handle"
START, SPIN = (10.0, 400.0, -30.0), 90.0  # [cm], [degrees/s]


def write_shot(path: Path) -> Path:
    """In centimetres: under a turned, moved and scaled group that moves on, a ball and a mesh that spins."""
    stage = new_world(path, (1, FRAMES), RATE, meters=0.01)
    group = UsdGeom.Xform.Define(stage, "/World/Set")
    move = group.AddTranslateOp()
    move.Set((0, 0, 0), 1)
    move.Set((5, 3, 1), FRAMES)
    group.AddRotateYOp().Set(30.0)
    group.AddScaleOp().Set((2, 2, 2))
    ball = UsdGeom.Sphere.Define(stage, BALL)
    ball.CreateRadiusAttr(5.0)
    ball.AddTranslateOp().Set(START)
    ball.AddScaleOp().Set((1, 1, 1))
    brick = UsdGeom.Mesh.Define(stage, BRICK)
    corners = [(x, y, z) for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)]
    brick.CreatePointsAttr(corners)
    brick.CreateExtentAttr([(-1, -2, -3), (1, 2, 3)])
    brick.CreateFaceVertexCountsAttr([4] * 6)
    brick.CreateFaceVertexIndicesAttr([0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3])
    brick.CreateSubdivisionSchemeAttr("none")
    brick.AddRotateZOp().Set(20.0)
    for prim in (ball.GetPrim(), brick.GetPrim()):
        body = UsdPhysics.RigidBodyAPI.Apply(prim)
        UsdPhysics.CollisionAPI.Apply(prim)
    body.CreateAngularVelocityAttr((0, SPIN, 0))
    UsdGeom.Xform.Define(stage, HELD).AddTranslateOp().Set((0, 2, 0))
    stage.Save()
    return path


def _sim(shot: Path, out: Path, *more: str) -> int:
    return main(
        ["sim", str(shot), "-o", str(out), "--preroll", "0", "--progress", "none", "--threads", "1", *more]
    )


def _world(path: Path, prim: str, code: float) -> np.ndarray:
    """(4, 4), column vectors, stage units."""
    stage = Usd.Stage.Open(str(path))
    return np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(stage.GetPrimAtPath(prim))).T


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("rigid")
    shot, out = write_shot(folder / "shot.usda"), folder / "out.usda"
    assert _sim(shot, out, "--set", "output.chunk=2") == EXIT_DONE
    return shot, out


def test_the_first_frame_is_as_drawn(result: tuple[Path, Path]) -> None:
    shot, out = result
    for prim in (BALL, BRICK, HELD):
        np.testing.assert_allclose(_world(out, prim, 1), _world(shot, prim, 1), atol=1e-4)


def test_they_do_not_fall_in_the_preroll(result: tuple[Path, Path], tmp_path: Path) -> None:
    """Held where they are drawn until the first frame: what follows is the same to the bit with a pre-roll."""
    shot, without = result
    out = tmp_path / "out.usda"
    assert _sim(shot, out, "--preroll", "3") == EXIT_DONE
    for prim in (BALL, BRICK):
        for code in range(1, FRAMES + 1):
            np.testing.assert_array_equal(_world(out, prim, code), _world(without, prim, code))


def test_a_run_that_begins_too_late_is_told(
    result: tuple[Path, Path], tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    """From frame 3 a body has fallen only if the run comes by the shot's first: two more frames of pre-roll."""
    shot, whole = result
    out = tmp_path / "out.usda"
    assert _sim(shot, out, "-f", "3") == EXIT_DONE
    assert "--preroll 2" in capfd.readouterr().err
    assert _sim(shot, out, "-f", "3", "--preroll", "2", "--overwrite") == EXIT_DONE
    assert "--preroll" not in capfd.readouterr().err
    for prim in (BALL, BRICK):
        np.testing.assert_array_equal(_world(out, prim, 3), _world(whole, prim, 3))


def test_bodies_fall_in_the_world_not_with_their_group(result: tuple[Path, Path]) -> None:
    """x = x0 + g t^2 / 2, to the first order of the step."""
    shot, out = result
    for prim in (BALL, BRICK):
        for code in range(1, FRAMES + 1):
            fallen = np.array([0.0, -0.5 * 981.0 * ((code - 1) / RATE) ** 2, 0.0])
            moved = _world(out, prim, code)[:3, 3] - _world(shot, prim, 1)[:3, 3]
            # The first-order step of gravity: at most g h t / 2, with h a substep of the default 8 a frame.
            assert np.abs(moved - fallen).max() <= 0.5 * 981.0 / RATE / 8 * (code - 1) / RATE + 1e-3


def test_a_spin_about_the_groups_axis(result: tuple[Path, Path]) -> None:
    """Turned about y, which the group keeps upright, by the rate times the time; sizes never change."""
    shot, out = result
    before, after = _world(shot, BRICK, 1)[:3, :3], _world(out, BRICK, FRAMES)[:3, :3]
    turn = after @ np.linalg.inv(before)
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-9)
    angle = np.degrees(np.arccos(0.5 * (np.trace(turn) - 1.0)))
    assert angle == pytest.approx(SPIN * (FRAMES - 1) / RATE, abs=0.5), "a lopsided body's spin wanders a little"


def test_transforms_alone_are_written(result: tuple[Path, Path]) -> None:
    _, out = result
    stage = Usd.Stage.Open(str(out))
    for path in (BALL, BRICK):
        prim = stage.GetPrimAtPath(path)
        assert [op.GetOpName() for op in UsdGeom.Xformable(prim).GetOrderedXformOps()] == [
            "xformOp:transform:plait"
        ]
        assert not prim.HasAttribute("points") or not prim.GetAttribute("points").GetTimeSamples()
    assert stage.GetPrimAtPath(BALL).GetAttribute("xformOp:translate").Get() == Gf.Vec3d(START)
    assert validate(out) == []


def test_packed_it_is_the_same_and_compare_sees_motion(result: tuple[Path, Path]) -> None:
    _, out = result
    packed = out.with_name("packed.usda")
    pack(out, packed)
    same = compare(out, packed, 0.0)
    assert same.ok and {prim.path for prim in same.prims} >= {BALL, BRICK}
    layer = Sdf.Layer.FindOrOpen(str(packed))
    name = f"{BALL}.xformOp:transform:plait"
    moved = Gf.Matrix4d(layer.QueryTimeSample(name, FRAMES))
    layer.SetTimeSample(name, FRAMES, moved.SetTranslateOnly(moved.ExtractTranslation() + Gf.Vec3d(1, 0, 0)))
    layer.Save()
    judged = compare(out, packed, 0.01)
    (other,) = [prim for prim in judged.prims if not prim.same]
    # One unit under a scale of two, in centimetres.
    assert other.path == BALL and other.largest.max() == pytest.approx(0.02, rel=1e-4)
    assert other.first_beyond == FRAMES


class _StopsSoon(StopRequest):
    """A signal that comes during the third frame."""

    asked = 0

    def __bool__(self) -> bool:
        self.asked += 1
        return self.asked >= 3


def test_resumed_it_is_the_same_to_the_bit(result: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    shot, out = result
    again = out.with_name("again.usda")
    with monkeypatch.context() as patch:
        patch.setattr(driver, "StopRequest", _StopsSoon)
        assert _sim(shot, again, "--set", "output.chunk=2") == EXIT_STOPPED
    assert _sim(shot, again, "--set", "output.chunk=2", "--resume") == EXIT_DONE
    chunks = sorted(out.with_suffix(".cache").glob("chunk.*"))
    assert len(chunks) == 2
    for chunk in chunks:
        assert (again.with_suffix(".cache") / chunk.name).read_bytes() == chunk.read_bytes()


def test_a_pendulum_hangs_on_its_hinge(tmp_path: Path) -> None:
    """A bob on a hinge of the world keeps its distance, and swings as theta'' = -(3 g / 4 l) cos(theta) starts."""
    path = tmp_path / "shot.usda"
    stage = new_stage(path, (1, FRAMES), RATE)
    UsdGeom.SetStageUpAxis(stage, "Z")
    rod = UsdGeom.Cube.Define(stage, "/Rod")
    rod.AddTranslateOp().Set((1, 0, 0))
    rod.AddScaleOp().Set((1, 0.01, 0.01))
    UsdPhysics.RigidBodyAPI.Apply(rod.GetPrim())
    UsdPhysics.CollisionAPI.Apply(rod.GetPrim())
    hinge = UsdPhysics.RevoluteJoint.Define(stage, "/Hinge")
    hinge.CreateAxisAttr("Y")
    hinge.CreateBody1Rel().SetTargets(["/Rod"])
    hinge.CreateLocalPos1Attr((-1, 0, 0))
    stage.Save()
    out = tmp_path / "out.usda"
    assert _sim(path, out, "--substeps", "32") == EXIT_DONE
    for code in range(1, FRAMES + 1):
        matrix = _world(out, "/Rod", code)
        assert np.linalg.norm(matrix[:3, 3]) == pytest.approx(1.0, abs=1e-5)
        np.testing.assert_allclose(matrix @ [-1, 0, 0, 1], [0, 0, 0, 1], atol=1e-5)
        time = (code - 1) / RATE
        angle = np.arctan2(-matrix[2, 3], matrix[0, 3])
        # A uniform rod of length 2: 3 g / (2 * 2), to the second order in time, and a first-order step's error.
        start = 0.5 * 0.75 * 9.81 * time**2
        assert angle == pytest.approx(start, abs=start**3 + 0.75 * 9.81 * time / RATE / 32 + 1e-4)


def test_hair_grows_on_a_prop_beneath_which_it_lies(tmp_path: Path) -> None:
    """Its roots keep their place in the prop's own space, where they have no velocity: the prop carries it."""
    path, out = write_shot(tmp_path / "shot.usda"), tmp_path / "out.usda"
    stage = Usd.Stage.Open(str(path))
    hair = UsdGeom.BasisCurves.Define(stage, f"{BRICK}/Turned/Hair")
    UsdGeom.Xform.Define(stage, f"{BRICK}/Turned").AddRotateYOp().Set(90.0)
    roots = [(z, 2.0, x) for x in (-0.5, 0.5) for z in (-2.0, 0.0, 2.0)]
    hair.CreateTypeAttr("linear")
    hair.CreateCurveVertexCountsAttr([5] * len(roots))
    hair.CreatePointsAttr([(x, y + 0.4 * k, z) for x, y, z in roots for k in range(5)])
    hair.CreateWidthsAttr([0.01])
    hair.SetWidthsInterpolation("constant")
    hair.GetPrim().CreateAttribute("plait:role", Sdf.ValueTypeNames.Token).Set("strands")
    stage.Save()
    assert _sim(path, out) == EXIT_DONE
    stage = Usd.Stage.Open(str(out))
    hair = UsdGeom.BasisCurves(stage.GetPrimAtPath(f"{BRICK}/Turned/Hair"))
    lengths = []
    for code in range(1, FRAMES + 1):
        points = np.array(hair.GetPointsAttr().Get(code)).reshape(len(roots), 5, 3)
        np.testing.assert_allclose(points[:, 0], roots, atol=1e-5)
        lengths.append(np.linalg.norm(np.diff(points, axis=1), axis=2))
        velocities = np.array(hair.GetVelocitiesAttr().Get(code)).reshape(len(roots), 5, 3)
        if code > 1:
            # A strand's velocity is the difference over a substep, so it lags by w^2 r h / 2, r < 4; it falls at
            # 20 units a second and more meanwhile.
            assert np.abs(velocities[:, 0]).max() < np.radians(SPIN) ** 2 * 4.0 / RATE / 8 / 2
    np.testing.assert_allclose(lengths, 0.4, rtol=1e-3)


EXAMPLES = "samples/PixarAnimationStudios_OpenUSD/pxr/usd/usdPhysics/examples"


LAST = 48  # frame, two seconds


@pytest.fixture
def simulated(shared: Path, tmp_path: Path) -> Callable[..., Path]:
    """Runs one of the examples as it is."""

    def run(name: str, *more: str) -> Path:
        shot = shared / EXAMPLES / f"usdPhysics{name}.usda"
        if not shot.is_file():
            pytest.skip("the samples do not hold it")
        out = tmp_path / "out.usda"
        assert _sim(shot, out, "-f", f"0:{LAST}", *more) == EXIT_DONE
        assert validate(out) == []
        return out

    return run


def _lowest(matrix: np.ndarray, half: float) -> float:
    """Of a cube's corners, along z."""
    corners = np.array(list(itertools.product((-half, half), repeat=3)))
    return float((corners @ matrix[2, :3] + matrix[2, 3]).min())


def test_example_a_box_comes_to_rest_on_a_box(simulated: Callable[..., Path]) -> None:
    """Its middle half its edge, 12.5, above the ground at 10, within .1 % of its size."""
    np.testing.assert_allclose(_world(simulated("BoxOnBox"), "/World/BoxActor", LAST)[2, 3], 22.5, atol=0.025)


def test_example_a_box_heavy_beyond_its_corner_stays_above_the_quad(simulated: Callable[..., Path]) -> None:
    """It stands up on the corner next to its centre of mass, which then is below the quad."""
    out = simulated("BoxOnQuad")
    for code in range(20, LAST + 1, 2):
        matrix = _world(out, "/World/BoxActor", code)
        assert _lowest(matrix, 12.5) > -0.025
    center = [(_world(out, "/World/BoxActor", code) @ [40.0, 40.0, 40.0, 1.0])[2] for code in range(30, LAST + 1)]
    assert min(center) < -40.0, "hanging straight down it is at 12.5 sqrt(3) - 40 sqrt(3) = -47.6"


def test_example_a_distance_is_kept(simulated: Callable[..., Path]) -> None:
    """At most 50 from the other's place; at first 0, it is led to 10 at .5 m/s."""
    out = simulated("DistanceJoint")
    for code in range(12, LAST + 1, 2):
        place = _world(out, "/World/DynamicBox", code) @ [0.0, -60.0, 0.0, 1.0]
        assert 10.0 - 1e-3 <= np.linalg.norm(place[:3] - [0.0, 60.0, 1000.0]) <= 50.0 + 1e-3


@pytest.mark.parametrize("name", ["GroupFiltering", "PairFiltering"])
def test_examples_boxes_kept_apart_fall_through_each_other(name: str, simulated: Callable[..., Path]) -> None:
    out = simulated(name)
    for box in ("Box1", "Box2"):
        np.testing.assert_allclose(_world(out, f"/World/{box}", LAST)[:3, 3], [0.0, 0.0, 22.5], atol=0.025)


def test_example_a_driven_joint_turns_at_its_speed(simulated: Callable[..., Path]) -> None:
    """10 degrees a second about z, after a start of I / c = .08 s; the hinge holds."""
    out = simulated("Joints")
    angle = []
    for code in (24, LAST):
        matrix = _world(out, "/World/DynamicBox", code)
        np.testing.assert_allclose((matrix @ [0.0, -60.0, 0.0, 1.0])[:3], [0.0, 60.0, 1000.0], atol=1e-3)
        angle.append(np.degrees(np.arctan2(-matrix[0, 1], matrix[1, 1])))
    assert angle[1] - angle[0] == pytest.approx(10.0, abs=1e-3)


def test_example_spheres_bounce_as_their_materials_say(simulated: Callable[..., Path]) -> None:
    """Restitution .1 and .8: up again to the square of that part of the fall, up to the substep of the impact."""
    substeps = 64
    out = simulated("SpheresWithMaterial", "--substeps", str(substeps))
    fall = 500.0 - 25.0
    speed = np.sqrt(2.0 * 981.0 * fall)
    for name, restitution in (("RegularSphere", 0.1), ("BouncySphere", 0.8)):
        heights = [_world(out, f"/World/{name}", code)[2, 3] for code in range(24, LAST + 1)]
        assert min(heights) > 25.0 - 0.025
        # Between samples it is up to half a frame from its highest. An impact is found up to a substep early: it
        # then lacks g h of its speed, and starts up to a substep's way too high.
        lost = 0.5 * 981.0 * (0.5 / RATE) ** 2 + (restitution**2 + 1.0) * speed / RATE / substeps
        assert max(heights) == pytest.approx(25.0 + restitution**2 * fall, abs=lost)
