"""Strands that are drawn within each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plait.pipeline.benchmarks.scenes import rods, straight
from plait.solver.scene import Scene

from .scenes import FRAMES_PER_SECOND, TUBE, TUBE_THICKNESS, Case


def test_what_touches_as_drawn_moves_as_if_alone():
    """A strand drawn twice, and two from one root that part: none has a side on which it could be kept from the
    other, so each falls as without contact, in the substeps asked for.
    """
    twice = straight(10, 0.1, (1.0, 0.0, 0.0))
    parting = [straight(10, 0.1, (1.0, 0.0, side), (0.0, 0.0, 0.1)) for side in (0.0, 0.5)]
    surface, strands = rods("hair", [twice, twice.copy(), *parting], TUBE, rest_shape="authored")
    case, points = Case(Scene((surface,), (strands,)), frames=3), []
    for method in ("none", "implicit"):
        simulation = case.start(method)
        for frame in range(case.frames):
            found = simulation.advance_frame((frame + 1) / FRAMES_PER_SECOND)
            assert found["substeps"] == 8
        points.append(simulation.model.parts["strands"].points(0))
        fallen = points[0] - strands.points
    # Newton's tolerance, a part of a segment.
    assert np.abs(points[1] - points[0]).max() < 0.03 * 0.01
    assert fallen[:, 1].min() < -0.02


def test_what_is_drawn_too_near_stays_as_drawn():
    """A groom at rest whose strands overlap, .4 mm apart where they are to keep 1 mm: a drawn shape is an
    equilibrium, to 1e-4 of its length, contact or not; in one pass a substep, none halved, nothing missed.
    """
    lock = [
        straight(10, 0.1, (1.0, -0.3, 0.0), (0.0, 4e-4 * row, 4e-4 * column))
        for row in (0, 1)
        for column in (0, 1, 2)
    ]
    surface, strands = rods("hair", lock, TUBE)
    strands = replace(strands, thickness=TUBE_THICKNESS)
    case = Case(Scene((surface,), (strands,)), frames=8)
    simulation = case.start()
    for frame in range(case.frames):
        found = simulation.advance_frame((frame + 1) / FRAMES_PER_SECOND)
        assert found["substeps"] == 8 and found["strands"]["missed"] == 0
        assert found["strands"]["strand_passes"] == 1
    moved = simulation.model.parts["strands"].points(0) - strands.points
    assert np.abs(moved).max() < 1e-4 * 0.1
