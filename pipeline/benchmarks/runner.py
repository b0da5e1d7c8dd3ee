"""Measures a case: errors against its reference, seconds, orders; failures keep rows of their own."""

from __future__ import annotations

import functools
import itertools
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from plait.pipeline.benchmarks.case import ORDER_MARGIN, Case, Hardware, Known, Outcome, Richardson, Variant

# Measured runs of a variant: the most, and the fewest, where these take longer than that [s], prepared and all.
REPEATS, FEWEST, LONG = 5, 3, 0.2
LEVELS = (1e-2, 1e-3)  # errors whose time to reach is reported

# Of one run: its outcome, or None; its seconds; why it failed, or ''.
Attempt = tuple[Outcome | None, float, str]


@dataclass(frozen=True)
class Row:
    """One variant's result. Errors are relative. A row with a `failure` is on no front, whatever else it has.

    seconds: median of the warm runs.  first_seconds: what the first run took beyond that: compiling, mostly.
    """

    ladder: str
    variant: Variant
    error: float | None = None
    seconds: float | None = None
    runs: tuple[float, ...] = ()
    first_seconds: float | None = None
    figures: dict[str, float] = field(default_factory=dict)
    failure: str = ""
    front: bool = False


@dataclass(frozen=True)
class Order:
    """How fast a ladder's results approach each other: log2 of successive differences' ratios, finest last."""

    ladder: str
    nominal: float
    observed: tuple[float, ...]


@dataclass(frozen=True)
class Result:
    """All that was measured of a case.

    reference_order: observed on a Richardson reference, None for a known one.
    failures: of the case as a whole (its reference), beside those of rows.
    time_to: level -> the fastest row at most that far off, None where none is.
    """

    case: Case
    rows: tuple[Row, ...]
    orders: tuple[Order, ...]
    reference_order: float | None
    failures: tuple[str, ...]
    time_to: dict[float, Row | None]

    @property
    def failed(self) -> bool:
        return bool(self.failures) or any(row.failure for row in self.rows)


def measure(
    case: Case,
    hardware: Hardware,
    *,
    clock: Callable[[], float] = time.perf_counter,
    step_done: Callable[[str], None] = lambda text: None,
) -> Result:
    """Runs every rung of every ladder of `case`, each once to warm up and `FEWEST` to `REPEATS` times measured.

    step_done: told after each variant, with what it was; called `step_count(case)` times.
    """
    # A variant that the reference was made with is warmed up.
    first = functools.cache(lambda variant: _attempt(case, variant, hardware, clock))
    reference, reference_order, failures = _reference(case, first, step_done)
    timings: dict[Variant, tuple[Row, np.ndarray | None]] = {}
    rows, orders = [], []
    for ladder in case.ladders:
        values = []
        for variant in ladder.variants:
            if variant not in timings:
                timings[variant] = _time(case, variant, hardware, clock, first(variant))
                step_done(f"{case.name} {ladder.name}")
            row, value = timings[variant]
            error = None if value is None or reference is None else case.error(value, reference)
            values.append(None if row.failure else value)
            rows.append(replace(row, ladder=ladder.name, error=error))
        if ladder.nominal_order is not None:
            observed = _observed_orders(case, values)
            orders.append(Order(ladder.name, ladder.nominal_order, observed))
    rows = _mark_front(rows)
    return Result(case, rows, tuple(orders), reference_order, failures, _time_to(rows))


def step_count(case: Case) -> int:
    """How many times `measure` calls `step_done`."""
    levels = len(case.reference.levels) if isinstance(case.reference, Richardson) else 0
    return levels + len({variant for ladder in case.ladders for variant in ladder.variants})


def _reference(
    case: Case, first: Callable[[Variant], Attempt], step_done: Callable[[str], None]
) -> tuple[np.ndarray | None, float | None, tuple[str, ...]]:
    """The reference value, the order observed on it, and why it cannot be relied on, if so."""
    if isinstance(case.reference, Known):
        return np.asarray(case.reference.value, float), None, ()
    values = []
    for variant in case.reference.levels:
        outcome, _, failure = first(variant)
        step_done(f"{case.name} reference")
        if failure:
            return None, None, (f"no reference: {failure} ({variant.label})",)
        values.append(outcome.value)
    nominal = case.reference.nominal_order
    order = _observed_orders(case, values)[0]
    extrapolated = values[2] + (values[2] - values[1]) / (2.0**nominal - 1.0)
    if abs(order - nominal) <= ORDER_MARGIN:
        return extrapolated, order, ()
    return extrapolated, order, (f"reference in doubt: its observed order is {order:.2f}, not {nominal:g}",)


def _time(
    case: Case, variant: Variant, hardware: Hardware, clock: Callable[[], float], first: Attempt
) -> tuple[Row, np.ndarray | None]:
    """The measured runs, after the `first` one."""
    outcome, first_seconds, failure = first
    runs, started = [], clock()
    while outcome is not None and _too_few(len(runs), clock() - started):
        outcome, seconds, failure = _attempt(case, variant, hardware, clock)
        runs.append(seconds)
    if outcome is None:
        return Row("", variant, failure=failure), None
    seconds = statistics.median(runs)
    beyond = max(0.0, first_seconds - seconds)
    return Row("", variant, None, seconds, tuple(runs), beyond, outcome.figures, failure), outcome.value


def _too_few(runs: int, seconds: float) -> bool:
    return runs < FEWEST or (runs < REPEATS and seconds < LONG)


def _attempt(case: Case, variant: Variant, hardware: Hardware, clock: Callable[[], float]) -> Attempt:
    """One run. Whatever goes wrong is a result here, to be reported in a row, so every exception is caught."""
    try:
        trial = case.prepare(variant, hardware)
        try:
            started = clock()
            outcome = trial.run()
            seconds = clock() - started
        finally:
            trial.close()
    except Exception as error:
        return None, 0.0, f"{type(error).__name__}: {error}"
    if not np.all(np.isfinite(outcome.value)):
        return None, seconds, "the result is not finite"
    return outcome, seconds, outcome.failure


def _observed_orders(case: Case, values: list[np.ndarray | None]) -> tuple[float, ...]:
    """log2(|u1 - u2| / |u2 - u3|) of each three successive rungs; nan where one failed or nothing changed."""
    steps = [
        np.nan if coarse is None or fine is None else case.error(coarse, fine)
        for coarse, fine in itertools.pairwise(values)
    ]
    with np.errstate(divide="ignore", invalid="ignore"):
        return tuple(float(np.log2(np.divide(*pair))) for pair in itertools.pairwise(steps))


def _mark_front(rows: list[Row]) -> tuple[Row, ...]:
    """Marks the rows that no other row beats in both error and seconds."""
    ranked = sorted(_solved(rows), key=lambda row: (row.seconds, row.error))
    front, least = set(), np.inf
    for row in ranked:
        if row.error < least:
            least = row.error
            front.add(row.variant)
    return tuple(replace(row, front=row.variant in front) for row in rows)


def _time_to(rows: Sequence[Row]) -> dict[float, Row | None]:
    reached = {level: [row for row in _solved(rows) if row.error <= level] for level in LEVELS}
    return {level: min(found, key=lambda row: row.seconds, default=None) for level, found in reached.items()}


def _solved(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row.error is not None and not row.failure]
