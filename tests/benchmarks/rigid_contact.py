"""Rigid contact by Han 2019 §6 beside the default, on the same scenes.

    python tests/benchmarks/rigid_contact.py

One thread, 192 substeps a second. The paper's particles keep what touches a cell or two apart, so bodies are laid
down from a little above: from more than that, a box may tumble down the slope that it is to stick to.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.solver.contact.shapes import ball
from tests.solver.contact.soft_scenes import floor, turn_z
from tests.solver.rigid.rigid_scenes import FRAME, SUBSTEPS, Prop, Rigid, box, shaped

METHODS = ("exact", "paper")
GRAVITY, SIZE, CELL = 9.81, 0.2, 0.02
ANGLE = 25.0
# Cells between what touches and what it is laid on.
ABOVE = 1.6
SETTLING = 12  # frames
SPEEDS = (0.3, 0.6, 1.2)
STACKED = 3


def _incline(method: str, friction: float, frames: int = 20) -> tuple[np.ndarray, Rigid]:
    """A box on an incline of `ANGLE`: its way down the slope [m] after each frame, once it has landed."""
    rotation = turn_z(ANGLE)
    height = (0.5 * SIZE + ABOVE * CELL) * rotation[:, 1]
    scene = Rigid(
        [box(centre=height, rotation=rotation, friction=friction)],
        [floor(rotation=rotation, friction=friction, half=20.0)],
        method=method,
    )
    way = []
    for _ in range(SETTLING + frames):
        scene.run(FRAME)
        way.append(scene.position[0] @ -rotation[:, 0])
    return np.array(way[SETTLING:]), scene


def _acceleration(way: np.ndarray) -> float:
    return float(2.0 * np.polyfit(FRAME * np.arange(len(way)), way, 2)[0])


def _on_incline(method: str) -> dict[str, float]:
    """Errors of the acceleration, over g, and of the coefficient at which sliding begins; creep where it must not.

    threshold_error: mu + a / (g cos) at a coefficient .05 below tan, less tan.  creep: [m/s] at .05 above.
    """
    slope = np.radians(ANGLE)
    expected = GRAVITY * (np.sin(slope) - 0.3 * np.cos(slope))
    slides, _ = _incline(method, np.tan(slope) - 0.05)
    holds, _ = _incline(method, np.tan(slope) + 0.05)
    found = _acceleration(_incline(method, 0.3)[0])
    return {
        "acceleration_error": (found - expected) / GRAVITY,
        "threshold_error": _acceleration(slides) / (GRAVITY * np.cos(slope)) - 0.05,
        "creep": float(np.polyfit(FRAME * np.arange(len(holds)), holds, 1)[0]),
    }


def _stack(method: str) -> dict[str, float]:
    """Boxes dropped on one another by `ABOVE` cells: in the second second how far the top moves, over its size.

    gap: [cells] between neighbours in the end, the least and the largest; negative where they overlap.
    """
    pitch = SIZE + ABOVE * CELL
    scene = Rigid(
        [box(centre=(0.0, 0.5 * SIZE + ABOVE * CELL + pitch * k, 0.0)) for k in range(STACKED)],
        [floor()],
        method=method,
    )
    scene.run(1.0)
    start, most = scene.position[-1], 0.0
    for _ in range(round(1.0 / FRAME)):
        scene.run(FRAME)
        most = max(most, float(np.linalg.norm(scene.position[-1] - start)))
    low = [scene.points(k)[:, 1].min() for k in range(STACKED)]
    high = [0.0, *(scene.points(k)[:, 1].max() for k in range(STACKED - 1))]
    gaps = (np.array(low) - high) / CELL
    return {"top_moves": most / SIZE, "least_gap": float(gaps.min()), "largest_gap": float(gaps.max())}


def _sphere(**body: Any) -> Prop:
    """Of triangles, which both methods then take."""
    prop = shaped("sphere", 0.5 * SIZE, **body)
    points, triangles = ball(16, 0.5 * SIZE)
    prop.surface = replace(prop.surface, points=points, triangles=triangles, shape=None)
    return prop


def _head_on(method: str, speed: float) -> dict[str, float]:
    """Two spheres without restitution: energy after over before, the largest on the way, error of momentum."""
    scene = Rigid(
        [
            _sphere(velocity=[speed, 0.0, 0.0]),
            _sphere(centre=(SIZE + 0.1, 0.0, 0.0), velocity=[-speed, 0.0, 0.0]),
        ],
        gravity=(0.0, 0.0, 0.0),
        method=method,
    )
    before, most, energy = float(scene.mass.sum() * speed**2 / 2.0), 0.0, 0.0
    for _ in range(round(0.3 / speed / FRAME * SUBSTEPS)):
        energy = scene.substep()["kinetic_energy"]
        most = max(most, energy / before)
    passed = bool(scene.position[1, 0] < scene.position[0, 0])
    error = np.abs(scene.momenta()[0]).max() / (scene.mass[0] * speed)
    return {"energy": energy / before, "largest_energy": most, "momentum_error": float(error), "passed": passed}


def _cost(method: str, bodies: int) -> float:
    """[ms] a substep, the best of three rounds, of boxes on a floor and on each other, before they sleep."""
    pitch = SIZE + ABOVE * CELL
    scene = Rigid(
        [box(centre=(0.0, 0.5 * SIZE + ABOVE * CELL + pitch * k, 0.0)) for k in range(bodies)],
        [floor()],
        method=method,
    )
    scene.run(2 * FRAME)
    best = np.inf
    for _ in range(3):
        started = time.perf_counter()
        scene.run(FRAME)
        best = min(best, time.perf_counter() - started)
    return 1e3 * best / SUBSTEPS


def measure() -> dict[str, Any]:
    """All scenes by both methods."""
    rows = []
    for method in METHODS:
        rows.append(
            {
                "method": method,
                "incline": _on_incline(method),
                "stack": _stack(method),
                "head_on": {str(speed): _head_on(method, speed) for speed in SPEEDS},
                "ms_a_substep": {str(bodies): _cost(method, bodies) for bodies in (1, STACKED)},
            }
        )
    return {"rows": rows}


def table(held: dict[str, Any]) -> list[str]:
    """Lines of Markdown, of what `measure` found, under the key 'rigid'."""
    exact, paper = ({row["method"]: row for row in held["rigid"]["rows"]}[method] for method in METHODS)

    def line(what: str, cell: Any) -> str:
        return f"| {what} | {cell(exact)} | {cell(paper)} |"

    lines = [
        "| one scene by each method of rigid contact | exact, the default | Han 2019 (34)-(41) |",
        "|---|---|---|",
        line(
            f"box on an incline of {ANGLE:g}°, friction .3: error of the acceleration over g",
            lambda row: f"{row['incline']['acceleration_error']:.1e}",
        ),
        line("the same: error of the threshold", lambda row: f"{row['incline']['threshold_error']:.1e}"),
        line(
            "the same, friction .05 above the threshold: creep", lambda row: f"{row['incline']['creep']:.1e} m/s"
        ),
        line(
            "three boxes stacked: the top moves in a second",
            lambda row: f"{row['stack']['top_moves']:.1e} of its size",
        ),
        line(
            "the same: gaps in cells, negative for overlap",
            lambda row: "{least_gap:.1e} to {largest_gap:.1e}".format(**row["stack"]),
        ),
    ]
    for speed in exact["head_on"]:
        lines.append(
            line(
                f"spheres head on, {speed} m/s each: energy left; largest on the way",
                lambda row, speed=speed: _energies(row["head_on"][speed]),
            )
        )
    for bodies, first in exact["ms_a_substep"].items():
        lines.append(
            line(
                f"boxes on a floor and each other, {bodies}: cost of a substep",
                lambda row, bodies=bodies, first=first: f"{row['ms_a_substep'][bodies] / first:.3g}",
            )
        )
    return lines


def _energies(found: dict[str, Any]) -> str:
    return f"{found['energy']:.3f}; {found['largest_energy']:.3f}" + (
        " (passed through)" if found["passed"] else ""
    )


if __name__ == "__main__":
    print("\n".join(table({"rigid": measure()})))
