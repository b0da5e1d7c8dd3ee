"""Strands under motion no animator means: each scene ten times, each with what must hold said in words."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from plait.pipeline.benchmarks.scenes import Fibre, FormulaMotion, shaking, translation
from plait.solver.scene import RestShape

from ..solver.tets.lattices import turn
from .harness import (
    DAMPED_HAIR,
    FRAME,
    GRAVITY,
    LIMP_HAIR,
    Play,
    curls,
    jumps,
    placed,
    random_unit,
    scene_of,
    seeds,
)

STRANDS = 20


class Hair(NamedTuple):
    fibre: Fibre
    rest_shape: RestShape


HAIRS = pytest.mark.parametrize(
    "hair", [Hair(DAMPED_HAIR, "sagfree"), Hair(LIMP_HAIR, "authored")], ids=["coarse", "limp"]
)


@HAIRS
@seeds(quick=True)
def test_roots_that_teleport(seed, hair):
    """Roots jump 1 m in one substep, three times, and turn by up to half a turn: nothing breaks or tears (1 % of
    the length), and two seconds after the last jump all is at rest.
    """
    random = np.random.default_rng(seed)
    places = [placed(turn(random_unit(random), random.uniform(0.0, np.pi)), random_unit(random)) for _ in range(3)]
    times = np.array([2.5, 5.5, 8.5]) * FRAME
    scene = scene_of(curls(random, STRANDS), hair.fibre, motion=jumps(times, places), rest_shape=hair.rest_shape)
    play = Play(scene, int(random.choice([1, 2, 8])))
    play.run(9 * FRAME)
    play.settle()


@HAIRS
@seeds(quick=True)
def test_hundred_g(seed, hair):
    """Shaken with 100 g at 2 to 20 Hz for half a second along any direction: nothing breaks or tears, and two
    seconds after it stops all is at rest.
    """
    random = np.random.default_rng(seed)
    frequency, direction = random.uniform(2.0, 20.0), random_unit(random)
    free = shaking(100.0 * GRAVITY, frequency).transform
    stop = np.ceil(0.5 * frequency) / frequency  # a whole period, where it has come back to rest
    motion = FormulaMotion(lambda time: translation(free(min(time, stop))[0, 3] * direction))
    scene = scene_of(curls(random, STRANDS), hair.fibre, motion=motion, rest_shape=hair.rest_shape)
    play = Play(scene, int(random.choice([1, 2, 8])))
    play.run(stop)
    play.settle()


@seeds()
def test_one_to_a_thousand_substeps(seed):
    """A quarter of a second shaken with 1 g, in 1, 10, 100 and 1000 substeps a frame: nothing breaks or tears,
    whatever the step, and all is at rest two seconds after it ends.
    """
    random = np.random.default_rng(seed)
    shapes = curls(random, 4, points=12)
    free = shaking(GRAVITY, 4.0, axis=int(random.integers(3))).transform
    motion = FormulaMotion(lambda time: free(min(time, 0.25)))
    for substeps in (1, 10, 100, 1000):
        play = Play(scene_of(shapes, motion=motion), substeps)
        play.run(0.25)
        play.substeps = min(substeps, 8)
        play.settle()


@seeds()
def test_flung_round(seed):
    """Roots spin at 20 turns a second for half a second (400 g at 0.25 m) and stop dead: nothing breaks or tears,
    and two seconds after all is at rest.
    """
    random = np.random.default_rng(seed)
    axis = random_unit(random)
    motion = FormulaMotion(lambda time: placed(turn(axis, 40.0 * np.pi * min(time, 0.5)), np.zeros(3)))
    play = Play(scene_of(curls(random, STRANDS), motion=motion), int(random.choice([8, 16])))
    play.run(0.5)
    play.settle()
