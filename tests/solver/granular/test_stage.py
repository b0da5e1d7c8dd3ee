"""Scenes with granular matter: falling, lying, sliding, struck, poured in, taken up again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.solver.build import build
from plait.solver.diagnostics import Diverged
from plait.solver.scene import Emitter, Granular, KeyedMotion, Scene, Surface
from plait.solver.settings import Settings

from ..contact.soft_scenes import solid_box
from .heaps import CELL, FRAME, granular, lattice, plate, run, simulated

SOFT = {"youngs_modulus": 2e4, "density": 1000.0}


def heap(places: np.ndarray, velocity=(0.0, 0.0, 0.0), **values) -> Granular:
    return granular(places, np.tile(velocity, (len(places), 1)), **(SOFT | values))


def test_falls_as_thrown():
    """x + v t + g t (t + dt) / 2, the sum of symplectic steps: all particles alike, none strained."""
    places = lattice((3, 3, 3), (40.0, 3.0, -2.0))
    simulation = simulated(Scene(granular=(heap(places, (1.0, 2.0, 0.0)),)))
    metrics = run(simulation, 6)
    grains = simulation.model.parts["granular"].grains(0)
    time, steps = 6 * FRAME, sum(m["steps"] for m in metrics)
    fallen = [1.0 * time, 2.0 * time - 9.81 * time**2 / 2, 0.0]
    # Steps are not all as long: between none and twice what equal ones fall further.
    off = grains.positions - places - fallen
    assert np.abs(off[:, [0, 2]]).max() < 1e-5
    assert (off[:, 1] < 0.0).all() and (off[:, 1] > -9.81 * time * time / steps - 1e-5).all()
    np.testing.assert_allclose(
        grains.velocities, np.tile([1.0, 2.0 - 9.81 * time, 0.0], (len(places), 1)), atol=1e-5
    )
    assert metrics[-1]["elastic_energy"] < 1e-6 * metrics[-1]["kinetic_energy"]


def test_a_plate_bears_the_weight():
    """A column between walls without friction comes to rest; the floor then gives it m g t, to 1 %."""
    places = lattice((4, 4, 4))
    scene = Scene(surfaces=(box_inside((4 * CELL, 1.0, 4 * CELL)),), granular=(heap(places),))
    simulation = simulated(scene)
    run(simulation, 40)
    stage = simulation.model.parts["granular"]
    impulse = np.zeros(3)
    for _ in range(12):
        run(simulation, 1)
        impulse += stage.contact.impulse[0]
    weight = 1000.0 * (4 * CELL) ** 3 * 9.81
    assert impulse[1] == pytest.approx(12 * FRAME * weight, rel=0.01)
    assert np.abs(impulse[[0, 2]]).max() < 0.01 * impulse[1]


def box_inside(size: tuple[float, float, float], **values) -> Surface:
    """Walls from the origin to `size` that face inwards, open above."""
    x, y, z = size
    points = np.array([[i * x, j * y, k * z] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    faces = [(0, 4, 5, 1), (0, 1, 3, 2), (4, 6, 7, 5), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    triangles = np.array(triangles, dtype=np.int32)
    centre = np.array([x, y, z]) / 2
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = np.einsum("na,na->n", normal, corners.mean(axis=1) - centre) > 0.0
    triangles[outwards] = triangles[outwards][:, ::-1]
    return Surface("box", points, triangles, **({"friction": 0.0} | values))


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_thrown_against_a_plate_and_pulled_off(precision):
    """The plate pushes and never pulls: pulled off faster than sand comes back, its impulse is exactly none."""
    times = np.array([0.0, 8 * FRAME, 16 * FRAME])
    transforms = np.tile(np.eye(4), (3, 1, 1, 1)).reshape(3, 1, 4, 4)
    transforms[2, 0, 0, 3] = -2.0
    wall = replace(plate(2.0, (1.0, 0.0, 0.0)), motion=KeyedMotion(times, transforms), friction=0.6)
    sand = heap(lattice((3, 3, 3), (0.3, 0.0, 0.0)), (-2.0, 0.0, 0.0))
    scene = Scene(surfaces=(wall,), granular=(sand,), gravity=np.zeros(3))
    simulation = simulated(scene, precision=precision)
    stage = simulation.model.parts["granular"]
    run(simulation, 8)
    before = stage.grains(0)
    momentum = 1000.0 * CELL**3 / 8 * before.velocities.sum(axis=0)
    assert momentum[0] > -0.02 * 2.0 * len(sand.positions)  # it has been stopped
    assert before.positions[:, 0].min() < CELL  # and lies against the wall
    run(simulation, 1)
    for _ in range(6):
        run(simulation, 1)
        assert not np.any(stage.contact.impulse.get(0, 0.0))


@pytest.mark.parametrize("between", [0.0, 0.25, 0.5, 0.75])
def test_snow_comes_down_to_a_plate_wherever_it_is_between_nodes(between):
    """Thrown at it at 3 m/s its lowest layer lies a quarter of a cell above, half its grains' size; to as much."""
    under = plate(4.0)
    under = replace(under, points=under.points + np.array([0.0, between * CELL, 0.0]))
    places = lattice((4, 4, 4), (-0.2, (between + 0.5) * CELL, -0.2))
    snow = granular(places, np.tile([0.0, -3.0, 0.0], (len(places), 1)), "snow", density=400.0)
    simulation = simulated(Scene(surfaces=(under,), granular=(snow,)))
    run(simulation, 12)
    heights = simulation.model.parts["granular"].grains(0).positions[:, 1] / CELL - between
    lowest = np.sort(heights)[: 8 * 8].mean()
    assert 0.0 < lowest < 0.5


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_slides_on_a_plate_by_its_friction(friction):
    """A block thrown along a plate: m dv_x = -mu (m g t + m dv_y), what the plate gave it, to 1 %."""
    places = lattice((6, 2, 6), (-0.3, 0.0, -0.3))
    firm = {"law": "snow", "youngs_modulus": 2e5, "critical_compression": 0.2, "critical_stretch": 0.2}
    scene = Scene(surfaces=(plate(4.0, friction=friction),), granular=(heap(places, (2.0, 0.0, 0.0), **firm),))
    simulation = simulated(scene)
    velocities = []
    for _ in range(7):
        run(simulation, 1)
        velocities.append(simulation.model.parts["granular"].grains(0).velocities.mean(axis=0))
    change = velocities[-1] - velocities[1]
    assert change[0] == pytest.approx(-friction * (9.81 * 5 * FRAME + change[1]), rel=0.01)
    assert velocities[-1][0] > 0.2  # and slides still


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [28.0, 34.0])
def test_flows_down_slopes_steeper_than_its_friction_angle(degrees):
    """3 degrees steeper than phi a layer gets faster by g (sin theta - tan phi cos theta), to 1 degree.

    And 3 degrees less steep it comes to rest. One degree is g (cos phi + tan phi sin phi) pi/180 of acceleration.
    """
    phi, length, cells = np.radians(degrees), 160, (160, 8, 2)
    places = lattice(cells)
    sand = heap(places, youngs_modulus=1e6, friction_angle=phi, density=1600.0)
    middle = (np.abs(places[:, 0] - length * CELL / 2) < 0.05 * length * CELL) & (places[:, 1] > 6 * CELL)
    walls = [plate(1e2, (0.0, 0.0, z), friction=0.0) for z in (1.0, -1.0)]
    walls[1] = replace(walls[1], points=walls[1].points + np.array([0.0, 0.0, 2 * CELL]))
    degree = 9.81 * (np.cos(phi) + np.tan(phi) * np.sin(phi)) * np.pi / 180.0
    for theta in (phi - np.radians(3.0), phi + np.radians(3.0)):
        gravity = 9.81 * np.array([np.sin(theta), -np.cos(theta), 0.0])
        surfaces = (plate(1e2, friction=10.0), *walls)
        simulation = simulated(Scene(surfaces=surfaces, granular=(sand,), gravity=gravity))
        speeds = []
        for _ in range(2):
            run(simulation, 12)
            speeds.append(simulation.model.parts["granular"].grains(0).velocities[middle, 0].mean())
        if theta < phi:
            assert abs(speeds[1]) < 12 * FRAME * degree
    faster = (speeds[1] - speeds[0]) / (12 * FRAME)
    assert abs(faster - 9.81 * (np.sin(theta) - np.tan(phi) * np.cos(theta))) < degree


