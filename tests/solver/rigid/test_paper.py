"""Rigid bodies by Han 2019 §6, the variant for comparison: what it promises, beside what it does not."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plait.pipeline.benchmarks.scenes import FormulaMotion
from plait.solver.diagnostics import Refused
from plait.solver.model import Interval
from plait.solver.rigid.paper_law import SHEAR
from plait.solver.scene import Joint
from plait.solver.settings import RigidSettings

from ..contact.soft_scenes import floor, turn_z
from ..tets.lattices import box_body, placed
from .rigid_scenes import FRAME, SUBSTEPS, Prop, Rigid, box, rotation_about
from .test_flesh import Both

GRAVITY, SIZE, CELL = 9.81, 0.2, 0.02
# [Pa] Boxes of this size and 1000 kg/m3 press on what they lie on with two hundredths of it.
SOFT = 4e5
# Particles share nodes within so many cells.
RANGE = 3.0
WEIGHTLESS = {"gravity": (0.0, 0.0, 0.0)}


def run(props: list[Prop], obstacles: list | tuple = (), **settings: Any) -> Rigid:
    return Rigid(props, obstacles, method="paper", **{"stiffness": SOFT, **settings})


def oblique(**settings: Any) -> Rigid:
    """Two boxes, one heavier, that meet edge to face, turning."""
    turned = rotation_about(np.array([1.0, 2.0, 3.0]), 0.4)
    first = box(rotation=turned, velocity=[0.5, 0.1, 0.0])
    second = box(
        (0.3, 0.3, 0.3), (0.4, 0.06, 0.02), density=2000.0, velocity=[-0.5, 0.0, 0.1], angular_velocity=[1, 2, 3]
    )
    return run([first, second], **WEIGHTLESS, **settings)


def head_on(speed: float, **settings: Any) -> Rigid:
    pair = [
        box(velocity=[speed, 0.0, 0.0]),
        box(centre=(SIZE + 0.06, 0.0, 0.0), velocity=[-speed, 0.0, 0.0]),
    ]
    return run(pair, **WEIGHTLESS, **settings)


# -- the potential -------------------------------------------------------------------------------------------


def splines(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quadratic B-splines and their slopes at x cells from their nodes."""
    a = np.abs(x)
    value = np.where(a < 0.5, 0.75 - a**2, np.where(a < 1.5, 0.5 * (1.5 - a) ** 2, 0.0))
    slope = np.where(a < 0.5, -2.0 * x, np.where(a < 1.5, np.sign(x) * (a - 1.5), 0.0))
    return value, slope


def test_forces_at_nodes_are_the_energys_negative_gradient():
    """f_i = -dPsi/dx_i: the work of any small displacement of nodes, by central differences; 1e-6 of it.

    Psi is the sum of V_q psi(d + sum_i (grad w_iq . d) u_i) with (34) written out, u_i in the particle's axes.
    """
    scene = oblique()
    while scene.time < 0.12:
        scene.substep()
    contact = scene.stage.contact
    field, grid = contact._field, contact._grid
    held = {name: getattr(field.placed, name).numpy() for name in ("director", "normal", "facing", "seen")}
    pressed = np.flatnonzero(held["seen"])
    particle, body = (getattr(field.placed, name).numpy()[pressed] for name in ("particle", "body"))
    place = grid.node_positions()[grid.data.base.numpy()] + CELL * grid.data.offset.numpy()
    place = place[pressed]
    director, normal, facing = (held[name][pressed] for name in ("director", "normal", "facing"))
    volume = field.skin.volume.numpy()[particle] * np.einsum("ni,ni->n", normal, facing)
    assert (np.einsum("ni,ni->n", director, normal) < 0.99).any() and set(body) == {0, 1}
    offset = (place[:, None] - grid.node_positions()) / CELL
    value, slope = splines(offset)
    gradient = (
        np.stack([np.prod(np.where(np.arange(3) == k, slope, value), axis=2) for k in range(3)], axis=2) / CELL
    )
    along = np.einsum("nik,nk->ni", gradient, director)
    displacement = np.random.default_rng(7).normal(size=(grid.node_count, 3))
    turn = np.array([turn_between(a, b) for a, b in zip(facing, normal, strict=True)])
    change = np.einsum("nkl,ni,il->nk", turn, along, displacement)

    def energy(step: float) -> float:
        d = director + step * change
        r33 = np.einsum("ni,ni->n", d, normal)
        shear = np.square(d - r33[:, None] * normal).sum(axis=1)
        return volume @ (SOFT / 3.0 * np.maximum(1.0 - r33, 0.0) ** 3 + 0.5 * float(SHEAR) * SOFT * shear)

    force = np.zeros((grid.node_count, 3))
    block, layers = field.layers.block.numpy(), field.layers.force.numpy().reshape(-1, 64, 3)
    np.add.at(force.reshape(-1, 64, 3), block, layers)
    step = 1e-6
    work = (energy(step) - energy(-step)) / (2.0 * step)
    assert abs(work) > 1e-3 * np.abs(force).max()
    assert -np.einsum("ik,ik->", force, displacement) == pytest.approx(work, rel=1e-6)


