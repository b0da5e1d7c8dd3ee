"""What a step of elastic bodies costs, how that grows with the number of tets, and what an error of 1 % costs.

    python tests/benchmarks/flesh_cost.py [cost] [growth] [error] [large]      default: all

`large` is `error` with twenty times as many tets, six minutes, most of them the peers'.

A bar clamped at one end starts to sway under gravity; fixed corotated, E = 1 MPa, nu = .3, dt = 1/96 s, tolerance
as in production. Its tets are those of a body-centred lattice, 4:1:1. Newton's solvers take the same tets in the
same run (`newton_cost.py`).
"""

from __future__ import annotations

import statistics
import sys
import time
from typing import Any

import newton_cost
import numpy as np

from plait.pipeline.benchmarks.bars import bar_lattice, bar_scene
from plait.solver.build import build
from plait.solver.scene import Scene
from plait.solver.settings import FleshSettings, Settings
from plait.solver.step import Simulation

STEP = 1.0 / 96.0
COUNTED = (50_000, 200_000)
GROWTH = (10_000, 100_000, 1_000_000)
MODULUS, RATIO, DENSITY, LENGTH = 1e6, 0.3, 1000.0, 1.0
SETTLED, TIMED = 4, 8
LINEAR_ITERATIONS = 20
# The bar of the comparison in error, its end time [s] and how often it is looked at until then.
ERROR_CELLS, ERROR_TIME, LOOKS = (12, 3, 3), 0.125, 4
ERROR_LENGTH = 0.6
LARGE_CELLS, LARGE_FINEST = (32, 8, 8), 1536
LEVEL = 0.01
# Steps a second of our own ladder, and of its reference.
LADDER, FINEST = (48, 96, 192, 384, 768), 6144


def _swaying_bar(nodes: np.ndarray, tets: np.ndarray) -> Scene:
    return bar_scene(
        nodes,
        tets,
        youngs_modulus=MODULUS,
        poissons_ratio=RATIO,
        density=DENSITY,
        gravity=(0.0, -9.81, 0.0),
    )


def _bar_of(tet_count: int) -> tuple[Scene, int]:
    """With about so many tets, and how many it has."""
    across = round((tet_count / 48.0) ** (1.0 / 3.0))
    nodes, tets = bar_lattice((4 * across, across, across), LENGTH)
    return _swaying_bar(nodes, tets), len(tets)


def _measure(tet_count: int, threads: int) -> dict[str, Any]:
    """Milliseconds a step, Newton and linear iterations a step, ns a tet and linear iteration."""
    scene, tets = _bar_of(tet_count)
    simulation = build(scene, Settings(threads=threads))
    try:
        for k in range(SETTLED):
            simulation.advance_frame((k + 1) * STEP, substeps=1)
        seconds, processor, metrics = [], time.process_time(), []
        for k in range(SETTLED, SETTLED + TIMED):
            started = time.perf_counter()
            metrics.append(simulation.advance_frame((k + 1) * STEP, substeps=1)["tets"])
            seconds.append(time.perf_counter() - started)
        processor = time.process_time() - processor
        linear = _linear_iteration(simulation)
    finally:
        simulation.close()
    return {
        "tets": tets,
        "threads": threads,
        "ms_a_step": {
            "best": 1e3 * min(seconds),
            "median": 1e3 * statistics.median(seconds),
            "processor": 1e3 * processor / TIMED,
        },
        "newton_iterations": statistics.mean(held["newton_iterations"] for held in metrics),
        "linear_iterations": statistics.mean(held["linear_iterations"] for held in metrics),
        "ns_a_tet_and_linear_iteration": 1e9 * linear / tets,
    }


def _linear_iteration(simulation: Simulation) -> float:
    """[s] of one iteration of conjugate gradients with the block diagonal, best of several runs."""
    gradients = simulation.model.parts["tets"].solver(0).newton.gradients
    load = np.random.default_rng(0).standard_normal((gradients.count, 3))
    best = np.inf
    for _ in range(5):
        gradients.krylov.residual.assign(load)
        started = time.perf_counter()
        taken = gradients.solve(1e-12, LINEAR_ITERATIONS)
        best = min(best, (time.perf_counter() - started) / taken)
    return best


def cost() -> list[dict[str, Any]]:
    """50k and 200k tets on one and two threads."""
    return [_measure(tets, threads) for tets in COUNTED for threads in (1, 2)]


def growth() -> dict[str, Any]:
    """The bar refined, one thread: the exponent of a straight line through the logarithms."""
    rows = [_measure(tets, threads=1) for tets in GROWTH]
    sizes = [row["tets"] for row in rows]
    exponents = {
        kind: float(np.polyfit(np.log(sizes), np.log([row["ms_a_step"][kind] for row in rows]), 1)[0])
        for kind in ("best", "processor")
    }
    return {"rows": rows, "exponent": exponents["best"], "processor_exponent": exponents["processor"]}


def _run(scene: Scene, steps_a_second: int, tolerance: float) -> tuple[np.ndarray, float]:
    """(LOOKS, node_count, 3) [m] positions, and the seconds it took."""
    settings = Settings(threads=1, flesh=FleshSettings(tolerance=tolerance))
    simulation = build(scene, settings)
    stage, looks = simulation.model.parts["tets"], []
    started = time.perf_counter()
    for k in range(LOOKS):
        substeps = round(steps_a_second * ERROR_TIME / LOOKS)
        simulation.advance_frame((k + 1) * ERROR_TIME / LOOKS, substeps=max(1, substeps))
        looks.append(stage.nodes(0).copy())
    seconds = time.perf_counter() - started
    simulation.close()
    return np.array(looks), seconds


def error(cells: tuple[int, int, int] = ERROR_CELLS, finest: int = FINEST) -> dict[str, Any]:
    """Seconds to 1 % of error in time, each solver against its own converged motion of the same tets."""
    nodes, tets = bar_lattice(cells, ERROR_LENGTH)
    scene = _swaying_bar(nodes, tets)
    settings = {"modulus": MODULUS, "ratio": RATIO, "density": DENSITY, "time": ERROR_TIME, "looks": LOOKS}
    exact, _ = _run(scene, finest, tolerance=1e-6)
    rows = []
    for steps in LADDER:
        found, seconds = min((_run(scene, steps, FleshSettings().tolerance) for _ in range(3)), key=lambda r: r[1])
        off = newton_cost.relative_error(found, exact, nodes)
        rows.append({"steps_a_second": steps, "iterations": None, "seconds": seconds, "error": off})
    solvers = {"plait": {"rows": rows, "to_level": newton_cost.cheapest(rows, LEVEL)}}
    peers = newton_cost.measure(nodes, tets, np.isclose(nodes[:, 0], 0.0), LEVEL, **settings)
    return {"tets": len(tets), "level": LEVEL, "solvers": solvers | (peers or {})}


def large() -> dict[str, Any]:
    """`error` at a size where no solver waits for its launches."""
    return error(LARGE_CELLS, LARGE_FINEST)


def main() -> None:
    measurements = {"cost": cost, "growth": growth, "error": error, "large": large}
    for name in sys.argv[1:] or measurements:
        print(name, measurements[name]())


if __name__ == "__main__":
    main()
