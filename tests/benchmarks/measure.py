"""Runs every benchmark and writes `results/*.json` and the tables of the README, `results/tables.md`.

    OPENBLAS_NUM_THREADS=1 python tests/benchmarks/measure.py [NAME ...]

NAME is one of MEASUREMENTS below; default: all, twenty minutes. numpy's threads would wait busily beside ours.

Run it on a machine that does nothing else. Figures of different machines do not compare; ratios within one run do.
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import contact_rules
import flesh_cost
import numpy as np
import pyelastica_cost
import rigid_contact
import strands_cost

from plait.pipeline import bench
from plait.pipeline.benchmarks import report, runner
from plait.pipeline.benchmarks.case import Hardware, Variant
from plait.pipeline.benchmarks.cases import CASES

RESULTS = Path(__file__).parent / "results"
STRANDS, SEGMENTS = 10_000, 50
GROWTH = (20, 200, 2_000, 20_000)  # strands: 1e3 to 1e6 segments
SUBSTEPS_A_SECOND = 192
# What the rods are to reach, us per segment and substep by threads; and the growth's exponent.
COST_TO_REACH = {1: 0.8, 2: 0.45}
EXPONENT_TO_REACH = 1.05
FLESH_EXPONENT_TO_REACH = 1.1


def _cost(strand_count: int, threads: int, frames: int = 6) -> dict[str, Any]:
    """Of `strands_cost.wavy_hair`: us per segment and substep, Newton iterations."""
    segments = strand_count * SEGMENTS
    simulation = strands_cost.start(strands_cost.wavy_hair(strand_count, SEGMENTS), threads)
    try:
        best, median, processor, iterations = strands_cost.cost(simulation, segments, frames)
    finally:
        simulation.close()
    return {
        "segments": segments,
        "threads": threads,
        "us_per_segment_substep": {"best": best, "median": median, "processor": processor},
        "iterations": iterations,
    }


def cost() -> dict[str, Any]:
    """10,000 strands of 50 segments, dt = 1/192 s, 1 g, on one and two threads."""
    rows = [_cost(STRANDS, threads) for threads in COST_TO_REACH]
    for row in rows:
        row["to_reach"] = COST_TO_REACH[row["threads"]]
        row["seconds_a_simulated_second"] = _simulated_second(
            row["us_per_segment_substep"]["median"], SUBSTEPS_A_SECOND
        )
    return {"rows": rows}


def _simulated_second(microseconds: float, steps: float) -> float:
    return 1e-6 * microseconds * STRANDS * SEGMENTS * steps


def pyelastica() -> dict[str, Any]:
    """The same hair in PyElastica, a simulated second extrapolated from the cost of a step."""
    measured = pyelastica_cost.measure()
    if measured is None:
        return {"skipped": "PyElastica is not installed: pip install plait[bench]"}
    each = measured["us_per_segment_step"]["median"]
    return measured | {"seconds_a_simulated_second": _simulated_second(each, 1.0 / measured["step"])}


def growth() -> dict[str, Any]:
    """From 1e3 to 1e6 segments on one thread: exponent of a straight line through the logarithms."""
    rows = [_cost(count, threads=1) for count in GROWTH]
    segments = [row["segments"] for row in rows]
    seconds = [row["us_per_segment_substep"]["median"] * row["segments"] for row in rows]
    exponent = float(np.polyfit(np.log(segments), np.log(seconds), 1)[0])
    return {"rows": rows, "exponent": exponent, "to_reach": EXPONENT_TO_REACH}


def errors() -> dict[str, Any]:
    """`plait bench` on one thread, and its plot."""
    results = []
    for case in CASES:
        print(f"  {case.name}", flush=True)
        results.append(runner.measure(case, Hardware()))
    report.plot(results, RESULTS / "errors.png")
    return {"cases": [report.as_data(result) for result in results]}


def flesh() -> dict[str, Any]:
    """Elastic bodies: the cost of a step, its growth, and the time to an error, beside Newton's VBD and XPBD."""
    return {"cost": flesh_cost.cost(), "growth": flesh_cost.growth(), "error": flesh_cost.error()}


def _cost_table(held: dict[str, Any]) -> list[str]:
    lines = [
        "| 10,000 strands of 50 segments, dt = 1/192 s, 1 g | us per segment and step | a simulated second |",
        "|-|-|-|",
    ]
    for row in held["cost"]["rows"]:
        each = row["us_per_segment_substep"]
        lines.append(
            f"| plait, threads: {row['threads']}, Newton iterations: {row['iterations']:.2f} "
            f"| {each['median']:.2f} (best {each['best']:.2f}; to reach {row['to_reach']:g}) "
            f"| {row['seconds_a_simulated_second']:.0f} s |"
        )
    other = held.get("pyelastica", {})
    if "step" in other:
        lines.append(
            f"| PyElastica {other['version']}, explicit, dt = {other['step']:.1e} s (its longest), extrapolated "
            f"| {other['us_per_segment_step']['median']:.2f} | {other['seconds_a_simulated_second']:.1e} s |"
        )
    return lines


