"""What a result says at each time comes from its clips, whatever the source says of the same attributes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

FRAMES = range(1, 9)
# float32 interpolation between two samples of magnitude below 10: one rounding each.
ROUNDING = 4 * 10 * np.finfo(np.float32).eps


def stage_at(path: Path) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(24)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(10)
    return stage


def other_clips(stage: Usd.Stage, folder: Path, anchor: str, curves: str, name: str) -> None:
    """Puts clips of the source's own on `anchor`, which play `points` and `velocities` of `curves`."""
    chunk, manifest = (
        Sdf.Layer.CreateNew(str(folder / "own.usda")),
        Sdf.Layer.CreateNew(str(folder / "manifest.usda")),
    )
    for attribute, kind in (("points", "Point3fArray"), ("velocities", "Vector3fArray")):
        for layer in (chunk, manifest):
            Sdf.AttributeSpec(Sdf.CreatePrimInLayer(layer, curves), attribute, getattr(Sdf.ValueTypeNames, kind))
        for code in (0.0, 2.5, 5.0, 30.0):
            chunk.SetTimeSample(f"{curves}.{attribute}", code, Vt.Vec3fArray(6, Gf.Vec3f(77)))
    chunk.Save()
    manifest.Save()
    clips = Usd.ClipsAPI(stage.GetPrimAtPath(anchor))
    clips.SetClipAssetPaths([Sdf.AssetPath("./own.usda")], name)
    clips.SetClipActive([(0, 0)], name)
    clips.SetClipTimes([(0, 0), (100, 100)], name)
    clips.SetClipManifestAssetPath("./manifest.usda", name)
    clips.SetClipPrimPath(anchor, name)


def animate(curves: UsdGeom.BasisCurves, codes: tuple[float, ...]) -> None:
    rest = np.array(curves.GetPointsAttr().Get(Usd.TimeCode.EarliestTime()))
    for code in codes:
        curves.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(rest + np.float32(code)), code)
        curves.CreateVelocitiesAttr().Set(Vt.Vec3fArray.FromNumpy(rest - np.float32(code)), code)
        curves.GetExtentAttr().Set([(-9, -9, -9), (9, 9, 9)], code)


def asset(fabricated, folder: Path) -> Path:
    """A layer of its own with animated curves at /asset/grp/hair, to be brought in by an arc."""
    stage = stage_at(folder / "asset.usda")
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/asset").GetPrim())
    animate(fabricated.define_curves(stage, "/asset/grp/hair"), (0, 0.5, 1, 3.25, 8, 20))
    stage.Save()
    return folder / "asset.usda"


def defaults(fabricated, folder):
    fabricated.define_curves(stage := stage_at(folder / "shot.usda"), "/World/hair")
    return stage, "/World/hair"


def time_samples(fabricated, folder):
    curves = fabricated.define_curves(stage := stage_at(folder / "shot.usda"), "/World/hair")
    animate(curves, (-5, 0.5, 1, 1.5, 2.25, 8, 8.5, 20))
    return stage, "/World/hair"


def own_clips(fabricated, folder, anchor="/World/hair", name="default"):
    stage, path = defaults(fabricated, folder)
    other_clips(stage, folder, anchor, path, name)
    return stage, path


def own_clips_named_like_ours(fabricated, folder):
    return own_clips(fabricated, folder, name="plait")


def clips_on_a_parent(fabricated, folder):
    return own_clips(fabricated, folder, anchor="/World")


def reference(fabricated, folder):
    asset(fabricated, folder)
    stage = stage_at(folder / "shot.usda")
    stage.DefinePrim("/World/actor", "Xform").GetReferences().AddReference("./asset.usda")
    return stage, "/World/actor/grp/hair"


def payload(fabricated, folder):
    asset(fabricated, folder)
    stage = stage_at(folder / "shot.usda")
    stage.DefinePrim("/World/actor", "Xform").GetPayloads().AddPayload("./asset.usda")
    return stage, "/World/actor/grp/hair"


def inherits(fabricated, folder):
    stage = stage_at(folder / "shot.usda")
    stage.CreateClassPrim("/_class")
    animate(fabricated.define_curves(stage, "/_class/hair"), (0, 2.5, 20))
    stage.DefinePrim("/World/actor", "Xform").GetInherits().AddInherit("/_class")
    return stage, "/World/actor/hair"


def instance(fabricated, folder):
    stage, path = reference(fabricated, folder)
    stage.GetPrimAtPath("/World/actor").SetInstanceable(True)
    return stage, path


def nested_instance(fabricated, folder):
    asset(fabricated, folder)
    crowd = stage_at(folder / "crowd.usda")
    crowd.SetDefaultPrim(crowd.DefinePrim("/crowd", "Xform"))
    inner = crowd.DefinePrim("/crowd/inner", "Xform")
    inner.GetReferences().AddReference("./asset.usda")
    inner.SetInstanceable(True)
    crowd.Save()
    stage = stage_at(folder / "shot.usda")
    for name in ("first", "second"):
        prim = stage.DefinePrim(f"/World/{name}", "Xform")
        prim.GetReferences().AddReference("./crowd.usda")
        prim.SetInstanceable(True)
    return stage, "/World/first/inner/grp/hair"


def variant(fabricated, folder):
    stage, path = time_samples(fabricated, folder)
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath(path))
    looks = curves.GetPrim().GetVariantSets().AddVariantSet("look")
    looks.AddVariant("wet")
    looks.SetVariantSelection("wet")
    with looks.GetVariantEditContext():
        animate(curves, (0, 0.25, 3, 3.5))
    return stage, path