def turn_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, 3), the least rotation that takes a to b, both unit."""
    axis = np.cross(a, b)
    angle = np.arctan2(np.linalg.norm(axis), a @ b)
    return np.eye(3) if angle < 1e-12 else rotation_about(axis, angle)


# -- two bodies ----------------------------------------------------------------------------------------------


def test_momenta_of_a_closed_pair_stay():
    """Each impulse acts on both, in one place: 1e-12 of what is exchanged."""
    scene = oblique()
    linear, angular = scene.momenta()
    before = scene.velocity
    while scene.time < 0.4:
        scene.substep()
    scale = (scene.mass[:, None] * np.abs(scene.velocity - before)).max()
    assert scale > 0.1 * scene.mass[0]
    after = scene.momenta()
    assert np.abs(after[0] - linear).max() < 1e-12 * scale
    assert np.abs(after[1] - angular).max() < 1e-12 * scale


@pytest.mark.parametrize("speed", [0.3, 0.6])
def test_a_head_on_impact_gains_no_energy(speed):
    """Without restitution: never above what there was, by a hundredth; the boxes part, or are stopped."""
    scene = head_on(speed)
    energy = 0.5 * (scene.mass @ np.square(scene.velocity).sum(axis=1))
    most = 0.0
    while scene.time < 0.3:
        most = max(most, scene.substep()["kinetic_energy"])
    assert most < 1.01 * energy
    assert scene.velocity[0, 0] <= 0.0 <= scene.velocity[1, 0]
    assert scene.position[1, 0] - scene.position[0, 0] > SIZE


def test_pulled_apart_nothing_holds_them():
    """Half a cell apart, and going: the impulse is exactly 0."""
    away = np.array([[-0.3, 0.0, 0.0], [0.3, 0.01, 0.0]])
    scene = run([box(velocity=away[0]), box(centre=(SIZE + 0.5 * CELL, 0.0, 0.0), velocity=away[1])], **WEIGHTLESS)
    scene.substep()
    assert scene.stage.contact._touching is not None
    for _ in range(SUBSTEPS):
        scene.substep()
    assert np.array_equal(scene.velocity, away)
    assert not scene.stage.angular_momentum.numpy().any()


def test_what_shares_no_node_is_left_as_it_is():
    """A spinning box near another, its particles on the grid, but none at nodes of the other's: the same bits."""
    turned = turn_z(45.0)
    corner = SIZE / np.sqrt(2.0)
    # Edge to edge across the diagonal of the boxes that the axes draw about them.
    apart = corner + (RANGE + 0.5) * CELL / np.sqrt(2.0)
    pair = [
        box(rotation=turned, angular_velocity=[0.0, 0.0, 1e-3]),
        box(centre=(apart, apart, 0.0), rotation=turned, angular_velocity=[0.0, 0.0, -1e-3]),
    ]
    scene = run(pair, **WEIGHTLESS)
    spin = scene.stage.angular_momentum.numpy().copy()
    for _ in range(4):
        scene.substep()
    assert scene.stage.contact._grid.particle_count > 0
    assert not scene.stage.contact._touching.numpy().any()
    assert np.array_equal(scene.stage.angular_momentum.numpy(), spin)
    assert not scene.velocity.any()


