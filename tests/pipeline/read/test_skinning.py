"""Surfaces' poses against UsdSkel's own skinned points, at frames and between them.

Tolerance: 1e-6 of the surface's size, what UsdSkel's float32 leaves.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel, Vt

from plait.pipeline.read.motions import DeformedMotion
from plait.pipeline.read.placing import place_points
from plait.pipeline.read.skeletons import SkeletonBinding, Skeletons
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Bodies, Body

ORIGIN = np.array([3.0, -2.0, 5.0])
SKEL = "PixarAnimationStudios_OpenUSD/pxr/usd/usdSkel/testenv/testUsdSkelBakeSkinning"
SAMPLES = (
    f"{SKEL}/lbs.usda",
    f"{SKEL}/dqs.usda",
    f"{SKEL}/blendshapes.usda",
    f"{SKEL}/blendshapesWithNormals.usda",
    "converted/Barbarian_2H_Melee_Attack_Spin.usdc",
    "converted/Mage_Walking_A.usdc",
    "Autodesk_maya-usd/test/testSamples/UsdSkel/skinCluster.usda",
    "PixarAnimationStudios_OpenUSD/pxr/usdImaging/usdImagingGL/testenv/testUsdImagingGLUsdSkel/twoBends.usda",
)


def _by_usdskel(source: Source, body: Body, binding: SkeletonBinding, code: float) -> np.ndarray:
    """(n, 3) scene coordinates of the mesh's authored points, by UsdSkel alone."""
    points = Vt.Vec3fArray(UsdGeom.PointBased(body.prim).GetPointsAttr().Get(code))
    query, skeleton = binding.query, binding.skeleton
    if query.HasBlendShapes():
        shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(body.prim))
        weights = query.GetBlendShapeMapper().Remap(skeleton.animation.ComputeBlendShapeWeights(code))
        shapes.ComputeDeformedPoints(
            *shapes.ComputeSubShapeWeights(weights),
            shapes.ComputeBlendShapePointIndices(),
            shapes.ComputeSubShapePointOffsets(),
            points,
        )
    holder = body.prim
    if query.HasJointInfluences():
        query.ComputeSkinnedPoints(skeleton.query.ComputeSkinningTransforms(code), points, code)
        holder = skeleton.prim
    to_world = np.array(UsdGeom.Imageable(holder).ComputeLocalToWorldTransform(code))
    placed = np.array(points, dtype=float) @ to_world[:3, :3] + to_world[3, :3]
    return placed * source.units.meters_per_unit - source.origin


def _assert_follows_usdskel(path: Path, codes: tuple[float, ...] | None = None) -> list[Body]:
    source = Source(path)
    source.origin = ORIGIN
    skeletons = Skeletons(source)
    bodies = Bodies(source, skeletons)
    compared = []
    for prim in source.stage.Traverse(Usd.TraverseInstanceProxies()):
        binding = skeletons.find(prim)
        if binding is None or not prim.IsA(UsdGeom.Mesh):
            continue
        body = bodies.get(prim)
        start, end = source.info.start, source.info.end
        for code in codes or (start, start + 0.37 * (end - start), 0.5 * (start + end) + 0.25, end):
            expected = _by_usdskel(source, body, binding, float(code))
            pose = body.surface.motion.pose(code / source.units.time_codes_per_second)
            found = place_points(body.surface, pose)
            # Welded points are compared through the triangles' authored corners.
            difference = found[body.surface.triangles] - expected[body.authored_points]
            size = float(np.ptp(expected, axis=0).max())
            extent = float(np.abs(expected + ORIGIN).max())
            assert np.abs(difference).max() <= 1e-6 * max(size, extent), f"{prim.GetPath()} at {code}"
        compared.append(body)
    assert compared
    return compared


@pytest.mark.parametrize("sample", SAMPLES)
def test_samples(sample: str, shared: Path) -> None:
    _assert_follows_usdskel(shared / "samples" / sample)


RIG = """
def SkelRoot "Body" (prepend apiSchemas = ["SkelBindingAPI"] {metadata})
{{
    {root_transform}
    rel skel:skeleton = </Body/Rig>
    {method}
    def Skeleton "Rig" (prepend apiSchemas = ["SkelBindingAPI"])
    {{
        {rig_transform}
        uniform token[] joints = ["A", "A/B", "A/B/C"]
        uniform matrix4d[] bindTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 2, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 4, 0, 1))]
        uniform matrix4d[] restTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 2, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 2, 0, 1))]
        rel skel:animationSource = </Body/Walk>
    }}
    def SkelAnimation "Walk"
    {{
        uniform token[] joints = ["A/B", "A"]
        float3[] translations = [(0, 2, 0), (0, 0, 0)]
        quatf[] rotations.timeSamples = {{
            1: [(1, 0, 0, 0), (1, 0, 0, 0)], 10: [(0.8, 0, 0.6, 0), (0.6, 0.8, 0, 0)] }}
        half3[] scales.timeSamples = {{ 1: [(1, 1, 1), (1, 1, 1)], 10: [(1, 2, 1), (1, 1, 1)] }}
    }}
    def {group} "Group"
    {{
        def Mesh "Skin" (prepend apiSchemas = ["SkelBindingAPI"])
        {{
            int[] faceVertexCounts = [3, 3]
            int[] faceVertexIndices = [0, 1, 2, 1, 3, 2]
            point3f[] points = [(0, 0, 0), (1, 2, 0), (0, 4, 1), (1, 5, 0)]
            {influences}
            matrix4d primvars:skel:geomBindTransform = ((0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 2, 0), (0.5, 0, 1, 1))
        }}
    }}
}}
"""
VARYING = """
            uniform token[] skel:joints = ["A/B/C", "A"]
            int[] primvars:skel:jointIndices = [0, 1, 1, 0, 0, 1, 1, 0] (
                elementSize = 2
                interpolation = "vertex"
            )
            float[] primvars:skel:jointWeights = {weights} (
                elementSize = 2
                interpolation = "vertex"
            )
"""
HALVES = "[0.5, 0.5, 0.25, 0.75, 1, 0, 0.1, 0.9]"
CONSTANT = """
            int[] primvars:skel:jointIndices = [1] (
                interpolation = "constant"
            )
            float[] primvars:skel:jointWeights = [1] (
                interpolation = "constant"
            )
"""
WALKS = """double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 10: (30, 0, 5) }
    double xformOp:rotateY.timeSamples = { 1: 0, 10: 200 }
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY"]"""
SMALL = """float3 xformOp:scale = (0.01, 0.01, 0.01)
    uniform token[] xformOpOrder = ["xformOp:scale"]"""
