"""Normals of ribbons keep their place in the material frames of the hair, through solver and transforms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plait.pipeline.normals import CarriedNormals
from plait.pipeline.outputs import Outputs, prim_frame
from plait.pipeline.shot import CurveOutput, Normals, Shot, StageInfo
from plait.solver.build import build
from plait.solver.scene import KeyedMotion, RootBinding, Scene, Strands, Surface
from plait.solver.settings import Settings

OFFSETS = np.array([0, 4, 7])
DOUBLE = 1e-14


def frames(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points of two strands, and unit directors across their segments."""
    points = rng.normal(size=(7, 3))
    along = np.diff(points, axis=0, append=points[-1:] + 1.0)
    directors = np.cross(along, rng.normal(size=(7, 3)))
    return points, directors / np.linalg.norm(directors, axis=1, keepdims=True)


def normals_of(rng: np.random.Generator) -> Normals:
    values = rng.normal(size=(5, 3))
    return Normals(values / np.linalg.norm(values, axis=1, keepdims=True), np.array([0, 2, 2, 4, 5]))


def test_at_the_start_they_are_as_drawn():
    """What was authored, turned as the root is."""
    rng = np.random.default_rng(1)
    points, directors = frames(rng)
    normals = normals_of(rng)
    roots = Rotation.random(2, rng=rng).as_matrix()
    carried = CarriedNormals(normals, points, directors, roots, OFFSETS).at(points, directors)
    expected = np.einsum("nij,nj->ni", roots[[0, 0, 0, 1, 1]], normals.values)
    np.testing.assert_allclose(carried, expected, atol=DOUBLE)


def test_they_turn_with_the_frame():
    """R x, R m gives R n for any rotation R, about the strand too; lengths of segments play no part."""
    rng = np.random.default_rng(2)
    points, directors = frames(rng)
    normals = normals_of(rng)
    carried = CarriedNormals(normals, points, directors, np.tile(np.eye(3), (2, 1, 1)), OFFSETS)
    turn = Rotation.random(rng=rng).as_matrix()
    found = carried.at(3.0 * points @ turn.T, directors @ turn.T)
    np.testing.assert_allclose(found, normals.values @ turn.T, atol=DOUBLE)


def test_they_stay_across_the_hair_in_sheared_space():
    """A prim under uneven scale: the local normal is across the local tangent, and unit."""
    rng = np.random.default_rng(3)
    transform = np.eye(4)
    transform[:3, :3] = rng.normal(size=(3, 3)) + 3 * np.eye(3)
    tangent = np.array([0.0, 0.6, 0.8])
    normal = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
    output = CurveOutput("/hair", lambda _: transform, 0, np.zeros(2), point_map=np.arange(2))
    local = prim_frame(output, np.array([np.zeros(3), tangent]), np.zeros((2, 3)), 0.0, normals=normal)
    along = local.points[1] - local.points[0]
    np.testing.assert_allclose(
        local.normals @ along, 0.0, atol=8 * np.finfo(np.float32).eps * np.linalg.norm(along)
    )
    np.testing.assert_allclose(np.linalg.norm(local.normals, axis=1), 1.0, atol=4 * np.finfo(np.float32).eps)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turned_root_turns_the_normals_of_hair_at_rest(axis):
    """A straight strand without weight, its root turned by a quarter, along itself (axis 1) too.

    At rest again it is the drawn one turned as a whole, so all normals are. One hundredth, as the strand's damping
    of 20/s leaves e^-20 of any swing after the second that follows the turn.
    """
    codes = np.linspace(0.0, 0.5, 13)
    turns = np.tile(np.eye(4), (13, 1, 1, 1))
    quarter = np.eye(3)[axis] * np.pi / 2
    turns[:, 0, :3, :3] = [Rotation.from_rotvec(quarter * part).as_matrix() for part in codes / 0.5]
    scalp = Surface(
        "scalp",
        np.array([[1.0, 0, 0], [-1, 0, -1], [-1, 0, 1]]),
        np.array([[0, 1, 2]], np.int32),
        KeyedMotion(codes, turns),
        collides=False,
    )
    hair = Strands(
        "hair",
        np.array([[0.0, 0.02 * i, 0.0] for i in range(6)]),
        np.array([0, 6], np.int32),
        RootBinding(0, np.zeros(1, np.int32), np.array([[1 / 3, 1 / 3, 1 / 3]])),
        np.full(6, 40e-6),
        *(np.array([value]) for value in (1300.0, 20.0, 8e-9, 6e-9, 20.0, 0.3)),
    )
    values = np.array([[0.0, 0.6, 0.8], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    output = CurveOutput(
        "/hair",
        lambda _: np.eye(4),
        0,
        np.zeros(6),
        point_map=np.arange(6),
        normals=Normals(values, np.array([0, 2, 4])),
    )
    info = StageInfo("made.usda", 1.0, "Y", 24.0, 24.0, 0.0, 36.0)
    scene = Scene((scalp,), (hair,), gravity=np.zeros(3))
    simulation = build(scene, Settings(threads=1), 0.0)
    try:
        outputs = Outputs(Shot(info, scene, (output,), ()), simulation.model.parts)
        for frame in range(1, 37):
            simulation.advance_frame(frame / 24.0, 4)
        (result,) = outputs.frames(1.5)
    finally:
        simulation.close()
    np.testing.assert_allclose(result.normals, values @ turns[-1, 0, :3, :3].T, atol=1e-2)