@pytest.mark.slow
def test_a_snowball_thrown_on_a_wall_breaks():
    """Thrown aslant at 7 m/s it is packed where it strikes and torn elsewhere; at .1 m/s it stays whole.

    The pressure of the blow, density times speed squared, is 6 times the strength theta_c E there, and less than
    a hundredth here. Torn is what has come to twice its volume, packed what has lost a tenth of it for good.
    """
    places = lattice((8, 8, 8), (-4 * CELL,) * 3)
    places = places[np.linalg.norm(places, axis=1) < 4 * CELL] + [4.2 * CELL, 0.0, 0.0]
    for speed, broken in ((5.0, True), (0.07, False)):
        snow = heap(
            places, (-speed, speed, 0.0), law="snow", youngs_modulus=1.4e5, poissons_ratio=0.2, density=400.0
        )
        wall = plate(6.0, (1.0, 0.0, 0.0), friction=0.5)
        simulation = simulated(Scene(surfaces=(wall,), granular=(snow,), gravity=np.zeros(3)))
        simulation.advance_frame(0.2 * CELL / speed)  # until it touches
        run(simulation, 8)
        volume = np.exp(simulation.state.arrays["granular/memory"].numpy())
        torn, packed = (volume > 2.0).mean(), (volume < 0.9).mean()
        if broken:
            assert torn > 0.05 and packed > 0.05
        else:
            assert torn == 0.0 and packed == 0.0


