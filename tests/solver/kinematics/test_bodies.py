"""What the kinematics stage does for elastic bodies: colliders near a box, skins and roots that bodies carry."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.kinematics.stage import KinematicsStage, build
from plait.solver.launch import Launcher
from plait.solver.model import Interval, Model
from plait.solver.scene import KeyedMotion, RootBinding, Scene, StaticMotion, Strands, Surface
from plait.solver.settings import Settings
from plait.solver.state import State

POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
SHOT = Interval(0.0, 1.0)


class Body:
    """Stands in for the bodies' stage: carries its skin where the test says."""

    def __init__(self, points: np.ndarray) -> None:
        self.points = points

    def place_skin(self, body: int, points_out: wp.array, query_points_out: wp.array) -> None:
        points_out.assign(self.points)
        if len(query_points_out):
            query_points_out.assign(self.points.astype(np.float32))


def shifted(x: float, z: float = 0.0) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = (x, 0.0, z)
    return matrix


def make_stage(scene: Scene) -> tuple[KinematicsStage, State]:
    state = State()
    return build(Model(scene, Settings(threads=1), Launcher("cpu", 1), 0.0), state), state


def hair_on(surface: int) -> Strands:
    one = np.ones(1)
    return Strands(
        "hair",
        np.array([[0.25, 0.5, 0.0], [0.25, 0.5, -1.0]]),
        np.array([0, 2]),
        RootBinding(surface, np.array([0]), np.array([[0.5, 0.25, 0.25]])),
        np.full(2, 1e-3),
        *(one * value for value in (1300.0, 1.0, 1.0, 1.0, 0.0, 0.3)),
    )


def test_colliders_near_are_those_that_enter_the_box_in_the_substep() -> None:
    """A surface passing by at 10 m/s is near only while it passes, and stands at both ends of the substep."""
    passing = KeyedMotion(np.array([0.0, 1.0]), np.stack([shifted(-5.0)[None], shifted(5.0)[None]]))
    still = Surface("still", POINTS, TRIANGLES, StaticMotion(shifted(0.0, 50.0)))
    scene = Scene((Surface("passing", POINTS, TRIANGLES, passing), still), bodies=(object(),))
    stage, state = make_stage(scene)
    stage.begin_frame(state, SHOT)
    lower, upper = np.array([-0.1, 0.0, 0.0]), np.array([0.1, 0.5, 0.5])
    seen = []
    for i in range(20):
        substep = Interval(i / 20, (i + 1) / 20)
        stage.step(state, substep)
        near = stage.colliders_near(lower, upper, substep)
        seen.append([collider.surface.name for collider in near])
        for collider in near:
            for buffer, time in ((stage.start, substep.start), (stage.end, substep.end)):
                placed = stage.colliders.points[buffer][collider.points].numpy()
                np.testing.assert_allclose(placed, np.add(POINTS, [10.0 * time - 5.0, 0.0, 0.0]), atol=1e-12)
    # Its points reach from x to x + 1 with x = 10 t - 5: they meet [-.1, .1] for t between .39 and .51.
    assert [bool(names) for names in seen] == [7 <= i <= 10 for i in range(20)]
    assert all(names in ([], ["passing"]) for names in seen)


def test_a_substep_taken_back_leaves_colliders_where_they_were() -> None:
    """After `retract` the substep's start is the present again, also for surfaces first placed in that substep."""
    passing = KeyedMotion(np.array([0.0, 1.0]), np.stack([shifted(0.0)[None], shifted(4.0)[None]]))
    stage, state = make_stage(Scene((Surface("passing", POINTS, TRIANGLES, passing),), bodies=(object(),)))
    stage.begin_frame(state, SHOT)
    everywhere = np.full(3, -10.0), np.full(3, 10.0)
    for substep in (Interval(0.0, 0.5), Interval(0.0, 0.25), Interval(0.25, 0.5)):
        stage.step(state, substep)
        (collider,) = stage.colliders_near(*everywhere, substep)
        for buffer, time in ((stage.start, substep.start), (stage.end, substep.end)):
            placed = stage.colliders.points[buffer][collider.points].numpy()
            np.testing.assert_allclose(placed, np.add(POINTS, [4.0 * time, 0.0, 0.0]), atol=1e-12)
        if substep.end - substep.start == 0.5:
            stage.retract(state, substep)


def test_roots_and_skins_go_where_the_body_takes_them() -> None:
    """Not where the animation would: a root on a deformed skin is carried by its triangle (polar rotation)."""
    skin = Surface("skin", POINTS, TRIANGLES, body=0)
    stage, state = make_stage(Scene((skin,), (hair_on(0),), bodies=(object(),)))
    np.testing.assert_allclose(stage.root_position.numpy(), [[0.25, 0.5, 0.0]], atol=1e-14)
    turned = POINTS @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [0.0, 0.0, 3.0]
    stage.model.parts["tets"] = Body(turned)
    stage.begin_frame(state, SHOT)
    stage.step(state, SHOT)
    stage.follow_bodies(SHOT.end)
    np.testing.assert_allclose(stage.root_position.numpy(), [[-0.5, 0.25, 3.0]], atol=1e-14)
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(stage.root_rotation.numpy()[0], rotation, atol=1e-14)
    (collider,) = stage.in_reach
    placed = stage.colliders.points[stage.end][collider.points].numpy()
    np.testing.assert_allclose(placed, turned, atol=0.0)
    assert not stage.colliders_near(np.full(3, -10.0), np.full(3, 10.0), SHOT)


def test_a_carried_skin_is_taken_back_with_its_body() -> None:
    """Start and end of a substep are the body's own, also when the substep is retracted and taken in halves."""
    skin = Surface("skin", POINTS, TRIANGLES, body=0)
    stage, state = make_stage(Scene((skin,), (hair_on(0),), bodies=(object(),)))
    body = stage.model.parts["tets"] = Body(POINTS)
    stage.begin_frame(state, SHOT)

    def step(substep: Interval, height: float) -> tuple[float, float]:
        stage.step(state, substep)
        body.points = np.add(POINTS, [0.0, 0.0, height])
        stage.follow_bodies(substep.end)
        (collider,) = stage.in_reach
        return tuple(stage.colliders.points[b][collider.points].numpy()[0, 2] for b in (stage.start, stage.end))

    assert step(SHOT, 1.0) == (0.0, 1.0)
    body.points = POINTS
    stage.retract(state, SHOT)
    assert stage.root_position.numpy()[0, 2] == 0.0
    assert step(Interval(0.0, 0.5), 0.25) == (0.0, 0.25)
    assert step(Interval(0.5, 1.0), 1.0) == (0.25, 1.0)
