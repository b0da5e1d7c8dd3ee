"""Sand and snow through the command line: what is filled, poured and drawn comes back, as points and a surface."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from plait.assets.stages import new_world
from plait.pipeline import driver
from plait.pipeline.cli import main
from plait.pipeline.compare import compare
from plait.pipeline.config import Config
from plait.pipeline.errors import EXIT_DONE, EXIT_STOPPED, PlaitError
from plait.pipeline.pack import pack
from plait.pipeline.pictures.drawables import Changing, Dots, collect
from plait.pipeline.read import read_shot
from plait.pipeline.read.source import Source
from plait.pipeline.shot import PrimFrame
from plait.pipeline.stopping import StopRequest
from plait.pipeline.validate import validate
from plait.pipeline.write import CacheWriter

RATE, FRAMES, SUBSTEPS = 24.0, 4, 8
PILE, TAP, DUST = "/World/Set/Pile", "/World/Set/Tap", "/World/Set/Dust"
HEAP, POURED, SURFACE = f"{PILE}_grains", f"{TAP}_grains", f"{PILE}_surface"
FLAGS = ("--preroll", "2", "--substeps", str(SUBSTEPS), "--chunk", "2", "--threads", "1")
SPACING = 2.0  # [cm] of the grains
POUR = 590.0  # [1/s]


def write_shot(path: Path) -> Path:
    """In centimetres, under a turned, moved and scaled group that moves on: a ball, a tap and two grains."""
    stage = new_world(path, (1, FRAMES), RATE, meters=0.01)
    group = UsdGeom.Xform.Define(stage, "/World/Set")
    move = group.AddTranslateOp()
    move.Set((0, 0, 0), 1)
    move.Set((6, 3, 0), FRAMES)
    group.AddRotateYOp().Set(30.0)
    group.AddScaleOp().Set((2, 2, 2))
    material = UsdShade.Material.Define(stage, "/World/Ice")
    ball = UsdGeom.Sphere.Define(stage, PILE)
    ball.CreateRadiusAttr(8.0)
    ball.CreateExtentAttr([(-8, -8, -8), (8, 8, 8)])
    ball.AddTranslateOp().Set((0, 60, 0))
    ball.CreateDisplayColorAttr([(0.2, 0.4, 0.9)])
    UsdShade.MaterialBindingAPI.Apply(ball.GetPrim()).Bind(material)
    tap = UsdGeom.Cube.Define(stage, TAP)
    tap.CreateSizeAttr(4.0)
    tap.CreateExtentAttr([(-2, -2, -2), (2, 2, 2)])
    tap.AddTranslateOp().Set((60, 60, 0))
    dust = UsdGeom.Points.Define(stage, DUST)
    dust.CreatePointsAttr([(-60, 60, 0), (-60, 61, 0)])
    dust.CreateIdsAttr([17, 5])
    dust.CreateExtentAttr([(-60, 60, 0), (-60, 61, 0)])
    for prim in (ball, tap, dust):
        prim.GetPrim().CreateAttribute("plait:role", Sdf.ValueTypeNames.Token).Set("sand")
        prim.GetPrim().CreateAttribute("plait:spacing", Sdf.ValueTypeNames.Float).Set(SPACING)
    ball.GetPrim().CreateAttribute("plait:surface", Sdf.ValueTypeNames.Bool).Set(True)
    tap.GetPrim().CreateAttribute("plait:rate", Sdf.ValueTypeNames.Float).Set(POUR)
    tap.GetPrim().CreateAttribute("plait:velocity", Sdf.ValueTypeNames.Float3).Set((0, -300, 0))
    stage.Save()
    return path


def _sim(shot: Path, out: Path, *more: str) -> int:
    return main(["sim", str(shot), "-o", str(out), *FLAGS, "--progress", "none", *more])


def _values(path: Path, prim: str, name: str, code: float) -> np.ndarray:
    stage = Usd.Stage.Open(str(path))
    return np.array(stage.GetPrimAtPath(prim).GetAttribute(name).Get(code))


def _world(path: Path, prim: str, code: float) -> np.ndarray:
    """(n, 3) [m]"""
    stage = Usd.Stage.Open(str(path))
    matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(stage.GetPrimAtPath(prim)))
    points = np.array(stage.GetPrimAtPath(prim).GetAttribute("points").Get(code), np.float64)
    return 0.01 * (points @ matrix[:3, :3] + matrix[3, :3])


def _chunks(out: Path) -> list[bytes]:
    return [path.read_bytes() for path in sorted(out.with_suffix(".cache").glob("chunk.*"))]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("grains")
    shot, out = write_shot(folder / "shot.usda"), folder / "out.usda"
    assert _sim(shot, out) == EXIT_DONE
    return shot, out


def test_the_first_frame_is_as_drawn_whatever_the_preroll(result: tuple[Path, Path]) -> None:
    shot, out = result
    scene = read_shot(shot, Config()).scene
    for path, granular in ((HEAP, scene.granular[0]), (DUST, scene.granular[2])):
        # float32 of some hundred centimetres.
        np.testing.assert_allclose(_world(out, path, 1), granular.positions + scene.origin, atol=1e-6)
    assert len(_values(out, POURED, "points", 1)) == 0
    np.testing.assert_allclose(_values(out, DUST, "points", 1), [(-60, 60, 0), (-60, 61, 0)], atol=1e-5)


def test_grains_fall_in_the_world_not_with_their_group(result: tuple[Path, Path]) -> None:
    """x = x0 + g t^2 / 2, but for the first-order steps, each no longer than a substep: g h t / 2."""
    _, out = result
    for path in (HEAP, DUST):
        for code in range(1, FRAMES + 1):
            time = (code - 1) / RATE
            moved = _world(out, path, code) - _world(out, path, 1) - [0.0, -0.5 * 9.81 * time**2, 0.0]
            assert np.abs(moved).max() <= 0.5 * 9.81 * time / RATE / SUBSTEPS + 1e-5


def test_velocities_are_those_of_the_points_in_their_own_space(result: tuple[Path, Path]) -> None:
    """Mean of two frames' velocities times their distance, exact where acceleration is constant."""
    _, out = result
    step = _values(out, DUST, "points", 3) - _values(out, DUST, "points", 2)
    mean = 0.5 * (_values(out, DUST, "velocities", 3) + _values(out, DUST, "velocities", 2)) / RATE
    # A first-order step of gravity, in units of the group: 50 a metre.
    np.testing.assert_allclose(step, mean, atol=50.0 * 0.5 * 9.81 / RATE**2 / SUBSTEPS + 1e-4)


