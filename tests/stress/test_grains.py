"""Sand and snow thrown, poured, crushed and swept: each scene ten times, each with what must hold said."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from plait.pipeline.benchmarks.scenes import FormulaMotion
from plait.solver.scene import Emitter, Granular, Joint, RigidBody, Scene, StaticMotion, Surface

from ..solver.contact.soft_scenes import floor, solid_box
from ..solver.granular.coupled_scenes import Coupled, block, mat_of_strands, rigid_box
from ..solver.granular.heaps import CELL
from ..solver.tets.lattices import box_body, placed, turn
from .harness import GRAVITY, random_unit, seeds, sphere

WEIGHTLESS = np.zeros(3)


def random_matter(random: np.random.Generator, corner, velocity=(0.0, 0.0, 0.0), cells: int = 4) -> Granular:
    """A block of sand or snow, soft or hard, light or heavy."""
    law = str(random.choice(["sand", "snow"]))
    return replace(
        block((cells, cells, cells), corner, velocity),
        law=law,
        youngs_modulus=10.0 ** random.uniform(4.0, 6.0),
        poissons_ratio=random.uniform(0.0, 0.4),
        density=10.0 ** random.uniform(2.0, 3.3),
        friction_angle=random.uniform(0.2, 0.8),
        friction=random.uniform(0.0, 1.0),
    )


def random_prop(random: np.random.Generator, index: int, centre, **body: Any) -> tuple[Surface, RigidBody]:
    """A box of 2 to 6 cells a side, of any orientation, as light as cork's tenth or as heavy as iron."""
    size = CELL * random.uniform(2.0, 6.0, 3)
    density = 10.0 ** random.uniform(1.5, 3.9)
    surface, told = rigid_box(
        size, centre, density=density, friction=random.uniform(0.0, 1.0), index=index, **body
    )
    motion = StaticMotion(placed(centre, turn(random_unit(random), random.uniform(0.0, np.pi))))
    return replace(surface, motion=motion), replace(told, motion=motion)


def energy_of(scene: Coupled, metrics: dict[str, Any], *phases: str) -> float:
    """[J] of motion, of the grains' strain, and in gravity."""
    held = metrics["granular"]
    of_grains = held["kinetic_energy"] + held["elastic_energy"] + held["potential_energy"]
    return of_grains + sum(
        metrics[name]["kinetic_energy"]
        + metrics[name].get("elastic_energy", 0.0)
        + metrics[name]["potential_energy"]
        for name in phases
    )


@seeds(quick=True)
def test_thrown_at_loose_boxes(seed: int) -> None:
    """At 1 to 30 m/s, boxes of any mass: momentum is kept to float32's rounding, and no energy is made.

    Energy may seem to rise by what passes between a substep and the next: 1 % of all.
    """
    random = np.random.default_rng(seed)
    velocity = 10.0 ** random.uniform(0.0, 1.5) * random_unit(random)
    sand = random_matter(random, -2 * CELL * np.ones(3) - 0.12 * velocity, velocity)
    props = [random_prop(random, k, (0.0, 0.8 * (k - 0.5), 0.0)) for k in range(2)]
    surfaces, bodies = zip(*props, strict=True)
    scene = Coupled(Scene(surfaces, rigid_bodies=bodies, gravity=WEIGHTLESS, granular=(sand,)))
    start, momentum = scene.grains.energy, scene.grains.momentum
    for _ in range(12):
        metrics = scene.run()
        assert energy_of(scene, metrics, "rigid") < 1.01 * start
    total = scene.grains.momentum + scene.rigid.momentum
    assert np.linalg.norm(total - momentum) < 1e-5 * np.linalg.norm(momentum)


