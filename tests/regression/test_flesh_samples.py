"""The flesh of characters by other people: limbs, heads, bodies, props, open shells, run as they are.

A layer over each file says that its skinned meshes are flesh, and nothing else.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from plait.pipeline.cli import main
from plait.pipeline.config import Config
from plait.pipeline.errors import EXIT_DONE
from plait.pipeline.outputs import Outputs
from plait.pipeline.read import read_shot
from plait.pipeline.shot import Shot
from plait.pipeline.validate import skinned_prims, validate
from plait.solver.build import build

CHARACTERS = ("Barbarian_Running_A", "Mage_Walking_A")
PARTS = ("ArmLeft", "ArmRight", "Body", "Cape", "Hat", "Head", "LegLeft", "LegRight")
FRAMES = 24
# [m] on characters of some two metres.
REST = 1e-5
BUDGET = 1500.0


def fleshed(source: Path, path: Path, *, only: tuple[str, ...] = (), still: bool = False) -> Path:
    """A layer over `source`. only: names of the prims that take part; all if empty.
    still: in the bind pose and without gravity."""
    stage = Usd.Stage.Open(str(source))
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths.append(str(source))
    layer.startTimeCode, layer.endTimeCode = stage.GetStartTimeCode(), stage.GetStartTimeCode() + FRAMES - 1
    layer.timeCodesPerSecond = stage.GetTimeCodesPerSecond()
    layer.pseudoRoot.SetInfo("metersPerUnit", UsdGeom.GetStageMetersPerUnit(stage))
    layer.pseudoRoot.SetInfo("upAxis", UsdGeom.GetStageUpAxis(stage))
    for prim in stage.Traverse():
        over = Sdf.CreatePrimInLayer(layer, prim.GetPath())
        if prim.IsA(UsdGeom.Mesh):
            chosen = not only or prim.GetName() in only
            role = Sdf.AttributeSpec(over, "plait:role", Sdf.ValueTypeNames.Token)
            role.default = "flesh" if chosen else "none"
        if still and prim.IsA(UsdSkel.Skeleton):
            animation = Sdf.RelationshipSpec(over, "skel:animationSource", custom=False)
            animation.targetPathList.ClearEditsAndMakeExplicit()
    if still:
        physics = Sdf.CreatePrimInLayer(layer, "/Physics")
        physics.specifier, physics.typeName = Sdf.SpecifierDef, "PhysicsScene"
        Sdf.AttributeSpec(physics, "physics:gravityMagnitude", Sdf.ValueTypeNames.Float).default = 0.0
    layer.Export(str(path))
    return path


def sample(shared: Path, name: str) -> Path:
    return shared / "samples" / "converted" / f"{name}.usdc"


def read(path: Path) -> Shot:
    return read_shot(path, Config(parameters={"tetBudget": BUDGET}))


def bound_points(path: Path) -> dict[str, np.ndarray]:
    """World points of the skins as UsdSkel puts them at the first frame, by prim."""
    stage = Usd.Stage.Open(str(path))
    start = stage.GetStartTimeCode()
    stage.SetEditTarget(stage.GetSessionLayer())
    UsdSkel.BakeSkinning(stage.Traverse())
    found = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            matrix = np.array(UsdGeom.XformCache(start).GetLocalToWorldTransform(prim))
            points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(start), float)
            found[str(prim.GetPath())] = points @ matrix[:3, :3] + matrix[3, :3]
    return found


def ratios(nodes: np.ndarray, rest: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """(tet_count,) volume over that at rest."""
    now, then = nodes[tets], rest[tets]
    return np.linalg.det(now[:, 1:] - now[:, :1]) / np.linalg.det(then[:, 1:] - then[:, :1])


def check_at_rest(path: Path, frames: int) -> None:
    """In the bind pose: no tet inverted, and every point of every skin where UsdSkel has it, now and later."""
    shot, expected = read(path), bound_points(path)
    start, rate = shot.info.start, shot.info.time_codes_per_second
    simulation = build(shot.scene, start_time=start / rate)
    outputs = Outputs(shot, simulation.model.parts)
    try:
        tets = simulation.model.parts["tets"]
        for index, body in enumerate(shot.scene.bodies):
            assert ratios(tets.nodes(index), body.nodes, body.tets).min() > 0.999, body.name
        for frame in range(frames + 1):
            time = (start + frame) / rate
            if frame:
                simulation.advance_frame(time)
            for output, result in zip(shot.meshes, outputs.frames(time), strict=True):
                to_world = np.linalg.inv(output.world_to_local(time))
                world = result.points @ to_world[:3, :3].T + to_world[:3, 3] + shot.scene.origin
                away = np.linalg.norm(world - expected[output.prim_path], axis=1).max()
                assert away < REST, f"{output.prim_path}, frame {frame}: {away:.2g} m"
    finally:
        simulation.close()


def test_some_of_it_at_rest(shared, tmp_path):
    """Two limbs of open shells, apart from one another."""
    only = ("Mage_ArmLeft", "Mage_LegRight")
    check_at_rest(fleshed(sample(shared, CHARACTERS[1]), tmp_path / "still.usda", only=only, still=True), 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", CHARACTERS)
def test_all_of_it_at_rest(shared, tmp_path, name):
    """All parts at once: as drawn many lie within others, and none pushes another."""
    check_at_rest(fleshed(sample(shared, name), tmp_path / "still.usda", still=True), FRAMES)


def check_runs(path: Path, output: Path, only: tuple[str, ...]) -> None:
    """Through the command line: every frame is there, finite, of the size it was, skinned once."""
    arguments = ["--set", f"parameters.tetBudget={BUDGET}", "--preroll", "0", "--progress", "none"]
    assert main(["sim", str(path), "-o", str(output), *arguments]) == EXIT_DONE
    assert validate(output) == []
    stage = Usd.Stage.Open(str(output))
    metrics = json.loads(output.with_suffix(".metrics.json").read_text())
    assert len(metrics["frames"]) == FRAMES - 1
    prims = [prim for prim in stage.Traverse() if prim.GetName() in only]
    assert len(prims) == len(only) and not skinned_prims(stage) & {str(prim.GetPath()) for prim in prims}
    for prim in prims:
        mesh = UsdGeom.Mesh(prim)
        codes = mesh.GetPointsAttr().GetTimeSamples()
        assert len(codes) == FRAMES
        points = np.array([mesh.GetPointsAttr().Get(code) for code in codes])
        assert np.isfinite(points).all()
        # It keeps its size: nothing explodes, nothing collapses.
        sizes = np.linalg.norm(np.ptp(points, axis=1), axis=1)
        assert sizes.max() < 1.5 * sizes[0] and sizes.min() > 0.6 * sizes[0], prim.GetPath()


def parts_of(name: str) -> tuple[str, ...]:
    """Limbs, head, body and what is worn; not what the character holds, drawn all at once in its hands."""
    return tuple(f"{name.split('_')[0]}_{part}" for part in PARTS)


@pytest.mark.slow
@pytest.mark.parametrize("name", CHARACTERS)
def test_each_part_runs_unprepared(shared, tmp_path, name):
    for part in parts_of(name):
        path = fleshed(sample(shared, name), tmp_path / f"{part}.usda", only=(part,))
        check_runs(path, tmp_path / f"{part}_out.usda", (part,))


@pytest.mark.slow
@pytest.mark.parametrize("name", CHARACTERS)
def test_all_of_it_runs_together(shared, tmp_path, name):
    path = fleshed(sample(shared, name), tmp_path / "shot.usda", only=parts_of(name))
    check_runs(path, tmp_path / "out.usda", parts_of(name))
