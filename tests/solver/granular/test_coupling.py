"""What passes between grains and rigid bodies, flesh and strands (Han 2019, 7)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.pipeline.tetrahedra.skin import Inside
from plait.solver.scene import Emitter, Granular, Joint, Scene, StaticMotion
from plait.solver.settings import GranularSettings

from ..contact.soft_scenes import floor
from ..tets.lattices import box_body, placed
from .coupled_scenes import WEIGHTLESS, Coupled, block, mat_of_strands, rigid_box
from .heaps import CELL, FRAME

GRAVITY = 9.81


def all_phases() -> Scene:
    """Three blocks of sand thrown at a box, a jelly and a mat of strands, none of them held."""
    prop, body = rigid_box((0.5, 0.3, 0.5), (0.0, 0.0, 0.0), density=500.0)
    jelly, skin = box_body(
        (0.5, 0.3, 0.5), (4, 2, 4), surface=1, youngs_modulus=5e4, transform=placed((2.0, 0.0, 0.0))
    )
    roots, strands = mat_of_strands(np.array([4.0, 0.0, 0.0]), density=1000.0)
    strands = replace(strands, roots=replace(strands.roots, surface=2))
    thrown = [block((3, 3, 3), (x - 0.12, 0.25, -0.17), (0.3, -2.0, 0.1)) for x in (0.0, 2.0, 4.0)]
    sand = replace(
        thrown[0],
        **{
            name: np.concatenate([getattr(g, name) for g in thrown])
            for name in ("positions", "velocities", "volumes", "widths")
        },
        ids=np.arange(sum(len(g.ids) for g in thrown)),
    )
    return Scene(
        surfaces=(prop, skin, roots),
        rigid_bodies=(body,),
        bodies=(jelly,),
        strands=(strands,),
        granular=(sand,),
        gravity=WEIGHTLESS,
    )


@pytest.mark.parametrize(("precision", "part"), [("float32", 1e-5), ("float64", 1e-12)])
def test_momentum_over_all_phases(precision, part):
    """It passes from one to the other and none is made or lost: so much of it in a second at most."""
    scene = Coupled(all_phases(), precision=precision)
    phases = ("grains", "rigid", "flesh", "strands")
    before = sum(getattr(scene, name).momentum for name in phases)
    scene.run(24)
    after = {name: getattr(scene, name) for name in phases}
    total = sum(phase.momentum for phase in after.values())
    assert np.linalg.norm(total - before) < part * np.linalg.norm(before)
    for name in ("rigid", "flesh", "strands"):
        assert after[name].momentum[1] < -0.05 * after[name].mass, f"{name} was not hit"


@pytest.mark.parametrize("density", [50.0, 1000.0, 20000.0])
def test_a_free_box_is_hit_without_a_gain_of_energy(density):
    """Lighter or heavier than the sand: all energy there is, the sand's strain included, never rises."""
    prop, body = rigid_box((0.8, 0.4, 0.8), (0.0, 0.0, 0.0), density=density)
    sand = block((4, 4, 4), (-0.17, 0.25, -0.22), (0.0, -2.0, 0.0))
    scene = Coupled(Scene(surfaces=(prop,), rigid_bodies=(body,), granular=(sand,), gravity=WEIGHTLESS))
    start = scene.grains.energy
    for _ in range(12):
        metrics = scene.run()
        energy = metrics["granular"]["kinetic_energy"] + metrics["granular"]["elastic_energy"] + scene.rigid.energy
        assert energy < 1.001 * start
    # Inelastic: at the end the box does not go away from the sand faster than half the approach.
    apart = scene.grains.momentum[1] / scene.grains.mass - scene.rigid.momentum[1] / scene.rigid.mass
    assert scene.rigid.momentum[1] < 0.0
    assert apart < 0.5 * 2.0


@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_a_pile_rests_on_a_jelly(offset):
    """At rest the jelly is given the pile's weight, to 1 %; no grain is under its skin by a quarter of a cell.

    Wherever the skin lies between the nodes of the grid: offset, of a cell.
    """
    height = 0.4 + offset * CELL
    jelly, skin = box_body((1.2, 0.4, 1.2), (6, 2, 6), youngs_modulus=1e6, mass_damping=2.0,
                           transform=placed((0.0, height - 0.2, 0.0)))  # fmt: skip
    pinned = replace(jelly, pinned=jelly.nodes[:, 1] < -0.19)
    sand = block((5, 3, 5), (-0.25, height, -0.25), youngs_modulus=2e5)
    scene = Coupled(Scene(surfaces=(skin,), bodies=(pinned,), granular=(sand,)))
    scene.run(36)
    given = []
    for _ in range(12):
        scene.run()
        given.append(scene.parts["tets"].external_impulse.numpy()[:, 1].sum())
    assert -np.mean(given) == pytest.approx(scene.grains.mass * GRAVITY * FRAME / 4, rel=0.01)
    top = scene.parts["tets"].position.numpy()[:, 1].max()
    assert scene.parts["granular"].grains(0).positions[:, 1].min() > top - 0.25 * CELL


