"""Strands no groomer means: each scene ten times, each with what must hold said in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.pipeline.benchmarks.scenes import FormulaMotion, shaking, straight
from plait.solver.build import build
from plait.solver.diagnostics import Diverged, Refused
from plait.solver.scene import Scene

from .harness import DAMPED_HAIR, FRAME, GRAVITY, Play, curls, random_unit, scene_of, seeds

STRANDS = 20


def shaken_then_still(seed: int) -> FormulaMotion:
    """1 g along an axis for half a second, 2 Hz, then at rest."""
    free = shaking(GRAVITY, 2.0, axis=seed % 3).transform
    return FormulaMotion(lambda time: free(min(time, 0.5)))


def shake_and_settle(play: Play) -> None:
    play.run(0.5)
    play.settle()


@seeds()
def test_stiffness_a_million_apart(seed):
    """E from 4e5 to 4e11 Pa side by side, shaken with 1 g: none breaks; none stretches by more than its weight,
    eight times over, would stretch the softest; the stiffest bends by no more than twice what 1 g across it would
    bend it, q L^4 / 8 EI; two seconds later all are at rest.
    """
    random = np.random.default_rng(seed)
    shapes = curls(random, STRANDS)
    fibres = [replace(DAMPED_HAIR, youngs_modulus=4e5 * 10.0 ** random.uniform(0.0, 6.0)) for _ in shapes]
    fibres[0], fibres[1] = soft, stiff = tuple(replace(DAMPED_HAIR, youngs_modulus=E) for E in (4e5, 4e11))
    strain = soft.density * GRAVITY * 0.3 / soft.youngs_modulus
    # A limp strand would leave its drawn equilibrium by itself: none is held up.
    scene = scene_of(shapes, fibres, motion=shaken_then_still(seed), rest_shape="authored")
    play = Play(scene, reach=1.0 + 8.0 * strain)
    drawn, length = shapes[1] - shapes[1][0], play.lengths[1]
    bent = stiff.density * stiff.area * GRAVITY * length**4 / (8.0 * stiff.bend_stiffness)

    def keeps_shape(time: float) -> None:
        points = play.points[play.offsets[1] : play.offsets[2]]
        assert np.linalg.norm(points - points[0] - drawn, axis=1).max() < 2.0 * np.sqrt(2.0) * bent

    play.run(0.5, keeps_shape)
    play.settle()


@seeds(quick=True)
def test_slivers_and_coinciding_points(seed):
    """Segments 1e4 apart in length, points repeated at root, middle and tip, and points 1e-9 m from their
    neighbour: nothing breaks or tears when shaken, repeated points stay together, and two seconds later all is at
    rest.
    """
    random = np.random.default_rng(seed)
    shapes = [uneven(random, shape) for shape in curls(random, STRANDS, points=201)]
    repeated = []
    for k, shape in enumerate(shapes):
        at = int(random.choice([0, len(shape) // 2, len(shape) - 1]))
        shapes[k] = np.insert(shape, at, shape[at], axis=0)
        nudged = int(random.integers(1, len(shape)))
        shapes[k][nudged] = shapes[k][nudged - 1] + 1e-9 * random_unit(random)
        repeated.append(at)
    play = Play(scene_of(shapes, motion=shaken_then_still(seed)))
    shake_and_settle(play)
    for strand, at in enumerate(repeated):
        if np.array_equal(shapes[strand][at], shapes[strand][at + 1]):
            first = play.offsets[strand] + at
            assert np.array_equal(play.points[first], play.points[first + 1])


def uneven(random: np.random.Generator, shape: np.ndarray) -> np.ndarray:
    """Twenty points of a finely drawn strand whose gaps go from 1e-4 of the longest to the longest."""
    gaps = 10.0 ** random.uniform(-4.0, 0.0, 19)
    gaps[random.integers(19)] = 1.0
    at = np.concatenate([[0.0], np.cumsum(gaps) / gaps.sum()]) * (len(shape) - 1)
    return np.stack([np.interp(at, np.arange(len(shape)), shape[:, axis]) for axis in range(3)], axis=1)


@seeds()
def test_folds(seed):
    """Strands drawn folded back on themselves, by 150 degrees to flat, shaken: nothing breaks or tears, and two
    seconds later all is at rest.
    """
    random = np.random.default_rng(seed)
    shapes = []
    for k in range(STRANDS):
        there = random_unit(random)
        across = np.cross(there, random_unit(random))
        angle = np.pi if k % 2 else np.radians(random.uniform(150.0, 180.0))
        back = np.cos(angle) * there + np.sin(angle) * across / np.linalg.norm(across)
        out = straight(8, 0.1, there)
        shapes.append(np.concatenate([out, straight(5, 0.0625, back, root=out[-1])[1:]]))
    shake_and_settle(Play(scene_of(shapes, motion=shaken_then_still(seed))))


@seeds(quick=True)
def test_two_to_five_hundred_points(seed):
    """Strands of 2 to 500 points in one prim, shaken with 1 g: nothing breaks or tears, and two seconds later all
    is at rest.
    """
    random = np.random.default_rng(seed)
    counts = np.exp(random.uniform(np.log(2.0), np.log(500.0), 12)).astype(int)
    counts[:3] = 2, 3, 500
    shapes = curls(random, len(counts), points=counts)
    play = Play(scene_of(shapes, motion=shaken_then_still(seed)))
    shake_and_settle(play)


def spoil(scene: Scene, strand: int, attribute: str, value: float) -> Scene:
    """`scene` with one number of one strand made wrong."""
    hair = scene.strands[0]
    values = getattr(hair, attribute).copy()
    by_point = attribute in ("points", "radius")
    values[hair.offsets[strand + 1] - 1 if by_point else strand] = value
    return replace(scene, strands=(replace(hair, **{attribute: values}),))


WRONG = [
    ("points", np.nan),
    ("points", np.inf),
    ("radius", 0.0),
    ("radius", -1e-5),
    ("density", 0.0),
    ("density", np.nan),
    ("stretch_stiffness", -1.0),
    ("bend_stiffness", np.inf),
    ("twist_stiffness", 0.0),
    ("damping", -1.0),
    ("friction", np.nan),
]


@pytest.mark.parametrize(("attribute", "value"), WRONG)
def test_a_wrong_number_is_refused_by_name(attribute, value):
    """A number no rod can have is refused, naming prim, strand and quantity; ten random strands each."""
    for seed in range(10):
        random = np.random.default_rng(seed)
        strand = int(random.integers(STRANDS))
        scene = spoil(scene_of(curls(random, STRANDS)), strand, attribute, value)
        with pytest.raises(Refused, match=f"/hair strand {strand}: {attribute} "):
            build(scene)


def test_strands_without_extent_are_refused_by_name():
    """A strand whose points all coincide, and one of a single point, are refused with prim and strand."""
    for seed in range(10):
        random = np.random.default_rng(seed)
        strand = int(random.integers(1, STRANDS))
        shapes = curls(random, STRANDS)
        points = shapes[strand]
        shapes[strand] = np.repeat(points[:1], len(points), axis=0)
        with pytest.raises(Refused, match=f"/hair strand {strand}: all its points coincide"):
            build(scene_of(shapes))
        scene = scene_of(curls(random, STRANDS))
        hair = scene.strands[0]
        offsets = hair.offsets.copy()
        offsets[strand] = offsets[strand + 1] - 1
        with pytest.raises(Refused, match=f"/hair strand {strand}: 1 point"):
            build(replace(scene, strands=(replace(hair, offsets=offsets),)))


@seeds()
def test_animation_that_is_not_finite(seed):
    """From some frame on the character's pose is NaN: the run stops there, naming the prim, and not before."""
    random = np.random.default_rng(seed)
    bad = int(random.integers(2, 10)) * FRAME
    motion = FormulaMotion(lambda time: np.full((4, 4), np.nan) if time > bad + 1e-6 else np.eye(4))
    play = Play(scene_of(curls(random, STRANDS), motion=motion))
    play.run(bad)
    with pytest.raises(Diverged, match="/hair strand"):
        play.run(FRAME)