def test_goes_on_from_a_saved_state_bit_for_bit():
    """A run taken up at a frame's end is the run that was not left, with sand poured in meanwhile."""
    scene = poured_scene()
    whole = simulated(scene)
    run(whole, 3)
    kept = whole.state.to_numpy()
    run(whole, 3)
    taken_up = simulated(scene)
    taken_up.state.restore(kept)
    run(taken_up, 3)
    for name, values in whole.state.to_numpy().items():
        np.testing.assert_array_equal(taken_up.state.to_numpy()[name], values, err_msg=name)


def poured_scene() -> Scene:
    emitter = Emitter(
        rate=2000.0,
        limit=300,
        lower=np.array([0.0, 0.5, 0.0]),
        upper=np.array([0.2, 0.6, 0.2]),
        velocity=np.array([0.0, -1.0, 0.0]),
        volume=CELL**3 / 8,
        width=0.05,
        seed=4,
    )
    sand = replace(heap(lattice((2, 2, 2), (0.0, 0.1, 0.0))), emitter=emitter, ids=np.arange(64) * 3)
    return Scene(surfaces=(plate(3.0),), granular=(sand,))


def test_pours_at_the_rate_told():
    """rate times time, no more than the limit; in the box moved with the velocity; ids numbered on."""
    simulation = simulated(poured_scene())
    assert run(simulation, 1)[0]["particles"] == 64 + int(2000 * FRAME)
    grains = simulation.model.parts["granular"].grains(0)
    assert grains.ids[:64].tolist() == (np.arange(64) * 3).tolist()
    assert grains.ids[64:].tolist() == list(range(190, 190 + int(2000 * FRAME)))
    assert run(simulation, 5)[-1]["particles"] == 64 + 300


