"""Curves that follow guides: at rest, in rigid motion, beside guides that bend, twist and part.

The guides' stage is stood in for by arrays, so that guides take any shape; roots are placed by the solver's own.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from plait.pipeline import following_kernels
from plait.pipeline.following import DIFFERENCE, Following
from plait.pipeline.read.guides import NEAREST, bind
from plait.pipeline.shot import CurvesNow, Followers
from plait.solver.kinematics import stage as kinematics
from plait.solver.launch import Launcher
from plait.solver.model import Model
from plait.solver.scene import Pose, RootBinding, Scene, Strands, Surface
from plait.solver.settings import Settings
from plait.solver.state import State

# Rounding of positions of about one metre through some tens of operations.
DOUBLE = 1e-13
SPIN, SPEED = np.array([0.7, -1.1, 0.4]), np.array([0.3, 2.0, -1.0])
TRIANGLE = np.array([[0.2, 0, 0.1], [1.0, 0.1, 0.0], [0.1, 0.0, 0.9]])


class Ride:
    """A rigid motion at constant spin and speed."""

    animated = True

    def matrix(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        return Rotation.from_rotvec(SPIN * time).as_matrix(), SPEED * time

    def pose(self, time: float) -> Pose:
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = self.matrix(time)
        return Pose(result[None])


class Stage:
    """What `StrandsStage` tells of one prim's strands, set by hand."""

    def __init__(self, points: np.ndarray, directors: np.ndarray) -> None:
        self.now, self.speed, self.across = points, np.zeros_like(points), directors

    def points(self, prim: int) -> np.ndarray:
        return self.now

    def velocities(self, prim: int) -> np.ndarray:
        return self.speed

    def directors(self, prim: int) -> np.ndarray:
        return self.across


def strands(lines: list[np.ndarray]) -> Strands:
    count = len(lines)
    offsets = np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int32)
    roots = RootBinding(0, np.zeros(count, np.int32), np.tile([1.0, 0.0, 0.0], (count, 1)))
    points = np.concatenate(lines)
    return Strands("hair", points, offsets, roots, np.full(len(points), 1e-4), *([np.ones(count)] * 6))


def curls(count: int, points: int = 8, seed: int = 3) -> list[np.ndarray]:
    """Irregular lines that rise from the plane y = 0."""
    random = np.random.default_rng(seed)
    steps = random.normal([0.0, 0.03, 0.0], 0.01, size=(count, points, 3))
    steps[:, 0] = random.uniform(-0.1, 0.1, size=(count, 3)) * [1, 0, 1]
    return list(np.cumsum(steps, axis=1))


def across(points: np.ndarray, offsets: np.ndarray, seed: int = 5) -> np.ndarray:
    """(n, 3) unit, across each segment; anything at tips."""
    along = np.diff(points, axis=0, append=points[-1:] + 1.0)
    along[offsets[1:] - 1] = 1.0
    director = np.cross(along, np.random.default_rng(seed).normal(size=points.shape))
    return director / np.linalg.norm(director, axis=1, keepdims=True)


class Case:
    """Guides and their followers, at rest at time zero."""

    def __init__(self, guides: list[np.ndarray], curves: list[np.ndarray], motion: object | None = None) -> None:
        self.guides, self.curves = strands(guides), strands(curves)
        more = {"motion": motion} if motion else {}
        scalp = Surface("scalp", TRIANGLE, np.array([[0, 1, 2]], np.int32), collides=False, **more)
        model = Model(Scene((scalp,), (self.guides,)), Settings(threads=1), Launcher("cpu", 1), 0.0)
        self.kinematics = kinematics.build(model, State())
        self.stage = Stage(self.guides.points, across(self.guides.points, self.guides.offsets))
        roots = [held.points[held.offsets[:-1]] for held in (self.curves, self.guides)]
        self.nearest, self.weights = bind(*roots)
        count = len(curves)
        followers = Followers(
            self.curves,
            np.arange(len(self.curves.points)),
            np.arange(count),
            self.curves.offsets,
            self.nearest,
            self.weights,
        )
        self.following = Following([followers], {"kinematics": self.kinematics, "strands": self.stage}, True)

    def now(self, time: float = 0.0) -> CurvesNow:
        self.kinematics.place_roots(time)
        (result,) = self.following.now(time)
        return result