def offset_sublayer(fabricated, folder):
    asset(fabricated, folder)
    stage = stage_at(folder / "shot.usda")
    stage.GetRootLayer().subLayerPaths.append("./asset.usda")
    stage.GetRootLayer().subLayerOffsets[0] = Sdf.LayerOffset(3.0, 2.0)
    return stage, "/asset/grp/hair"


SOURCES = (
    defaults,
    time_samples,
    own_clips,
    own_clips_named_like_ours,
    clips_on_a_parent,
    reference,
    payload,
    inherits,
    instance,
    nested_instance,
    variant,
    offset_sublayer,
)


@pytest.mark.parametrize("source", SOURCES)
def test_values_come_from_the_clips(fabricated, tmp_path, source):
    """At frames the very bits written, between them linear interpolation (across files too), outside held."""
    stage, path = source(fabricated, tmp_path)
    stage.Save()
    shot = fabricated.shot_of(tmp_path / "shot.usda", [path])
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 8), chunk=3)

    opened = Usd.Stage.Open(str(out))
    written = {code: fabricated.results(shot, float(code))[0] for code in FRAMES}
    for name in ("points", "velocities", "extent"):
        assert opened.GetPrimAtPath(path).GetAttribute(name).GetTimeSamples() == [float(code) for code in FRAMES]
        for code in FRAMES:
            assert np.array_equal(fabricated.values(opened, path, name, code), getattr(written[code], name))
        for code in (0.0, -40.0):
            assert np.array_equal(fabricated.values(opened, path, name, code), getattr(written[1], name))
        for code in (8.5, 300.0):
            assert np.array_equal(fabricated.values(opened, path, name, code), getattr(written[8], name))
        for code, part in ((before, part) for before in FRAMES[:-1] for part in (0.25, 0.5)):
            expected = (1 - part) * getattr(written[code], name) + part * getattr(written[code + 1], name)
            found = fabricated.values(opened, path, name, code + part)
            np.testing.assert_allclose(found, expected, rtol=ROUNDING, atol=ROUNDING)


def test_other_instances_keep_the_source(fabricated, tmp_path):
    """Only the instances above a simulated prim are taken apart."""
    stage, path = nested_instance(fabricated, tmp_path)
    stage.Save()
    shot = fabricated.shot_of(tmp_path / "shot.usda", [path])
    opened = Usd.Stage.Open(str(fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 2))))
    assert not opened.GetPrimAtPath("/World/first").IsInstance()
    assert opened.GetPrimAtPath("/World/second").IsInstance()
    other = "/World/second/inner/grp/hair"
    for code in (1.0, 5.0):
        expected = fabricated.values(Usd.Stage.Open(str(tmp_path / "shot.usda")), other, "points", code)
        assert np.array_equal(fabricated.values(opened, other, "points", code), expected)


def test_a_result_is_a_source_again(fabricated, tmp_path):
    """Simulating over a result overrides that result."""
    source = fabricated.curve_source(tmp_path / "shot.usda")
    first = fabricated.write(tmp_path / "first.usda", fabricated.shot_of(source), fabricated.frames(1, 8))
    again = fabricated.shot_of(first)
    second = fabricated.write(tmp_path / "second.usda", again, fabricated.frames(3, 5), chunk=2)
    opened = Usd.Stage.Open(str(second))
    assert opened.GetPrimAtPath("/World/hair").GetAttribute("points").GetTimeSamples() == [3.0, 4.0, 5.0]
    assert np.array_equal(
        fabricated.values(opened, "/World/hair", "points", 8), fabricated.results(again, 5.0)[0].points
    )


def test_shutter_samples_interpolate_across_files(fabricated, tmp_path):
    """Samples about each frame keep their own values, also beside a chunk's edge."""
    source = fabricated.curve_source(tmp_path / "shot.usda")
    shot = fabricated.shot_of(source)
    samples = [(frame - 0.25, frame, frame + 0.25) for frame in (1.0, 2.0, 3.0, 4.0)]
    opened = Usd.Stage.Open(str(fabricated.write(tmp_path / "out.usda", shot, samples, chunk=2)))
    codes = [code for frame in samples for code in frame]
    points = opened.GetPrimAtPath("/World/hair").GetAttribute("points")
    assert points.GetTimeSamples() == codes
    for code in codes:
        assert np.array_equal(np.array(points.Get(code)), fabricated.results(shot, code)[0].points)
    between = 0.5 * (fabricated.results(shot, 2.25)[0].points + fabricated.results(shot, 2.75)[0].points)
    np.testing.assert_allclose(np.array(points.Get(2.5)), between, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize("rate", [25.0, 30.0, 120.0])
def test_any_rate(fabricated, tmp_path, rate):
    """USD scales the times of layers whose rate is not the root's: all of a result's have the source's."""
    path = fabricated.curve_source(tmp_path / "shot.usda")
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.timeCodesPerSecond = rate
    layer.Save()
    shot = fabricated.shot_of(path)
    opened = Usd.Stage.Open(str(fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 8))))
    assert opened.GetTimeCodesPerSecond() == rate
    for code in FRAMES:
        found = fabricated.values(opened, "/World/hair", "points", code)
        assert np.array_equal(found, fabricated.results(shot, float(code))[0].points)


def test_frame_subset(fabricated, tmp_path):
    """1:9x2 writes every other frame; those between are interpolated."""
    shot = fabricated.shot_of(fabricated.curve_source(tmp_path / "shot.usda"))
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 9, 2), chunk=2)
    opened = Usd.Stage.Open(str(out))
    points = opened.GetPrimAtPath("/World/hair").GetAttribute("points")
    assert points.GetTimeSamples() == [1.0, 3.0, 5.0, 7.0, 9.0]
    assert len({len(points.Get(code)) for code in np.arange(0, 11, 0.5)}) == 1
