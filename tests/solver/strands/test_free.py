"""Strands that nothing holds: momentum, fall, rest on a floor, shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.solver.diagnostics import Refused
from plait.solver.scene import KeyedMotion, Scene, Surface
from plait.solver.settings import StrandSettings
from plait.solver.step import Simulation

from .rod_scenes import line, rod_scene, simulate

SUBSTEP = 1.0 / 192.0
GRAVITY = 9.81


def curl(turns: float = 0.75, segments: int = 30) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi * turns, segments + 1)
    return 0.02 * np.stack([np.cos(angle), np.sin(angle), 0.3 * angle], axis=1)


def raised(shape: np.ndarray, height: float, aside: float = 0.0) -> np.ndarray:
    return shape + np.array([0.0, height, aside])


def set_free(scene: Scene, *, free: list[bool] | None = None) -> Scene:
    (strands,) = scene.strands
    which = np.ones(strands.strand_count, bool) if free is None else np.array(free)
    return replace(scene, strands=(replace(strands, free=which),))


def floor(friction: float = 0.5) -> Surface:
    corners = np.array([[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]])
    return Surface("floor", corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), friction=friction)


def momenta(simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """(3,) momentum [kg m/s] and angular momentum about zero [kg m2/s], the edges' own turning included."""
    layout, arrays = simulation.model.parts["strands"].layout, simulation.state.arrays
    x, v, spin = (arrays[f"strands/{name}"].numpy() for name in ("position", "velocity", "spin"))
    momentum = layout.mass[:, None] * v
    edges = np.diff(x, axis=0)[1:]
    tangents = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    own = (layout.turn_inertia * spin)[1:-1] @ tangents
    return momentum.sum(axis=0), np.cross(x, momentum).sum(axis=0) + own


@pytest.mark.parametrize(("integrator", "damping"), [("backward-euler", 10.0), ("sdirk2", 0.0)])
def test_falls_as_a_stone(integrator, damping):
    """x = -g t^2 / 2, for Euler's method -g h^2 n (n + 1) / 2, whatever damps the shape."""
    scene = set_free(rod_scene([line(0.1, 20)], damping=damping))
    simulation = simulate(scene, strands=StrandSettings(integrator=integrator))
    stage = simulation.model.parts["strands"]
    start, count = stage.points(0).copy(), 96
    for frame in range(12):
        simulation.advance_frame((frame + 1) / 24.0)
    steps = count * (count + 1) if integrator == "backward-euler" else count**2
    fall = 0.5 * GRAVITY * SUBSTEP**2 * steps
    np.testing.assert_allclose(stage.points(0) - start, np.tile([0.0, -fall, 0.0], (21, 1)), atol=1e-9 * fall)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_momentum_in_free_flight(precision):
    """A spinning curl's momentum is kept to rounding each step; its angular momentum drifts as the step."""
    rounding = {"float64": 1e-12, "float32": 1e-4}[precision]
    drifts = []
    for substeps in (8, 16):
        scene = set_free(rod_scene([curl()], radius=200e-6, young=1e8, gravity=(0.0, 0.0, 0.0), damping=3.0))
        simulation = simulate(scene, strands=StrandSettings(precision=precision))
        arrays = simulation.state.arrays
        position = arrays["strands/position"].numpy()
        velocity = np.array([0.1, 0.2, 0.3]) + np.cross([3.0, 5.0, -4.0], position - position[1:].mean(axis=0))
        velocity[0] = 0.0
        arrays["strands/velocity"].assign(velocity)
        first = before = momenta(simulation)
        for step in range(6 * substeps):
            simulation.advance_frame((step + 1) / (24.0 * substeps), substeps=1)
            after = momenta(simulation)
            assert np.linalg.norm(after[0] - before[0]) <= rounding * np.linalg.norm(first[0])
            before = after
        drifts.append(np.linalg.norm(before[1] - first[1]) / np.linalg.norm(first[1]))
    assert drifts[1] < 0.6 * drifts[0] < 0.03


