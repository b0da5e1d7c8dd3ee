"""Rigid bodies and flesh move each other (Newton's third law), whatever their masses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import warp as wp

from plait.solver.build import build
from plait.solver.model import Interval
from plait.solver.scene import Joint, RootBinding, Surface, TetBody
from plait.solver.settings import Settings

from ..contact.soft_scenes import SUBSTEPS, floor, solid_box
from ..tets.lattices import box_body, keyed, placed
from .rigid_scenes import FRAME, Prop, Rigid, box
from .test_stage import one_strand

SUBSTEP = FRAME / SUBSTEPS
# Distance that flesh keeps from a surface: a part of its tets' edge.
REACH = 0.02


class Both:
    """A running scene of rigid bodies, elastic bodies and surfaces."""

    def __init__(
        self,
        props: list[Prop],
        flesh: list[tuple[TetBody, Surface]],
        obstacles: tuple | list = (),
        *,
        gravity: Any = (0.0, -9.81, 0.0),
        joints: tuple = (),
        strands: tuple = (),
        **settings: Any,
    ) -> None:
        scene = Rigid(props, obstacles, gravity=gravity, joints=joints).scene
        surfaces, first = list(scene.surfaces), len(scene.surfaces)
        surfaces += [replace(skin, body=k) for k, (_, skin) in enumerate(flesh)]
        bodies = tuple(replace(body, surface=first + k) for k, (body, _) in enumerate(flesh))
        scene = replace(scene, surfaces=tuple(surfaces), bodies=bodies, strands=strands)
        self.simulation = build(scene, Settings(threads=1, substeps=SUBSTEPS, **settings))
        parts = self.simulation.model.parts
        self.tets, self.rigid = parts["tets"], parts["rigid"]
        self.tet_mass = self.tets.layout.mass[:, None]
        self.mass = np.array([body.mass for body in self.rigid.bodies])[:, None]

    def substep(self) -> float:
        """Takes one; the energy [J] at its end."""
        metrics = self.simulation.advance_frame(self.simulation.state.time + SUBSTEP, 1)
        parts = [metrics["tets"], metrics["rigid"]]
        return sum(m["kinetic_energy"] + m["potential_energy"] for m in parts) + parts[0]["elastic_energy"]

    def push_flesh(self, velocity: Any) -> None:
        self.tets.external_impulse.assign(self.tet_mass * np.asarray(velocity))

    @property
    def velocity(self) -> np.ndarray:
        return self.rigid.velocity.numpy().copy()

    @property
    def position(self) -> np.ndarray:
        return self.rigid.position.numpy().copy()

    def momenta(self) -> tuple[np.ndarray, np.ndarray]:
        """Linear and angular momentum of all, about the origin."""
        of_tets, of_bodies = self.tet_mass * self.tets.velocity.numpy(), self.mass * self.velocity
        angular = np.cross(self.tets.position.numpy(), of_tets).sum(axis=0)
        angular += (np.cross(self.position, of_bodies) + self.rigid.angular_momentum.numpy()).sum(axis=0)
        return of_tets.sum(axis=0) + of_bodies.sum(axis=0), angular


def flying_block(**body: Any) -> tuple[TetBody, Surface]:
    """8 kg beside a box about the origin, 3 cm off its middle."""
    return box_body((0.2, 0.2, 0.2), (2, 2, 2), transform=placed((-0.22, 0.03, 0.0)), **body)


@pytest.mark.parametrize("density", [10.0, 1000.0, 1e5])
def test_an_impact_keeps_both_momenta_and_makes_no_energy(density: float):
    """Flesh of 1000 kg/m3 thrown at a free box a hundredth and a hundred times as heavy: to 1e-12 in a second."""
    scene = Both([box(density=density)], [flying_block()], gravity=(0.0, 0.0, 0.0), precision="float64")
    scene.push_flesh((1.0, 0.0, 0.0))
    before = scene.substep()
    linear, angular = scene.momenta()
    for _ in range(24):
        energy = scene.substep()
        assert energy <= before * (1.0 + 1e-10)
        before = energy
    after_linear, after_angular = scene.momenta()
    assert np.abs(after_linear - linear).max() <= 1e-12 * np.abs(linear).max()
    assert np.abs(after_angular - angular).max() <= 1e-12 * np.abs(linear).max() * 0.2
    assert scene.velocity[0, 0] > 1e-3


def test_a_box_thrown_at_resting_flesh_stops_or_turns_back():
    """In float32, to 1e-5; the energy does not grow."""
    scene = Both([box(density=100.0, velocity=[-2.0, 0.0, 0.0])], [flying_block()], gravity=(0.0, 0.0, 0.0))
    before = scene.substep()
    linear, _ = scene.momenta()
    for _ in range(24):
        energy = scene.substep()
        assert energy <= before * (1.0 + 1e-6)
        before = energy
    assert np.abs(scene.momenta()[0] - linear).max() <= 1e-5 * np.abs(linear).max()
    assert scene.velocity[0, 0] > -0.2


@pytest.mark.parametrize("density", [20.0, 4000.0])
def test_a_box_comes_to_rest_on_a_soft_block(density: float):
    """It neither sinks into the skin nor goes on bouncing, heavy or light; flesh of 32 kg."""
    flesh = box_body((0.4, 0.2, 0.4), (4, 2, 4), transform=placed((0.0, 0.105, 0.0)))
    scene = Both([box(centre=(0.0, 0.31, 0.0), density=density)], [flesh], [floor()])
    top = scene.substep()
    for _ in range(159):
        energy = scene.substep()
        assert energy <= top + 1e-4 * abs(top)
    skin, bottom = scene.tets.position.numpy(), scene.position[0, 1] - 0.1
    under = skin[(np.abs(skin[:, [0, 2]]) < 0.101).all(axis=1), 1].max()
    assert -0.05 * 0.1 < bottom - under < 0.05 * 0.1
    assert np.abs(scene.velocity).max() < 0.1


def test_what_touches_is_pulled_apart_without_a_pull():
    """Flesh that leaves a box it lies against takes nothing of it along: exactly."""
    flesh = box_body((0.2, 0.2, 0.2), (2, 2, 2), transform=placed((-0.2005, 0.0, 0.0)))
    scene = Both([box(density=10.0)], [flesh], gravity=(0.0, 0.0, 0.0))
    scene.push_flesh((-1.0, 0.0, 0.0))
    for _ in range(12):
        scene.substep()
    assert not scene.velocity[:, 0].any() or scene.velocity[0, 0] > 0.0


@pytest.mark.parametrize("degrees", [16.0, 17.5, 25.0])
def test_a_box_on_a_slope_of_flesh_slides_as_coulomb_has_it(degrees: float):
    """Gravity tilted, friction .3, threshold 16.7 degrees: to .3 % of g."""
    friction, angle = 0.3, np.radians(degrees)
    body, skin = box_body(
        (1.0, 0.1, 0.4), (10, 1, 4), youngs_modulus=1e6, transform=placed((0.2, 0.05, 0.0)), friction=friction
    )
    body = replace(body, pinned=body.nodes[:, 1] < -0.049)
    slider = box((0.2, 0.1, 0.2), (0.0, 0.1525, 0.0), density=500.0, friction=friction)
    down = 9.81 * np.array([np.sin(angle), -np.cos(angle), 0.0])
    scene = Both([slider], [(body, skin)], gravity=down)
    for _ in range(24):
        scene.substep()
    before = scene.velocity[0, 0]
    for _ in range(24):
        scene.substep()
    acceleration = (scene.velocity[0, 0] - before) / (24 * SUBSTEP)
    expected = max(0.0, np.sin(angle) - friction * np.cos(angle))
    assert acceleration / 9.81 == pytest.approx(expected, abs=0.003)


@pytest.mark.parametrize("aside", [0.0, 0.15])
def test_flesh_that_falls_on_a_loose_pebble_makes_no_energy(aside: float):
    """Eighty grams under 32 kg, in the middle and at the edge, from where it is flicked away."""
    flesh = box_body((0.4, 0.2, 0.4), (4, 2, 4), transform=placed((aside, 0.33, 0.0)))
    scene = Both([box(centre=(0.0, 0.1, 0.0), density=10.0)], [flesh], [floor()])
    top = scene.substep()
    for _ in range(59):
        assert scene.substep() <= top * (1.0 + 1e-5)


@pytest.mark.parametrize("density", [20.0, 2000.0])
def test_a_door_that_flesh_hits_turns_on_its_hinge(density: float):
    """Light or heavy, it opens; the hinge stays where it is to rounding, and no energy is made."""
    hinge = np.eye(4)
    hinge[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]).T  # z upwards
    hinge[:3, 3] = [0.0, 0.0, -0.25]
    door = box((0.05, 0.5, 0.5), density=density)
    flesh = box_body((0.2, 0.2, 0.2), (2, 2, 2), transform=placed((-0.13, 0.0, 0.1)))
    joint = Joint("hinge", "revolute", (0, None), (hinge, hinge))
    scene = Both([door], [flesh], gravity=(0.0, 0.0, 0.0), joints=(joint,))
    scene.push_flesh((1.0, 0.0, 0.0))
    start = scene.substep()
    for _ in range(24):
        assert scene.substep() <= start * (1.0 + 1e-6)
    pose = scene.rigid.pose(0)
    assert pose[:3] @ hinge[:, 3] == pytest.approx(hinge[:3, 3], abs=1e-9)
    assert scene.rigid.speeds()[0, 4] > 0.5


def test_hair_on_a_box_that_flesh_pushes_goes_where_the_box_ends():
    """A bristle on the face away from the flesh: its root stays on the box to rounding, and the box moves on."""
    prop = box(density=100.0)
    corners = prop.surface.points[prop.surface.triangles]
    triangle = next(t for t, corner in enumerate(corners) if np.allclose(corner[:, 0], 0.1))
    root = corners[triangle].mean(axis=0)
    points = root + np.linspace(0.0, 0.1, 8)[:, None] * [1.0, 0.0, 0.0]
    hair = one_strand(points, RootBinding(0, np.array([triangle]), np.full((1, 3), 1.0 / 3.0)), np.eye(4), 4e-5)
    scene = Both([prop], [flying_block()], gravity=(0.0, 0.0, 0.0), strands=(hair,))
    scene.push_flesh((1.0, 0.0, 0.0))
    for _ in range(16):
        scene.substep()
    pose, kinematics = scene.rigid.pose(0), scene.simulation.model.parts["kinematics"]
    assert scene.velocity[0, 0] > 0.5
    assert kinematics.root_position.numpy()[0] == pytest.approx(pose[:3, :3] @ root + pose[:3, 3], abs=1e-12)


def test_a_saved_state_goes_on_with_the_same_bits():
    def resting() -> Both:
        flesh = box_body((0.4, 0.2, 0.4), (4, 2, 4), transform=placed((0.0, 0.105, 0.0)))
        return Both([box(centre=(0.0, 0.31, 0.0), density=500.0)], [flesh], [floor()])

    scene, other = resting(), resting()
    for _ in range(16):
        scene.substep()
    other.simulation.state.restore(scene.simulation.state.to_numpy())
    for each in (scene, other):
        for _ in range(8):
            each.substep()
    assert np.array_equal(scene.position, other.position)
    assert np.array_equal(scene.tets.position.numpy(), other.tets.position.numpy())


def test_a_retracted_step_leaves_no_trace():
    scene, other = (
        Both(
            [box(centre=(0.0, 0.1, 0.0), density=200.0)],
            [box_body(0.2 * np.ones(3), 2, transform=placed((0.0, 0.31, 0.0)))],
            [floor()],
        )
        for _ in range(2)
    )
    for each in (scene, other):
        for _ in range(12):
            each.substep()
    state, stages = scene.simulation.state, list(scene.simulation.model.parts.values())
    substep = Interval(state.time, state.time + SUBSTEP)
    for stage in stages:
        stage.begin_frame(state, substep)
    for stage in stages:
        stage.step(state, substep, False)
    for stage in reversed(stages):
        stage.retract(state, substep)
    for each in (scene, other):
        for _ in range(8):
            each.substep()
    assert np.array_equal(scene.position, other.position)
    assert np.array_equal(scene.tets.position.numpy(), other.tets.position.numpy())


def test_forces_are_the_gradient_of_the_energy_with_the_body_giving_way():
    """By central differences along a direction, the body having found its place anew at each: to their order."""
    flesh = box_body((0.4, 0.2, 0.4), (4, 2, 4), transform=placed((0.0, 0.105, 0.0)))
    scene = Both([box(centre=(0.0, 0.302, 0.0), density=500.0)], [flesh], [floor()], precision="float64")
    for _ in range(4):
        scene.substep()
    forces, position = scene.tets._contact.obstacles.bodies[0], scene.tets.position
    assert forces.gives_way
    x, direction = position.numpy().copy(), np.random.default_rng(3).normal(size=(len(position), 3))
    x += 1e-3 * np.array([0.0, 1.0, 0.0])  # well into the box
    tet_force = wp.zeros(4 * len(scene.tets.layout.tets), dtype=wp.vec3d)
    forces.add_forces(wp.array(x, dtype=wp.vec3d), tet_force)
    nodes = np.zeros_like(x)
    np.add.at(nodes, scene.tets.layout.tets.ravel(), tet_force.numpy())
    step = 1e-7
    ends = [forces.energy(wp.array(x + s * step * direction, dtype=wp.vec3d)) for s in (1.0, -1.0)]
    assert np.abs(nodes).max() > 1.0
    assert (ends[1] - ends[0]) / (2.0 * step) == pytest.approx(float((nodes * direction).sum()), rel=1e-5)


@pytest.mark.slow
def test_a_fist_lifts_a_box_as_heavy_as_a_finger():
    """Two blocks of flesh, backs driven, close by 3 cm each and rise by 14 cm: the box between goes along."""

    def finger(side: float, k: int) -> tuple[TetBody, Surface]:
        ways = [(0.215, 0.0), (0.185, 0.0), (0.185, 0.0), (0.185, 0.14)]
        motion = keyed([0.0, 0.25, 0.4, 0.9], [placed((side * x, y, 0.0)) for x, y in ways])
        body, skin = box_body((0.2, 0.2, 0.2), (2, 2, 2), motion=motion, index=k, friction=0.8)
        return replace(body, pinned=side * body.nodes[:, 0] > 0.099), skin

    table = solid_box("table", (1.0, 0.1, 1.0), (0.0, -0.1505, 0.0))
    scene = Both([box(friction=0.8)], [finger(-1.0, 0), finger(1.0, 1)], [table])
    for _ in range(172):
        scene.substep()
    assert scene.position[0] == pytest.approx([0.0, 0.14, 0.0], abs=0.04)
    assert np.abs(scene.velocity[0, [0, 2]]).max() < 0.01