# -- what the animation moves --------------------------------------------------------------------------------


def test_a_box_dropped_on_a_floor_stays_on_it():
    """From four cells above: within a second it rests, level, no cell deep and in the particles' range."""
    scene = run([box(centre=(0.013, 0.5 * SIZE + 4.0 * CELL, 0.007))], [floor()])
    lowest = np.inf
    while scene.time < 1.0:
        scene.substep()
        lowest = min(lowest, scene.points(0)[:, 1].min())
    assert -CELL < lowest
    assert 0.0 < scene.position[0, 1] - 0.5 * SIZE < RANGE * CELL
    assert np.abs(scene.velocity).max() < 0.01
    assert scene.rotation[0, 1, 1] > np.cos(0.01)


def incline(angle: float, friction: float) -> np.ndarray:
    """A box laid down above an incline; its way down the slope [m] at the end of frames."""
    rotation = turn_z(angle)
    height = (0.5 * SIZE + 1.6 * CELL) * rotation[:, 1]
    scene = run(
        [box(centre=height, rotation=rotation, friction=friction)],
        [floor(rotation=rotation, friction=friction, half=20.0)],
        stiffness=RigidSettings().stiffness,
    )
    way = []
    for _ in range(18):
        scene.run(FRAME)
        way.append(scene.position[0] @ -rotation[:, 0])
    return np.array(way)


@pytest.mark.slow
@pytest.mark.parametrize("angle, friction", [(25.0, 0.3), (20.0, 0.2), (15.0, 0.0)])
def test_a_slope_above_the_threshold_is_slid_down(angle, friction):
    """tan(angle) > mu: a = g (sin - mu cos) within 3 % of g, once it has landed."""
    slope = np.radians(angle)
    way = incline(angle, friction)[6:]
    found = 2.0 * np.polyfit(FRAME * np.arange(len(way)), way, 2)[0]
    assert abs(found - GRAVITY * (np.sin(slope) - friction * np.cos(slope))) < 0.03 * GRAVITY


@pytest.mark.slow
@pytest.mark.parametrize("angle, friction", [(20.0, 0.9), (20.0, 0.45)])
def test_a_slope_below_the_threshold_holds(angle, friction):
    """tan(20) = .364 < mu: once landed it stays within a cell, where without friction it would go forty."""
    way = incline(angle, friction)[6:]
    assert np.ptp(way) < CELL


@pytest.mark.slow
def test_a_rising_floor_lifts_and_carries_along():
    """A floor that rises and slides, at .2 and .3 m/s: the box on it comes to move with it."""

    def moved(time: float) -> np.ndarray:
        return placed((0.3 * time, 0.2 * time, 0.0))

    scene = run([box(centre=(0.0, 0.5 * SIZE + CELL, 0.0), friction=0.8)], [floor(motion=FormulaMotion(moved))])
    scene.run(0.5)
    velocity = []
    for _ in range(6):
        scene.run(FRAME)
        velocity.append(scene.velocity[0])
    assert np.mean(velocity, axis=0) == pytest.approx([0.3, 0.2, 0.0], abs=0.02)


# -- as a stage ----------------------------------------------------------------------------------------------


def landing(threads: int = 1) -> Rigid:
    props = [box(centre=(0.01, 0.13, 0.0)), box(centre=(0.05, 0.36, 0.02), angular_velocity=[0.0, 1.0, 0.5])]
    return run(props, [floor()], threads=threads)


