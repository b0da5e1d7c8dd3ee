"""Joints of rigid bodies: what they hold, what they leave free, and their limits."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.benchmarks.scenes import FormulaMotion
from plait.solver.diagnostics import Refused
from plait.solver.scene import Drive, Joint

from ..tets.lattices import placed
from .rigid_scenes import FRAME, Rigid, box, rotation_about

GRAVITY = 9.81
ALONG_X = rotation_about(np.array([0.0, 1.0, 0.0]), 0.5 * np.pi)  # z to x


def frame(centre=(0.0, 0.0, 0.0), rotation=None) -> np.ndarray:
    return placed(centre, rotation)


def joint_poses(scene: Rigid, joint: Joint) -> tuple[np.ndarray, np.ndarray]:
    """(4, 4) of both sides, world."""
    return tuple(
        (joint.motion.pose(scene.time).joint_transforms[0] if body is None else scene.stage.pose(body)) @ held
        for body, held in zip(joint.bodies, joint.frames, strict=True)
    )


def apart(scene: Rigid, joint: Joint) -> float:
    """How far a joint's sides are from where they are held [m], [1]."""
    a, b = joint_poses(scene, joint)
    way = a[:3, :3].T @ (b[:3, 3] - a[:3, 3])
    if joint.kind == "prismatic":
        way = way[:2]
    turn = a[:3, :3].T @ b[:3, :3]
    if joint.kind == "revolute":
        turn = turn[:, 2] - [0.0, 0.0, 1.0]
    elif joint.kind == "spherical":
        turn = np.zeros(3)
    else:
        turn = turn - np.eye(3)
    return max(np.abs(way).max(), np.abs(turn).max())


@pytest.mark.parametrize("kind", ["fixed", "revolute", "spherical", "prismatic"])
def test_a_chain_of_joints_holds(kind):
    """Three bars swing for 3 s, hung on the world: no joint opens by more than 1e-6, nor drifts."""
    bars = [box((0.3, 0.05, 0.05), (0.15 + 0.3 * k, 0.0, 0.0), angular_velocity=[1.0, 0.0, 0.0]) for k in range(3)]
    turn = ALONG_X if kind == "prismatic" else None
    joints = [
        Joint("first", "spherical" if kind == "prismatic" else kind, (None, 0), (np.eye(4), frame((-0.15, 0, 0))))
    ]
    for k in range(2):
        ends = (frame((0.15, 0, 0), turn), frame((-0.15, 0, 0), turn))
        joints.append(Joint("next", kind, (k, k + 1), ends, limits=(-0.1, 0.1) if kind == "prismatic" else None))
    scene = Rigid(bars, joints=tuple(joints))
    for _ in range(12):
        scene.run(0.25)
        assert max(apart(scene, joint) for joint in joints) < 1e-6


def test_a_pendulum_keeps_its_energy_and_period():
    """A bar on a hinge, let go at 90 degrees: T = 4 K(1/2) sqrt(I / (m g l)), K(1/2) = 1.85407468, and energy.

    SHAKE is symplectic: of second order in the period, and without drift of the energy.
    """
    length = 0.6
    bar = box((length, 0.05, 0.05), (0.5 * length, 0.0, 0.0))
    hinge = Joint("hinge", "revolute", (None, 0), (np.eye(4), frame((-0.5 * length, 0.0, 0.0))))
    scene = Rigid([bar], joints=(hinge,))
    about = bar.mass.inertia[2, 2] / bar.mass.mass + (0.5 * length) ** 2
    period = 4.0 * 1.8540746773 * np.sqrt(about / (GRAVITY * 0.5 * length))
    angles, energies = [], []
    while scene.time < 10.0 * period:
        metrics = scene.run(FRAME)
        x = scene.position[0]
        angles.append(np.arctan2(x[1], x[0]) + 0.5 * np.pi)
        energies.append(metrics["kinetic_energy"] + metrics["potential_energy"])
    times = FRAME * (1 + np.arange(len(angles)))
    down = [
        times[k] + FRAME * angles[k] / (angles[k] - angles[k + 1])
        for k in range(len(angles) - 1)
        if angles[k] > 0.0 >= angles[k + 1]
    ]
    assert np.diff(down).mean() == pytest.approx(period, rel=2e-3)
    scale = bar.mass.mass * GRAVITY * 0.5 * length
    early, late = np.array(energies[:24]), np.array(energies[-24:])
    assert abs(late.mean() - early.mean()) < 5e-3 * scale