def test_pours_out_of_a_box_that_moves():
    """Its places, its direction and its own velocity: a box turned by 90 degrees about y that moves at 2 m/s."""
    turn = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    keys = np.tile(turn, (2, 1, 1, 1))
    keys[1, 0, :3, 3] = 0.0, 2.0, 0.0
    emitter = replace(
        poured_scene().granular[0].emitter,
        motion=KeyedMotion(np.array([0.0, 1.0]), keys),
        velocity=np.array([3.0, 0.0, 0.0]),
    )
    sand = replace(heap(np.zeros((0, 3))), emitter=emitter)
    simulation = simulated(Scene(granular=(sand,), gravity=np.zeros(3)))
    run(simulation, 1)
    grains = simulation.model.parts["granular"].grains(0)
    np.testing.assert_allclose(grains.velocities.mean(axis=0), [0.0, 2.0, -3.0], atol=1e-5)
    # x of the box is -z of the world; it has risen, and they have flown on, for up to a frame.
    lower, upper = grains.positions.min(axis=0), grains.positions.max(axis=0)
    assert (lower > [-1e-6, 0.5, -0.2 - 3.0 * FRAME - 1e-6]).all()
    assert (upper < [0.2 + 1e-6, 0.6 + 2.0 * FRAME + 1e-6, 1e-6]).all()


def test_stays_as_given_until_it_starts():
    """Neither does it fall nor is any poured in."""
    scene = replace(poured_scene(), surfaces=())
    late = simulated(replace(scene, granular_start=2.0 * FRAME))
    run(late, 2)
    stage = late.model.parts["granular"]
    np.testing.assert_array_equal(
        np.sort(stage.grains(0).positions, axis=0), np.sort(scene.granular[0].positions, axis=0)
    )
    run(late, 1)
    assert len(stage.grains(0).positions) == 64 + int(2000 * FRAME)
    fallen = (stage.grains(0).positions[:64] - scene.granular[0].positions)[:, 1]
    # A first-order step, as long as a substep at most.
    np.testing.assert_allclose(fallen, -0.5 * 9.81 * FRAME**2, atol=0.5 * 9.81 * FRAME * FRAME / 2 + 1e-6)


class Hesitant:
    """A stage after all others that wants the first substep halved."""

    def __init__(self) -> None:
        self.steps = 0

    def begin_frame(self, state, frame) -> None: ...

    def step(self, state, substep, last_resort=False) -> bool:
        self.steps += 1
        return self.steps > 1

    def retract(self, state, substep) -> None: ...

    def end_frame(self, state, frame) -> dict:
        return {}


def test_a_substep_taken_again_in_halves_leaves_no_trace():
    """As if the halves had been asked for, bit by bit, with sand poured in and thrown."""
    halved, asked = (build(poured_scene(), Settings(threads=1, substeps=n)) for n in (1, 2))
    halved.model.parts["hesitant"] = Hesitant()
    for simulation in (halved, asked):
        run(simulation, 1)
    for name, values in asked.state.to_numpy().items():
        np.testing.assert_array_equal(halved.state.to_numpy()[name], values, err_msg=name)


def test_what_is_not_finite_is_told():
    velocities = np.zeros((216, 3))
    velocities[5] = np.inf
    sand = replace(heap(lattice((3, 3, 3))), velocities=velocities)
    with pytest.raises(Diverged, match="heap particle"):
        run(simulated(Scene(granular=(sand,))), 1)


def test_stays_out_of_a_wall_that_stands_on_the_floor():
    """Its foot has its hidden face nearest, in the floor: still no grain of a heap goes a quarter cell into it."""
    wall = solid_box("wall", (1.0, 2.0, 2.0), centre=(-0.5, 1.0, 0.0))
    scene = Scene(surfaces=(plate(5.0), wall), granular=(heap(lattice((4, 5, 4), (0.0, 0.0, -0.2))),))
    simulation = simulated(scene)
    for _ in range(4):
        run(simulation, 6)
        grains = simulation.model.parts["granular"].grains(0).positions
        beside = np.abs(grains[:, 2]) < 1.0
        assert grains[beside, 0].min() > -0.25 * CELL
