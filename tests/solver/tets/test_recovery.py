"""Bodies find back to their shape: from broken states, after a bend, a jump of the skeleton, from under plates.

Many more of each in `tests/stress/test_flesh_recovery.py`.
"""

from __future__ import annotations

import pytest

from .lattices import box_lattice
from .recoveries import COARSE_ELBOW, FRAME, KINDS, POP_SPEED, PROMISE, crush, jump, recover, unbend


@pytest.mark.parametrize("kind", KINDS)
def test_a_bar_returns(kind):
    left, metrics = recover(*box_lattice((1.0, 0.3, 0.3), (4, 2, 2)), kind, seed=1)
    assert left < PROMISE
    assert metrics["inverted"] == 0


def test_a_joint_unbends():
    furthest, left = unbend(COARSE_ELBOW)
    assert furthest > 0.5
    assert left < PROMISE


@pytest.mark.parametrize("shift, lasts", [(0.0, 0.0), (1.0, FRAME)], ids=["at once", "within a frame"])
def test_a_jump_of_the_skeleton_takes_the_flesh_along(shift, lasts):
    pops, speed = jump(COARSE_ELBOW, 90.0, shift, lasts)
    assert pops > 0
    assert speed < POP_SPEED


def test_a_crushed_box_returns():
    height, left = crush(2)
    assert height < 0.25
    assert left < PROMISE
