"""Strands against strands: what passes through, what is strained, and what it costs.

    python tests/benchmarks/strand_contact.py tubes [head ...] [--method implicit paper none mcadams]
        [--size strands=270,segments=175] [--frames 100] [--substeps 8] [--threads 2] [--json FILE]

Scenes are those of `tests/solver/strand_contact/scenes.py`; the judge of missed collisions is its referee's.
'mcadams' is the baseline of `mcadams.py`.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from plait.pipeline import bench
from plait.pipeline.benchmarks.case import Hardware
from plait.solver.settings import Settings, StrandContactSettings
from tests.benchmarks.mcadams import McAdams
from tests.solver.strand_contact.referee import Referee, inside_convex
from tests.solver.strand_contact.scenes import CASES, FRAMES_PER_SECOND, Case, head_transform

METHODS = ("implicit", "paper", "none", "mcadams")
ENERGIES = ("kinetic_energy", "elastic_energy", "potential_energy")


def measure(
    case: Case, method: str, *, threads: int, substeps: int | None, frames: int | None, judged: bool = True
) -> dict[str, Any]:
    """Runs a case: missed collisions, strains, energies and seconds.

    judged: False leaves the referee out, for costs alone. seconds: of the strands' stage, the least and the median
    frame; the referee's own time is not in them.
    """
    solved = StrandContactSettings(method="none" if method == "mcadams" else method)
    count = substeps or case.substeps
    simulation = case.start(Settings(threads=threads, substeps=count, strand_contact=solved))
    try:
        if method == "mcadams":
            McAdams(simulation)
        judge = Referee(simulation) if judged else None
        rows = [_frame(simulation, case, number, count) for number in range(frames or case.frames)]
        found = _summary(rows, simulation)
        if judge is not None:
            found |= {
                "missed": judge.missed,
                "missed_by_frame": judge.by_frame,
                "strain_max": judge.largest_strain,
            }
            found["strain_median"] = float(np.median(np.abs(judge.strains())))
    finally:
        simulation.close()
    return found | {"method": method, "threads": threads, "frames": rows}


def _frame(simulation: Any, case: Case, number: int, substeps: int) -> dict[str, Any]:
    end = (number + 1) / FRAMES_PER_SECOND
    started = time.process_time()
    metrics = simulation.advance_frame(end, substeps)
    strands = metrics["strands"]
    row = {"substeps": metrics["substeps"], "seconds": metrics["seconds"]["strands"]}
    row["processor_with_referee"] = time.process_time() - started
    row |= {name: strands[name] for name in (*ENERGIES, "strain_max", "strain_median", "iterations_mean")}
    row["energy"] = sum(strands[name] for name in ENERGIES)
    row |= {name: value for name, value in strands.items() if name.startswith("strand_contact")}
    if ball := [surface for surface in case.scene.surfaces if surface.name == "head"]:
        row["inside"] = _inside_head(simulation, ball[0], end)
    return row


def _inside_head(simulation: Any, ball: Any, end: float) -> int:
    transform = head_transform(end)
    points = simulation.model.parts["strands"].points(0)
    local = (points - transform[:3, 3]) @ transform[:3, :3]
    return int(inside_convex(local, ball.points, ball.triangles).sum())


def _summary(rows: list[dict[str, Any]], simulation: Any) -> dict[str, Any]:
    layout = simulation.model.parts["strands"].layout
    seconds = [row["seconds"] for row in rows]
    segments = layout.node_count - 2 * layout.strand_count
    each = [1e6 * row["seconds"] / (segments * row["substeps"]) for row in rows]
    return {
        "segments": segments,
        "seconds": {"median": float(np.median(seconds)), "mean": float(np.mean(seconds)), "max": max(seconds)},
        "us_per_segment_substep": float(np.median(each)),
        "substeps": int(np.sum([row["substeps"] for row in rows])),
        "energy": [rows[0]["energy"], rows[-1]["energy"]],
        "inside": max((row.get("inside", 0) for row in rows), default=0),
    }


def row_of(name: str, found: dict[str, Any]) -> str:
    first, last = found["energy"]
    return (
        f"| {name} | {found['method']} | {found['segments']:,} | {found.get('missed', '-')} "
        f"| {100 * found.get('strain_max', np.nan):.2g} % | {100 * found.get('strain_median', np.nan):.2g} % "
        f"| {found['seconds']['median']:.3g} s ({found['seconds']['max']:.3g} s) "
        f"| {found['us_per_segment_substep']:.2f} | {found['substeps']} | {first:.3e} to {last:.3e} J "
        f"| {found['inside']} |"
    )


HEADER = (
    "| scene | method | segments | missed | largest strain | median strain | seconds a frame, median (most) "
    "| us per segment and substep | substeps | energy, first and last frame | points inside |\n" + "|-" * 11 + "|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", choices=sorted(CASES), metavar="SCENE", help=", ".join(CASES))
    parser.add_argument("--method", nargs="+", default=["implicit"], choices=METHODS)
    parser.add_argument("--size", default="", help="arguments of the scene: strands=270,segments=175")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--substeps", type=int)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--unjudged", action="store_true", help="without the referee")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    size = {name: float(value) if "." in value else int(value) for name, value in _pairs(options.size)}
    print(HEADER, flush=True)
    results = []
    for name in options.scenes:
        for method in options.method:
            found = measure(
                CASES[name](**size),
                method,
                threads=options.threads,
                substeps=options.substeps,
                frames=options.frames,
                judged=not options.unjudged,
            )
            print(row_of(name, found), flush=True)
            results.append({"scene": name, "size": size, **found})
    if options.json:
        options.json.write_text(bench.as_json_text({**bench.machine(Hardware()), "results": results}) + "\n")


def _pairs(text: str) -> list[list[str]]:
    return [part.split("=") for part in text.split(",") if part]


if __name__ == "__main__":
    main()
