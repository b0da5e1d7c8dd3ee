"""Skinned points of real shots: read by us and placed on the device, against UsdSkel's own baking of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import warp as wp
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

from plait.pipeline.read.skeletons import Skeletons
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Bodies
from plait.solver.kinematics.deformer import Deformer
from plait.solver.launch import Launcher

OPENUSD = "PixarAnimationStudios_OpenUSD/pxr/usd/usdSkel/testenv/testUsdSkelBakeSkinning/"
SAMPLES = [
    OPENUSD + "lbs.usda",
    OPENUSD + "dqs.usda",
    OPENUSD + "blendshapes.usda",
    "converted/Barbarian_2H_Melee_Attack_Spin.usdc",
    "converted/Mage_Walking_A.usdc",
    "Autodesk_maya-usd/test/testSamples/UsdSkel/skinCluster.usda",
]
FRAMES = 6


def baked_points(path: Path, codes: list[float]) -> dict[str, np.ndarray]:
    """(code_count, point_count, 3) world points [stage units] of each mesh UsdSkel deforms; the file stays."""
    stage = Usd.Stage.Open(Sdf.Layer.OpenAsAnonymous(str(path)))
    roots = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)]
    cache = UsdSkel.Cache()
    deformed = []
    for root in roots:
        cache.Populate(UsdSkel.Root(root), Usd.PrimDefaultPredicate)
        for binding in cache.ComputeSkelBindings(UsdSkel.Root(root), Usd.PrimDefaultPredicate):
            deformed += [query.GetPrim().GetPath() for query in binding.GetSkinningTargets()]
        assert UsdSkel.BakeSkinning(UsdSkel.Root(root), Gf.Interval(codes[0], codes[-1]))
    result = {}
    for prim in (stage.GetPrimAtPath(target) for target in deformed):
        if not prim.IsA(UsdGeom.Mesh):
            continue
        points = UsdGeom.PointBased(prim).GetPointsAttr()
        frames = []
        for code in codes:
            matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))
            frames.append(np.array(points.Get(code), dtype=np.float64) @ matrix[:3, :3] + matrix[3, :3])
        result[str(prim.GetPath())] = np.array(frames)
    return result


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: Path(sample).stem)
def test_skinned_points_agree_with_usdskel(shared: Path, sample: str) -> None:
    """1e-6 of the size for the float32 points that queries see, every skinned mesh, several frames."""
    path = shared / "samples" / sample
    source = Source(path)
    bodies = Bodies(source, Skeletons(source))
    codes = [float(code) for code in np.linspace(source.info.start, source.info.end, FRAMES).round()]
    launcher = Launcher("cpu", 2)
    compared = 0
    for prim_path, reference in baked_points(path, codes).items():
        body = bodies.get(source.stage.GetPrimAtPath(prim_path))
        surface = body.surface
        deformer = Deformer(surface, launcher)
        points = wp.zeros(deformer.count, dtype=wp.vec3d, device="cpu")
        rounded = wp.zeros(deformer.count, dtype=wp.vec3f, device="cpu")
        size = np.ptp(reference, axis=(0, 1)).max()
        for code, expected in zip(codes, reference, strict=True):
            deformer.place(surface.motion.pose(code / source.units.time_codes_per_second), points, rounded)
            placed = rounded.numpy().astype(np.float64) / source.units.meters_per_unit
            error = np.abs(placed[surface.triangles] - expected[body.authored_points]).max()
            assert error < 1e-6 * size, f"{prim_path} at {code:g}: {error / size:.1e} of its size"
            compared += 1
    launcher.close()
    assert compared >= FRAMES
