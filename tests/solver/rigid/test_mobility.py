"""How rigid bodies give way to impulses, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.rigid.mobility import mobility
from plait.solver.scene import Joint

from ..contact.soft_scenes import floor
from .rigid_scenes import Rigid, box, pose, rotation_about


def of(scene: Rigid, body: int = 0, **options: bool) -> np.ndarray:
    return mobility(scene.stage, np.array([body]), **options)[0]


def test_a_free_body_has_its_inverse_mass():
    """1/m for a velocity, R I^-1 R^T for a spin."""
    turned = rotation_about([1.0, 2.0, 3.0], 0.7)
    scene = Rigid([box((0.2, 0.3, 0.5), rotation=turned)])
    matrix = of(scene)
    inertia = turned @ scene.scene.rigid_bodies[0].inertia @ turned.T
    np.testing.assert_allclose(matrix[:3, :3], np.eye(3) / scene.mass[0], rtol=1e-12)
    np.testing.assert_allclose(matrix[3:, 3:], np.linalg.inv(inertia), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(matrix[:3, 3:], 0.0, atol=1e-12)


@pytest.mark.parametrize("kind", ["fixed", "revolute", "spherical", "prismatic"])
def test_a_joint_leaves_what_it_leaves(kind):
    """A body held to a place 0.3 m from its centre: M^-1 on the motions that the joint allows, and no others.

    Those are spanned by S (6, n), all motions about or along the joint: the mobility is S (S^T M S)^-1 S^T.
    """
    axes, arm = rotation_about([1.0, 1.0, 0.0], 0.9), np.array([0.3, 0.1, -0.2])
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = axes, arm
    scene = Rigid([box((0.2, 0.3, 0.5))], joints=(Joint("j", kind, (0, None), (frame, frame)),))
    turns = {"fixed": [], "revolute": [axes[:, 2]], "spherical": list(np.eye(3)), "prismatic": []}[kind]
    allowed = [np.concatenate([np.cross(turn, -arm), turn]) for turn in turns]
    allowed += [np.append(axes[:, 2], np.zeros(3))] if kind == "prismatic" else []
    body = scene.scene.rigid_bodies[0]
    mass = np.block([[body.mass * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), body.inertia]])
    expected = np.zeros((6, 6))
    if allowed:
        S = np.array(allowed).T
        expected = S @ np.linalg.inv(S.T @ mass @ S) @ S.T
    matrix = of(scene)
    np.testing.assert_allclose(matrix, expected, atol=1e-10)


def test_what_lies_on_a_floor_gives_way_along_it_alone():
    """No impulse lifts or presses it, none tilts it; along the floor it is free, and about the vertical.

    Without its supports it gives way as if they were not there.
    """
    scene = Rigid([box((0.2, 0.2, 0.2), centre=(0.0, 0.1, 0.0))], [floor()])
    scene.run(0.25)
    matrix = of(scene)
    held, free = [1, 3, 5], [0, 2, 4]
    inverse = 1.0 / np.array([scene.mass[0], scene.mass[0], scene.scene.rigid_bodies[0].inertia[1, 1]])
    # It may stand as far from upright as the solve's tolerance lets it.
    np.testing.assert_allclose(matrix[held], 0.0, atol=1e-6 * inverse.max())
    np.testing.assert_allclose(matrix[np.ix_(free, free)], np.diag(inverse), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(of(scene, supports=False)[:3, :3], np.eye(3) / scene.mass[0], rtol=1e-12)


def test_two_that_are_joined_move_as_one():
    """A pair fixed to each other, pushed through their common centre: 1 / (m1 + m2)."""
    here, there = pose((0.5, 0.0, 0.0)).transform, pose((-0.5, 0.0, 0.0)).transform
    props = [box(), box(centre=(1.0, 0.0, 0.0), density=3000.0)]
    scene = Rigid(props, joints=(Joint("j", "fixed", (0, 1), (here, there)),))
    matrix = of(scene)
    centre = np.array([scene.mass[1] / scene.mass.sum(), 0.0, 0.0])
    push = np.concatenate([[0.0, 1.0, 0.0], np.cross(centre, [0.0, 1.0, 0.0])])
    np.testing.assert_allclose(matrix[:3] @ push, [0.0, 1.0 / scene.mass.sum(), 0.0], atol=1e-12)
    np.testing.assert_allclose(matrix[3:] @ push, 0.0, atol=1e-10)
