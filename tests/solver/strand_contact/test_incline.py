"""Stick and slip of a free strand on inclined strands."""

from __future__ import annotations

import numpy as np
import pytest

from . import scenes

GRAVITY = 9.81


def slide(friction: float, degrees: float) -> np.ndarray:
    """(13,) [m] the way down the rails at frames of 1/24 s, rails inclined by so much more than atan(friction)."""
    angle = np.arctan(friction) + np.radians(degrees)
    case = scenes.incline(angle, friction)
    simulation = case.start()
    down = np.array([np.cos(angle), -np.sin(angle), 0.0])
    stage = simulation.model.parts["strands"]
    ways = [float((stage.points(1) @ down).mean())]
    for frame in range(case.frames):
        simulation.advance_frame((frame + 1) / scenes.FRAMES_PER_SECOND)
        ways.append(float((stage.points(1) @ down).mean()))
    return np.array(ways) - ways[0]


@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_a_strand_sticks_half_a_degree_below_the_threshold(friction):
    """tan(angle) < friction: it has come to rest by frame 6; a millimetre is left for the meeting itself."""
    ways = slide(friction, -0.5)
    assert abs(ways[-1] - ways[6]) < 1e-3


@pytest.mark.parametrize("friction", [0.3, 0.6])
@pytest.mark.parametrize("degrees", [0.5, 10.0])
def test_a_strand_slides_above_it(friction, degrees):
    """With g (sin - friction cos), within 1 % of g."""
    ways, angle = slide(friction, degrees), np.arctan(friction) + np.radians(degrees)
    times = np.arange(3, 13) / scenes.FRAMES_PER_SECOND
    acceleration = 2.0 * np.polyfit(times, ways[3:], 2)[0]
    expected = GRAVITY * (np.sin(angle) - friction * np.cos(angle))
    assert acceleration == pytest.approx(expected, abs=0.01 * GRAVITY)
