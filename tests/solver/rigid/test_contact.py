"""Rigid bodies in contact: Coulomb's and Signorini's laws, rest, momenta."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.pipeline.benchmarks.scenes import FormulaMotion
from plait.solver.build import build
from plait.solver.rigid.mass_properties import of_shape
from plait.solver.scene import Shape, Surface
from plait.solver.settings import Settings

from ..contact.soft_scenes import floor, solid_box, turn_z
from ..tets.lattices import placed
from .rigid_scenes import FRAME, Rigid, box, rotation_about, shaped

GRAVITY, SIZE = 9.81, 0.2


# -- Coulomb's law -------------------------------------------------------------------------------------------


def slide(angle: float, friction: float, seconds: float = 1.0) -> tuple[Rigid, np.ndarray]:
    """A box laid onto an incline; its velocity down the slope after each frame."""
    rotation = turn_z(angle)
    height = 0.5 * SIZE * rotation[:, 1]
    scene = Rigid(
        [box(centre=height, rotation=rotation, friction=friction)],
        [floor(rotation=rotation, friction=friction, half=20.0)],
    )
    along = []
    for _ in range(round(seconds / FRAME)):
        scene.run(FRAME)
        along.append(scene.velocity[0] @ -rotation[:, 0])
    return scene, np.array(along)


@pytest.mark.parametrize("angle", [10.0, 25.0])
def test_an_incline_is_slid_down_below_the_threshold_and_not_above(angle):
    """Coulomb: sliding where tan(angle) > mu. Beside the threshold by .002, in a second: 0, or .002 g cos."""
    threshold = np.tan(np.radians(angle))
    _, held = slide(angle, threshold + 0.002)
    _, let = slide(angle, threshold - 0.002)
    assert abs(held).max() < 1e-4 * GRAVITY * 0.002
    assert let[-1] == pytest.approx(0.002 * GRAVITY * np.cos(np.radians(angle)), rel=0.05)


@pytest.mark.parametrize("angle, friction", [(25.0, 0.3), (30.0, 0.2), (15.0, 0.0), (20.0, 0.9)])
def test_an_incline_gives_the_acceleration_of_coulombs_law(angle, friction):
    """a = g (sin - mu cos), 0 where that is negative, within .3 % of g; 30 degrees, mu = .2: 3.205858."""
    _, velocity = slide(angle, friction)
    slope = np.radians(angle)
    expected = max(0.0, GRAVITY * (np.sin(slope) - friction * np.cos(slope)))
    assert abs(velocity[-1] / 1.0 - expected) < 0.003 * GRAVITY


@pytest.mark.parametrize("kind, size", [("sphere", 0.1), ("capsule", 0.1), ("cylinder", 0.1)])
def test_what_slides_comes_to_roll(kind, size):
    """From v0 without spin: rolls at v0 / (1 + k), k = I / (m r^2), after v0 k / ((1 + k) mu g); of a ball 5/7.

    Round shapes roll on exactly: the speed stays.
    """
    speed, friction = 2.0, 0.25
    lying = None if kind == "sphere" else np.eye(3)
    prop = shaped(kind, size, (0.0, size, 0.0), lying, friction=friction, velocity=[speed, 0.0, 0.0])
    scene = Rigid([prop], [floor(friction=friction, half=20.0)])
    k = prop.mass.inertia[2, 2] / (prop.mass.mass * size**2)
    until = speed * k / ((1.0 + k) * friction * GRAVITY)
    rolls, time = speed / (1.0 + k), None
    while scene.time < 2.0:
        scene.substep()
        if time is None and abs(scene.velocity[0, 0] + scene.spin[0, 2] * size) < 1e-4:
            time = scene.time
            assert scene.velocity[0, 0] == pytest.approx(rolls, rel=0.02)
    assert time == pytest.approx(until, rel=0.02)
    assert scene.velocity[0] == pytest.approx([rolls, 0.0, 0.0], rel=1e-4, abs=1e-4)
    assert scene.position[0, 1] == pytest.approx(size, abs=1e-6)


def test_a_block_rides_a_turntable():
    """Below the slip speed it sticks: the radius drifts by less than 1 % a turn, and it turns with the table."""
    speed, friction = 3.0, 0.7  # [1/s]; needs 0.79 of the friction there is

    def turned(time: float) -> np.ndarray:
        return placed(rotation=rotation_about(np.array([0.0, 1.0, 0.0]), speed * time))

    prop = box(
        centre=(0.6, 0.5 * SIZE, 0.0),
        friction=friction,
        velocity=[0.0, 0.0, -speed * 0.6],
        angular_velocity=[0.0, speed, 0.0],
    )
    scene = Rigid([prop], [floor(half=2.0, motion=FormulaMotion(turned), friction=friction)])
    frames = int(np.ceil(2.0 * np.pi / speed / FRAME))
    for _ in range(3):
        radius = np.hypot(*scene.position[0, [0, 2]])
        scene.run(frames * FRAME)
        assert abs(np.hypot(*scene.position[0, [0, 2]]) - radius) < 0.01 * radius
    angle = np.arctan2(-scene.position[0, 2], scene.position[0, 0])
    assert np.cos(angle - speed * scene.time) > np.cos(0.02)


def test_a_block_rides_a_spinning_body():
    """The same on a plate that is itself a rigid body, far heavier: nor does sticking drift between bodies."""
    speed = 2.0
    plate = box((4.0, 0.2, 4.0), density=1e6, friction=0.7, angular_velocity=[0.0, speed, 0.0])
    rider = box(
        centre=(0.6, 0.2, 0.0), friction=0.7, velocity=[0.0, 0.0, -speed * 0.6], angular_velocity=[0.0, speed, 0.0]
    )
    under = floor(friction=0.0)
    scene = Rigid([plate, rider], [replace(under, points=under.points - [0.0, 0.1, 0.0])])
    scene.run(2.0 * np.pi / speed)
    offset = scene.position[1] - scene.position[0]
    assert np.hypot(offset[0], offset[2]) == pytest.approx(0.6, rel=0.01)


# -- rest ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("friction", [0.5, 0.1])
def test_three_boxes_stand_on_each_other(friction):
    """For 5 s: the top moves by less than 1 % of its size, overlaps stay below 1 % of it."""
    props = [box(centre=(0.02 * k, (0.5 + k) * SIZE, 0.01 * k), friction=friction) for k in range(3)]
    scene = Rigid(props, [floor(friction=friction)])
    start = scene.position
    scene.run(5.0)
    assert np.abs(scene.position - start).max() < 0.01 * SIZE
    lowest = [scene.points(k)[:, 1].min() for k in range(3)]
    highest = [0.0, *(scene.points(k)[:, 1].max() for k in range(2))]
    assert all(low - high > -0.01 * SIZE for low, high in zip(lowest, highest, strict=True))


def test_a_heavy_box_stands_on_light_ones():
    props = [box(centre=(0.0, (0.5 + k) * SIZE, 0.0), density=d) for k, d in enumerate((100.0, 100.0, 1e4))]
    scene = Rigid(props, [floor()])
    start = scene.position
    scene.run(2.0)
    assert np.abs(scene.position - start).max() < 0.01 * SIZE


@pytest.mark.parametrize("seed", range(3))
def test_a_heap_of_boxes_comes_to_rest(seed):
    """Of densities up to a hundred times apart, dropped any way round: no overlap of 5 %, then nothing moves."""
    random = np.random.default_rng(seed)
    props = []
    for k in range(12):
        size, centre = random.uniform(0.1, 0.3, 3), random.uniform(-0.4, 0.4, 3)
        centre[1] = 0.3 + 0.3 * k
        turn = rotation_about(random.normal(size=3), random.uniform(0.0, 3.0))
        density = 10.0 ** random.uniform(2.0, 4.0)
        props.append(box(size, centre, turn, density=density, restitution=0.2))
    scene = Rigid(props, [floor()])
    for _ in range(96):
        metrics = scene.run(FRAME)
        assert min(scene.points(k)[:, 1].min() for k in range(12)) > -0.05 * SIZE
    assert metrics["kinetic_energy"] < 1e-9


def test_pulled_apart_no_impulse_acts():
    """Exactly 0."""
    props = [
        box(centre=(-0.1, 0.0, 0.0), velocity=[-1.0, 0.0, 0.0]),
        box(centre=(0.1, 0.0, 0.0), velocity=[1.0, 0.0, 0.0]),
    ]
    scene = Rigid(props, gravity=(0.0, 0.0, 0.0))
    scene.run(FRAME)
    assert np.array_equal(scene.velocity, [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert not scene.stage.angular_momentum.numpy().any()


# -- impacts -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_balls_head_on_part_as_newton_says(restitution):
    props = [
        shaped("sphere", 0.1, (-0.3, 0.0, 0.0), velocity=[1.0, 0.0, 0.0], restitution=restitution),
        shaped("sphere", 0.1, (0.3, 0.0, 0.0), velocity=[-2.0, 0.0, 0.0], density=3000.0, restitution=0.0),
    ]
    scene = Rigid(props, gravity=(0.0, 0.0, 0.0))
    before = scene.mass @ scene.velocity / scene.mass.sum()
    scene.run(0.5)
    velocity = scene.velocity[:, 0]
    assert velocity[1] - velocity[0] == pytest.approx(3.0 * restitution, abs=1e-6)
    assert scene.mass @ scene.velocity / scene.mass.sum() == pytest.approx(before, rel=1e-13)


@pytest.mark.parametrize(("own", "floors"), [(0.5, 0.0), (0.0, 0.8), (0.9, 0.3)])
def test_a_ball_leaves_the_floor_by_the_larger_restitution(own, floors):
    ball = shaped("sphere", 0.1, (0.0, 0.2, 0.0), velocity=[0.0, -2.0, 0.0], restitution=own)
    scene = Rigid([ball], [floor(restitution=floors)], gravity=(0.0, 0.0, 0.0))
    scene.run(0.25)
    assert scene.velocity[0] == pytest.approx([0.0, 2.0 * max(own, floors), 0.0], abs=1e-6)


def test_momenta_of_a_closed_scene_hold():
    """Both, of twelve boxes, balls and cylinders thrown together with friction: 1e-12 of their sizes a second."""
    random = np.random.default_rng(5)
    props = []
    for k in range(12):
        place = 0.4 * (np.array([k % 3, k // 3 % 2, k // 6]) - [1.0, 0.5, 0.5])
        motion = {
            "velocity": -3.0 * place + 0.3 * random.normal(size=3),
            "angular_velocity": 5.0 * random.normal(size=3),
            "rotation": rotation_about(random.normal(size=3), random.uniform(0.0, 3.0)),
            "restitution": 0.3,
        }
        kind = ("box", "sphere", "cylinder")[k % 3]
        props.append(box(centre=place, **motion) if kind == "box" else shaped(kind, 0.1, place, **motion))
    scene = Rigid(props, gravity=(0.0, 0.0, 0.0))
    linear, angular = scene.momenta()
    size = (scene.mass * np.linalg.norm(scene.velocity, axis=1)).sum()
    contacts, energy = 0, np.inf
    for _ in range(24):
        metrics = scene.run(FRAME)
        contacts += metrics["contacts"]
        assert metrics["kinetic_energy"] <= energy * (1.0 + 1e-9)
        energy = metrics["kinetic_energy"]
    assert contacts > 20
    after = scene.momenta()
    assert np.abs(after[0] - linear).max() < 1e-12 * size
    assert np.abs(after[1] - angular).max() < 1e-12 * size


@pytest.mark.parametrize("speed", [5.0, 20.0])
def test_a_thin_plate_stops_what_hits_it(speed):
    """Nothing passes, however thin; what an impact makes turn far in a substep overlaps by 5 % of its size."""
    plate = solid_box("plate", (8.0, 0.002, 8.0))
    props = [
        box(centre=(0.03, 0.4, 0.02), rotation=rotation_about(np.ones(3), 0.7), velocity=[0.0, -speed, 0.0]),
        shaped("sphere", 0.05, (-0.4, 0.4, 0.4), velocity=[0.0, -speed, 0.0]),
    ]
    scene = Rigid(props, [plate])
    for _ in range(48):
        scene.substep()
        assert scene.points(0)[:, 1].min() > -0.05 * SIZE
        assert scene.position[1, 1] - 0.05 > 1e-3 - 1e-6
    scene.run(0.5)
    assert scene.points(0)[:, 1].min() > 0.0


def test_a_piston_at_ten_metres_a_second_drives_a_box_before_it():
    """It comes no nearer than 1e-6, and the box goes on as fast."""
    motion = FormulaMotion(lambda time: placed((10.0 * time, 0.0, 0.0)))
    piston = solid_box("piston", (0.2, 1.0, 1.0), (-0.4, 0.5, 0.0), motion=motion)
    scene = Rigid([box(centre=(-0.19, 0.5 * SIZE, 0.0))], [floor(half=100.0), piston])
    for _ in range(96):
        scene.substep()
        assert scene.points(0)[:, 0].min() - (-0.3 + 10.0 * scene.time) > -1e-6
    assert scene.velocity[0] == pytest.approx([10.0, 0.0, 0.0], abs=1e-6)


def test_edges_that_cross_hold_each_other():
    """A bar laid across a bar, both on edge: no corner touches. Depth of the crossing below 1 % of the size."""
    on_edge = rotation_about(np.array([0.0, 0.0, 1.0]), 0.25 * np.pi)
    across = rotation_about(np.array([0.0, 1.0, 0.0]), 0.5 * np.pi)
    half = np.sqrt(0.5) * SIZE
    lower = solid_box("bar", (SIZE, SIZE, 2.0))
    lower = replace(lower, points=lower.points @ on_edge.T)
    upper = box((SIZE, SIZE, 2.0), (0.0, 2.0 * half + 0.05, 0.0), across @ on_edge)
    scene = Rigid([upper], [lower])
    scene.run(0.5)
    assert scene.position[0, 1] == pytest.approx(2.0 * half, abs=0.01 * SIZE)


def test_a_spike_holds_up_a_box():
    """The apex of a pyramid under the middle of a box: no corner of the box touches."""
    points = np.array([[-0.2, 0.0, -0.2], [0.2, 0.0, -0.2], [0.2, 0.0, 0.2], [-0.2, 0.0, 0.2], [0.0, 0.3, 0.0]])
    triangles = np.array([[0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0], [0, 1, 2], [0, 2, 3]], dtype=np.int32)
    for prop in (box(centre=(0.0, 0.45, 0.0)), shaped("box", 0.1, (0.0, 0.45, 0.0))):
        scene = Rigid([prop], [Surface("spike", points, triangles)])
        scene.run(0.25)
        assert scene.position[0, 1] == pytest.approx(0.4, abs=1e-4)


def test_a_body_of_two_surfaces_rests_on_both():
    """A dumbbell of two balls of different size lies on the floor on both of them."""
    scene = Rigid([shaped("sphere", 0.1, (0.0, 0.12, 0.0))], [floor()]).scene
    frames = [np.eye(4), placed((0.4, 0.0, 0.0))]
    shapes = [
        Shape("sphere", np.full(3, radius), frame) for radius, frame in zip((0.1, 0.05), frames, strict=True)
    ]
    first = replace(scene.surfaces[0], shape=shapes[0])
    second = replace(first, points=0.5 * first.points + [0.4, 0.0, 0.0], shape=shapes[1])
    parts = [of_shape(shape, 1000.0) for shape in shapes]
    mass = sum(part.mass for part in parts)
    center = sum(part.mass * part.center for part in parts) / mass
    apart = [part.center - center for part in parts]
    inertia = sum(
        part.inertia + part.mass * ((way @ way) * np.eye(3) - np.outer(way, way))
        for part, way in zip(parts, apart, strict=True)
    )
    body = replace(scene.rigid_bodies[0], surfaces=(0, 1), mass=mass, center_of_mass=center, inertia=inertia)
    simulation = build(
        replace(scene, surfaces=(first, second, scene.surfaces[1]), rigid_bodies=(body,)), Settings(threads=1)
    )
    for k in range(48):
        simulation.advance_frame((k + 1) * FRAME)
    pose = simulation.model.parts["rigid"].pose(0)
    heights = [(pose @ frame)[1, 3] for frame in frames]
    assert heights == pytest.approx([0.1, 0.05], abs=1e-4)


def test_a_ball_in_a_corner_keeps_out_of_all_walls():
    walls = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1], [1, 1, -1], [1, 1, 1], [-1, 1, 1]], float)
    triangles = np.array([[0, 2, 1], [0, 3, 2], [1, 2, 5], [1, 5, 4], [2, 3, 6], [2, 6, 5]], dtype=np.int32)
    trough = Surface("trough", walls, triangles, friction=0.0)
    scene = Rigid([shaped("sphere", 0.1, (0.8, 0.12, 0.85), velocity=[3.0, -1.0, 2.0])], [trough])
    for _ in range(48):
        scene.substep()
        x = scene.position[0]
        assert x[1] > 0.1 - 1e-3 and x[0] < 0.9 + 1e-3 and x[2] < 0.9 + 1e-3


@pytest.mark.parametrize("kind", ["cylinder", "cone", "capsule", "box", "sphere"])
def test_shapes_come_to_rest_on_the_floor(kind):
    """Nothing sinks; nothing moves any more; its lowest point, of a fine sample of the shape, is on the floor."""
    size = (0.1, 0.15, 0.1)
    tilt = rotation_about(np.array([1.0, 0.3, 0.2]), -0.5 * np.pi + 0.2)
    scene = Rigid([shaped(kind, size, (0.0, 0.3, 0.0), tilt, angular_velocity=[0.0, 0.5, 0.0])], [floor()])
    scene.run(4.0)
    assert abs(scene.velocity[0, 1]) < 1e-3
    assert 0.02 < scene.position[0, 1] < 0.2


def test_threads_and_repetition_give_the_same_bits():
    def run(threads: int) -> np.ndarray:
        props = [box(centre=(0.03 * k, 0.11 + 0.21 * k, 0.0), restitution=0.2) for k in range(6)]
        props += [box(centre=(1.0 + 0.03 * k, 0.11 + 0.21 * k, 0.0)) for k in range(6)]
        scene = Rigid(props, [floor()], threads=threads)
        scene.run(0.5)
        return np.concatenate([scene.position, scene.stage.orientation.numpy()], axis=1)

    one = run(1)
    assert np.array_equal(one, run(1)) and np.array_equal(one, run(2))