def poses(scene: Rigid) -> np.ndarray:
    return np.concatenate([scene.position, scene.stage.orientation.numpy(), scene.velocity], axis=1)


def test_bits_do_not_depend_on_threads_or_interruptions():
    """Run to run, on one or two threads, taken up from a saved state, or with a step that was retracted."""
    scene, again, threaded, resumed = landing(), landing(), landing(2), landing()
    for each in (scene, again, threaded):
        each.run(2 * FRAME)
    resumed.simulation.state.restore(scene.simulation.state.to_numpy())
    substep = Interval(again.time, again.time + FRAME / SUBSTEPS)
    kinematics = again.simulation.model.parts["kinematics"]
    for stage in (kinematics, again.stage):
        stage.begin_frame(again.simulation.state, substep)
        stage.step(again.simulation.state, substep, False)
    for stage in (again.stage, kinematics):
        stage.retract(again.simulation.state, substep)
    for each in (scene, again, threaded, resumed):
        each.run(FRAME)
        assert np.array_equal(poses(each), poses(scene))
    assert scene.stage.contact._touching.numpy().any()


def test_flesh_meets_the_bodies_as_by_the_default():
    """A jelly thrown at a free box: it is pushed, momenta stay, though substeps are taken again for it."""
    jelly = box_body(size=(0.2, 0.2, 0.2), cells=2, youngs_modulus=1e4)
    both = Both(
        [box(centre=(0.23, 0.03, 0.0), density=300.0)],
        [jelly],
        gravity=(0.0, 0.0, 0.0),
        precision="float64",
        rigid=RigidSettings(method="paper"),
    )
    both.push_flesh([2.0, 0.0, 0.0])
    both.substep()
    linear, angular = both.momenta()
    for _ in range(16):
        both.substep()
    after = both.momenta()
    assert both.velocity[0, 0] > 0.2
    assert np.abs(after[0] - linear).max() < 1e-12 * np.abs(linear).max()
    assert np.abs(after[1] - angular).max() < 1e-12 * np.abs(linear).max()


def test_what_has_no_skin_falls():
    """Nothing collides: a body without a skin, above a floor and below it."""
    prop = box(centre=(0.0, 0.15, 0.0))
    prop.surface = replace(prop.surface, collides=False)
    scene = run([prop], [floor()])
    scene.run(0.5)
    assert scene.velocity[0] == pytest.approx([0.0, -GRAVITY * 0.5, 0.0], rel=1e-12)


def test_far_from_everything_a_substep_is_one_step_of_two_launches():
    scene = run([box(centre=(0.0, 5.0, 0.0)), box(centre=(3.0, 5.0, 0.0))], [floor()])
    scene.substep()
    before = scene.simulation.model.launcher.launches["rigid"]
    scene.substep()
    assert scene.simulation.model.launcher.launches["rigid"] - before == 2


def test_what_the_variant_does_not_know_is_refused():
    joint = Joint("hinge", "revolute", (None, 0), (np.eye(4), np.eye(4)))
    with pytest.raises(Refused, match="joints"):
        run([box()], joints=(joint,))
    with pytest.raises(Refused, match="restitution"):
        run([box(restitution=0.5)])
    with pytest.raises(Refused, match="restitution"):
        run([box()], [floor(restitution=0.5)])
    with pytest.raises(Refused, match="filtered pairs"):
        run([box(), box()], filtered=((0, 1),))


def test_what_is_not_selected_is_not_loaded():
    code = """
import sys
from tests.solver.rigid.rigid_scenes import Rigid, box
scene = Rigid([box()])
assert "rigid/director" not in scene.simulation.state.arrays
parts = ("rigid.paper", "face_particles", "sparse_grid")
assert not [name for name in sys.modules if any(part in name for part in parts)]
"""
    root = Path(__file__).parents[3]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