@seeds(quick=True)
def test_poured_on_a_jelly(seed: int) -> None:
    """Whatever falls on it, hard or soft, light or heavy: energy only falls, and no tet is lost."""
    random = np.random.default_rng(seed)
    jelly, skin = box_body(
        (0.8, 0.4, 0.8),
        (4, 2, 4),
        youngs_modulus=10.0 ** random.uniform(4.0, 6.0),
        density=10.0 ** random.uniform(2.3, 3.2),
        poissons_ratio=random.uniform(0.0, 0.4),
        friction=random.uniform(0.0, 1.0),
    )
    jelly = replace(jelly, pinned=jelly.nodes[:, 1] < -0.19)
    sand = random_matter(random, (-0.2, random.uniform(0.25, 0.8), -0.2))
    scene = Coupled(Scene(surfaces=(skin,), bodies=(jelly,), granular=(sand,)))
    start = energy_of(scene, scene.run(), "tets")
    size = abs(scene.grains.mass * GRAVITY)
    for _ in range(24):
        metrics = scene.run()
        assert energy_of(scene, metrics, "tets") < start + 0.01 * size
    assert metrics["tets"]["least_volume"] > 0.0


@seeds()
def test_crushed_between_plates(seed: int) -> None:
    """Two walls close on a block to a third of it, and open: nothing goes through them, nothing is lost."""
    random = np.random.default_rng(seed)
    sand = random_matter(random, (-0.2, 0.0, -0.2))

    def moved(side: float) -> FormulaMotion:
        def way(time: float) -> np.ndarray:
            closed = 0.5 * (1.0 - np.cos(np.pi * np.clip(time / 0.5, 0.0, 2.0)))
            return placed((side * (0.6 - 0.3 * closed), 0.5, 0.0))

        return FormulaMotion(way)

    walls = [solid_box(f"wall {side}", (0.5, 1.5, 3.0), motion=moved(side)) for side in (-1.0, 1.0)]
    scene = Coupled(Scene(surfaces=(*walls, floor()), granular=(sand,)))
    for frame in range(24):
        scene.run()
        face = 0.6 - 0.3 * 0.5 * (1.0 - np.cos(np.pi * (frame + 1) / 12.0)) - 0.25
        grains = scene.parts["granular"].grains(0).positions
        inside = np.abs(grains[:, 2]) < 1.0
        assert (np.abs(grains[inside, 0]) < face + CELL).all()
        assert grains[:, 1].min() > -CELL
    assert len(grains) == len(sand.positions)


@seeds()
def test_swept_by_a_ball(seed: int) -> None:
    """A ball goes through a heap at 5 to 20 m/s: none is left inside it by more than a cell."""
    random = np.random.default_rng(seed)
    sand, speed = random_matter(random, (-0.3, 0.0, -0.3), cells=6), random.uniform(5.0, 20.0)
    motion = FormulaMotion(lambda time: placed((-2.0 + speed * time, 0.3, 0.0)))
    ball = Surface("ball", *sphere(0.3, np.zeros(3)), motion=motion)
    scene = Coupled(Scene(surfaces=(ball, floor()), granular=(sand,)))
    for frame in range(12):
        scene.run()
        centre = np.array([-2.0 + speed * (frame + 1) / 24.0, 0.3, 0.0])
        apart = np.linalg.norm(scene.parts["granular"].grains(0).positions - centre, axis=1)
        assert apart.min() > 0.3 - CELL