def test_a_hinge_stops_at_its_limits():
    """A door swung at both of its stops goes no further than either, and turns freely between."""
    door = box((0.8, 2.0, 0.04), (0.4, 0.0, 0.0), angular_velocity=[0.0, 3.0, 0.0], velocity=[0.0, 0.0, -1.2])
    upright = rotation_about(np.array([1.0, 0.0, 0.0]), -0.5 * np.pi)  # z to y
    hinge = Joint(
        "hinge",
        "revolute",
        (None, 0),
        (frame(rotation=upright), frame((-0.4, 0.0, 0.0), upright)),
        limits=(-0.3, 1.2),
    )
    scene = Rigid([door], joints=(hinge,))

    def angle() -> float:
        a, b = joint_poses(scene, hinge)
        turn = a[:3, :3].T @ b[:3, :3]
        return np.arctan2(turn[1, 0], turn[0, 0])

    scene.run(0.25)
    assert angle() == pytest.approx(0.75, rel=1e-3)
    scene.run(0.5)
    assert angle() == pytest.approx(1.2, abs=1e-6)
    assert np.abs(scene.spin).max() < 1e-6
    scene.stage.angular_impulse.assign([[0.0, -door.mass.inertia[1, 1] * 20.0, 0.0]])
    scene.run(2.0)
    assert angle() == pytest.approx(-0.3, abs=1e-6)


def test_a_slide_is_free_along_its_axis_up_to_its_limits():
    """It falls by g t (t + h) / 2 down to its limit, and no further."""
    up = rotation_about(np.array([1.0, 0.0, 0.0]), -0.5 * np.pi)
    slide = Joint("slide", "prismatic", (None, 0), (frame(rotation=up), frame(rotation=up)), limits=(-1.0, 0.1))
    scene = Rigid([box(angular_velocity=[0.0, 0.0, 0.0])], joints=(slide,))
    scene.run(0.25)
    assert scene.position[0, 1] == pytest.approx(-0.5 * GRAVITY * 0.25 * (0.25 + FRAME / 8), rel=1e-6)
    scene.run(1.0)
    assert scene.position[0] == pytest.approx([0.0, -1.0, 0.0], abs=1e-6)


def test_a_cone_bounds_how_far_a_ball_joint_leans():
    down = rotation_about(np.array([1.0, 0.0, 0.0]), 0.5 * np.pi)  # z to -y
    ball = Joint("ball", "spherical", (None, 0), (frame(rotation=down), frame((0.0, 0.3, 0.0), down)), cone=0.4)
    bar = box((0.05, 0.6, 0.05), (0.0, -0.3, 0.0), angular_velocity=[0.0, 0.0, 8.0], velocity=[2.4, 0.0, 0.0])
    scene = Rigid([bar], joints=(ball,))
    most = 0.0
    for _ in range(96):
        scene.substep()
        a, b = joint_poses(scene, ball)
        most = max(most, np.arccos(np.clip(a[:3, 2] @ b[:3, 2], -1.0, 1.0)))
    assert most == pytest.approx(0.4, abs=1e-4)


def test_a_joint_follows_the_motion_of_its_world_side():
    motion = FormulaMotion(lambda time: placed((np.sin(3.0 * time), 0.0, 0.0)))
    held = Joint("held", "fixed", (None, 0), (np.eye(4), np.eye(4)), motion=motion)
    scene = Rigid([box()], joints=(held,))
    scene.run(1.0)
    assert scene.position[0] == pytest.approx([np.sin(3.0), 0.0, 0.0], abs=1e-6)


