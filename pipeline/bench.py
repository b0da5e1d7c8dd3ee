"""`plait bench`: run time against error."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from plait.pipeline import progress, provenance
from plait.pipeline.benchmarks import report
from plait.pipeline.benchmarks.case import Case, Hardware
from plait.pipeline.benchmarks.cases import CASES
from plait.pipeline.benchmarks.runner import Result, measure, step_count
from plait.pipeline.errors import EXIT_DONE, EXIT_FAILED, UsageError


def show(
    cases: Sequence[str],
    *,
    list_only: bool = False,
    device: str = "cpu",
    threads: int = 1,
    as_json: bool = False,
    plot: Path | None = None,
    available: Sequence[Case] = CASES,
) -> int:
    """Measures the named cases (all when none is named) and prints, or writes as JSON, what came out.

    Returns EXIT_DONE, or EXIT_FAILED when anything is in a row of failures. Raises UsageError for an unknown case,
    device or kind of picture.
    """
    chosen = _choose(cases, available)
    if list_only:
        for case in chosen:
            print(f"{case.name:24} {case.description}")
        return EXIT_DONE
    _check_plot(plot)
    hardware = Hardware(_checked_device(device), threads)
    results = _measure(chosen, hardware)
    if plot is not None:
        report.plot(results, plot)
    if as_json:
        print(as_json_text({**machine(hardware), "cases": [report.as_data(result) for result in results]}))
    else:
        from rich.console import Console

        console = Console(width=None if sys.stdout.isatty() else 160)
        for result in results:
            report.show(result, console)
    return EXIT_FAILED if any(result.failed for result in results) else EXIT_DONE


def as_json_text(data: dict[str, Any]) -> str:
    """Indented JSON; numpy's numbers become plain ones, and what is not a number null."""
    return msgspec.json.format(msgspec.json.encode(data, enc_hook=float), indent=1).decode()


def machine(hardware: Hardware) -> dict[str, Any]:
    """What the figures were measured on and with."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "device": hardware.device,
        "threads": hardware.threads,
        "versions": provenance.versions(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def _choose(names: Sequence[str], available: Sequence[Case]) -> list[Case]:
    known = {case.name: case for case in available}
    for name in names:
        if name not in known:
            raise UsageError(f"no benchmark case {name}; there are {', '.join(known)}")
    return [known[name] for name in names] or list(available)


def _check_plot(path: Path | None) -> None:
    if path is not None and path.suffix not in (".png", ".svg", ".pdf"):
        raise UsageError(f"--plot {path}: write to a .png, .svg or .pdf file")
    if path is not None and not path.parent.is_dir():
        raise UsageError(f"--plot {path}: there is no folder {path.parent}")


def _checked_device(device: str) -> str:
    import warp as wp

    from plait.solver.warp_start import start_warp

    start_warp()
    try:
        return str(wp.get_device(device))
    except Exception as error:
        raise UsageError(f"--device {device}: {error}") from error


def _measure(chosen: Sequence[Case], hardware: Hardware) -> list[Result]:
    shown = progress.make("rich", "text")
    total = sum(step_count(case) for case in chosen)
    done = 0

    def step_done(text: str) -> None:
        nonlocal done
        done += 1
        shown.frame(done, total, text)

    shown.phase("measuring")
    try:
        return [measure(case, hardware, step_done=step_done) for case in chosen]
    finally:
        shown.close()
