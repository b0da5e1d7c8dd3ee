"""What was measured, as a table, as data and as a plot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plait.pipeline.benchmarks.case import Case, Known, Variant
from plait.pipeline.benchmarks.runner import Order, Result, Row
from plait.pipeline.files import replacing

if TYPE_CHECKING:
    from rich.console import Console

COLUMNS = (
    "",
    "ladder",
    "integrator",
    "precision",
    "resolution",
    "step s",
    "tolerance",
    "error %",
    "median s",
    "first s",
)


def show(result: Result, console: Console) -> None:
    """Prints a case: a row a variant (* on the Pareto front), orders, times to reach an error, failures."""
    from rich.table import Table

    case = result.case
    figures = sorted({name for row in result.rows for name in row.figures})
    table = Table(*COLUMNS, *figures, title=f"{case.name}: {case.description}", title_justify="left")
    for row in result.rows:
        if not row.failure:
            table.add_row(*_cells(case, row), *(f"{row.figures.get(name, float('nan')):.3g}" for name in figures))
    console.print(table)
    console.print(f"error: {case.measure}; reference: {reference_text(result)}", markup=False)
    for order in result.orders:
        console.print(f"order of {order.ladder}: {_orders_text(order)}", markup=False)
    for level, row in result.time_to.items():
        reached = "not reached" if row is None else f"{row.seconds:.4g} s ({row.variant.label})"
        console.print(f"time to {level:.1%}: {reached}", markup=False)
    for failure in result.failures:
        console.print(f"FAILED {case.name}: {failure}", style="bold red", markup=False)
    for row in result.rows:
        if row.failure:
            off = "" if row.error is None else f"; {row.error:.3g} off after {row.seconds:.4g} s"
            text = f"FAILED {row.ladder} ({row.variant.label}): {row.failure}{off}"
            console.print(text, style="bold red", markup=False)
    console.print()


def reference_text(result: Result) -> str:
    """Where the reference is from."""
    reference = result.case.reference
    if isinstance(reference, Known):
        return reference.source
    order = "none" if result.reference_order is None else f"{result.reference_order:.2f}"
    return f"three-level Richardson extrapolation, observed order {order}, nominal {reference.nominal_order:g}"


def _orders_text(order: Order) -> str:
    return f"{', '.join(f'{value:.2f}' for value in order.observed)} (nominal {order.nominal:g})"


def _cells(case: Case, row: Row) -> tuple[str, ...]:
    variant = row.variant
    error = "-" if row.error is None else f"{100.0 * row.error:.3g}"
    return (
        "*" if row.front else "",
        row.ladder,
        variant.integrator if variant.substeps else "static",
        variant.precision,
        f"{variant.segments} {variant.unit}",
        _step(case, variant),
        f"{variant.tolerance:g}",
        error,
        f"{row.seconds:.4g}",
        f"{row.first_seconds:.2g}",
    )


def _step(case: Case, variant: Variant) -> str:
    return f"{case.interval / variant.substeps:.3g}" if variant.substeps else "-"


def as_data(result: Result) -> dict[str, Any]:
    """Everything `show` prints, and each single run, as JSON can hold it."""
    case = result.case
    return {
        "name": case.name,
        "description": case.description,
        "measure": case.measure,
        "reference": reference_text(result),
        "rows": [_row_data(case, row) for row in result.rows],
        "orders": [
            {"ladder": order.ladder, "nominal": order.nominal, "observed": order.observed}
            for order in result.orders
        ],
        "time_to": {
            f"{level:g}": None if row is None else {"seconds": row.seconds, **row.variant._asdict()}
            for level, row in result.time_to.items()
        },
        "failures": list(result.failures),
    }


def _row_data(case: Case, row: Row) -> dict[str, Any]:
    return {
        "ladder": row.ladder,
        **row.variant._asdict(),
        "step": case.interval / row.variant.substeps if row.variant.substeps else None,
        "error": row.error,
        "seconds": row.seconds,
        "runs": row.runs,
        "first_seconds": row.first_seconds,
        "figures": row.figures,
        "front": row.front,
        "failure": row.failure,
    }


def plot(results: Sequence[Result], path: Path) -> None:
    """Error against seconds, a panel a case, both axes logarithmic; the Pareto front joined by a line."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = math.ceil(math.sqrt(len(results)))
    rows = math.ceil(len(results) / columns)
    figure = Figure(figsize=(6.0 * columns, 5.0 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    for place, result in enumerate(results, 1):
        _panel(figure.add_subplot(rows, columns, place), result)
    with replacing(path) as aside:
        figure.savefig(aside, format=path.suffix.lstrip(".") or "png", dpi=120)


def _panel(axes: Any, result: Result) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    measured = {row.variant: row for row in result.rows if row.error and not row.failure}
    axes.set(title=result.case.name)
    if not measured:  # no error has a place on a logarithmic axis
        axes.text(0.5, 0.5, "no row with an error above 0", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    kinds: dict[str, list[Row]] = {}
    for variant, row in measured.items():
        kind = f"{variant.integrator if variant.substeps else 'static'}, {variant.precision}"
        kinds.setdefault(kind, []).append(row)
    for kind, rows in sorted(kinds.items()):
        axes.plot([row.seconds for row in rows], [row.error for row in rows], "o", label=kind)
    front = sorted((row.seconds, row.error) for row in measured.values() if row.front)
    axes.plot(*zip(*front, strict=True) if front else ((), ()), "k-", linewidth=1.0, label="Pareto front")
    axes.set(xscale="log", yscale="log", xlabel="seconds", ylabel="relative error")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize="small")