@seeds()
def test_sand_on_hinged_plates(seed: int) -> None:
    """Plates turn about random axes under what falls on them: they stay on their hinges, and energy only falls."""
    random = np.random.default_rng(seed)
    surfaces, bodies, joints = [], [], []
    for k in range(3):
        centre = np.array([0.0, 0.7 * k, 0.0])
        surface, body = rigid_box((0.8, 0.2, 0.8), centre, density=10.0 ** random.uniform(2.0, 3.5), index=k)
        frame = placed((0.0, 0.0, 0.0), turn(random_unit(random), random.uniform(0.0, np.pi)))
        world = placed(centre) @ frame
        surfaces, bodies = [*surfaces, surface], [*bodies, body]
        joints.append(Joint(f"hinge {k}", "revolute", (k, None), (frame, world)))
    sand = random_matter(random, (-0.1, 1.8, -0.2), (0.0, -3.0, 0.0))
    held = Scene(tuple(surfaces), rigid_bodies=tuple(bodies), joints=tuple(joints), granular=(sand,))
    scene = Coupled(held, substeps=8)
    energy = None
    for _ in range(24):
        metrics = scene.run()
        total = energy_of(scene, metrics, "rigid")
        size = scene.grains.mass * GRAVITY
        assert energy is None or total < energy + 0.01 * size
        energy = total
        places = scene.parts["rigid"].position.numpy()
        assert np.abs(places - [[0.0, 0.7 * k, 0.0] for k in range(3)]).max() < 1e-3


@seeds()
def test_among_loose_strands(seed: int) -> None:
    """Sand or snow falls through a mat of loose strands on a floor: all stays finite and above the floor."""
    random = np.random.default_rng(seed)
    roots, strands = mat_of_strands(np.array([0.0, 0.1, 0.0]), density=10.0 ** random.uniform(2.0, 3.5))
    sand = random_matter(random, (-0.2, 0.3, -0.2), (0.0, -random.uniform(0.0, 10.0), 0.0))
    scene = Coupled(Scene(surfaces=(roots, floor()), strands=(strands,), granular=(sand,)), substeps=8)
    for _ in range(24):
        scene.run()
    assert scene.parts["strands"].points(0)[:, 1].min() > -0.01
    assert scene.parts["granular"].grains(0).positions[:, 1].min() > -CELL
    assert np.abs(scene.parts["strands"].velocities(0)).max() < 20.0


@seeds()
def test_drawn_into_each_other(seed: int) -> None:
    """A heap drawn through a loose box and a jelly: what is inside comes out, or stays, without an explosion."""
    random = np.random.default_rng(seed)
    prop, body = random_prop(random, 0, (0.3, 0.4, 0.0))
    jelly, skin = box_body((0.4, 0.4, 0.4), (2, 2, 2), surface=1, transform=placed((-0.3, 0.3, 0.0)))
    sand = random_matter(random, (-0.4, 0.0, -0.3), cells=7)
    scene = Coupled(
        Scene(surfaces=(prop, skin, floor()), rigid_bodies=(body,), bodies=(jelly,), granular=(sand,)), substeps=8
    )
    for _ in range(24):
        scene.run()
        for phase in (scene.grains, scene.rigid, scene.flesh):
            # What falls from where it is drawn is no faster, in the mean, than from twice the scene's height.
            assert phase.energy < phase.mass * GRAVITY * 2.0


@seeds()
def test_poured_into_a_solid(seed: int) -> None:
    """An emitter inside a closed box that may move: grains come in for ever, and nothing is lost or not finite."""
    random = np.random.default_rng(seed)
    pours = Emitter(
        rate=4000.0,
        limit=3000,
        lower=np.array([-0.1, 0.0, -0.1]),
        upper=np.array([0.1, 0.3, 0.1]),
        velocity=5.0 * random_unit(random),
        volume=CELL**3 / 8,
        width=CELL / 2,
        seed=seed,
    )
    none = random_matter(random, (0.0, 0.0, 0.0))
    empty = np.zeros((0, 3))
    sand = replace(
        none, positions=empty, velocities=empty, volumes=np.zeros(0), widths=np.zeros(0), ids=np.zeros(0, np.int64)
    )
    prop, body = random_prop(random, 0, (0.0, 0.2, 0.0))
    scene = Coupled(
        Scene(surfaces=(prop, floor()), rigid_bodies=(body,), granular=(replace(sand, emitter=pours),))
    )
    for _ in range(24):
        scene.run()
    assert scene.parts["granular"].matter.count == 3000