def test_what_is_poured_is_counted_and_numbered(result: tuple[Path, Path]) -> None:
    _, out = result
    stage = Usd.Stage.Open(str(out))
    before: set[int] = set()
    for code in range(1, FRAMES + 1):
        ids = _values(out, POURED, "ids", code).astype(int).tolist()
        assert len(ids) == len(set(ids)) == int(POUR * (code - 1) / RATE) and before <= set(ids)
        before = set(ids)
        for name in ("points", "velocities", "widths"):
            assert len(stage.GetPrimAtPath(POURED).GetAttribute(name).Get(code)) == len(ids)
    places = _world(out, POURED, 2) - 0.01 * np.array([2.0, 1.0, 0.0])  # where the group is by then
    turned = places @ np.array(
        [[np.cos(np.pi / 6), 0, np.sin(np.pi / 6)], [0, 1, 0], [-np.sin(np.pi / 6), 0, np.cos(np.pi / 6)]]
    )
    off = turned - [1.2, 1.2, 0.0]
    assert (np.abs(off[:, [0, 2]]) < 0.04 + 0.05).all(), "within the box, and what it moved meanwhile"
    assert (off[:, 1] < 0.04 + 1e-6).all() and (off[:, 1] > -0.04 - 3.5 / RATE).all()


def test_the_source_is_hidden_and_otherwise_as_it_was(result: tuple[Path, Path]) -> None:
    shot, out = result
    before, after = Usd.Stage.Open(str(shot)), Usd.Stage.Open(str(out))
    for path in (PILE, TAP):
        assert UsdGeom.Imageable(after.GetPrimAtPath(path)).ComputeVisibility() == UsdGeom.Tokens.invisible
        assert UsdGeom.Imageable(before.GetPrimAtPath(path)).ComputeVisibility() == UsdGeom.Tokens.inherited
    shown = {
        p: UsdGeom.Imageable(after.GetPrimAtPath(p)).ComputeVisibility() for p in (HEAP, POURED, SURFACE, DUST)
    }
    assert [path for path, visible in shown.items() if visible == UsdGeom.Tokens.invisible] == [HEAP]
    for path in (HEAP, SURFACE):
        prim = after.GetPrimAtPath(path)
        np.testing.assert_allclose(prim.GetAttribute("primvars:displayColor").Get(), [(0.2, 0.4, 0.9)], atol=1e-6)
        assert UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0].GetPath() == "/World/Ice"
    assert {str(p.GetPath()) for p in after.Traverse()} - {str(p.GetPath()) for p in before.Traverse()} == {
        HEAP,
        POURED,
        SURFACE,
    }


