"""Elastic bodies in motion: what the stage as a whole promises."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.build import build
from plait.solver.diagnostics import Diverged
from plait.solver.model import Interval
from plait.solver.scene import Pose, Scene
from plait.solver.settings import FleshSettings, Settings
from plait.solver.step import Simulation

from .lattices import box_body, turn

PRECISIONS = ("float32", "float64")
INTEGRATORS = ("bdf2", "backward-euler", "symplectic-euler")
WEIGHTLESS = np.zeros(3)


class Moved:
    """Nodes that lie where `before` has them up to `time` [s], and where `after` has them from then on."""

    animated = True

    def __init__(self, before: np.ndarray, after: np.ndarray, time: float = 0.0) -> None:
        self._before, self._after, self._time = before, after, time

    def pose(self, time: float) -> Pose:
        return Pose(np.eye(4)[None], points=self._after if time > self._time else self._before)


def simulate(body, skin, *, gravity=WEIGHTLESS, precision="float32", threads=1, **flesh) -> Simulation:
    scene = Scene(surfaces=(skin,), bodies=(body,), gravity=np.array(gravity, dtype=float))
    settings = Settings(threads=threads, precision=precision, flesh=FleshSettings(**flesh))
    return build(scene, settings)


def stage_of(simulation: Simulation):
    return simulation.model.parts["tets"]


def advance(simulation: Simulation, steps: int, length: float) -> dict:
    for _ in range(steps):
        metrics = simulation.advance_frame(simulation.state.time + length, substeps=1)
    return metrics["tets"]


def momenta(simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Linear, and angular about the centre of mass."""
    stage = stage_of(simulation)
    mass, x, v = stage.layout.mass[:, None], stage.nodes(0), stage.node_velocities(0)
    centre = (mass * x).sum(axis=0) / mass.sum()
    return (mass * v).sum(axis=0), np.cross(x - centre, mass * v).sum(axis=0)


def on_boundary(nodes: np.ndarray) -> np.ndarray:
    lower, upper = nodes.min(axis=0), nodes.max(axis=0)
    return (np.isclose(nodes, lower) | np.isclose(nodes, upper)).any(axis=1)


SHEARED = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.1], [0.0, 0.05, 1.05]])
TURNED = turn(np.array([1.0, 2.0, 0.5]) / np.sqrt(5.25), 0.6)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("matrix", [SHEARED, TURNED], ids=["affine", "rigid"])
def test_patch(matrix, precision):
    """With its boundary moved by a linear map, a body of one material is that map throughout, at equilibrium.

    A step so long that inertia is nothing finds it; to 1e-12 of the size in float64, 1e-5 in float32.
    """
    rest, _ = box_body((1.0, 0.75, 0.75), (4, 3, 3))
    nodes, boundary = rest.nodes, on_boundary(rest.nodes)
    goal = nodes @ matrix.T + [0.1, 0.2, 0.3]
    moved = np.where(boundary[:, None], goal, nodes)
    body, skin = box_body((1.0, 0.75, 0.75), (4, 3, 3), pinned=boundary, motion=Moved(nodes, moved))
    simulation = simulate(body, skin, precision=precision, integrator="backward-euler", tolerance=1e-14)
    advance(simulation, 3, 1e6)
    off = np.abs(stage_of(simulation).nodes(0) - goal).max()
    assert off <= (1e-12 if precision == "float64" else 1e-5)
    # The skin's points follow an affine map exactly too, whatever lies between.
    assert np.abs(stage_of(simulation).points(0) - (skin.points @ matrix.T + [0.1, 0.2, 0.3])).max() <= off + 1e-6


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_momenta_in_free_flight(integrator, precision):
    """Inner forces change neither momentum; gravity adds M g t. To 1e-12 in float64, 1e-5 in float32."""
    body, skin = box_body((0.8, 0.4, 0.4), (4, 2, 2))
    gravity = np.array([0.3, -9.81, 0.1])
    simulation = simulate(body, skin, gravity=gravity, precision=precision, integrator=integrator)
    stage = stage_of(simulation)
    noise = np.random.default_rng(1).uniform(-0.2, 0.2, body.nodes.shape)
    stage.velocity.assign(noise + np.array([1.0, 2.0, 0.5]) + np.cross([3.0, 1.0, -2.0], body.nodes))
    linear, angular = momenta(simulation)
    steps, length = 24, 1.0 / 192.0
    advance(simulation, steps, length)
    after_linear, after_angular = momenta(simulation)
    fallen = linear + stage.layout.mass.sum() * gravity * steps * length
    close = 1e-12 if precision == "float64" else 1e-5
    assert np.linalg.norm(after_linear - fallen) <= close * np.linalg.norm(fallen)
    assert np.linalg.norm(after_angular - angular) <= close * np.linalg.norm(angular)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_an_impulse_is_the_change_of_momentum(integrator):
    """In the step that takes it up and for good, though BDF2 looks two steps back."""
    body, skin = box_body((0.4, 0.4, 0.4), 2)
    simulation = simulate(body, skin, precision="float64", integrator=integrator)
    advance(simulation, 2, 1.0 / 192.0)
    impulse = np.random.default_rng(0).uniform(-0.1, 0.1, body.nodes.shape)
    stage_of(simulation).external_impulse.assign(impulse)
    for _ in range(3):
        advance(simulation, 1, 1.0 / 192.0)
        linear, _ = momenta(simulation)
        np.testing.assert_allclose(linear, impulse.sum(axis=0), atol=1e-12)
    assert not stage_of(simulation).external_impulse.numpy().any()


