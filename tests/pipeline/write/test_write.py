"""What a result holds beside its samples, and what is refused."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from plait.pipeline.errors import InputError, PlaitError, UsageError
from plait.pipeline.write import CacheWriter, cache_folder

MADE = {"version:plait": "0.1.0", "configuration": "0123456789abcdef", "seed": 0, "device": "cpu"}


@pytest.fixture
def shot(fabricated, tmp_path):
    return fabricated.shot_of(fabricated.curve_source(tmp_path / "shots" / "shot.usda"))


@pytest.fixture(autouse=True)
def shots_folder(tmp_path):
    (tmp_path / "shots").mkdir()


def test_repeats_the_sources_stage_metadata(fabricated, tmp_path):
    """Units, axis, rates, range, default prim, and what USD reads of a root layer only."""
    path = fabricated.curve_source(tmp_path / "shots" / "shot.usda")
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.expressionVariables = {"SHOT": "s010"}
    layer.customLayerData = {"studio": {"ticket": 7, "lut": Sdf.AssetPath("./lut.cube")}}
    layer.pseudoRoot.SetInfo("kilogramsPerUnit", 0.001)
    layer.pseudoRoot.SetInfo("colorConfiguration", Sdf.AssetPath("./config.ocio"))
    layer.framesPerSecond = 25
    layer.Save()
    out = fabricated.write(tmp_path / "results" / "out.usda", fabricated.shot_of(path), fabricated.frames(3, 5))
    top = Sdf.Layer.FindOrOpen(str(out))
    for key in ("metersPerUnit", "upAxis", "startTimeCode", "endTimeCode", "defaultPrim", "kilogramsPerUnit"):
        assert top.pseudoRoot.GetInfo(key) == layer.pseudoRoot.GetInfo(key), key
    assert (top.timeCodesPerSecond, top.framesPerSecond) == (24, 25)
    assert top.expressionVariables == {"SHOT": "s010"}
    assert top.customLayerData["studio"]["ticket"] == 7
    assert top.customLayerData["studio"]["lut"].path == "../shots/lut.cube"
    assert top.colorConfiguration.path == "../shots/config.ocio"


def test_a_source_without_a_range_gets_the_simulated_one(fabricated, tmp_path):
    path = fabricated.curve_source(tmp_path / "shots" / "shot.usda")
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.ClearStartTimeCode()
    layer.ClearEndTimeCode()
    layer.Save()
    stage = Usd.Stage.Open(
        str(fabricated.write(tmp_path / "o.usda", fabricated.shot_of(path), fabricated.frames(3, 5)))
    )
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (3, 5)


def test_says_how_it_was_made(fabricated, tmp_path, shot):
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 2))
    made = Sdf.Layer.FindOrOpen(str(out)).customLayerData["plait"]
    assert made["version"]["plait"] == "0.1.0"
    assert (made["seed"], made["device"], made["configuration"]) == (0, "cpu", MADE["configuration"])


def test_paths_are_relative_and_survive_a_move(fabricated, tmp_path, shot):
    """Source and result in different folders, moved together, open as before."""
    out = fabricated.write(tmp_path / "results" / "v1" / "out.usda", shot, fabricated.frames(1, 2))
    for layer in (out, *cache_folder(out).glob("*.usda")):
        assert str(tmp_path) not in layer.read_text()
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    shutil.move(tmp_path / "shots", moved / "shots")
    shutil.move(tmp_path / "results", moved / "results")
    stage = Usd.Stage.Open(str(moved / "results" / "v1" / "out.usda"))
    expected = fabricated.results(shot, 2.0)[0].points
    assert np.array_equal(fabricated.values(stage, "/World/hair", "points", 2), expected)
    assert not stage.GetCompositionErrors()


def test_folders_behind_links(fabricated, tmp_path, shot):
    """A result folder that is a link to another disk opens by the path that was given for it."""
    (tmp_path / "disk" / "deep" / "results").mkdir(parents=True)
    (tmp_path / "results").symlink_to(tmp_path / "disk" / "deep" / "results")
    stage = Usd.Stage.Open(str(fabricated.write(tmp_path / "results" / "out.usda", shot, fabricated.frames(1, 2))))
    assert len(stage.GetPrimAtPath("/World/hair").GetAttribute("points").GetTimeSamples()) == 2
    assert stage.GetPrimAtPath("/World/hair").GetAttribute("widths").HasAuthoredValue()


def test_file_names_of_every_kind(fabricated, tmp_path):
    """Spaces, the signs that USD writes around paths, letters of all alphabets."""
    folder = tmp_path / "a b@c #é %20"
    folder.mkdir()
    shot = fabricated.shot_of(fabricated.curve_source(folder / "s h@t.usda"))
    stage = Usd.Stage.Open(str(fabricated.write(tmp_path / "r @ 1" / "o@u t.usda", shot, fabricated.frames(1, 2))))
    assert len(stage.GetPrimAtPath("/World/hair").GetAttribute("points").GetTimeSamples()) == 2
    assert stage.GetPrimAtPath("/World/hair").GetAttribute("widths").HasAuthoredValue()


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_every_usd_suffix_opens(fabricated, tmp_path, shot, suffix):
    out = fabricated.write(tmp_path / f"out{suffix}", shot, fabricated.frames(1, 2))
    stage = Usd.Stage.Open(str(out))
    assert len(stage.GetPrimAtPath("/World/hair").GetAttribute("points").GetTimeSamples()) == 2


def test_inputs_are_never_edited(fabricated, tmp_path, shot):
    before = fabricated.contents(tmp_path / "shots")
    fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 5))
    assert fabricated.contents(tmp_path / "shots") == before


def test_nothing_to_simulate_is_a_top_layer_alone(fabricated, tmp_path, shot):
    out = fabricated.write(tmp_path / "out.usda", replace(shot, curves=()), fabricated.frames(1, 5))
    assert not cache_folder(out).exists()
    assert Sdf.Layer.FindOrOpen(str(out)).subLayerPaths == ["./shots/shot.usda"]
    stage = Usd.Stage.Open(str(out))
    assert not stage.GetPrimAtPath("/World/hair").GetAttribute("points").GetTimeSamples()


def test_before_the_first_chunk_the_source_shows(fabricated, tmp_path, shot):
    """Overrides that switch off skinning are of no use while there is nothing to show instead."""
    samples = fabricated.frames(1, 6)
    out = tmp_path / "out.usda"
    writer = CacheWriter(out, shot, samples=samples, chunk=3, provenance=MADE).open()
    writer.add(1.0, fabricated.results(shot, 1.0))
    assert writer.frames_done == 0
    source = Usd.Stage.Open(str(shot.info.path))
    stage = Usd.Stage.Open(str(out))
    expected = fabricated.values(source, "/World/hair", "points", 1)
    assert np.array_equal(fabricated.values(stage, "/World/hair", "points", 1), expected)


def test_stale_attributes_are_blocked_and_normals_refreshed(fabricated, tmp_path):
    """Accelerations and indexed normals of the source belong to points that are no longer there."""
    path = fabricated.curve_source(tmp_path / "shots" / "shot.usda")
    source = Usd.Stage.Open(str(path))
    curves = UsdGeom.BasisCurves(source.GetPrimAtPath("/World/hair"))
    curves.CreateAccelerationsAttr([(1, 2, 3)] * 6)
    primvar = UsdGeom.PrimvarsAPI(curves).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, "vertex")
    primvar.Set([(0, 0, 1)])
    primvar.SetIndices([0] * 6)
    source.Save()
    shot = fabricated.shot_of(path, has_normals=True)
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 4), normals=True)
    stage = Usd.Stage.Open(str(out))
    prim = stage.GetPrimAtPath("/World/hair")
    assert prim.GetAttribute("accelerations").Get(2) is None
    shown = np.array(UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals").ComputeFlattened(3))
    assert np.array_equal(shown, fabricated.results(shot, 3.0, normals=True)[0].normals)
    assert not prim.GetAttribute("normals").GetTimeSamples()


def test_normals_that_are_not_refreshed_are_blocked(fabricated, tmp_path):
    """Better none than those of other points."""
    path = fabricated.curve_source(tmp_path / "shots" / "shot.usda")
    source = Usd.Stage.Open(str(path))
    curves = UsdGeom.BasisCurves(source.GetPrimAtPath("/World/hair"))
    curves.CreateNormalsAttr([(0, 0, 1)] * 6)
    UsdGeom.PrimvarsAPI(curves).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray).Set([(0, 0, 1)])
    source.Save()
    out = fabricated.write(tmp_path / "out.usda", fabricated.shot_of(path), fabricated.frames(1, 4))
    stage = Usd.Stage.Open(str(out))
    for name in ("normals", "primvars:normals"):
        assert stage.GetPrimAtPath("/World/hair").GetAttribute(name).Get(2) is None


def test_plain_normals_are_refreshed(fabricated, tmp_path):
    path = fabricated.curve_source(tmp_path / "shots" / "shot.usda")
    source = Usd.Stage.Open(str(path))
    UsdGeom.BasisCurves(source.GetPrimAtPath("/World/hair")).CreateNormalsAttr([(0, 0, 1)] * 6)
    source.Save()
    shot = fabricated.shot_of(path, has_normals=True)
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 4), normals=True)
    stage = Usd.Stage.Open(str(out))
    expected = fabricated.results(shot, 3.0, normals=True)[0].normals
    assert np.array_equal(fabricated.values(stage, "/World/hair", "normals", 3), expected)
    with pytest.raises(ValueError, match="normals"):
        fabricated.write(tmp_path / "again.usda", shot, fabricated.frames(1, 4))


def test_bounds_above_hold_the_result(fabricated, tmp_path):
    """A bounding box cache looks no further than a SkelRoot's extent or a model's hint."""
    path = fabricated.curve_source(tmp_path / "shots" / "shot.usda")
    source = Usd.Stage.Open(str(path))
    root = UsdSkel.Root.Define(source, "/World/actor")
    root.CreateExtentAttr([(-1, -1, -1), (1, 1, 1)])
    Usd.ModelAPI(source.GetPrimAtPath("/World")).SetKind("component")
    UsdGeom.ModelAPI.Apply(source.GetPrimAtPath("/World")).SetExtentsHint([(0, 0, 0), (1, 1, 1)])
    curves = fabricated.define_curves(source, "/World/actor/hair")
    UsdGeom.Xformable(curves).AddTranslateOp().Set((0, 100, 0))
    source.Save()
    shot = fabricated.shot_of(path, ["/World/actor/hair"])
    stage = Usd.Stage.Open(str(fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 4))))
    for name in ("/World", "/World/actor"):
        boxes = UsdGeom.BBoxCache(3.0, ["default"], useExtentsHint=True)
        box = boxes.ComputeWorldBound(stage.GetPrimAtPath(name)).ComputeAlignedRange()
        held = float(fabricated.results(shot, 3.0)[0].extent[1, 1]) + 100.0
        assert box.GetMax()[1] == pytest.approx(held, rel=1e-6), name
        assert box.GetMin()[1] <= -1.0, name


def test_several_prims(fabricated, tmp_path):
    prims = ["/World/hair", "/World/brows", "/World/beard"]
    path = fabricated.curve_source(tmp_path / "shots" / "shot.usda", prims=prims)
    shot = fabricated.shot_of(path, prims)
    stage = Usd.Stage.Open(str(fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 5))))
    for result in fabricated.results(shot, 4.0):
        assert np.array_equal(fabricated.values(stage, result.prim_path, "points", 4), result.points)


# --- what is refused --------------------------------------------------------------------------------------------


def begin(out: Path, shot, **how) -> CacheWriter:
    return CacheWriter(out, shot, samples=[(1.0,), (2.0,)], chunk=3, provenance=MADE, **how).open()


def test_an_existing_result_is_kept_unless_told(fabricated, tmp_path, shot):
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 5))
    before = fabricated.contents(cache_folder(out))
    with pytest.raises(UsageError, match="exists"):
        begin(out, shot)
    out.unlink()
    with pytest.raises(UsageError, match="exists"):
        begin(out, shot)
    assert fabricated.contents(cache_folder(out)) == before


def test_overwrite_leaves_nothing_of_the_earlier_result(fabricated, tmp_path, shot):
    """Fewer chunks, and no checkpoint to resume the wrong run from."""
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 9))
    (cache_folder(out) / "checkpoint.npz").write_bytes(b"of the earlier run")
    (cache_folder(out) / ".chunk.0004.writing.usdc").write_bytes(b"partial")
    with begin(out, shot, overwrite=True) as writer:
        for code in (1.0, 2.0):
            writer.add(code, fabricated.results(shot, code))
    assert sorted(fabricated.contents(cache_folder(out))) == ["chunk.0001.usdc", "manifest.usda", "overrides.usda"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_never_writes_onto_an_input(fabricated, tmp_path, shot, overwrite):
    before = fabricated.contents(tmp_path / "shots")
    with pytest.raises(InputError, match=r"shot\.usda.*another -o"):
        begin(shot.info.path, shot, overwrite=overwrite)
    extra = tmp_path / "out.cache" / "texture.png"
    with pytest.raises(InputError, match=r"texture\.png"):
        begin(tmp_path / "out.usda", shot, inputs=[extra], overwrite=overwrite)
    assert fabricated.contents(tmp_path / "shots") == before


def test_never_writes_onto_a_sublayer(fabricated, tmp_path):
    path = fabricated.curve_source(tmp_path / "shots" / "groom.usda")
    top = Sdf.Layer.CreateNew(str(tmp_path / "shots" / "shot.usda"))
    top.subLayerPaths.append("./groom.usda")
    top.Save()
    with pytest.raises(InputError, match=r"groom\.usda"):
        begin(path, fabricated.shot_of(tmp_path / "shots" / "shot.usda"), overwrite=True)


def test_other_suffixes_are_refused(tmp_path, shot):
    for name in ("out", "out.usdz", "out.abc"):
        with pytest.raises(UsageError, match="ends in"):
            begin(tmp_path / name, shot)


def test_an_output_that_cannot_be_written_is_one_line(tmp_path, shot):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError) as refused:
        begin(tmp_path / "file" / "out.usda", shot)
    assert "\n" not in str(refused.value) and "out.usda" in str(refused.value)


@pytest.mark.parametrize("name", ["points", "velocities", "extent"])
def test_nan_never_reaches_a_file(fabricated, tmp_path, shot, name):
    """The frames before the one that is not finite are kept."""
    out = tmp_path / "out.usda"
    bad = fabricated.results(shot, 3.0)[0]
    array = getattr(bad, name).copy()
    array[1, 2] = np.nan
    with pytest.raises(PlaitError, match=rf"frame 3: </World/hair> {name}: 1 of"):
        with CacheWriter(out, shot, samples=fabricated.frames(1, 5), chunk=4, provenance=MADE) as writer:
            for code in (1.0, 2.0):
                writer.add(code, fabricated.results(shot, code))
            writer.add(3.0, [replace(bad, **{name: array})])
    stage = Usd.Stage.Open(str(out))
    attribute = stage.GetPrimAtPath("/World/hair").GetAttribute(name)
    assert attribute.GetTimeSamples() == [1.0, 2.0]
    assert all(np.isfinite(np.array(attribute.Get(code))).all() for code in (1.0, 2.0))


def test_mistakes_of_the_caller_are_errors(fabricated, tmp_path, shot):
    writer = begin(tmp_path / "out.usda", shot)
    good = fabricated.results(shot, 1.0)
    with pytest.raises(ValueError, match="not the one due"):
        writer.add(2.0, good)
    with pytest.raises(ValueError, match="not the one due"):
        writer.add(1.5, good)
    with pytest.raises(ValueError, match="results for"):
        writer.add(1.0, [])
    with pytest.raises(ValueError, match="points"):
        writer.add(1.0, [replace(good[0], points=good[0].points[:-1])])
    with pytest.raises(ValueError, match="in order"):
        CacheWriter(tmp_path / "o.usda", shot, samples=[(2.0,), (1.0,)], chunk=3, provenance=MADE)


FULL_DISK = """
import resource, runpy, signal, sys
from pathlib import Path
from plait.pipeline.errors import PlaitError
made = runpy.run_path(sys.argv[1])
shot = made["shot_of"](Path(sys.argv[2]))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
try:
    samples = made["frames"](1, 9)
    with made["CacheWriter"](Path(sys.argv[3]), shot, samples=samples, chunk=3, provenance={}) as writer:
        for code in range(1, 10):
            if code == 5:
                resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))
            writer.add(code, made["results"](shot, code))
except PlaitError as error:
    print(error)
    sys.exit(error.exit_code)
"""


def test_a_full_disk_ends_in_one_line_and_keeps_the_frames_before(fabricated, tmp_path):
    """A file that may not grow, as a disk without space: exit 3, the reason, nothing half written."""
    path = fabricated.curve_source(tmp_path / "shots" / "shot.usda", strands=100, per_strand=10)
    out = tmp_path / "out.usda"
    command = [sys.executable, "-c", FULL_DISK, str(Path(__file__).with_name("conftest.py")), str(path), str(out)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 3, ended.stderr
    assert ended.stdout.count("\n") == 1
    assert (
        "chunk.0002.usdc" in ended.stdout
        and "File too large" in ended.stdout
        and "3 frames are kept" in ended.stdout
    )
    names = set(os.listdir(cache_folder(out)))
    assert names == {"chunk.0001.usdc", "manifest.usda", "overrides.usda"}
    stage = Usd.Stage.Open(str(out))
    assert stage.GetPrimAtPath("/World/hair").GetAttribute("points").GetTimeSamples() == [1.0, 2.0, 3.0]