def test_ids_and_widths(result: tuple[Path, Path]) -> None:
    """Authored ids stay; widths that are not authored are the spacing, in the space of the prim."""
    _, out = result
    assert _values(out, DUST, "ids", 3).tolist() == [17, 5]
    np.testing.assert_allclose(_values(out, DUST, "widths", 3), 0.5 * SPACING, rtol=1e-6)
    stage = Usd.Stage.Open(str(out))
    assert UsdGeom.Points(stage.GetPrimAtPath(HEAP)).GetWidthsInterpolation() == "vertex"
    assert _values(out, HEAP, "ids", 2).tolist() == list(range(len(_values(out, HEAP, "points", 2))))


def test_written_stages_are_sound(result: tuple[Path, Path]) -> None:
    assert validate(result[1]) == []


def test_the_surface_is_closed_and_about_the_grains(result: tuple[Path, Path]) -> None:
    _, out = result
    radius = 0.16  # [m] of the ball
    for code in range(1, FRAMES + 1):
        points, indices = _world(out, SURFACE, code), _values(out, SURFACE, "faceVertexIndices", code)
        triangles = indices.reshape(-1, 3)
        assert _values(out, SURFACE, "faceVertexCounts", code).tolist() == [3] * len(triangles)
        edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        assert len(np.unique(edges, axis=0)) == len(edges), "no edge twice in one direction"
        assert {tuple(e) for e in edges.tolist()} == {tuple(e[::-1]) for e in edges.tolist()}
        a, b, c = (points[triangles[:, k]] - points.mean(axis=0) for k in range(3))
        # Positive: it faces outwards. A layer of half a spacing is uncertain.
        volume = np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0
        assert volume == pytest.approx(4.0 / 3.0 * np.pi * radius**3, rel=1.5 * 0.01 * SPACING / radius)


def test_previews_draw_grains_and_their_surface(result: tuple[Path, Path], tmp_path: Path) -> None:
    _, out = result
    drawn, left_out = collect(Source(out))
    assert left_out == []
    shown = {str(d.prim.GetPath()): d for d in drawn if d.visible(FRAMES)}
    assert isinstance(shown[POURED], Dots) and isinstance(shown[SURFACE], Changing)
    assert shown[POURED].width(FRAMES) == pytest.approx(0.01 * SPACING, rel=1e-5)
    assert PILE not in shown and len(shown[SURFACE].triangles(FRAMES)) > 100
    picture = tmp_path / "o.png"
    assert main(["preview", str(out), "-o", str(picture), "--size", "64x48", "-f", "3"]) == EXIT_DONE
    assert picture.stat().st_size > 0


def test_packed_it_is_the_same(result: tuple[Path, Path]) -> None:
    _, out = result
    packed, flat = out.with_name("packed.usdc"), out.with_name("flat.usdc")
    pack(out, packed)
    pack(out, flat, flatten=True)
    for path in (packed, flat):
        same = compare(out, path, 0.0)
        assert same.ok and {prim.path for prim in same.prims} >= {HEAP, POURED, SURFACE, DUST}
        assert validate(path) == []


def test_compare_matches_grains_by_ids(result: tuple[Path, Path]) -> None:
    _, out = result
    other = out.with_name("shuffled.usda")
    pack(out, other)
    layer = Sdf.Layer.FindOrOpen(str(other))

    def change(name: str, edit) -> None:
        path = f"{POURED}.{name}"
        layer.SetTimeSample(path, FRAMES, edit(layer.QueryTimeSample(path, FRAMES)))

    for name in ("points", "ids"):
        change(name, lambda held: type(held)(list(held)[::-1]))
    layer.Save()
    assert compare(out, other, 0.0).ok
    change("ids", lambda held: type(held)([held[0] + 1000, *list(held)[1:]]))
    layer.Save()
    (judged,) = [prim for prim in compare(out, other, 0.0).prims if not prim.same]
    assert judged.path == POURED and judged.problems == (f"other ids, from frame {FRAMES}",)


