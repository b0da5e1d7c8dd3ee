"""Motion against closed forms: a released cantilever, a hanging chain, damping, the root's own motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j0

from plait.solver.scene import KeyedMotion, Pose, Scene
from plait.solver.settings import StrandSettings
from plait.solver.step import Simulation

from .rod_scenes import line, rod_scene, simulate

LENGTH, RADIUS, DENSITY, YOUNG = 0.2, 1e-3, 1000.0, 1e8
FIRST_MODE = 1.875104068711961  # beta L of a cantilever


def released_cantilever(settings: StrandSettings, damping: float = 0.0) -> tuple[Simulation, np.ndarray, float]:
    """A rod let go from its first mode's shape at a small amplitude: simulation, shape of that mode, period [s].

    The load that bends it so is the mode itself times the mass, found by a static solve; then it is taken away.
    """
    segments = 50
    along = np.linspace(0.0, 1.0, segments + 1)
    b = FIRST_MODE
    sigma = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
    mode = np.cosh(b * along) - np.cos(b * along) - sigma * (np.sinh(b * along) - np.sin(b * along))
    mass = DENSITY * np.pi * RADIUS**2 * LENGTH / segments * np.where(along == 1.0, 0.5, 1.0)
    bend = YOUNG * np.pi * RADIUS**4 / 4.0
    omega = b**2 * np.sqrt(bend / (DENSITY * np.pi * RADIUS**2 * LENGTH**4))
    amplitude = 1e-3 * LENGTH / mode[-1]
    loads = np.zeros((segments + 1, 3))
    loads[:, 2] = omega**2 * mass * mode * amplitude
    shape = [line(LENGTH, segments)]
    constants = {
        "radius": RADIUS,
        "density": DENSITY,
        "young": YOUNG,
        "damping": damping,
        "gravity": (0.0, 0.0, 0.0),
    }
    bent = simulate(rod_scene(shape, loads=loads, **constants))
    bent.model.parts["strands"].relax(tolerance=1e-10)
    simulation = simulate(rod_scene(shape, **constants), strands=settings)
    simulation.state.restore(bent.state.to_numpy())
    return simulation, mass * mode, 2.0 * np.pi / omega


def ring(
    simulation: Simulation, weights: np.ndarray, period: float, periods: int, steps: int
) -> tuple[float, float]:
    """Periods a time of `period`, and the part of the amplitude kept in each, of the mode that `weights` picks."""
    strands = simulation.model.parts["strands"]
    values = []
    for i in range(periods * steps):
        simulation.advance_frame((i + 1) * period / steps, 1)
        points, speeds = strands.points(0)[:, 2], strands.velocities(0)[:, 2]
        values.append((weights @ points, weights @ speeds * period / (2.0 * np.pi)))
    turning = np.array(values) @ np.array([1.0, 1j])
    phase = np.unwrap(np.angle(turning))
    times = np.arange(len(turning)) / steps
    rate = -np.polyfit(times, phase, 1)[0] / (2.0 * np.pi)
    kept = np.exp(np.polyfit(times, np.log(np.abs(turning)), 1)[0])
    return rate, kept


def test_released_cantilever_keeps_frequency_and_amplitude_with_sdirk2(capsys: pytest.CaptureFixture) -> None:
    """Ten periods of 24 steps: frequency within 0.5 %, 99.5 % of the amplitude a period; Euler's is printed."""
    rate, kept = ring(*released_cantilever(StrandSettings(integrator="sdirk2", tolerance=1e-8)), 10, 24)
    euler = ring(*released_cantilever(StrandSettings(tolerance=1e-8)), 10, 24)
    with capsys.disabled():
        print(f"\nSDIRK2 frequency {rate:.5f}, kept {kept:.5f}; backward Euler {euler[0]:.4f}, {euler[1]:.4f}")
    assert abs(rate - 1.0) < 5e-3
    assert 0.995 < kept < 1.0 + 1e-3


def test_sdirk2_is_second_order_in_time() -> None:
    """The frequency's error falls by four when the step is halved."""
    errors = []
    exact = ring(*released_cantilever(StrandSettings(integrator="sdirk2", tolerance=1e-9)), 2, 192)[0]
    for steps in (12, 24):
        settings = StrandSettings(integrator="sdirk2", tolerance=1e-9)
        errors.append(abs(ring(*released_cantilever(settings), 2, steps)[0] - exact))
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.3


def test_damping_is_the_rate_at_which_relative_velocity_dies_out() -> None:
    """A mode much faster than its damping c keeps exp(-c T / 2) of its amplitude a period T."""
    undamped = ring(*released_cantilever(StrandSettings(integrator="sdirk2", tolerance=1e-8)), 4, 24)[1]
    simulation, weights, period = released_cantilever(
        StrandSettings(integrator="sdirk2", tolerance=1e-8), damping=2.0
    )
    damped = ring(simulation, weights, period, 4, 24)[1]
    assert damped / undamped == pytest.approx(np.exp(-2.0 * period / 2.0), rel=3e-3)


