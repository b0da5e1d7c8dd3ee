"""Free rigid bodies against closed forms and the invariants of Euler's equations."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.rigid.mass_properties import MassProperties
from plait.solver.scene import Joint, Surface

from .rigid_scenes import FRAME, Prop, Rigid, pose, rotation_about

FLIP = 20.7546098  # [s] half of the period of an elliptic function, of inertia (1, 2, 3) and spin (0.01, 1, 0)


def of_inertia(inertia, centre=(0.0, 0.0, 0.0), mass=1.0, rotation=None, **body) -> Prop:
    """A body that touches nothing."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    surface = Surface("prop", corners, np.array([[0, 1, 2]]), collides=False)
    properties = MassProperties(mass, np.asarray(centre), np.asarray(inertia, dtype=float))
    return Prop(surface, properties, pose(rotation=rotation), **body)


def body_spin(scene: Rigid) -> np.ndarray:
    return scene.rotation[0].T @ scene.spin[0]


@pytest.mark.parametrize("turned", [False, True])
def test_a_body_flips_about_its_middle_axis_when_it_should(turned):
    """Torque-free inertia (1, 2, 3) spinning at (0.01, 1, 0) flips every 20.7546098 s, whatever its axes."""
    axes = rotation_about(np.array([1.0, 2.0, 3.0]), 0.8) if turned else np.eye(3)
    inertia = axes @ np.diag([1.0, 2.0, 3.0]) @ axes.T
    spin = axes @ np.array([0.01, 1.0, 0.0])
    scene = Rigid([of_inertia(inertia, angular_velocity=spin)], gravity=(0.0, 0.0, 0.0))
    times, last, before = [], 1.0, 0.0
    while len(times) < 3:
        scene.run(FRAME)
        about = float(axes[:, 1] @ body_spin(scene))
        if about * last < 0.0:
            times.append(before + (scene.time - before) * last / (last - about))
        last, before = about, scene.time
    assert np.diff(times) == pytest.approx(FLIP, rel=1e-4)


@pytest.mark.parametrize("rate", [1.0, 100.0])
def test_energy_and_angular_momentum_of_a_free_body_do_not_drift(rate):
    """Both are invariants of the scheme: to round-off, of the order of the number of steps times 1e-16."""
    spin = rate * np.array([0.3, 1.0, 0.2])
    scene = Rigid([of_inertia(np.diag([1.0, 2.0, 3.0]), angular_velocity=spin)], gravity=(0.0, 0.0, 0.0))
    energy = 0.5 * spin @ np.diag([1.0, 2.0, 3.0]) @ spin
    momentum = scene.momenta()[1]
    for _ in range(10):
        metrics = scene.run(0.5)
        assert metrics["kinetic_energy"] == pytest.approx(energy, rel=1e-12)
        assert np.array_equal(scene.momenta()[1], momentum)
        assert np.linalg.norm(scene.stage.orientation.numpy()[0]) == pytest.approx(1.0, abs=1e-15)


def test_a_steady_spin_keeps_its_phase_however_fast():
    """About a principal axis the scheme is exact: the angle is rate times time."""
    rate = 200.0  # [rad/s], more than one radian a substep
    scene = Rigid(
        [of_inertia(np.diag([1.0, 2.0, 3.0]), angular_velocity=[0.0, 0.0, rate])], gravity=(0.0, 0.0, 0.0)
    )
    scene.run(1.0)
    expected = rotation_about(np.array([0.0, 0.0, 1.0]), rate * scene.time)
    assert scene.rotation[0] == pytest.approx(expected, abs=1e-10)


def test_a_body_falls_as_symplectic_euler_does():
    """x = g t (t + h) / 2, to round-off."""
    scene = Rigid([of_inertia(np.eye(3), velocity=[1.0, 0.0, 0.0])])
    scene.run(1.0)
    h = FRAME / 8
    assert scene.position[0] == pytest.approx([1.0, -0.5 * 9.81 * (1.0 + h), 0.0], rel=1e-12, abs=1e-12)


def test_impulses_of_others_are_taken_up_once():
    scene = Rigid([of_inertia(np.diag([1.0, 2.0, 3.0]), mass=2.0)], gravity=(0.0, 0.0, 0.0))
    scene.stage.impulse.assign([[2.0, 0.0, 0.0]])
    scene.stage.angular_impulse.assign([[0.0, 0.0, 6.0]])
    scene.run(0.5)
    assert scene.velocity[0] == pytest.approx([1.0, 0.0, 0.0])
    assert scene.spin[0] == pytest.approx([0.0, 0.0, 2.0])


def heavy_top() -> Rigid:
    """Inertia (1, 1, .5) about its tip, m g l = 2, leaning 60 degrees, spinning at 12: slow steady precession."""
    lean, spin, rate = np.radians(60.0), 12.0, 0.34314575
    mass, length, gravity = 1.0, 0.2, 10.0
    inertia = np.diag([1.0 - mass * length**2, 1.0 - mass * length**2, 0.5])
    rotation = rotation_about(np.array([1.0, 0.0, 0.0]), lean)
    axis = rotation[:, 2]
    # Of the whole spin 12 is along the axis; across it is what precession gives.
    up = np.array([0.0, 0.0, 1.0])
    turning = rate * up + (spin - rate * np.cos(lean)) * axis
    top = of_inertia(
        inertia,
        (0.0, 0.0, length),
        mass,
        rotation,
        angular_velocity=turning,
        velocity=np.cross(turning, length * axis),
    )
    tip = Joint("tip", "spherical", (None, 0), (np.eye(4), np.eye(4)))
    return Rigid([top], gravity=(0.0, 0.0, -gravity), joints=(tip,))


def test_a_heavy_top_precesses_as_it_should_and_stays_on_its_tip():
    """A cos(60) W^2 - C n W + m g l = 0 gives W = 0.34314575 for A = 1, C = .5, n = 12, m g l = 2."""
    scene = heavy_top()
    angles = []
    for _ in range(240):
        scene.run(FRAME)
        axis = scene.rotation[0][:, 2]
        angles.append(np.arctan2(axis[1], axis[0]))
        assert np.linalg.norm(scene.stage.pose(0)[:3, 3]) < 1e-8
        assert np.degrees(np.arccos(axis[2])) == pytest.approx(60.0, abs=0.1)
    turned = np.unwrap(angles)
    rate = np.polyfit(FRAME * np.arange(len(turned)), turned, 1)[0]
    assert rate == pytest.approx(0.34314575, rel=1e-3)
