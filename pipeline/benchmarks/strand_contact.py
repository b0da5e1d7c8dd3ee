"""Cases of strands that meet: a capstan, bundles that fall across each other, fast crossings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from plait.pipeline.benchmarks import strand_scenes
from plait.pipeline.benchmarks.case import Case, Hardware, Known, Ladder, Outcome, Trial, Variant
from plait.pipeline.benchmarks.rods import FRAME, refined, simulation_of
from plait.pipeline.benchmarks.strand_scenes import CAPSTAN_LOAD
from plait.solver.scene import Scene
from plait.solver.settings import StrandContactSettings
from plait.solver.step import Simulation

# Of the capstan: friction and angle wound [rad].
WOUND = (0.3, np.pi)
PULLED, SLIDING = 10, 8  # frames; the strand slides all along in the last of them
FALLEN = 6  # frames; the bundles meet in the third
PAIRS, SPEEDS, CROSSED = 2, (5.0, 20.0), 3  # [m/s]; times looked at, a third of a frame apart
LOOK = FRAME / 3.0


def _simulation(scene: Scene, variant: Variant, hardware: Hardware) -> Simulation:
    return simulation_of(scene, variant, hardware, strand_contact=StrandContactSettings(method="implicit"))


def _trial(
    simulation: Simulation,
    variant: Variant,
    times: np.ndarray,
    look: Callable[[dict[str, Any]], float],
) -> Trial:
    """`look` at a frame's metrics of the strands gives a row of the value, at each of `times` [s]."""

    def run() -> Outcome:
        seen, found = [], []
        for time in times:
            found.append(simulation.advance_frame(float(time), variant.substeps)["strands"])
            seen.append(look(found[-1]))
        missed = sum(metrics["missed"] for metrics in found)
        figures = {
            "contacts": float(max(metrics["strand_contacts"] for metrics in found)),
            "strain": float(max(metrics["strain_max"] for metrics in found)),
            "passes": float(max(metrics["strand_passes"] for metrics in found)),
        }
        return Outcome(np.array(seen)[:, None], figures, f"{missed} collisions missed" if missed else "")

    return Trial(run, simulation.close)


def _prepare_capstan(variant: Variant, hardware: Hardware) -> Trial:
    """T2 / T1 over exp(mu theta), the mean of the frames in which the strand slides."""
    simulation = _simulation(strand_scenes.capstan(*WOUND), variant, hardware)
    pull = simulation.state.arrays["strands/tension"]
    trial = _trial(
        simulation,
        variant,
        FRAME * np.arange(1, PULLED + 1),
        # Of the second edge; the first is clamped.
        lambda _: float(pull.numpy()[2]) / CAPSTAN_LOAD / np.exp(np.prod(WOUND)),
    )

    def run() -> Outcome:
        outcome = trial.run()
        return outcome._replace(value=outcome.value[-SLIDING:].mean(axis=0, keepdims=True))

    return Trial(run, trial.close)


def _prepare_tubes(variant: Variant, hardware: Hardware) -> Trial:
    scene = strand_scenes.tubes(strands=20, segments=variant.segments)
    times = FRAME * np.arange(1, FALLEN + 1)
    return _trial(_simulation(scene, variant, hardware), variant, times, lambda metrics: metrics["missed"])


def _prepare_crossing(variant: Variant, hardware: Hardware) -> Trial:
    """What the energy rises by from look to look, of that at the start."""
    scene, velocity = strand_scenes.crossing(PAIRS, SPEEDS)
    simulation = _simulation(scene, variant, hardware)
    strand_scenes.set_velocity(simulation, velocity)
    layout = simulation.model.parts["strands"].layout
    first = before = 0.5 * float(layout.mass[layout.point_node] @ (velocity**2).sum(axis=1))

    def risen(metrics: dict[str, Any]) -> float:
        nonlocal before
        rise, before = metrics["kinetic_energy"] + metrics["elastic_energy"] - before, before
        before += rise
        return max(0.0, rise) / first

    return _trial(simulation, variant, LOOK * np.arange(1, CROSSED + 1), risen)


def _zero(rows: int) -> np.ndarray:
    return np.zeros((rows, 1))


CASES = (
    Case(
        "capstan",
        f"strand pulled round a fixed post, mu = {WOUND[0]:g}, {np.degrees(WOUND[1]):g} degrees",
        "tension, beyond exp(mu theta) times the load, over that",
        1.0,
        _prepare_capstan,
        Known(np.ones((1, 1)), "Euler and Eytelwein, T2 / T1 = exp(mu theta)"),
        (Ladder("time, Euler", refined(Variant(125, 8, 3e-2), substeps=(4, 8))),),
        interval=FRAME,
    ),
    Case(
        "tubes",
        "two bundles of 10 strands, one falls across the other",
        "collisions missed, rms over frames",
        1.0,
        _prepare_tubes,
        Known(_zero(FALLEN), "strands do not pass through each other"),
        (Ladder("space", (Variant(20, 8, 3e-2),)),),
        interval=FRAME,
    ),
    Case(
        "crossing",
        f"{PAIRS} pairs of strands that meet at {SPEEDS[0]:g} and {SPEEDS[1]:g} m/s",
        "what the energy rises by, of that at the start, rms over times",
        1.0,
        _prepare_crossing,
        Known(_zero(CROSSED), "nothing adds to the energy of strands that meet"),
        (Ladder("time, Euler", refined(Variant(30, 1, 3e-2), substeps=(1, 3))),),
        interval=LOOK,
    ),
)
