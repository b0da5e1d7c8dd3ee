"""Strands against strands: what passes through, what is strained, and what it costs.

    python tests/benchmarks/strand_contact.py tubes [head ...] [--method implicit paper none mcadams newton]
        [--size strands=270,segments=175] [--frames 100] [--substeps 8] [--threads 2 ...] [--json FILE]
    python tests/benchmarks/strand_contact.py growth [--tiles 3 10 30 90] [--threads 1]

Scenes are those of `tests/solver/strand_contact/scenes.py`; the judge of missed collisions is its referee's.
'mcadams' is the baseline of `mcadams.py`, 'newton' the cables of `newton_strands.py`, on one thread.
`growth` is what a segment costs in ever larger scenes, `mat`; 278 tiles have a million segments.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from plait.pipeline import bench
from plait.pipeline.benchmarks.case import Hardware
from tests.benchmarks import newton_strands
from tests.benchmarks.mcadams import McAdams
from tests.solver.strand_contact.referee import Referee, inside_convex
from tests.solver.strand_contact.scenes import CASES, FRAMES_PER_SECOND, Case, head_transform, mat

METHODS = ("implicit", "paper", "none", "mcadams", "newton")
GROWTH_TILES = (3, 10, 30, 90)  # of 3,600 segments
GROWTH_FRAMES = 4
EXPONENT_TO_REACH = 1.1
ENERGIES = ("kinetic_energy", "elastic_energy", "potential_energy")


def measure(
    case: Case, method: str, *, threads: int, substeps: int | None, frames: int | None, judged: bool = True
) -> dict[str, Any]:
    """Runs a case: missed collisions, strains, energies and seconds.

    judged: False leaves the referee out, for costs alone. seconds: of the strands' stage, the least and the median
    frame; the referee's own time is not in them.
    """
    count = substeps or case.substeps
    solved = "none" if method == "mcadams" else method
    simulation = case.start(solved, substeps=count, threads=threads)
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
    row |= {name: value for name, value in strands.items() if name.startswith("strand_")}
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
        f"| {name} | {found['method']}, threads: {found['threads']} | {found['segments']:,} "
        f"| {found.get('missed', '-')} "
        f"| {100 * found.get('strain_max', np.nan):.2g} % | {100 * found.get('strain_median', np.nan):.2g} % "
        f"| {found['seconds']['median']:.3g} s ({found['seconds']['max']:.3g} s) "
        f"| {found['us_per_segment_substep']:.2f} | {found['substeps']} | {first:.3e} to {last:.3e} J "
        f"| {found['inside']} |"
    )


def newton_row(name: str, found: dict[str, Any]) -> str:
    """The frames' median, without the first, which compiles."""
    frames = found["frames"][1:]
    each = float(np.median([row["us_per_segment_substep"] for row in frames]))
    most = max(row["contacts_a_segment"] for row in frames)
    missed = "-" if found["missed"] is None else found["missed"]
    return (
        f"| {name} | Newton {found['version']}, {found['sweeps']} sweeps, up to {most:.2f} contacts a segment "
        f"| {found['segments']:,} | {missed} | joints {found['joints_open']:.2g} segments wide "
        f"| | | {each:.2f} | {8 * len(found['frames'])} | | |"
    )


# -- growth ----------------------------------------------------------------------------------------------------


