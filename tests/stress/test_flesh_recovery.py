"""Flesh brought into states that no shot should hold, and out of them: everything lies as before."""

from __future__ import annotations

import pytest

from ..solver.tets.lattices import box_lattice
from ..solver.tets.recoveries import (
    COARSE_ELBOW,
    ELBOW,
    KINDS,
    KNEE,
    POP_SPEED,
    PROMISE,
    bunny,
    crush,
    jump,
    recover,
    unbend,
)

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", KINDS)
def test_a_bar_returns(kind, seed):
    assert recover(*box_lattice((1.0, 0.25, 0.25), (12, 3, 3)), kind, seed, touching=False)[0] < PROMISE


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", KINDS)
def test_a_bunny_returns(kind, seed):
    assert recover(*bunny(1500), kind, seed, touching=False)[0] < PROMISE


@pytest.mark.parametrize("shape", [ELBOW, KNEE], ids=["elbow", "knee"])
def test_a_joint_unbends(shape):
    furthest, left = unbend(shape)
    assert furthest > 0.5
    assert left < PROMISE


def test_a_joint_jumps_to_120_degrees():
    pops, speed = jump(COARSE_ELBOW, 120.0, 1.0, 0.0)
    assert pops > 0
    assert speed < POP_SPEED


def test_a_crushed_box_returns():
    height, left = crush(5)
    assert height < 0.25
    assert left < PROMISE