def test_spins_about_itself_for_good():
    """A straight strand has no stiffness against that: its spin stays what it was."""
    simulation = simulate(set_free(rod_scene([line(0.1, 10)], gravity=(0.0, 0.0, 0.0), damping=10.0)))
    spin = simulation.state.arrays["strands/spin"]
    spin.assign(np.where(np.arange(12) % 11 == 0, 0.0, 7.0))
    director = simulation.model.parts["strands"].directors(0)[0].copy()
    simulation.advance_frame(1.0 / 24.0)
    np.testing.assert_allclose(spin.numpy()[1:-1], 7.0, rtol=1e-9)
    turned = simulation.model.parts["strands"].directors(0)[0]
    angle = np.arctan2(np.cross(director, turned)[0], director @ turned)
    assert angle == pytest.approx(7.0 / 24.0, rel=1e-9)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_comes_to_rest_on_a_floor(precision):
    """Every node of a strand that fell flat, the first one too, lies a radius over the floor and does not move."""
    radius = 5e-4
    shapes = [raised(line(0.1, 20), 0.02), raised(line(0.1, 20, (1.0, 1.0, 0.0)), 0.02, 0.1)]
    scene = set_free(rod_scene(shapes, radius=radius, young=1e8, density=1000.0, surfaces=(floor(),)))
    simulation = simulate(scene, strands=StrandSettings(precision=precision))
    for frame in range(24):
        found = simulation.advance_frame((frame + 1) / 24.0)["strands"]
    stage = simulation.model.parts["strands"]
    # Contact is softer in float32, where it is a thousand times as stiff as the strand.
    np.testing.assert_allclose(stage.points(0)[:, 1], radius, atol=0.05 * radius)
    assert np.abs(stage.velocities(0)).max() < 1e-4
    assert found["penetrating"] == 0


def test_keeps_its_shape_in_flight():
    """As drawn without force, in 'sagfree' too: a curl that falls stays as it was, to rounding."""
    scene = set_free(rod_scene([curl()], radius=200e-6, young=1e8, rest_shape="sagfree"))
    simulation = simulate(scene)
    stage = simulation.model.parts["strands"]
    drawn = stage.points(0) - stage.points(0)[0]
    simulation.advance_frame(0.25, substeps=48)
    np.testing.assert_allclose(stage.points(0) - stage.points(0)[0], drawn, atol=1e-9)


def test_does_not_follow_its_skin():
    """Neither the skin it was drawn on nor another strand's freedom moves a strand."""
    moved = np.eye(4)
    moved[0, 3] = 0.1
    motion = KeyedMotion(np.array([0.0, 0.5]), np.array([[np.eye(4)], [moved]]))
    scene = rod_scene([line(0.1, 10), raised(line(0.1, 10), 0.0, 0.1)], motion=motion, gravity=(0.0, 0.0, 0.0))
    partly = simulate(set_free(scene, free=[True, False]))
    bound = simulate(scene)
    for frame in range(6):
        partly.advance_frame((frame + 1) / 24.0)
        bound.advance_frame((frame + 1) / 24.0)
    first, second = (s.model.parts["strands"].points(0).reshape(2, 11, 3) for s in (partly, bound))
    np.testing.assert_allclose(first[0], line(0.1, 10), atol=1e-15)
    assert np.array_equal(first[1], second[1])


def test_resumes_with_the_same_bits():
    shapes = [raised(curl(), 0.03)]
    scene = set_free(rod_scene(shapes, radius=200e-6, young=1e8, surfaces=(floor(),), damping=2.0))
    whole, again = simulate(scene), simulate(scene)
    for frame in range(4):
        whole.advance_frame((frame + 1) / 24.0)
    again.state.restore(whole.state.to_numpy())
    for frame in range(4, 8):
        whole.advance_frame((frame + 1) / 24.0)
        again.advance_frame((frame + 1) / 24.0)
    for name, array in whole.state.arrays.items():
        assert np.array_equal(array.numpy(), again.state.arrays[name].numpy()), name


def test_has_no_static_equilibrium():
    simulation = simulate(set_free(rod_scene([line(0.1, 10)])))
    with pytest.raises(Refused, match="free"):
        simulation.model.parts["strands"].relax()
