"""Results pass what their source passed, on real shots too; every own check finds what it is for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from plait.pipeline.compare import compare
from plait.pipeline.errors import InputError
from plait.pipeline.layers import open_stage
from plait.pipeline.validate import skinned_prims, validate, validator_findings
from plait.pipeline.write import cache_folder

ARNOLD = "Autodesk_arnold-usd/testsuite"
SKEL = "PixarAnimationStudios_OpenUSD/pxr/usd/usdSkel/testenv/testUsdSkelBakeSkinning"
IMAGING = "PixarAnimationStudios_OpenUSD/pxr/usdImaging/usdImagingGL/testenv"
SAMPLES = (
    f"{ARNOLD}/test_0184/data/test.usda",
    f"{ARNOLD}/test_0189/data/scene.usda",
    f"{ARNOLD}/test_0213/data/mblur_cur_const_def.usda",
    f"{ARNOLD}/test_0213/data/mblur_cur_const_trans.usda",
    f"{ARNOLD}/test_0213/data/mblur_cur_var_trans.usda",
    f"{ARNOLD}/test_0213/data/mblur_cur_var_vel.usda",
    f"{ARNOLD}/test_0213/data/test.usda",
    f"{ARNOLD}/test_1814/data/test.usda",
    f"{IMAGING}/testUsdImagingGLCurves/basicCurves.usda",
    f"{IMAGING}/testUsdImagingGLCurves/moreCurves.usda",
    f"{IMAGING}/testUsdImagingGLCurves/pinnedCurves.usda",
    f"{IMAGING}/testUsdImagingGLUsdSkel/arm.usda",
    f"{IMAGING}/testUsdImagingGLUsdSkel/twoBends.usda",
    f"{SKEL}/lbs.usda",
    f"{SKEL}/dqs.usda",
    f"{SKEL}/blendshapes.usda",
    f"{SKEL}/blendshapesWithNormals.usda",
    "Autodesk_maya-usd/test/testSamples/UsdSkel/skinCluster.usda",
    "converted/Barbarian_Running_A.usdc",
    "converted/Mage_Walking_A.usdc",
)


def simulated_shot(fabricated, path: Path):
    """All curves and skins of a shot, as if every one of them were simulated."""
    stage = Usd.Stage.Open(str(path))
    skinned = skinned_prims(stage)
    prims = [
        str(prim.GetPath())
        for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
        if prim.IsA(UsdGeom.PointBased)
        and (prim.IsA(UsdGeom.Curves) or str(prim.GetPath()) in skinned)
        and prim.GetAttribute("points").Get(Usd.TimeCode.EarliestTime())
    ]
    return fabricated.shot_of(path, prims, skinned=skinned)


def widest(shot) -> float:
    stage = Usd.Stage.Open(str(shot.info.path))
    widths = [
        max(UsdGeom.Curves(prim).GetWidthsAttr().Get(Usd.TimeCode.EarliestTime()) or [1.0])
        for prim in map(stage.GetPrimAtPath, (output.prim_path for output in shot.curves))
        if prim.IsA(UsdGeom.Curves)
    ]
    return max(widths, default=1.0)


@pytest.mark.parametrize("sample", SAMPLES)
def test_real_shots_keep_their_findings_and_gain_none(fabricated, shared, tmp_path, sample):
    """No validator error that the source did not have, 0 simulated prims skinned twice."""
    shot = simulated_shot(fabricated, shared / "samples" / sample)
    assert shot.curves
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 5), width=widest(shot))
    assert validate(out) == []
    assert not skinned_prims(open_stage(out)) & {output.prim_path for output in shot.curves}


def test_sources_have_findings_of_their_own(shared):
    """The comparison with the source is not empty: real shots do have validator findings."""
    path = shared / "samples" / ARNOLD / "test_1814/data/test.usda"
    assert len(validator_findings(open_stage(path))) > 0


@pytest.fixture
def skinned_shot(fabricated, tmp_path):
    """Strands bound to a skeleton by what their parent says, without an applied schema of their own."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdSkel.Root.Define(stage, "/actor")
    stage.SetDefaultPrim(root.GetPrim())
    skeleton = UsdSkel.Skeleton.Define(stage, "/actor/skeleton")
    skeleton.CreateJointsAttr(["hip"])
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1)])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1)])
    binding = UsdSkel.BindingAPI.Apply(root.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    fabricated.define_curves(stage, "/actor/hair")
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    stage.Save()
    assert skinned_prims(stage) == {"/actor/hair"}
    return fabricated.shot_of(tmp_path / "shot.usda", ["/actor/hair"], skinned={"/actor/hair"})


def checks(out: Path) -> set[str]:
    return {finding.check for finding in validate(out)}


def test_an_inherited_binding_is_switched_off(fabricated, tmp_path, skinned_shot):
    out = fabricated.write(tmp_path / "out.usda", skinned_shot, fabricated.frames(1, 2))
    assert checks(out) == set()
    assert skinned_prims(open_stage(out)) == set()


def test_finds_what_is_skinned_twice(fabricated, tmp_path, skinned_shot):
    """The same result without the empty skeleton target."""
    out = fabricated.write(tmp_path / "out.usda", skinned_shot, fabricated.frames(1, 2))
    overrides = cache_folder(out) / "overrides.usda"
    text = overrides.read_text()
    assert "rel skel:skeleton = None" in text
    overrides.write_text(text.replace("rel skel:skeleton = None", ""))
    Sdf.Layer.FindOrOpen(str(overrides)).Reload(force=True)
    assert checks(out) == {"plait:SkinnedTwice"}


@pytest.mark.parametrize(
    ("name", "spoil", "check"),
    [
        ("points", lambda value: value[:-1], "plait:Count"),
        ("velocities", lambda value: value[:-1], "plait:Count"),
        ("points", lambda value: np.where(np.arange(3) == 1, np.nan, value), "plait:NotFinite"),
        ("extent", lambda value: 0.99 * value, "plait:Extent"),
        ("extent", lambda value: value + np.array([[0.0, 0.011, 0.0], [0.0, 0.0, 0.0]]), "plait:Extent"),
    ],
)
def test_finds_what_is_wrong_with_samples(fabricated, tmp_path, name, spoil, check):
    """One sample of one attribute spoiled; the last moves a bound by more than the spare half width of 0.01."""
    shot = fabricated.shot_of(fabricated.curve_source(tmp_path / "shot.usda"))
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 3))
    assert checks(out) == set()
    chunk = Sdf.Layer.FindOrOpen(str(cache_folder(out) / "chunk.0001.usdc"))
    value = np.array(chunk.QueryTimeSample(f"/World/hair.{name}", 2.0))
    chunk.SetTimeSample(f"/World/hair.{name}", 2.0, Vt.Vec3fArray.FromNumpy(spoil(value).astype(np.float32)))
    chunk.Save()
    assert check in checks(out)


def test_finds_a_new_validator_error(fabricated, tmp_path):
    """Metadata that the source has and the result lost is the result's fault."""
    shot = fabricated.shot_of(fabricated.curve_source(tmp_path / "shot.usda"))
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 2))
    top = Sdf.Layer.FindOrOpen(str(out))
    top.pseudoRoot.ClearInfo("metersPerUnit")
    top.Save()
    assert any("StageMetadata" in check for check in checks(out))


def test_a_missing_chunk_is_found_and_is_no_result_to_compare(fabricated, tmp_path, capfd):
    """USD plays what is left of a result that was copied in part, with no more than a warning."""
    shot = fabricated.shot_of(fabricated.curve_source(tmp_path / "shot.usda"))
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1, 8))
    (cache_folder(out) / "chunk.0002.usdc").unlink()
    assert "plait:Missing" in checks(out)
    capfd.readouterr()
    with pytest.raises(InputError, match=r"out\.usda: \./chunk\.0002\.usdc is missing"):
        compare(out, out)
    assert capfd.readouterr().err == ""


def test_what_does_not_open_is_bad_input(tmp_path):
    with pytest.raises(InputError, match="nowhere"):
        validate(tmp_path / "nowhere.usda")
