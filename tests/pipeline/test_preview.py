"""Pictures: the size asked for, what must be seen in them, and one line where they cannot be drawn."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel

from plait.assets.small_scene import FOLDER, SHOT
from plait.pipeline import preview
from plait.pipeline.cli import main
from plait.pipeline.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_FAILED, EXIT_USAGE, PlaitError
from plait.pipeline.pictures.curves import _weights, light_through
from plait.pipeline.pictures.framing import around

SMALL = FOLDER / SHOT


@pytest.fixture(scope="module")
def gl() -> None:
    try:
        preview.probe()
    except PlaitError as error:
        pytest.skip(str(error))


@pytest.fixture
def stage(tmp_path) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Y")
    return stage


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def draw(path: Path, frame: float | None = None) -> np.ndarray:
    output = path.with_suffix(".png")
    preview.render_still(path, output, frame=frame, size=(160, 120))
    return pixels(output)


def draw_stage(stage: Usd.Stage, frame: float | None = None) -> np.ndarray:
    stage.Save()
    return draw(Path(stage.GetRootLayer().realPath), frame)


def middle(picture: np.ndarray) -> np.ndarray:
    """(3,) the mean colour about the middle."""
    high, wide = picture.shape[0] // 2, picture.shape[1] // 2
    return picture[high - 5 : high + 5, wide - 5 : wide + 5].reshape(-1, 3).mean(axis=0)


@pytest.mark.parametrize("name", ["still.png", "still.jpg"])
def test_a_still_has_the_size_asked_for(gl, tmp_path, name):
    output = tmp_path / "new folder" / name
    assert main(["preview", str(SMALL), "-o", str(output), "--size", "321x123", "-f", "7"]) == EXIT_DONE
    assert Image.open(output).size == (321, 123)


def test_hair_is_seen(gl, stage):
    """Where hair lies over a pale ball it darkens it; without the hair, or with it invisible, the ball is pale."""
    ball = UsdGeom.Sphere.Define(stage, "/ball")
    ball.CreateDisplayColorAttr([(0.9, 0.9, 0.9)])
    bald = middle(draw_stage(stage))
    curves = UsdGeom.BasisCurves.Define(stage, "/hair")
    x = np.linspace(0.0, 0.6, 60)
    curves.CreateTypeAttr("linear")
    curves.CreateCurveVertexCountsAttr([2] * len(x))
    curves.CreatePointsAttr([p for i in x for p in ((i, 0.4, 1.01), (i, -0.4, 1.01))])
    curves.CreateWidthsAttr([0.005])
    curves.SetWidthsInterpolation("constant")
    curves.CreateDisplayColorAttr([(0.1, 0.05, 0.02)])
    hairy = middle(draw_stage(stage))
    assert hairy.mean() < bald.mean() - 30
    assert hairy[0] > hairy[2]  # brown
    curves.MakeInvisible()
    assert np.abs(middle(draw_stage(stage)) - bald).max() < 2


@pytest.mark.parametrize("name", ["clip.webp", "clip.gif"])
def test_frames_of_a_clip_differ_and_keep_the_shot_s_rate(gl, tmp_path, name):
    output = tmp_path / name
    assert main(["preview", str(SMALL), "-o", str(output), "--size", "96x72", "-f", "1:13x4"]) == EXIT_DONE
    clip = Image.open(output)
    assert (clip.n_frames, clip.size) == (4, (96, 72))
    frames, times = [], []
    for index in range(clip.n_frames):
        clip.seek(index)
        frames.append(np.asarray(clip.convert("RGB")))
        times.append(clip.info["duration"])
    assert all((a != b).any() for a, b in itertools.pairwise(frames))
    assert sum(times) == pytest.approx(4 * 4 * 1000.0 / 24.0, abs=40.0)  # a gif counts hundredths


def test_colours_of_surfaces(gl, stage):
    """displayColor by vertex, face and corner, then the material's: red in the picture where red is authored."""
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreatePointsAttr([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    mesh.CreateSubdivisionSchemeAttr("none")
    grey = middle(draw_stage(stage))
    assert np.ptp(grey) < 15
    material = UsdShade.Material.Define(stage, "/material")
    shader = UsdShade.Shader.Define(stage, "/material/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(0.6, 0.0, 0.0))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    reds = [middle(draw_stage(stage))]
    colour = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray)
    for interpolation, count in (("constant", 1), ("uniform", 1), ("vertex", 4), ("faceVarying", 4)):
        colour.SetInterpolation(interpolation)
        colour.Set([Gf.Vec3f(0.6, 0.0, 0.0)] * count)
        reds.append(middle(draw_stage(stage)))
    for red in reds:
        assert red[0] > red[1] + 100 and red[0] > red[2] + 100


def test_skinned_points_are_where_usdskel_puts_them(gl, tmp_path):
    """A shot and the same shot baked by UsdSkel give the same picture, but for rounding at edges."""
    baked = tmp_path / "baked.usda"
    stage = Usd.Stage.Open(str(SMALL))
    stage.Flatten().Export(str(baked))
    flat = Usd.Stage.Open(str(baked))
    assert UsdSkel.BakeSkinning(Usd.PrimRange(flat.GetPseudoRoot()), Gf.Interval(1, 24))
    flat.Save()
    shot = tmp_path / "shot.usda"
    stage.Flatten().Export(str(shot))
    expected, found = draw(baked, 8), draw(shot, 8)
    assert (np.abs(expected - found).max(axis=2) > 8).mean() < 1e-3
    assert (np.abs(draw(shot, 1) - found).max(axis=2) > 8).mean() > 0.02


def test_visibility_and_purpose_decide_what_is_drawn(gl, stage):
    UsdGeom.Sphere.Define(stage, "/seen").CreateDisplayColorAttr([(0, 0, 0.6)])
    alone = draw_stage(stage)
    for name in ("proxy", "guide"):
        other = UsdGeom.Cube.Define(stage, f"/{name}")
        other.CreatePurposeAttr(name)
    hidden = UsdGeom.Cube.Define(stage, "/hidden")
    hidden.CreateVisibilityAttr("invisible")
    assert np.array_equal(draw_stage(stage), alone)
    hidden.MakeVisible()
    assert not np.array_equal(draw_stage(stage), alone)


def test_a_camera_of_the_stage(gl, stage, tmp_path):
    """A ball that the camera sees left of its middle is left of the picture's middle."""
    UsdGeom.Sphere.Define(stage, "/ball").CreateDisplayColorAttr([(0.6, 0, 0)])
    camera = UsdGeom.Camera.Define(stage, "/camera")
    UsdGeom.XformCommonAPI(camera).SetTranslate((2.0, 0.0, 8.0))
    stage.Save()
    output = tmp_path / "out.png"
    arguments = ["preview", stage.GetRootLayer().realPath, "-o", str(output), "--size", "160x120", "--camera"]
    assert main([*arguments, "/camera"]) == EXIT_DONE
    picture = pixels(output)
    red = picture[..., 0] > picture[..., 2] + 60
    # 50 mm lens on a 20.955 mm aperture, 160 pixels wide: 2 m off the axis at 8 m is 95 pixels.
    assert red.any() and np.nonzero(red)[1].mean() < 40
    assert main([*arguments, "/ball"]) == EXIT_USAGE


def test_all_points_are_in_the_frame_and_touch_it():
    """Tight: the furthest point is 1 / 1.08 of the way to an edge, opposite edges alike."""
    points = np.random.default_rng(0).normal(size=(200, 3)) * (1.0, 3.0, 0.5) + (5.0, 0.0, -2.0)
    for up_axis, aspect in itertools.product("YZ", (0.5, 1.0, 1.8)):
        view = around(points, up_axis, aspect)
        x, y, depth = ((points - view.position) @ view.axes.T).T
        half = np.tan(np.radians(view.angle) / 2.0)
        across, along = x / (-depth * half * aspect), y / (-depth * half)
        assert max(np.abs(across).max(), np.abs(along).max()) == pytest.approx(1.0 / 1.08, abs=2e-2)
        assert across.max() == pytest.approx(-across.min(), abs=1e-6)
        assert along.max() == pytest.approx(-along.min(), abs=1e-6)


@pytest.mark.parametrize("basis", ["bezier", "bspline", "catmullRom"])
@pytest.mark.parametrize("wrap", ["nonperiodic", "pinned", "periodic"])
def test_refined_curves_are_affine_and_pinned_ones_reach_their_ends(basis, wrap):
    """Weights sum to one, so that curves move with their points; pinned ones reach their end points."""
    count = 6 if basis == "bezier" and wrap == "periodic" else 7
    weights = _weights("cubic", basis, wrap, count)
    assert weights.sum(axis=1) == pytest.approx(1.0)
    if wrap == "pinned":
        assert weights[[0, -1]] == pytest.approx(np.eye(count)[[0, -1]], abs=1e-12)
    if wrap == "periodic":
        assert weights[0] == pytest.approx(weights[-1])


def test_hair_shades_hair():
    """Light falls off inwards: strands facing the light get more than those behind them."""
    grid = np.linspace(0.0, 1.0, 12)
    points = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3)
    light = light_through(points, np.full(len(points) // 2, 2), np.array([0.0, 0.0, 1.0]))
    front, back = light[points[:, 2] == 1.0], light[points[:, 2] == 0.0]
    assert front.min() > 2.0 * back.max()


@pytest.mark.parametrize(
    "arguments, code, said",
    [
        (["none.usda", "-o", "out.png"], EXIT_BAD_INPUT, "no such file"),
        ([str(SMALL), "-o", "out.tiff"], EXIT_USAGE, ".png"),
        ([str(SMALL), "-o", "out.png", "--size", "12"], EXIT_USAGE, "--size"),
        ([str(SMALL), "-o", "out.png", "--size", "0x100"], EXIT_USAGE, "--size"),
        ([str(SMALL), "-o", "out.png", "--size", "99999x100"], EXIT_USAGE, "--size"),
        ([str(SMALL), "-o", "out.png", "-f", "1:3"], EXIT_USAGE, ".webp"),
        ([str(SMALL), "-o", "out.webp", "-f", "3:1"], EXIT_USAGE, "--frames"),
        ([str(SMALL), "-o", "out.png", "--camera", "/none"], EXIT_USAGE, "--camera"),
        (["empty.usda", "-o", "out.png"], EXIT_BAD_INPUT, "nothing to draw"),
        (["hidden.usda", "-o", "out.png"], EXIT_BAD_INPUT, "nothing to draw"),
        (["broken.usda", "-o", "out.png"], EXIT_BAD_INPUT, "broken.usda"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(tmp_path, monkeypatch, capsys, arguments, code, said):
    monkeypatch.chdir(tmp_path)
    Path("broken.usda").write_text("#usda 1.0\ndef {{{")
    Path("empty.usda").write_text('#usda 1.0\ndef Xform "World" {}\n')
    Path("hidden.usda").write_text('#usda 1.0\ndef Sphere "a" {\n token visibility = "invisible"\n}\n')
    before = sorted(tmp_path.iterdir())
    assert main(["preview", *arguments]) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert sorted(tmp_path.iterdir()) == before


def test_without_opengl_one_line_says_so(tmp_path):
    """The driver's own switches hide it: neither EGL nor a display is found, and VTK would end the process."""
    hidden = {
        "__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent",
        "__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent",
        "LIBGL_DRIVERS_PATH": "/nonexistent",
    }
    held = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    command = [sys.executable, "-m", "plait.pipeline.cli", "preview", str(SMALL), "-o", str(tmp_path / "out.png")]
    done = subprocess.run(command, env=held | hidden, capture_output=True, text=True, check=False)
    if done.returncode == EXIT_DONE:
        pytest.skip("OpenGL cannot be hidden here")
    assert done.returncode == EXIT_FAILED
    (line,) = done.stderr.splitlines()
    assert line.startswith("plait: pictures cannot be drawn here")
    assert not list(tmp_path.iterdir())