@pytest.mark.parametrize("density", [50.0, 2000.0])
def test_a_pile_rests_on_a_box_that_rests_on_a_floor(density):
    """The box, lighter or heavier than the pile, is given its weight, and stays where it is."""
    prop, body = rigid_box((1.4, 0.4, 1.4), (0.0, 0.2, 0.0), density=density)
    sand = block((4, 3, 4), (-0.2, 0.4, -0.2), youngs_modulus=2e5)
    scene = Coupled(Scene(surfaces=(prop, floor()), rigid_bodies=(body,), granular=(sand,)))
    scene.run(36)
    given = []
    for _ in range(12):
        scene.run()
        given.append(scene.parts["rigid"].impulse.numpy()[0, 1])
    assert -np.mean(given) == pytest.approx(scene.grains.mass * GRAVITY * FRAME / 4, rel=0.01)
    np.testing.assert_allclose(scene.parts["rigid"].position.numpy()[0], [0.0, 0.2, 0.0], atol=1e-4)


@pytest.mark.parametrize("modulus", [pytest.param(3e3, marks=pytest.mark.slow), 5e4])
def test_a_stream_does_not_get_under_a_skin(modulus):
    """Poured on a jelly, soft or stiff for its mass and the substep: no grain deeper than a quarter of a cell."""
    jelly, skin = box_body((0.2, 0.1, 0.2), (8, 4, 8), youngs_modulus=modulus, mass_damping=1.0)
    jelly = replace(jelly, pinned=jelly.nodes[:, 1] < -0.049)
    size, none = 0.006, np.zeros((0, 3))
    pours = Emitter(
        rate=2250.0,
        limit=4500,
        lower=np.array([-0.03, 0.15, -0.03]),
        upper=np.array([0.03, 0.16, 0.03]),
        velocity=np.array([0.0, -1.0, 0.0]),
        volume=size**3,
        width=size,
    )
    sand = Granular("sand", "sand", none, none, np.zeros(0), np.zeros(0), np.zeros(0, np.int64), emitter=pours)
    settings = {"substeps": 8, "granular": GranularSettings(cell_size=2 * size)}
    scene = Coupled(Scene(surfaces=(skin,), bodies=(jelly,), granular=(sand,)), **settings)
    for _ in range(12):
        scene.run()
        colliders = scene.parts["kinematics"].colliders
        points = colliders.points[scene.parts["kinematics"].end].numpy()
        places = scene.parts["granular"].grains(0).positions
        distance, _ = Inside(points, colliders.triangles.numpy()).query(places)
        assert distance.min() > -0.25 * 2 * size
    above = (np.abs(places[:, [0, 2]]) < 0.1).all(axis=1)
    assert above.sum() > 300


def test_nothing_pulls():
    """A box that is lifted out of the sand it lies on: from when it leaves, exactly no impulse."""
    sand = block((6, 2, 6), (-0.3, 0.0, -0.3), youngs_modulus=2e5)
    prop, body = rigid_box((0.3, 0.2, 0.3), (0.0, 0.31, 0.0), velocity=np.array([0.0, 3.0, 0.0]))
    scene = Coupled(Scene(surfaces=(prop, floor()), rigid_bodies=(body,), granular=(sand,), gravity=WEIGHTLESS))
    for _ in range(6):
        scene.run()
        assert (scene.parts["rigid"].velocity.numpy()[0] == [0.0, 3.0, 0.0]).all()
        assert not scene.parts["rigid"].impulse.numpy().any()


def test_sand_turns_a_wheel_by_the_moment_it_gives():
    """A plate hinged in its middle, sand on one side: it begins to turn with all the moment of the sand's weight.

    d(L)/dt = x m g for the sand at a lever x and the plate alike, as both fall and turn together about the hinge:
    the angular momentum of all about it is the time integral of that.
    """
    prop, body = rigid_box((1.6, 0.2, 0.4), (0.0, 0.0, 0.0), density=1000.0, friction=1.0)
    frames = (np.eye(4), np.eye(4))
    hinge = Joint("hinge", "revolute", (0, None), frames, motion=StaticMotion())
    sand = block((3, 2, 3), (0.3, 0.1, -0.15), youngs_modulus=2e5)
    scene = Coupled(Scene(surfaces=(prop,), rigid_bodies=(body,), joints=(hinge,), granular=(sand,)), substeps=8)
    moment, frames_run = 0.0, 5
    for _ in range(frames_run):
        scene.run()
        lever = scene.parts["granular"].grains(0).positions[:, 0].mean()
        moment -= FRAME * lever * scene.grains.mass * GRAVITY
    grains, stage = scene.parts["granular"].grains(0), scene.parts["rigid"]
    mass = scene.grains.mass / len(grains.positions)
    of_grains = mass * np.cross(grains.positions, grains.velocities)[:, 2].sum()
    of_plate = stage.angular_momentum.numpy()[0, 2] + stage.angular_impulse.numpy()[0, 2]
    assert of_plate < 0.0
    assert of_grains + of_plate == pytest.approx(moment, rel=0.03)


def test_same_bits_with_threads_and_when_taken_up_again():
    """All phases at once."""
    runs = []
    for threads, taken_up in ((1, False), (2, False), (1, True)):
        scene = Coupled(all_phases(), threads=threads)
        scene.run(4)
        if taken_up:
            held = scene.simulation.state.to_numpy()
            scene = Coupled(all_phases(), threads=threads)
            scene.simulation.state.restore(held)
        scene.run(3)
        runs.append(scene.simulation.state.to_numpy())
    for other in runs[1:]:
        for name, values in runs[0].items():
            np.testing.assert_array_equal(values, other[name], err_msg=name)
