"""Rigid bodies thrown together, pressed into each other and spun: nothing gets energy that nothing gave it."""

from __future__ import annotations

from typing import Any

import numpy as np

from plait.solver.scene import Joint
from plait.solver.settings import RigidSettings

from ..solver.contact.soft_scenes import floor
from ..solver.rigid.rigid_scenes import Prop, Rigid, box, rotation_about, shaped
from .harness import GRAVITY, random_unit, seeds

# What a solve leaves of speeds, squared into energies by twice as much.
ROUNDING = 2.0 * RigidSettings().tolerance
EXIT_SPEED = RigidSettings().exit_speed


def random_props(random: np.random.Generator, height: float = 0.0) -> list[Prop]:
    """Two to five, light and heavy, close enough to overlap, up to 20 m/s towards each other and 500 rad/s."""
    props = []
    for _ in range(random.integers(2, 6)):
        way = random_unit(random)
        spin = random.uniform(0.0, 500.0) ** random.uniform(0.3, 1.0)
        told: dict[str, Any] = {
            "velocity": random.normal(size=3) - random.uniform(0.0, 20.0) * way,
            "angular_velocity": spin * random_unit(random),
            "density": 10.0 ** random.uniform(2.0, 4.0),
            "friction": random.uniform(0.0, 1.0),
        }
        place = random.uniform(0.08, 0.3) * way + [0.0, height, 0.0]
        rotation = rotation_about(random_unit(random), random.uniform(0.0, np.pi))
        kind = str(random.choice(["box", "sphere", "capsule", "cylinder"]))
        if kind == "box":
            props.append(box(random.uniform(0.05, 0.3, 3), place, rotation, **told))
        else:
            props.append(shaped(kind, random.uniform(0.04, 0.12, 3), place, rotation, **told))
    return props


def random_joint(random: np.random.Generator, props: list[Prop], first: int) -> Joint:
    """Between one and the next, half way; half of them with limits."""
    kind = str(random.choice(["fixed", "revolute", "spherical", "prismatic"]))
    poses = [props[first + k].motion.transform for k in range(2)]
    frame = np.eye(4)
    frame[:3, 3] = 0.5 * (poses[0] + poses[1])[:3, 3]
    frames = tuple(np.linalg.inv(pose) @ frame for pose in poses)
    told: dict[str, Any] = {"collide": bool(random.random() < 0.3)}
    if kind != "fixed" and random.random() < 0.5:
        told |= {"cone": 0.5} if kind == "spherical" else {"limits": (-0.3, 0.5)}
    return Joint(f"joint {first}", kind, (first, first + 1), frames, **told)


def random_length(random: np.random.Generator) -> float:
    """[s] of a substep, a frame's tenth to a whole one."""
    return float(10.0 ** random.uniform(np.log10(1.0 / 240.0), np.log10(1.0 / 24.0)))


def energy(scene: Rigid) -> float:
    """[J] of motion."""
    spin = np.sum(scene.spin * scene.stage.angular_momentum.numpy())
    return 0.5 * float(scene.mass @ np.square(scene.velocity).sum(axis=1) + spin)


@seeds(quick=True, count=40)
def test_thrown_together(seed: int) -> None:
    """In no substep do they gain energy, and both momenta stay, to 1e-12 of what flies."""
    random = np.random.default_rng(seed)
    scene, length = Rigid(random_props(random), gravity=(0.0, 0.0, 0.0)), random_length(random)
    linear, angular = scene.momenta()
    sizes = [
        np.abs(scene.mass[:, None] * scene.velocity).sum(),
        np.abs(scene.stage.angular_momentum.numpy()).sum(),
    ]
    for _ in range(40):
        before = energy(scene)
        scene.substep(length)
        assert energy(scene) <= (1.0 + ROUNDING) * before
    after = scene.momenta()
    assert np.abs(after[0] - linear).max() < 1e-12 * sizes[0]
    assert np.abs(after[1] - angular).max() < 1e-12 * sum(sizes)


@seeds(quick=True, count=40)
def test_thrown_on_a_floor(seed: int) -> None:
    """They lose energy, but for what lifts them out of each other at `exit_speed`, and none falls through."""
    random = np.random.default_rng(seed)
    ground = floor(half=30.0, friction=random.uniform(0.0, 1.0))
    scene, length = Rigid(random_props(random, height=0.5), [ground]), random_length(random)
    lifted = GRAVITY * EXIT_SPEED * length * scene.mass.sum()
    while scene.time < 1.5:
        before = energy(scene) + GRAVITY * scene.mass @ scene.position[:, 1]
        scene.substep(length)
        after = energy(scene) + GRAVITY * scene.mass @ scene.position[:, 1]
        assert after <= before + ROUNDING * abs(before) + lifted
    assert scene.position[:, 1].min() > 0.0


@seeds(quick=True, count=40)
def test_jointed_and_thrown_together(seed: int) -> None:
    """Joints swing their bodies' energy as they keep their places, but no more is ever there than at first."""
    random = np.random.default_rng(seed)
    props = random_props(random)
    joints = tuple(random_joint(random, props, k) for k in range(len(props) - 1) if random.random() < 0.6)
    scene, length = Rigid(props, gravity=(0.0, 0.0, 0.0), joints=joints), random_length(random)
    most = 1.1 * energy(scene)
    for _ in range(40):
        scene.substep(length)
        assert energy(scene) < most