def grow(tiles: int, threads: int) -> dict[str, Any]:
    """Processor time and memory a segment and substep of `mat`, in the last frames, when all is in contact.

    Memory is the process's peak beyond that of a scene with next to no segments: for a process of its own.
    """
    for case in (mat(1, segments=2), mat(tiles)):
        before = _peak()
        simulation = case.start(threads=threads)
        rows = [_frame(simulation, case, number, case.substeps) for number in range(GROWTH_FRAMES)]
        simulation.close()
    segments = sum(len(strands.points) - strands.strand_count for strands in case.scene.strands)
    last = rows[GROWTH_FRAMES // 2 :]
    return {
        "tiles": tiles,
        "segments": segments,
        "contacts_a_segment": last[-1]["strand_contacts"] / segments,
        "us_per_segment_substep": float(np.mean([_microseconds(row, segments) for row in last])),
        "seconds_a_frame": float(np.median([row["seconds"] for row in last])),
        "bytes_a_segment": (_peak() - before) / segments,
        "frames": rows,
    }


def _microseconds(row: dict[str, Any], segments: int) -> float:
    """Of processor time per segment and substep, of all threads together."""
    return 1e6 * row["processor_with_referee"] / (segments * row["substeps"])


def _peak() -> int:
    """[byte] the largest resident set of this process so far."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def growth(tiles: Sequence[int], threads: int) -> dict[str, Any]:
    """Rows by size, each from a process of its own, and the exponent of a line through the logarithms."""
    print(
        "| segments | contacts a segment | us of processor per segment and substep | seconds a frame "
        "| bytes a segment |\n"
        "|-|-|-|-|-|"
    )
    rows, spawn = [], multiprocessing.get_context("spawn")
    for count in tiles:
        with ProcessPoolExecutor(1, spawn) as alone:
            rows.append(row := alone.submit(grow, count, threads).result())
        print(
            f"| {row['segments']:,} | {row['contacts_a_segment']:.2f} | {row['us_per_segment_substep']:.2f} "
            f"| {row['seconds_a_frame']:.3g} | {row['bytes_a_segment']:,.0f} |",
            flush=True,
        )
    segments = np.array([row["segments"] for row in rows])
    seconds = segments * [row["us_per_segment_substep"] for row in rows]
    exponent = float(np.polyfit(np.log(segments), np.log(seconds), 1)[0]) if len(rows) > 1 else np.nan
    print(f"\nCost grows with the number of segments to the power {exponent:.3f} (to reach {EXPONENT_TO_REACH}).")
    return {"rows": rows, "exponent": exponent, "to_reach": EXPONENT_TO_REACH, "threads": threads}


HEADER = (
    "| scene | method | segments | missed | largest strain | median strain | seconds a frame, median (most) "
    "| us per segment and substep | substeps | energy, first and last frame | points inside |\n" + "|-" * 11 + "|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", choices=[*sorted(CASES), "growth"], metavar="SCENE")
    parser.add_argument("--method", nargs="+", default=["implicit"], choices=METHODS)
    parser.add_argument("--size", default="", help="arguments of the scene: strands=270,segments=175")
    parser.add_argument("--threads", type=int, nargs="+", default=[2])
    parser.add_argument("--substeps", type=int)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--tiles", type=int, nargs="+", default=GROWTH_TILES, help="sizes of growth")
    parser.add_argument("--unjudged", action="store_true", help="without the referee")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if "growth" in options.scenes:
        results = [growth(options.tiles, threads) for threads in options.threads]
    else:
        print(HEADER, flush=True)
        results = [_run(options, *chosen) for chosen in product(options.scenes, options.method, options.threads)]
    if options.json:
        options.json.write_text(bench.as_json_text({**bench.machine(Hardware()), "results": results}) + "\n")


def _run(options: argparse.Namespace, name: str, method: str, threads: int) -> dict[str, Any]:
    """Measures and prints a row."""
    size = {key: float(value) if "." in value else int(value) for key, value in _pairs(options.size)}
    case = CASES[name](**size)
    if method == "newton":
        found = newton_strands.measure(case.scene, options.frames or case.frames, judged=not options.unjudged)
        print(newton_row(name, found), flush=True)
    else:
        found = measure(
            case,
            method,
            threads=threads,
            substeps=options.substeps,
            frames=options.frames,
            judged=not options.unjudged,
        )
        print(row_of(name, found), flush=True)
    return {"scene": name, "size": size, **found}


def _pairs(text: str) -> list[list[str]]:
    return [part.split("=") for part in text.split(",") if part]


if __name__ == "__main__":
    main()