def test_hanging_chain_swings_at_bernoullis_frequency() -> None:
    """The first root of J0 gives omega sqrt(L / g) = 1.20241278 for a chain without stiffness; within 0.5 %."""
    length, segments, gravity = 1.0, 50, 9.81
    period = 2.0 * np.pi / (1.2024127788 * np.sqrt(gravity / length))
    weight = 1000.0 * np.pi * 1e-6 * gravity
    stiffness = weight * length**3 * 1e-6  # the boundary layer at the clamp is a thousandth of the length
    shape = [line(length, segments, (0.0, -1.0, 0.0))]
    chain = {"radius": 1e-3, "density": 1000.0, "bend": stiffness, "twist": stiffness, "stretch": 1e4}
    aside = np.zeros((segments + 1, 3))
    aside[:, 2] = 1e-4 * weight / segments
    pushed = simulate(rod_scene(shape, loads=aside, **chain))
    pushed.model.parts["strands"].relax(tolerance=1e-9)
    simulation = simulate(rod_scene(shape, **chain), strands=StrandSettings(integrator="sdirk2", tolerance=1e-7))
    simulation.state.restore(pushed.state.to_numpy())
    mode = j0(2.404825557695773 * np.sqrt(np.linspace(1.0, 0.0, segments + 1)))
    mode[-1] *= 0.5  # half a segment's mass
    rate, _ = ring(simulation, mode, period, 4, 96)
    assert rate == pytest.approx(1.0, abs=5e-3)


class Turning:
    """Steady rotation about y at one turn a second, from rest at time 0."""

    animated = True

    def pose(self, time: float) -> Pose:
        angle = 2.0 * np.pi * time
        turn = np.eye(4)
        turn[0, 0] = turn[2, 2] = np.cos(angle)
        turn[0, 2], turn[2, 0] = np.sin(angle), -np.sin(angle)
        return Pose(turn[None])


def test_root_carries_its_direction() -> None:
    """The clamp follows position and rotation of the root's frame exactly, at frame ends."""
    shape = line(0.05, 10) + np.array([0.1, 0.0, 0.0])
    simulation = simulate(rod_scene([shape], motion=Turning()))
    for frame in range(6):
        simulation.advance_frame((frame + 1) / 24.0, 4)
    turn = Turning().pose(0.25).joint_transforms[0, :3, :3]
    points = simulation.model.parts["strands"].points(0)
    assert points[0] == pytest.approx(turn @ shape[0], abs=1e-12)
    rotation = simulation.model.parts["strands"].root_rotations(0)[0]
    assert rotation == pytest.approx(turn, abs=1e-12)


def moved(scene: Scene, transform: np.ndarray) -> Scene:
    """The same scene elsewhere: surfaces and gravity moved, rest shapes carried by the surface's motion."""
    surfaces = tuple(
        replace(surface, motion=KeyedMotion(np.array([0.0, 1.0]), np.stack([transform[None]] * 2)))
        for surface in scene.surfaces
    )
    strands = tuple(replace(strands, rest_transform=transform) for strands in scene.strands)
    return replace(scene, surfaces=surfaces, strands=strands, gravity=transform[:3, :3] @ scene.gravity)


@pytest.mark.parametrize("rest_shape", ["authored", "sagfree"])
def test_moved_scene_gives_moved_result(rest_shape: str) -> None:
    """Nothing depends on where the origin is or how the axes lie: 1e-9 of the length in float64."""
    rng = np.random.default_rng(5)
    angle = np.linspace(0.0, 6.0, 31)
    curl = 0.02 * np.stack([np.cos(angle) - 1.0, np.sin(angle), 0.3 * angle], axis=1)
    scene = rod_scene([line(0.2, 30, (1.0, 0.4, 0.2)), curl], rest_shape=rest_shape, young=4e10)
    scene = replace(scene, gravity=np.array([0.0, -9.81, 0.0]))
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    transform = np.eye(4)
    transform[:3, :3] = q * np.sign(np.linalg.det(q))
    transform[:3, 3] = [3.0, -2.0, 1.0]
    results = []
    for one in (scene, moved(scene, transform)):
        simulation = simulate(one)
        for frame in range(6):
            simulation.advance_frame((frame + 1) / 24.0)
        results.append(simulation.model.parts["strands"].points(0))
    expected = results[0] @ transform[:3, :3].T + transform[:3, 3]
    assert np.abs(results[1] - expected).max() < 1e-9 * 0.2