def test_momenta_of_joined_bodies_hold():
    """1e-12 a second, of what they are without signs."""
    bars = [box((0.3, 0.05, 0.05), (0.3 * k, 0.0, 0.0), angular_velocity=[0.0, 2.0 * k, 5.0]) for k in range(4)]
    joints = tuple(
        Joint("next", "revolute", (k, k + 1), (frame((0.15, 0, 0)), frame((-0.15, 0, 0)))) for k in range(3)
    )
    scene = Rigid(bars, joints=joints, gravity=(0.0, 0.0, 0.0))
    linear, angular = scene.momenta()
    scene.run(1.0)
    size = (scene.mass * np.linalg.norm(scene.velocity, axis=1)).sum()
    after = scene.momenta()
    assert np.abs(after[0] - linear).max() < 1e-12 * size
    assert np.abs(after[1] - angular).max() < 1e-12 * size


def test_joined_bodies_do_not_touch_unless_told():
    """Two overlapping boxes on one hinge turn through each other; with `collide` they stay apart."""
    props = [box(centre=(0.0, 0.0, 0.0)), box(centre=(0.21, 0.0, 0.0), angular_velocity=[0.0, 0.0, 2.0])]
    ends = (frame((0.105, 0.0, 0.0)), frame((-0.105, 0.0, 0.0)))
    turns = []
    for collide in (False, True):
        joint = Joint("hinge", "revolute", (0, 1), ends, collide=collide)
        scene = Rigid(props, joints=(joint,), gravity=(0.0, 0.0, 0.0))
        turned = 0.0
        for _ in range(12):
            scene.run(FRAME)
            a, b = joint_poses(scene, joint)
            turn = a[:3, :3].T @ b[:3, :3]
            turned = max(turned, abs(np.arctan2(turn[1, 0], turn[0, 0])))
        turns.append(turned)
    assert turns[0] > 0.5 and turns[1] < 0.2


