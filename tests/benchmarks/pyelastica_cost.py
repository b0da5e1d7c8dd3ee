"""What PyElastica takes for the hair of `strands_cost.py`: an explicit Cosserat rod code, for comparison.

    python tests/benchmarks/pyelastica_cost.py        (needs `pip install plait[bench]`)

It is given every advantage: free rods without constraints, gravity, damping or shaking, all in one memory block,
and the longest step at which one such rod stays whole. A simulated second is not run but extrapolated from what a
step costs, which does not depend on the motion.
"""

from __future__ import annotations

import contextlib
import io
import statistics
import time
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import numpy as np

LENGTH, RADIUS, DENSITY, YOUNG, POISSON = 0.25, 40e-6, 1300.0, 4e9, 0.3
SEGMENTS = 50
TIMED_RODS = 500
TRIED_STEPS = 20000
STEP_RATIO = 1.05


def _rods(count: int) -> tuple[Any, list[Any]]:
    """A finalised system of straight rods that swing, and the rods."""
    import elastica

    random = np.random.default_rng(1)
    system = type("System", (elastica.BaseSystemCollection,), {})()
    rods = []
    with contextlib.redirect_stderr(io.StringIO()):
        for _ in range(count):
            direction = random.normal(size=3)
            direction /= np.linalg.norm(direction)
            side = np.cross(direction, [0.0, 0.0, 1.0])
            side /= np.linalg.norm(side)
            rod = elastica.CosseratRod.straight_rod(
                SEGMENTS,
                random.uniform(-0.1, 0.1, 3),
                direction,
                side,
                LENGTH,
                RADIUS,
                DENSITY,
                youngs_modulus=YOUNG,
                shear_modulus=YOUNG / (2.0 * (1.0 + POISSON)),
            )
            rod.velocity_collection[:] = 0.2 * side[:, None] * np.linspace(0.0, 1.0, SEGMENTS + 1) ** 2
            system.append(rod)
            rods.append(rod)
        system.finalize()
    return system, rods


def _advance(system: Any, step: float, count: int) -> None:
    import elastica

    stepper, now = elastica.PositionVerlet(), 0.0
    for _ in range(count):
        now = stepper.step(system, now, step)


def _stays_whole(step: float) -> bool:
    """Whether a rod is finite, and no longer than 1.05 times its length, after `TRIED_STEPS` steps."""
    system, (rod,) = _rods(1)
    with np.errstate(all="ignore"):
        _advance(system, step, TRIED_STEPS)
        length = np.linalg.norm(np.diff(rod.position_collection, axis=1), axis=0).sum()
    return bool(length < 1.05 * LENGTH)


def longest_step() -> float:
    """[s] Within 5 %. Sought around the time a stretch wave takes across the radius: what limits the step is the
    rotation of the thin cross-sections against the rod's shear stiffness.
    """
    step = RADIUS / np.sqrt(YOUNG / DENSITY)
    while not _stays_whole(step):
        step /= 2.0
    while _stays_whole(step * STEP_RATIO):
        step *= STEP_RATIO
    return float(step)


def measure() -> dict[str, Any] | None:
    """Cost and step, or None where PyElastica is not installed.

    us_per_segment_step: best and median of five runs of 100 steps.  step: [s].
    """
    if find_spec("elastica") is None:
        return None
    step = longest_step()
    system, _ = _rods(TIMED_RODS)
    _advance(system, step, 20)
    costs = []
    for _ in range(5):
        started = time.perf_counter()
        _advance(system, step, 100)
        costs.append(1e6 * (time.perf_counter() - started) / (100 * TIMED_RODS * SEGMENTS))
    return {
        "version": version("pyelastica"),
        "step": step,
        "us_per_segment_step": {"best": min(costs), "median": statistics.median(costs)},
    }


if __name__ == "__main__":
    print(measure() or "PyElastica is not installed: pip install plait[bench]")