UNEVEN = """float3 xformOp:scale = (1, 3, 0.5)
    uniform token[] xformOpOrder = ["xformOp:scale"]"""
DUAL = 'uniform token primvars:skel:skinningMethod = "dualQuaternion"'


def _rig(**parts: str) -> str:
    given = {
        "metadata": "",
        "root_transform": "",
        "rig_transform": "",
        "method": "",
        "group": "Xform",
        "influences": VARYING.format(weights=HALVES),
    }
    return RIG.format(**(given | parts))


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"root_transform": WALKS},
        {"root_transform": WALKS, "rig_transform": SMALL},
        {"rig_transform": UNEVEN},
        {"method": DUAL, "root_transform": WALKS, "rig_transform": SMALL},
        {"influences": CONSTANT, "root_transform": WALKS},
        {"influences": CONSTANT, "method": DUAL},
    ],
    ids=["subset", "walking", "scaled", "uneven", "dual", "rigid", "rigid_dual"],
)
def test_bindings_inherited_from_the_root(parts: dict[str, str], write) -> None:
    """Joint subset in another order, animated and scaled placements, times between frames; bound at the root."""
    body = _assert_follows_usdskel(write(_rig(**parts), meters=0.01))[0]
    assert body.surface.motion.animated


@pytest.mark.parametrize(
    "parts",
    [
        {"method": DUAL, "rig_transform": UNEVEN},
        {"influences": VARYING.format(weights="[0.5, 0.2, 0.25, 0.75, 1, 0, 0, 0]")},
    ],
    ids=["uneven_dual", "weights_short_of_one"],
)
def test_what_joint_matrices_cannot_say_is_left_to_usdskel(parts: dict[str, str], write) -> None:
    body = _assert_follows_usdskel(write(_rig(**parts)))[0]
    assert isinstance(body.surface.motion, DeformedMotion)


def test_an_instanced_root_is_read_through_its_instance(write, tmp_path: Path) -> None:
    write(_rig(root_transform=WALKS), name="asset")
    shot = write('def "Crowd" (instanceable = true; references = @asset.usda@</Body>)\n{\n}\n', name="instanced")
    assert [body.path for body in _assert_follows_usdskel(shot)] == ["/Crowd/Group/Skin"]


def test_a_prim_without_type_hides_its_bindings(write) -> None:
    """UsdSkel prunes it; the user is told, by the path of the prim to mend."""
    source = Source(write(_rig(group="")))
    skeletons = Skeletons(source)
    assert skeletons.find(source.stage.GetPrimAtPath("/Body/Group/Skin")) is None
    assert skeletons.hidden == {"/Body/Group/Skin": "/Body/Group"}
    assert any("</Body/Group>" in line and "make it an Xform" in line for line in source.warnings)


def test_several_skeletons(write) -> None:
    other = _rig(root_transform=WALKS).replace("/Body", "/Other").replace('"Body"', '"Other"')
    bodies = _assert_follows_usdskel(write(_rig() + other))
    assert [body.path for body in bodies] == ["/Body/Group/Skin", "/Other/Group/Skin"]
    assert bodies[0].binding.skeleton is not bodies[1].binding.skeleton


def test_a_still_skeleton_is_not_animated(write) -> None:
    text = _rig().replace("rel skel:animationSource = </Body/Walk>", "")
    assert not _assert_follows_usdskel(write(text))[0].surface.motion.animated


def test_an_asset_without_its_animation_stays_at_rest(write) -> None:
    source = Source(
        write(_rig().replace("rel skel:animationSource = </Body/Walk>", "rel skel:animationSource = </Gone>"))
    )
    skeletons = Skeletons(source)
    assert not skeletons.find(source.stage.GetPrimAtPath("/Body/Group/Skin")).skeleton.animated
    assert any("</Gone>" in line and "at rest" in line for line in source.warnings)


def test_only_the_joints_used_are_posed(write) -> None:
    source = Source(write(_rig()))
    body = Bodies(source, Skeletons(source)).get(source.stage.GetPrimAtPath("/Body/Group/Skin"))
    assert body.surface.motion.pose(0.1).joint_transforms.shape == (2, 4, 4)
    np.testing.assert_allclose(body.surface.skinning.joint_weights.sum(axis=1), 1.0, rtol=1e-15)