def test_filtered_surfaces_do_not_touch():
    props = [box(velocity=[1.0, 0.0, 0.0]), box(centre=(0.5, 0.0, 0.0))]
    scene = Rigid(props, gravity=(0.0, 0.0, 0.0), filtered=((0, 1),))
    scene.run(1.0)
    assert np.array_equal(scene.velocity, [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


def test_a_joint_between_nothing_is_refused():
    with pytest.raises(Refused, match="stray"):
        Rigid([box()], joints=(Joint("stray", "fixed", (None, None), (np.eye(4), np.eye(4))),))


def hinged(drive: Drive | None, size=(0.3, 0.2, 0.1), gravity=(0.0, 0.0, 0.0)) -> Rigid:
    """A box that turns about z through its own middle."""
    hinge = Joint("hinge", "revolute", (None, 0), (np.eye(4), np.eye(4)), drive=drive)
    return Rigid([box(size)], joints=(hinge,), gravity=gravity)


def turned(scene: Rigid) -> float:
    """[rad] about z."""
    rotation = scene.rotation[0]
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def test_a_driven_slide_is_a_damped_spring_in_backward_euler():
    """m (v1 - v0) / h = -k (x0 + h v1 - x*) - c (v1 - v*), step by step, to what the solve is asked for."""
    drive = Drive(stiffness=300.0, damping=8.0, target=0.1, target_velocity=0.2)
    ends = (frame(rotation=ALONG_X), frame(rotation=ALONG_X))
    slide = Joint("slide", "prismatic", (None, 0), ends, drive=drive)
    scene = Rigid([box()], joints=(slide,), gravity=(0.0, 0.0, 0.0), tolerance=1e-12)
    mass, h = scene.mass[0], FRAME / 8
    x, v = 0.0, 0.0
    for _ in range(100):
        scene.substep(h)
        push = h * (drive.stiffness * (drive.target - x) + drive.damping * drive.target_velocity)
        v = (mass * v + push) / (mass + h * drive.damping + h * h * drive.stiffness)
        x += h * v
        assert scene.position[0] == pytest.approx([x, 0.0, 0.0], abs=1e-9)


def test_a_drive_turns_at_its_speed_and_no_stronger_than_allowed():
    """A stiff one at the target within the solve's tolerance; a weak one at most t / I."""
    scene = hinged(Drive(damping=1e6, target_velocity=2.0))
    scene.run(1.0)
    assert scene.spin[0] == pytest.approx([0.0, 0.0, 2.0], abs=1e-5)
    assert turned(scene) == pytest.approx(2.0, abs=1e-5)
    scene = hinged(Drive(damping=1e6, target_velocity=-50.0, most=0.01))
    scene.run(1.0)
    inertia = scene.scene.rigid_bodies[0].inertia[2, 2]
    assert scene.spin[0] == pytest.approx([0.0, 0.0, -0.01 / inertia], rel=1e-9)


def test_a_drive_per_inertia_moves_all_alike():
    drive = Drive(stiffness=40.0, damping=3.0, target=1.0, per_inertia=True)
    scenes = [hinged(drive, size) for size in ((0.3, 0.2, 0.1), (0.9, 0.2, 0.4))]
    for _ in range(4):
        for scene in scenes:
            scene.run(0.25)
        assert turned(scenes[0]) == pytest.approx(turned(scenes[1]), rel=1e-4)
    assert turned(scenes[0]) > 0.5, "it has not moved"


def test_a_spring_takes_the_shorter_way_round():
    scene = hinged(Drive(stiffness=1.0, damping=1.0, target=np.radians(-170.0), per_inertia=True))
    held = scene.simulation.state.to_numpy()
    half = np.radians(170.0) / 2
    held["rigid/orientation"][0] = [0.0, 0.0, np.sin(half), np.cos(half)]
    scene.simulation.state.restore(held)
    scene.run(FRAME)
    assert scene.spin[0][2] > 0.0


def test_a_spring_goes_the_longer_way_where_limits_bar_the_shorter():
    """From 140 degrees to -140, within -150 to 150: over 0, not over 180."""
    limits = (-np.radians(150.0), np.radians(150.0))
    drive = Drive(stiffness=1.0, damping=1.0, target=np.radians(-140.0), per_inertia=True)
    hinge = Joint("hinge", "revolute", (None, 0), (np.eye(4), np.eye(4)), limits, drive=drive)
    scene = Rigid([box()], joints=(hinge,), gravity=(0.0, 0.0, 0.0))
    held = scene.simulation.state.to_numpy()
    half = np.radians(140.0) / 2
    held["rigid/orientation"][0] = [0.0, 0.0, np.sin(half), np.cos(half)]
    scene.simulation.state.restore(held)
    scene.run(FRAME)
    assert scene.spin[0][2] < 0.0


def test_a_distance_is_kept_within_its_limits():
    """A ball on a string of 0.4 m falls freely until it is taut, at .2 m; from then on it hangs."""
    ball = box((0.1, 0.1, 0.1), (0.0, -0.2, 0.0))
    string = Joint("string", "distance", (None, 0), (np.eye(4), np.eye(4)), limits=(0.1, 0.4))
    scene = Rigid([ball], joints=(string,))
    free = np.sqrt(2.0 * 0.2 / GRAVITY)
    while scene.time + FRAME < free:
        scene.run(FRAME)
        fallen = 0.5 * GRAVITY * scene.time * (scene.time + FRAME / 8)
        assert scene.position[0] == pytest.approx([0.0, -0.2 - fallen, 0.0], abs=1e-9)
    for _ in range(12):
        scene.run(2 * FRAME)
        assert np.linalg.norm(scene.position[0]) <= 0.4 + 1e-6
    assert scene.position[0] == pytest.approx([0.0, -0.4, 0.0], abs=1e-6)
    rod = Joint("rod", "distance", (None, 0), (np.eye(4), np.eye(4)), limits=(0.2, 0.2))
    scene = Rigid([box((0.1, 0.1, 0.1), (0.2, 0.0, 0.0))], joints=(rod,))
    for _ in range(12):
        scene.run(2 * FRAME)
        assert np.linalg.norm(scene.position[0]) == pytest.approx(0.2, abs=1e-6)
