"""Bodies that lie still on something cost nothing until something happens to them, and nothing is seen of it."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.benchmarks.scenes import FormulaMotion
from plait.solver.contact.obstacles import REACH
from plait.solver.model import Interval
from plait.solver.scene import Surface
from plait.solver.tets.stillness import STILL, STILL_TIME, islands

from ..tets.lattices import box_body, placed
from .soft_scenes import FRAME, SUBSTEPS, Soft, floor, solid_box, turn_z

CELL, EDGE = 0.1, 0.0951  # [m] of the lattices; mean of the tets' edges
GAP = REACH * EDGE
GRAVITY = 9.81
# [m/s] What lies is slower than this, on average over the time that it must do so.
STILL_SPEED = STILL * EDGE / STILL_TIME


def block(height: float, across: float = 0.0, index: int = 0, size=(0.3, 0.2, 0.2), **body) -> tuple:
    """A jelly with the damping that flesh has by default; `height` [m] of its lower side."""
    cells = tuple(round(side / CELL) for side in size)
    given = {
        "youngs_modulus": 1e5,
        "stiffness_damping": 0.005,
        "friction": 0.5,
        "transform": placed((across, height + 0.5 * size[1], 0.0)),
    }
    return box_body(size, cells, index=index, surface=index, **given | body)


def laid(*obstacles, others=(), **settings) -> Soft:
    """A block laid onto a floor, if no obstacle is given."""
    return Soft([block(GAP), *others], list(obstacles) or [floor()], **settings)


def asleep(scene: Soft) -> np.ndarray:
    return scene.simulation.state.arrays["tets/asleep"].numpy() > 0


def sleep(scene: Soft, seconds: float = 2.0) -> None:
    """Until all bodies do."""
    for _ in range(round(seconds / FRAME)):
        scene.run()
        if asleep(scene).all():
            return
    raise AssertionError(f"awake after {seconds} s")


def lowest(scene: Soft) -> float:
    return float(scene.skin[:, 1].min())


def test_a_block_laid_on_a_floor_sleeps_within_two_seconds():
    """No Newton iteration any more, and not one bit of a position changes."""
    scene = laid()
    sleep(scene)
    still = scene.nodes
    for _ in range(4):
        metrics = scene.run()["tets"]
        assert metrics["asleep"] == 1
        assert metrics["newton_iterations"] == metrics["linear_iterations"] == 0
    np.testing.assert_array_equal(scene.nodes, still)
    assert scene.speed == 0.0


def test_a_floor_that_starts_to_move_carries_it():
    """Within friction: with the floor's speed to a hundredth, after a second; and it neither sinks nor hops."""
    start, acceleration = 2.0, 0.2 * GRAVITY

    def place(time: float) -> np.ndarray:
        return placed((0.5 * acceleration * max(time - start, 0.0) ** 2, 0.0, 0.0))

    scene = laid(floor(motion=FormulaMotion(place)))
    sleep(scene)
    while scene.frames * FRAME < start - 0.5 * FRAME:
        scene.run()
    assert asleep(scene).all()
    low, height = lowest(scene), scene.centre[1]
    for _ in range(SUBSTEPS):
        scene.substep()
        assert not asleep(scene).any()
        assert lowest(scene) > 0.5 * low and abs(scene.centre[1] - height) < 1e-3 * CELL
    scene.run(23)
    assert scene.velocity[0] == pytest.approx(acceleration, rel=1e-2)


def test_a_floor_that_drops_away_lets_it_fall():
    """At once further than the block could feel it: free fall from rest, begun within a substep."""
    start = 2.0
    motion = FormulaMotion(lambda time: placed((0.0, -1.0 if time > start else 0.0, 0.0)))
    scene = laid(floor(motion=motion))
    sleep(scene)
    while scene.frames * FRAME < start - 0.5 * FRAME:
        scene.run()
    assert asleep(scene).all()
    scene.run(2)
    assert scene.velocity[1] == pytest.approx(-GRAVITY * 2 * FRAME, abs=GRAVITY * FRAME / SUBSTEPS)


@pytest.mark.parametrize("way", [(0.0, 0.5, 0.0), (0.3, -0.1, 0.0)], ids=["up", "down and aside"])
def test_an_impulse_wakes_it(way):
    """What strands give, for one: taken up whole, with the floor still below."""
    scene = laid()
    sleep(scene)
    low = lowest(scene)
    scene.push(np.array(way))
    scene.substep()
    assert not asleep(scene).any()
    if way[1] > 0.0:
        # The floor has let go in this very step, but for what its spring back gives.
        weight = GRAVITY * FRAME / SUBSTEPS
        assert way[1] - weight < scene.velocity[1] < way[1] + weight
    else:
        assert lowest(scene) > 0.5 * low
        assert 0.0 < scene.velocity[0] <= way[0]


def test_what_falls_on_it_wakes_it_without_a_jump():
    """It lies to the bit till the other is near, moves no faster than what lies before the hit, never sinks."""
    scene = laid(others=[block(2.4, index=1, size=(0.2, 0.2, 0.2))])
    first = scene.tets.layout.nodes(0)
    scene.push(np.repeat([[0.0, 0.0, 0.0], [0.0, 8.0, 0.0]], np.diff(scene.tets.layout.first_node), axis=0))
    scene.run(24)
    assert asleep(scene).tolist() == [True, False]
    still, low, hit = scene.nodes[first], lowest(scene), False
    for _ in range(40 * SUBSTEPS):
        before = scene.tets.node_velocities(1)[:, 1].mean()
        scene.substep()
        # In free fall it loses g h in a step.
        hit = scene.tets.node_velocities(1)[:, 1].mean() > before - 0.9 * GRAVITY * FRAME / SUBSTEPS
        if hit:
            break
        if asleep(scene)[0]:
            np.testing.assert_array_equal(scene.nodes[first], still)
        assert np.abs(scene.tets.node_velocities(0)).max() <= STILL_SPEED
    assert hit and not asleep(scene).any()
    for _ in range(2 * SUBSTEPS):
        scene.substep()
        assert lowest(scene) > 0.25 * low
    assert np.abs(scene.tets.node_velocities(0)).max() > 0.1