def _clamped(**body):
    rest, _ = box_body((0.6, 0.2, 0.2), (6, 2, 2))
    return box_body((0.6, 0.2, 0.2), (6, 2, 2), pinned=np.isclose(rest.nodes[:, 0], -0.3), **body)


def test_the_same_bits_on_any_number_of_threads_and_from_a_checkpoint():
    def run(threads: int, restart: bool) -> np.ndarray:
        simulation = simulate(*_clamped(), gravity=(0.0, -9.81, 0.0), threads=threads)
        advance(simulation, 5, 1.0 / 96.0)
        if restart:
            held = simulation.state.to_numpy()
            simulation.close()
            simulation = simulate(*_clamped(), gravity=(0.0, -9.81, 0.0), threads=threads)
            simulation.state.restore(held)
        advance(simulation, 5, 1.0 / 96.0)
        simulation.close()
        return stage_of(simulation).nodes(0).copy()

    once = run(1, restart=False)
    np.testing.assert_array_equal(once, run(2, restart=False))
    np.testing.assert_array_equal(once, run(1, restart=True))


def test_a_step_taken_back_leaves_no_trace():
    simulation = simulate(*_clamped(), gravity=(0.0, -9.81, 0.0))
    advance(simulation, 3, 1.0 / 96.0)
    stage, state = stage_of(simulation), simulation.state
    stage.external_impulse.assign(np.full((stage.layout.node_count, 3), 1e-3))
    before = state.to_numpy()
    substep = Interval(state.time, state.time + 1.0 / 96.0)
    assert stage.step(state, substep)
    changed = state.to_numpy()
    assert (changed["tets/position"] != before["tets/position"]).any()
    stage.retract(state, substep)
    after = state.to_numpy()
    for name, values in before.items():
        np.testing.assert_array_equal(values, after[name], err_msg=name)


def test_rest_costs_nothing_and_ends_with_a_push():
    """A damped body comes to rest under gravity, bit for bit; an impulse wakes it."""
    simulation = simulate(*_clamped(mass_damping=8.0), gravity=(0.0, -9.81, 0.0))
    stage = stage_of(simulation)
    for _ in range(20):
        if advance(simulation, 24, 1.0 / 96.0)["asleep"]:
            break
    still = stage.nodes(0).copy()
    metrics = advance(simulation, 3, 1.0 / 96.0)
    assert metrics["asleep"] == 1 and metrics["newton_iterations"] == 0
    np.testing.assert_array_equal(stage.nodes(0), still)
    push = np.zeros_like(still)
    push[-1] = [0.0, 0.1, 0.0]
    stage.external_impulse.assign(push)
    assert advance(simulation, 1, 1.0 / 96.0)["asleep"] == 0
    assert np.abs(stage.nodes(0) - still).max() > 1e-5


def test_pinned_nodes_are_where_the_animation_is():
    """At the end of each step exactly, and attached ones go there as stiffly as their springs are."""
    body, _ = box_body((0.6, 0.2, 0.2), (6, 2, 2))
    there = body.nodes + np.array([0.01, 0.02, 0.0])
    end = np.isclose(body.nodes[:, 0], -0.3)
    moved = Moved(body.nodes, there)
    simulation = simulate(*box_body((0.6, 0.2, 0.2), (6, 2, 2), pinned=end, motion=moved))
    advance(simulation, 1, 1.0 / 96.0)
    np.testing.assert_array_equal(stage_of(simulation).nodes(0)[end], there[end])
    # At rest under a weight w, a body on springs k in all hangs w / k below its goal.
    springs = np.full(len(body.nodes), 50.0)
    held = box_body((0.6, 0.2, 0.2), (6, 2, 2), attachment=springs, youngs_modulus=1e8, motion=moved)
    simulation = simulate(*held, gravity=(0.0, -9.81, 0.0), integrator="backward-euler", precision="float64")
    advance(simulation, 40, 1.0)
    mass = stage_of(simulation).layout.mass
    sag = (stage_of(simulation).nodes(0) - there)[:, 1].mean()
    assert sag == pytest.approx(-9.81 * mass.sum() / springs.sum(), rel=1e-3)


def test_a_jump_of_the_animation_carries_the_flesh():
    """Bone that is elsewhere from one step to the next takes the flesh along, which then stays under 2 m/s."""
    rest, _ = _clamped()
    goal = rest.nodes @ turn(np.array([0.0, 0.0, 1.0]), 1.5).T + [1.0, 0.5, 0.0]
    jump = Moved(rest.nodes, goal, time=0.02)
    simulation = simulate(*_clamped(motion=jump))
    speeds, pops = [], 0
    for _ in range(20):
        pops += advance(simulation, 1, 1.0 / 96.0)["pops"]
        speeds.append(np.linalg.norm(stage_of(simulation).node_velocities(0), axis=1).max())
    assert pops == 1 and max(speeds) < 2.0
    assert np.abs(stage_of(simulation).nodes(0) - goal).max() < 0.05


def test_a_node_that_is_not_finite_is_named():
    simulation = simulate(*_clamped(name="jelly"))
    position = stage_of(simulation).nodes(0).copy()
    position[17] = np.nan
    stage_of(simulation).position.assign(position)
    with pytest.raises(Diverged, match="position of jelly, node 17 of its tets"):
        advance(simulation, 1, 1.0 / 96.0)