def test_arrays_that_disagree_or_are_not_finite_are_never_written(
    result: tuple[Path, Path], tmp_path: Path
) -> None:
    shot = read_shot(result[0], Config())
    grains = {output.prim_path: output for output in shot.grains}

    def frames(count: int, ids: int, width: float) -> list[PrimFrame]:
        place = np.zeros((count, 3), np.float32)
        held = {"ids": np.arange(ids), "widths": np.full(count, width, np.float32)}
        faces = {"faceVertexCounts": np.zeros(0, np.int32), "faceVertexIndices": np.zeros(0, np.int32)}
        nowhere = np.zeros((2, 3), np.float32)
        return [
            PrimFrame(path, place[:0], place[:0], nowhere, place[:0], faces)
            if path == SURFACE
            else PrimFrame(path, place, place, nowhere, others=held)
            for path in grains
        ]

    def writer() -> CacheWriter:
        return CacheWriter(
            tmp_path / "o.usda", shot, samples=[(1.0,), (2.0,)], chunk=1, provenance={}, overwrite=True
        )

    with writer() as held:
        with pytest.raises(ValueError, match="ids: 4 values, not 5"):
            held.add(1.0, frames(5, 4, 1.0))
        with pytest.raises(PlaitError, match="widths: 5 of 5 are not finite"):
            held.add(1.0, frames(5, 5, np.nan))
    assert not list((tmp_path / "o.cache").glob("chunk.*"))
    with writer() as held:
        held.add(1.0, frames(0, 0, 1.0))
        held.add(2.0, frames(3, 3, 1.0))
    assert validate(tmp_path / "o.usda") == []


class _StopsSoon(StopRequest):
    """A signal that comes during the fourth leg, the second frame."""

    asked = 0

    def __bool__(self) -> bool:
        self.asked += 1
        return self.asked >= 4


def test_resumed_it_is_the_same_to_the_bit(result: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    shot, out = result
    again = out.with_name("again.usda")
    with monkeypatch.context() as patch:
        patch.setattr(driver, "StopRequest", _StopsSoon)
        assert _sim(shot, again) == EXIT_STOPPED
    assert _sim(shot, again, "--resume") == EXIT_DONE
    assert len(_chunks(out)) == 2 and _chunks(again) == _chunks(out)
    metrics = json.loads(again.with_suffix(".metrics.json").read_text())
    assert metrics["frames"][-1]["granular"]["particles"] == sum(
        len(_values(out, path, "points", FRAMES)) for path in (HEAP, POURED, DUST)
    )


@pytest.mark.slow
@pytest.mark.parametrize("lines", [4, 6, 7])
def test_killed_and_resumed_on_more_threads_it_is_the_same(result: tuple[Path, Path], lines: int) -> None:
    """SIGKILL after so many lines of progress, of two legs of pre-roll and four frames."""
    shot, out = result
    again = out.with_name(f"killed{lines}.usda")
    arguments = ["sim", str(shot), "-o", str(again), *FLAGS, "--progress", "openjd"]
    command = [sys.executable, "-m", "plait.pipeline.cli", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        for _ in range(lines):
            process.stdout.readline()
        process.kill()
    assert _sim(shot, again, "--resume", "--threads", "2") == EXIT_DONE
    assert _chunks(again) == _chunks(out)


def test_frames_from_the_middle_are_those_of_the_whole_run(result: tuple[Path, Path]) -> None:
    shot, out = result
    part = out.with_name("part.usda")
    assert _sim(shot, part, "-f", f"3:{FRAMES}", "--preroll", "2") == EXIT_DONE
    for path in (HEAP, POURED, DUST):
        np.testing.assert_array_equal(_values(part, path, "points", FRAMES), _values(out, path, "points", FRAMES))


def test_what_the_animation_moves_meets_the_grains(tmp_path: Path) -> None:
    """A lift that rises at a metre a second takes what lies on it along; none falls behind by half a cell.

    Contact acts on the nodes of the grid, two spacings apart.
    """
    path = tmp_path / "shot.usda"
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(7)
    stage.SetTimeCodesPerSecond(RATE)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Z")
    lift = UsdGeom.Cube.Define(stage, "/Lift")
    move = lift.AddTranslateOp()
    move.Set((0, 0, -1), 1)
    move.Set((0, 0, -0.75), 7)
    UsdPhysics.CollisionAPI.Apply(lift.GetPrim())
    sand = UsdGeom.Cube.Define(stage, "/Sand")
    sand.CreateSizeAttr(0.2)
    sand.AddTranslateOp().Set((0, 0, 0.11))
    sand.GetPrim().CreateAttribute("plait:role", Sdf.ValueTypeNames.Token).Set("sand")
    sand.GetPrim().CreateAttribute("plait:spacing", Sdf.ValueTypeNames.Float).Set(0.04)
    stage.Save()
    out = tmp_path / "out.usda"
    assert _sim(path, out) == EXIT_DONE
    heights = _values(out, "/Sand_grains", "points", 7)[:, 2]
    assert heights.min() > 0.25 - 0.5 * 2.0 * 0.04
    assert _values(out, "/Sand_grains", "points", 1)[:, 2].min() < 0.05