def _growth_table(held: dict[str, Any]) -> list[str]:
    lines = ["| segments, one thread | us per segment and substep |", "|-|-|"]
    for row in held["growth"]["rows"]:
        each = row["us_per_segment_substep"]
        lines.append(f"| {row['segments']:,} | {each['median']:.2f} (best {each['best']:.2f}) |")
    exponent = held["growth"]["exponent"]
    return [
        *lines,
        "",
        f"Cost grows with the number of segments to the power {exponent:.3f} (to reach {EXPONENT_TO_REACH}).",
    ]


def _errors_table(held: dict[str, Any]) -> list[str]:
    lines = ["| case | time to 1 % | time to 0.1 % | reference | failures |", "|-|-|-|-|-|"]
    for case in held["errors"]["cases"]:
        reached = [_reached(case["time_to"][f"{level:g}"]) for level in runner.LEVELS]
        failures = [*case["failures"], *(row["failure"] for row in case["rows"] if row["failure"])]
        lines.append(f"| {case['name']} | {' | '.join(reached)} | {case['reference']} | {len(failures)} |")
    return lines


def _reached(row: dict[str, Any] | None) -> str:
    if row is None:
        return "not reached"
    names = ("segments", "substeps", "tolerance", "integrator", "precision", "unit")
    return f"{1e3 * row['seconds']:.3g} ms ({Variant(*(row[name] for name in names)).label})"


def _flesh_table(held: dict[str, Any]) -> list[str]:
    flesh = held["flesh"]
    lines = [
        "| a swaying bar of tets, dt = 1/96 s | ms a step | iterations: Newton, linear | ns a tet, linear one |",
        "|-|-|-|-|",
    ]
    for row in [*flesh["cost"], *flesh["growth"]["rows"]]:
        each = row["ms_a_step"]
        lines.append(
            f"| {row['tets']:,}, threads: {row['threads']} | {each['median']:.0f} (best {each['best']:.0f}) "
            f"| {row['newton_iterations']:.1f}, {row['linear_iterations']:.1f} "
            f"| {row['ns_a_tet_and_linear_iteration']:.1f} |"
        )
    exponent = flesh["growth"]["exponent"]
    grown = f"Cost grows with the number of tets to the power {exponent:.2f} (to reach {FLESH_EXPONENT_TO_REACH})."
    error = flesh["error"]
    lines += ["", grown, "", f"| {error['tets']:,} tets swaying, one thread | time to 1 % of error |", "|-|-|"]
    for name in ("plait", "vbd", "xpbd"):
        label = name if name == "plait" else f"Newton's {name.upper()}"
        lines.append(f"| {label} | {_flesh_reached(error['solvers'].get(name))} |")
    return lines


def _flesh_reached(solver: dict[str, Any] | None) -> str:
    if solver is None:
        return "not installed"
    if (row := solver["to_level"]) is None:
        row = min(solver["rows"], key=lambda row: row["error"])
        return f"not reached: {100.0 * row['error']:.2g} % in {row['seconds']:.2g} s"
    sweeps = f", {row['iterations']} sweeps" if row["iterations"] else ""
    return f"{row['seconds']:.2g} s ({row['steps_a_second']} steps a second{sweeps})"


MEASUREMENTS: dict[str, Callable[[], dict[str, Any]]] = {
    "cost": cost,
    "pyelastica": pyelastica,
    "growth": growth,
    "errors": errors,
    "flesh": flesh,
    "contact": contact_rules.measure,
    "rigid": rigid_contact.measure,
}
TABLES = {
    "cost": _cost_table,
    "growth": _growth_table,
    "errors": _errors_table,
    "flesh": _flesh_table,
    "contact": contact_rules.table,
    "rigid": rigid_contact.table,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MEASUREMENTS))
    names = parser.parse_args().names or list(MEASUREMENTS)
    if unknown := [name for name in names if name not in MEASUREMENTS]:
        parser.error(f"no measurement {', '.join(unknown)}; there are {', '.join(MEASUREMENTS)}")
    RESULTS.mkdir(exist_ok=True)
    for name in names:
        print(name, flush=True)
        date = datetime.datetime.now(datetime.UTC).isoformat(timespec="minutes")
        found = {"date": date, **bench.machine(Hardware()), **MEASUREMENTS[name]()}
        (RESULTS / f"{name}.json").write_text(bench.as_json_text(found) + "\n")
    held = {path.stem: json.loads(path.read_text()) for path in sorted(RESULTS.glob("*.json"))}
    parts = ["\n".join(table(held)) for name, table in TABLES.items() if name in held]
    first, dates = held[names[0]], sorted({found["date"][:10] for found in held.values()})
    when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    made = f"Measured on {first['cores']} cores of {first['processor']}, {when}."
    (RESULTS / "tables.md").write_text("\n\n".join([made, *parts]) + "\n")
    print((RESULTS / "tables.md").read_text())


if __name__ == "__main__":
    main()
