"""Scenes made by hand of strands that meet: they are played, and what passes through is counted."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
import warp as wp

from plait.solver.build import build
from plait.solver.scene import Scene
from plait.solver.settings import Settings, StrandContactSettings
from plait.solver.strand_contact.missed import MissedCollisions

FRAMES_PER_SECOND, SUBSTEPS = 24, 8


@dataclass(frozen=True)
class Played:
    """points: name of strands to (frame_count, strand_count, node_count, 3) [m], first how they started.
    missed: pairs of segments that passed through each other, over all substeps.
    strain: the largest at the end of any substep.  seconds: of computation, a frame."""

    points: dict[str, np.ndarray]
    missed: int
    strain: float
    seconds: float


def play(scene: Scene, method: Literal["implicit", "paper", "none"], frames: int) -> Played:
    """Simulates `frames` of a scene whose strands of one name have as many points each.

    method: of `StrandContactSettings`. Each substep is a frame of its own to the solver, so that what is committed
    can be judged, by a test that shares nothing with what keeps strands apart.
    """
    simulation = build(scene, Settings(substeps=1, strand_contact=StrandContactSettings(method=method)))
    stage = simulation.model.parts["strands"]
    judge = MissedCollisions(simulation.model.launcher, stage.layout)
    position = simulation.state.arrays["strands/position"]
    before = wp.clone(position)

    def points() -> list[np.ndarray]:
        return [stage.points(k).reshape(hair.strand_count, -1, 3) for k, hair in enumerate(scene.strands)]

    shown, missed, strain, seconds = [points()], 0, 0.0, 0.0
    for substep in range(1, frames * SUBSTEPS + 1):
        started = time.perf_counter()
        metrics = simulation.advance_frame(substep / (FRAMES_PER_SECOND * SUBSTEPS))
        seconds += time.perf_counter() - started
        missed += judge.count(before, position)
        wp.copy(before, position)
        strain = max(strain, metrics["strands"]["strain_max"])
        if substep % SUBSTEPS == 0:
            shown.append(points())
    simulation.close()
    named = zip((hair.name for hair in scene.strands), zip(*shown, strict=True), strict=True)
    return Played({name: np.array(found) for name, found in named}, missed, strain, seconds / frames)
