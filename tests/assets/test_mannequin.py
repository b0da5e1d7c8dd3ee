"""Mannequins: closed skins of three builds, whose weights add up, and whose feet stay where they are put."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from plait.assets import mannequin, walk
from plait.pipeline.validate import validator_findings

BUILDS = (mannequin.THIN, mannequin.AVERAGE, mannequin.HEAVY)
SLIDE = 0.1  # [cm] a planted foot may slide by: a hundredth of its width


@pytest.fixture(scope="module")
def mannequins() -> list[mannequin.Mannequin]:
    return [mannequin.make(build) for build in BUILDS]


def test_skins_are_closed_in_one_piece_and_grow_with_the_build(mannequins):
    meshes = [trimesh.Trimesh(held.points, held.triangles, process=False) for held in mannequins]
    for mesh in meshes:
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1
        assert mesh.bounds[0, 1] > -0.1  # stands on the ground
    volumes = [mesh.volume * 1e-3 for mesh in meshes]  # [l]
    assert all(after > 1.15 * before for before, after in pairwise(volumes))
    assert 40.0 < volumes[0] and volumes[-1] < 110.0  # of people


def test_weights_add_up_and_name_joints(mannequins):
    for held in mannequins:
        assert np.abs(held.joint_weights.sum(axis=1) - 1.0).max() < 1e-12
        assert held.joint_indices.max() < len(held.joints)


def test_planted_feet_do_not_slide_on_a_straight_walk():
    plan = mannequin.straight_walk(6)
    joints = mannequin.skeleton()
    times = np.arange(0.0, 4.5, 1.0 / 96.0)
    moved, turned = walk.animation(joints, times, plan)
    place, rotation = [], []
    for k, joint in enumerate(joints):  # parents first
        up = None if joint.parent < 0 else rotation[joint.parent]
        rotation.append(turned[:, k] if up is None else up @ turned[:, k])
        place.append(moved[:, k] if up is None else place[joint.parent] + walk.apply(up, moved[:, k]))
    motion = walk.Walk(joints, plan)
    for side, swings in plan.steps.items():
        ball = place[next(k for k, joint in enumerate(joints) if joint.name == side + "Toe")]
        number, pitch = motion.planted(side, times), motion.pitch(side, times)
        for footprint in range(len(swings) + 1):
            rolls_off = (number == footprint) & (pitch > -1e-9)
            assert rolls_off.sum() > 5
            assert np.ptp(ball[rolls_off], axis=0).max() < SLIDE, (side, footprint)
    hips = place[0]
    assert hips[-1, 2] - hips[0, 2] == pytest.approx(5 * 66.0, abs=5.0)  # five strides on


def test_an_authored_mannequin_is_sound_usd_and_is_skinned():
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    path = Sdf.Path("/World/Mannequin")
    skin = mannequin.author(stage, path, mannequin.THIN, np.arange(1.0, 25.0), mannequin.straight_walk(2), x=50.0)
    assert [str(finding) for finding in validator_findings(stage)] == []
    assert skin.GetPrim().GetAttribute("plait:role").Get() == "flesh"
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetPrimAtPath(path)), Usd.PrimDefaultPredicate)
    assert cache.GetSkinningQuery(skin.GetPrim()).HasJointInfluences()