def lengths(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    return np.delete(np.linalg.norm(np.diff(points, axis=0), axis=1), offsets[1:-1] - 1)


def test_at_rest_they_lie_as_drawn() -> None:
    case = Case(curls(9), curls(20, 11, seed=4))
    now = case.now()
    np.testing.assert_allclose(now.points, case.curves.points, atol=DOUBLE)
    np.testing.assert_allclose(now.velocities, 0.0, atol=DOUBLE / DIFFERENCE)


def test_a_rigid_motion_takes_them_along() -> None:
    """Points, directors and root rotations by R and x; velocities v + w x r, to the difference's first order."""
    motion = Ride()
    case = Case(curls(9), curls(20, 11, seed=4), motion)
    drawn = case.now().directors
    time = 0.6
    turn, shift = motion.matrix(time)
    case.stage.now = case.guides.points @ turn.T + shift
    case.stage.speed = np.cross(SPIN, case.guides.points @ turn.T) + SPEED
    case.stage.across = case.stage.across @ turn.T
    now = case.now(time)
    turned = case.curves.points @ turn.T
    np.testing.assert_allclose(now.points, turned + shift, atol=DOUBLE)
    np.testing.assert_allclose(now.directors, drawn @ turn.T, atol=1e3 * DOUBLE)
    np.testing.assert_allclose(now.rotations, np.broadcast_to(turn, (20, 3, 3)), atol=DOUBLE)
    # A second derivative is at most |w|^2 |r|; guides go on in straight lines, which may double it.
    bound = DIFFERENCE * np.linalg.norm(SPIN) ** 2 * np.linalg.norm(turned, axis=1).max()
    np.testing.assert_allclose(now.velocities, np.cross(SPIN, turned) + SPEED, atol=bound)


def bent(case: Case, seed: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """The guides bent, stretched and twisted, roots held; and in motion."""
    random = np.random.default_rng(seed)
    points, offsets = case.guides.points.copy(), case.guides.offsets
    for begin, end in itertools.pairwise(offsets):
        turns = Rotation.from_rotvec(np.cumsum(random.normal(scale=0.2, size=(end - begin - 1, 3)), axis=0))
        steps = turns.apply(np.diff(points[begin:end], axis=0)) * random.uniform(0.98, 1.02, (end - begin - 1, 1))
        points[begin + 1 : end] = points[begin] + np.cumsum(steps, axis=0)
    velocity = random.normal(size=points.shape)
    velocity[offsets[:-1]] = 0.0
    case.stage.now, case.stage.speed = points, velocity
    case.stage.across = across(points, offsets, seed + 1)
    return points, velocity


def test_a_curve_drawn_like_a_guide_moves_like_it() -> None:
    guides = curls(9)
    case = Case(guides, guides[::-1])
    points, velocity = bent(case)
    now = case.now()
    order = np.arange(72).reshape(9, 8)[::-1].ravel()
    np.testing.assert_allclose(now.points, points[order], atol=DOUBLE)
    np.testing.assert_allclose(now.velocities, velocity[order], atol=DOUBLE / DIFFERENCE)


def test_roots_stay_on_the_skin_and_lengths_as_drawn() -> None:
    """However guides bend and twist, by the weighed mean of their stretch, here within 2 %."""
    case = Case(curls(9), curls(20, 11, seed=4))
    bent(case)
    now = case.now()
    roots = case.curves.offsets[:-1]
    np.testing.assert_allclose(now.points[roots], case.curves.points[roots], atol=DOUBLE)
    ratio = lengths(now.points, case.curves.offsets) / lengths(case.curves.points, case.curves.offsets)
    assert np.all(ratio > 0.98 - DOUBLE) and np.all(ratio < 1.02 + DOUBLE)


def test_what_is_between_guides_that_part_does_not_shrink() -> None:
    """Two guides lean apart by 75° each; the mean of their displacements is a quarter of the length."""
    upright = np.linspace([0, 0, 0], [0, 0.2, 0], 9)
    left, right, middle = (upright + np.array([x, 0, 0]) for x in (-0.01, 0.01, 0.0))
    case = Case([left, right], [middle])
    turns = [Rotation.from_euler("z", angle, degrees=True) for angle in (75, -75)]
    leaned = [line[0] + turn.apply(line - line[0]) for line, turn in zip((left, right), turns, strict=True)]
    case.stage.now = np.concatenate(leaned)
    directors = np.split(case.stage.across, 2)
    case.stage.across = np.concatenate([turn.apply(own) for own, turn in zip(directors, turns, strict=True)])
    now = case.now()
    np.testing.assert_allclose(lengths(now.points, case.curves.offsets), 0.025, atol=DOUBLE)
    np.testing.assert_allclose(now.points, middle, atol=1e-3 * 0.2)


def test_what_is_around_a_guide_turns_with_it() -> None:
    """A straight guide twists, by 90° at its last segment: what lay along x of its tip then lies across.

    A segment that goes aside by .01 pi/2 / 20 keeps its length of .01, and so gets .3 % less far aside.
    """
    line = np.linspace([0, 0, 0], [0, 0.2, 0], 21)
    case = Case([line], [line + np.array([0.01, 0, 0])])
    angles = 90.0 * np.minimum(np.arange(21) + 0.5, 19.5) / 19.5
    case.stage.across = Rotation.from_euler("y", angles[:, None], degrees=True).apply(case.stage.across)
    now = case.now()
    offset = (now.points[-1] - line[-1]) * [1, 0, 1]
    np.testing.assert_allclose(offset, [0.0, 0.0, -0.01], atol=0.004 * np.hypot(0.01, 0.01))
    np.testing.assert_allclose(lengths(now.points, case.curves.offsets), 0.01, atol=DOUBLE)


def test_beyond_a_guides_tip_its_last_segment_carries() -> None:
    """A guide of half the length swings as a whole: what follows stays straight beyond its tip."""
    long, short = np.linspace([0, 0, 0], [0, 0.4, 0], 17), np.linspace([0, 0, 0], [0, 0.2, 0], 9)
    case = Case([short], [long])
    turn = Rotation.from_euler("z", 50.0, degrees=True)
    case.stage.now, case.stage.across = turn.apply(short), turn.apply(case.stage.across)
    np.testing.assert_allclose(case.now().points, turn.apply(long), atol=DOUBLE)


def test_weights_are_continuous_and_all_on_a_guide_that_is_met() -> None:
    random = np.random.default_rng(7)
    guides = random.uniform(-1, 1, size=(12, 3)) * [1, 0, 1]

    def largest_change(steps: int) -> float:
        """Of any weight in a step, along a way on which guides take each other's place."""
        way = np.linspace([-0.9, 0, -0.8], [0.8, 0, 0.9], steps + 1)
        nearest, weights = bind(way, guides)
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-14)
        assert weights.min() >= 0.0 and np.all(np.diff(weights, axis=1) <= 0.0)
        assert len(np.unique(nearest)) > NEAREST + 2
        every = np.zeros((len(way), len(guides)))
        np.put_along_axis(every, nearest, weights, axis=1)
        return float(np.abs(np.diff(every, axis=0)).max())

    # In proportion to the step; a jump would stay as it is.
    assert largest_change(8000) < 0.6 * largest_change(4000)
    nearest, weights = bind(guides, guides)
    np.testing.assert_array_equal(nearest[:, 0], np.arange(12))
    np.testing.assert_array_equal(weights[:, 0], 1.0)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_guides(count: int) -> None:
    """Weights as 1/d²; unused places have none."""
    guides = np.array([[1.0, 0, 0], [2.0, 0, 0], [-3.0, 0, 0]])[:count]
    _, weights = bind(np.zeros((1, 3)), guides)
    raw = np.zeros(3)
    raw[:count] = [1.0, 1 / 4, 1 / 9][:count]
    np.testing.assert_allclose(weights[0], raw / raw.sum(), atol=1e-15)


def test_guides_all_as_near_weigh_the_same() -> None:
    guides = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(bind(np.zeros((1, 3)), guides)[1], 1 / 3)


def test_compiles_for_sm_90(tmp_path) -> None:
    module = following_kernels.follow_guides.module
    assert following_kernels.NEAREST == NEAREST
    (binary,) = wp.compile_aot_module(module, arch=90, module_dir=tmp_path)
    assert binary.stat().st_size > 0