def stack(**settings) -> Soft:
    return laid(others=[block(0.2 + 0.05 * CELL, across=0.03, index=1, size=(0.2, 0.1, 0.2))], **settings)


def test_what_lies_on_a_body_sleeps_with_it_and_wakes_with_it():
    """A push of the lower one alone: both are awake from that substep on."""
    scene = stack()
    sleep(scene, 4.0)
    still = scene.nodes
    metrics = scene.run()["tets"]
    assert metrics["asleep"] == 2 and metrics["newton_iterations"] == 0
    np.testing.assert_array_equal(scene.nodes, still)
    push = np.zeros_like(still)
    push[scene.tets.layout.nodes(0)] = [0.5, 0.0, 0.0]
    scene.push(push)
    scene.substep()
    assert not asleep(scene).any()
    # The upper one follows by friction alone and goes on lying there: no hop, no fall.
    assert np.abs(scene.tets.node_velocities(1)[:, 1]).max() < 2.0 * GRAVITY * FRAME / SUBSTEPS
    assert scene.tets.node_velocities(1)[:, 0].mean() > 0.0


def pillars() -> Surface:
    """Two of them, a metre to either side, that go up and down all the time."""
    motion = FormulaMotion(lambda time: placed((0.0, 0.3 * np.sin(3.0 * time), 0.0)))
    one, other = (solid_box("pillar", (0.2, 1.0, 0.2), (x, 0.0, 0.0)) for x in (-1.0, 1.0))
    points = np.concatenate([one.points, other.points])
    triangles = np.concatenate([one.triangles, other.triangles + len(one.points)])
    return Surface("pillars", points, triangles, motion=motion)


def test_what_does_not_touch_it_changes_no_bit():
    """Neither a body that is kept awake elsewhere, nor a surface that moves on either side of it."""
    alone = laid()
    among = laid(floor(), pillars(), others=[block(GAP, across=3.0, index=1)])
    own, other = among.tets.layout.nodes(0), among.tets.layout.nodes(1)
    push = np.zeros_like(among.nodes)
    for frame in range(36):
        push[other] = among.mass[other] * [0.0, 0.0, 0.1 * (-1) ** frame]
        among.tets.external_impulse.assign(push)
        among.run()
        alone.run()
        np.testing.assert_array_equal(among.nodes[own], alone.nodes)
        assert asleep(among).tolist() == [asleep(alone)[0], False]
    assert asleep(alone).all()


@pytest.mark.parametrize("make", [laid, stack])
def test_a_sleeping_scene_goes_on_from_a_checkpoint_bit_for_bit(make):
    """Asleep when saved, and woken afterwards."""
    scene, again = make(), make(threads=2)
    sleep(scene, 4.0)
    again.simulation.state.restore(scene.simulation.state.to_numpy())
    for part in (scene, again):
        part.run()
        assert asleep(part).all()
        part.push(np.array([0.3, -0.1, 0.1]))
        part.run(3)
    for name, array in scene.simulation.state.arrays.items():
        np.testing.assert_array_equal(array.numpy(), again.simulation.state.arrays[name].numpy(), err_msg=name)


@pytest.mark.parametrize("pushed", [False, True])
def test_a_step_taken_back_leaves_no_trace(pushed):
    """Where a body falls asleep in that step, and where it wakes."""
    scene = laid()
    state, parts = scene.simulation.state, scene.simulation.model.parts
    while not asleep(scene).all():
        held = state.to_numpy()
        scene.substep()
    if pushed:
        scene.run()
        scene.push(np.array([0.1, 0.0, 0.0]))
    else:
        state.restore(held)
    before = state.to_numpy()
    substep = Interval(state.time, state.time + FRAME / SUBSTEPS)
    parts["kinematics"].begin_frame(state, substep)
    parts["kinematics"].step(state, substep)
    assert scene.tets.step(state, substep)
    assert asleep(scene).all() != pushed
    scene.tets.retract(state, substep)
    for name, values in state.to_numpy().items():
        if name != "time":
            np.testing.assert_array_equal(values, before[name], err_msg=name)


def test_a_slow_slide_is_no_rest():
    """On ice that slopes by a thousandth, from rest: v = 0.001 g t."""
    slope = turn_z(np.degrees(1e-3))
    jelly = block(0.0, transform=placed((GAP + 0.1) * slope[:, 1], slope), friction=0.0)
    scene = Soft([jelly], [floor(rotation=slope, friction=0.0)])
    scene.run(48)
    assert not asleep(scene).any()
    assert scene.velocity @ -slope[:, 0] == pytest.approx(1e-3 * GRAVITY * 48 * FRAME, rel=0.05)


def test_islands():
    """Bodies in one chain of pairs are one island, and those in none alone."""
    pairs = np.array([[5, 3], [3, 1], [2, 2], [4, 0]])
    assert [group.tolist() for group in islands(6, pairs)] == [[0, 4], [1, 3, 5], [2]]
    assert [group.tolist() for group in islands(2, pairs[:0])] == [[0], [1]]
