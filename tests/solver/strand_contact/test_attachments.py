"""Points of strands that are held to surfaces and to each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import warp as wp

from plait.pipeline.benchmarks.scenes import FormulaMotion, translation
from plait.solver.build import build
from plait.solver.diagnostics import Refused
from plait.solver.scene import Attachment, Motion, Scene, Surface
from plait.solver.settings import Settings, StrandContactSettings, StrandSettings
from plait.solver.step import Simulation

from ..strands.rod_scenes import line, rod_scene
from ..tets.lattices import box_lattice, tet_body
from .scenes import clamp

FRAME = 1.0 / 24.0
LENGTH, SEGMENTS = 0.1, 20
SEGMENT = LENGTH / SEGMENTS
FIBRE: dict[str, Any] = {"radius": 200e-6, "young": 1e8, "density": 1000.0}


@dataclass(frozen=True)
class Window:
    """A switch that is on from `first` to `last` [s]."""

    first: float
    last: float

    def on(self, time: float) -> bool:
        return self.first <= time + 1e-9 < self.last


def held(scene: Scene, point: int, motion: Motion | None = None, **more: Any) -> Scene:
    """Point `point` held at a place of its own."""
    surface = clamp("place", scene.strands[0].points[point], motion)
    middle = np.full((1, 3), 1.0 / 3.0)
    tie = Attachment("held", 0, np.array([point]), len(scene.surfaces), np.zeros(1, np.int32), middle, **more)
    return replace(scene, surfaces=(*scene.surfaces, surface), attachments=(*scene.attachments, tie))


def tied(scene: Scene, point: int, other: int, **more: Any) -> Scene:
    tie = Attachment("tied", 0, np.array([point]), other=0, other_point=np.array([other]), **more)
    return replace(scene, attachments=(*scene.attachments, tie))


def set_free(scene: Scene, *free: bool) -> Scene:
    return replace(scene, strands=(replace(scene.strands[0], free=np.array(free)),))


def start(scene: Scene, method: str = "none", precision: str = "float64") -> Simulation:
    contact = StrandContactSettings(method=method)
    return build(scene, Settings(threads=1, strands=StrandSettings(precision=precision), strand_contact=contact))


def rolling(time: float) -> np.ndarray:
    """(4, 4): to and fro, and a turn about z."""
    moved = translation(np.array([0.02 * np.sin(8.0 * time) - 0.02 * time, 0.03 * np.sin(6.0 * time), 0.0]))
    angle = 0.5 * np.sin(5.0 * time)
    moved[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return moved


@pytest.mark.parametrize(("precision", "allowed"), [("float64", 1e-6), ("float32", 1e-3)])
def test_a_held_point_follows_its_surface(precision, allowed):
    """To 1e-6 of a segment; in float32 to the rounding of positions, 1e-7 of the strand."""
    scene = held(rod_scene([line(LENGTH, SEGMENTS)], **FIBRE), SEGMENTS, FormulaMotion(rolling))
    simulation = start(scene, precision=precision)
    drawn = np.append(scene.strands[0].points[-1], 1.0)
    for frame in range(12):
        simulation.advance_frame((frame + 1) * FRAME)
        where = simulation.model.parts["strands"].points(0)[-1]
        assert np.linalg.norm(where - (rolling((frame + 1) * FRAME) @ drawn)[:3]) <= allowed * SEGMENT


def test_a_tie_carries_exactly_the_weight_that_hangs_on_it():
    """A free strand hangs by its end from another's: the tie's force is its weight, to 1e-4."""
    upper = line(LENGTH, SEGMENTS, (0.0, -1.0, 0.0))
    scene = rod_scene([upper, upper - [0.0, LENGTH + 1e-3, 0.0]], damping=20.0, **FIBRE)
    simulation = start(tied(set_free(scene, False, True), SEGMENTS, SEGMENTS + 1))
    for frame in range(48):
        simulation.advance_frame((frame + 1) * FRAME)
    layout = simulation.model.parts["strands"].layout
    weight = layout.force[layout.first_node[1] :].sum(axis=0)
    force = simulation.state.arrays["attachments/force"].numpy()[0]
    np.testing.assert_allclose(force, weight, atol=1e-4 * np.linalg.norm(weight))


@pytest.mark.parametrize("stiffness", [np.inf, 50.0])
def test_tied_strands_in_flight_keep_their_momentum(stiffness):
    """What one gets the other loses: 1e-10 of the momentum of either."""
    shapes = [line(LENGTH, SEGMENTS), line(LENGTH, SEGMENTS, (0.0, 1.0, 0.3)) + np.array([0.0, 0.01, 0.0])]
    scene = rod_scene(shapes, gravity=(0.0, 0.0, 0.0), **FIBRE)
    simulation = start(tied(set_free(scene, True, True), 10, SEGMENTS + 4, stiffness=stiffness))
    arrays, layout = simulation.state.arrays, simulation.model.parts["strands"].layout
    velocity = np.where((layout.node_strand == 0)[:, None], [0.3, 0.1, 0.0], [-0.2, 0.1, 0.4])
    arrays["strands/velocity"].assign(velocity)
    momentum = layout.mass @ velocity
    for frame in range(6):
        simulation.advance_frame((frame + 1) * FRAME)
    after = arrays["strands/velocity"].numpy()
    one = layout.node_strand == 0
    assert np.linalg.norm(layout.mass[one] @ (after - velocity)[one]) > 1e-2 * np.linalg.norm(momentum)
    assert np.linalg.norm(layout.mass @ after - momentum) <= 1e-10 * np.linalg.norm(momentum)


def test_a_switch_lets_go_without_a_jump():
    """Held, a strand stays; let go, it falls from rest, no faster than a free point: |v| <= g t."""
    shape = line(LENGTH, SEGMENTS)
    scene = held(set_free(rod_scene([shape], **FIBRE), True), 0, switch=Window(0.0, 4 * FRAME))
    scene = held(scene, SEGMENTS, switch=Window(0.0, 4 * FRAME))
    simulation = start(scene)
    stage = simulation.model.parts["strands"]
    for frame in range(4):
        simulation.advance_frame((frame + 1) * FRAME)
    np.testing.assert_allclose(stage.points(0)[[0, -1]], shape[[0, -1]], atol=1e-6 * SEGMENT)
    before = stage.velocities(0)
    simulation.advance_frame(4 * FRAME + FRAME / 8, substeps=1)
    change = stage.velocities(0) - before
    layout = stage.layout
    mean = layout.mass[1:] @ change / layout.mass.sum()
    np.testing.assert_allclose(mean, [0.0, -9.81 * FRAME / 8, 0.0], atol=1e-9)
    assert not simulation.state.arrays["attachments/on"].numpy().any()


def test_what_comes_on_later_keeps_the_offset_of_that_time():
    shape = line(LENGTH, SEGMENTS)
    scene = held(rod_scene([shape], **FIBRE), SEGMENTS, switch=Window(2 * FRAME, np.inf))
    simulation = start(scene)
    stage = simulation.model.parts["strands"]
    for frame in range(2):
        simulation.advance_frame((frame + 1) * FRAME)
    then = stage.points(0)[-1].copy()
    assert np.linalg.norm(then - shape[-1]) > SEGMENT
    for frame in range(2, 6):
        simulation.advance_frame((frame + 1) * FRAME)
    np.testing.assert_allclose(stage.points(0)[-1], then, atol=1e-6 * SEGMENT)


def test_a_spring_gives_by_force_over_stiffness():
    """Weight / k within 1 %, of a free strand that hangs by its first point."""
    scene = set_free(rod_scene([line(LENGTH, SEGMENTS, (0.0, -1.0, 0.0))], damping=20.0, **FIBRE), True)
    stiffness = 2.0
    simulation = start(held(scene, 0, stiffness=stiffness))
    stage = simulation.model.parts["strands"]
    for frame in range(72):
        simulation.advance_frame((frame + 1) * FRAME)
    weight = 9.81 * stage.layout.mass.sum()
    assert stage.points(0)[0, 1] == pytest.approx(-weight / stiffness, rel=1e-2)


def test_tied_points_do_not_collide():
    """Strands tied closer than they would keep apart: the tie holds, and nothing asks for shorter steps."""
    shapes = [line(LENGTH, SEGMENTS), line(LENGTH, SEGMENTS, (0.3, 0.0, 1.0)) - [0.01, 2.5e-4, 0.033]]
    scene = rod_scene(shapes, damping=5.0, **FIBRE)
    simulation = start(tied(scene, 4, SEGMENTS + 8), "implicit")
    stage = simulation.model.parts["strands"]
    drawn = stage.points(0)[4] - stage.points(0)[SEGMENTS + 8]
    for frame in range(6):
        assert simulation.advance_frame((frame + 1) * FRAME)["substeps"] == 8
        apart = stage.points(0)[4] - stage.points(0)[SEGMENTS + 8]
        np.testing.assert_allclose(apart, drawn, atol=1e-6 * SEGMENT)


def test_a_point_held_below_a_surface_stays_there():
    """What holds a point exactly says where it is; the rest of the strand lies on the floor."""
    corners = np.array([[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]])
    floor = Surface("floor", corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), friction=0.5)
    shape = line(LENGTH, SEGMENTS) + np.array([0.0, 1e-3, 0.0])
    down = FormulaMotion(lambda time: translation(np.array([0.0, -2e-3 * min(4.0 * time, 1.0), 0.0])))
    scene = held(set_free(rod_scene([shape], surfaces=(floor,), damping=5.0, **FIBRE), True), 10, down)
    simulation = start(scene)
    for frame in range(12):
        assert simulation.advance_frame((frame + 1) * FRAME)["substeps"] == 8
    height = simulation.model.parts["strands"].points(0)[:, 1]
    assert height[10] == pytest.approx(-1e-3, abs=1e-6 * SEGMENT)
    assert np.delete(height, 10).min() > 0.0


def test_a_point_follows_flesh():
    """Held to a skin, it goes where the body takes that: a soft bar that sags and swings."""
    nodes, tets = box_lattice((0.4, 0.1, 0.1), (4, 1, 1))
    body, skin = tet_body(
        nodes, tets, surface=1, youngs_modulus=3e4, pinned=nodes[:, 0] < nodes[:, 0].min() + 1e-6
    )
    triangle = int(np.argmax(skin.points[skin.triangles[:, 0]] @ [1.0, -1.0, 0.0]))
    shape = skin.points[skin.triangles[triangle, 0]] + line(LENGTH, SEGMENTS, (0.2, -1.0, 0.0))
    scene = set_free(rod_scene([shape], damping=5.0, surfaces=(replace(skin, collides=False),), **FIBRE), True)
    corner = Attachment("held", 0, np.zeros(1, np.int32), 1, np.array([triangle]), np.array([[1.0, 0.0, 0.0]]))
    simulation = start(replace(scene, bodies=(body,), attachments=(corner,)))
    stage, flesh = simulation.model.parts["strands"], simulation.model.parts["tets"]
    skinned = wp.zeros(len(skin.points), dtype=wp.vec3d, device="cpu")
    for frame in range(6):
        simulation.advance_frame((frame + 1) * FRAME)
        flesh.place_skin(0, skinned, wp.zeros(0, dtype=wp.vec3f, device="cpu"))
        corner_now = skinned.numpy()[skin.triangles[triangle, 0]]
        assert np.linalg.norm(stage.points(0)[0] - corner_now) <= 1e-6 * SEGMENT
    assert np.linalg.norm(corner_now - shape[0]) > 0.01


def test_resumes_with_the_same_bits():
    shapes = [line(LENGTH, SEGMENTS), line(LENGTH, SEGMENTS) + np.array([0.0, 0.0, 0.02])]
    scene = held(rod_scene(shapes, **FIBRE), SEGMENTS, FormulaMotion(rolling), switch=Window(2 * FRAME, 6 * FRAME))
    scene = tied(scene, 10, SEGMENTS + 11, switch=Window(FRAME, 5 * FRAME))
    whole, again = start(scene), start(scene)
    for frame in range(3):
        whole.advance_frame((frame + 1) * FRAME)
    again.state.restore(whole.state.to_numpy())
    for frame in range(3, 8):
        whole.advance_frame((frame + 1) * FRAME)
        again.advance_frame((frame + 1) * FRAME)
    for name, array in whole.state.arrays.items():
        assert np.array_equal(array.numpy(), again.state.arrays[name].numpy()), name


def test_points_that_are_not_there_are_refused():
    scene = rod_scene([line(LENGTH, SEGMENTS)], **FIBRE)
    with pytest.raises(Refused, match="tied: point 99 of 21 points"):
        start(tied(scene, 99, 0))
