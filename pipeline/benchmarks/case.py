"""What a benchmark case is: data that one runner can measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

Integrator = Literal["backward-euler", "sdirk2", "bdf2", "symplectic-euler"]
Precision = Literal["float32", "float64"]

# How far an observed order may lie from the nominal one before a Richardson reference is in doubt.
ORDER_MARGIN = 0.2


class Hardware(NamedTuple):
    """Where a case runs: device as Warp names it, CPU threads."""

    device: str = "cpu"
    threads: int = 1


class Variant(NamedTuple):
    """One way of solving a case.

    segments: how many of `unit` there are.  substeps: between two samples of the result; 0 for a case that is
        static, where the integrator plays no part.
    tolerance: Newton's, as the settings of the solver in question mean it.
    """

    segments: int
    substeps: int
    tolerance: float
    integrator: Integrator = "backward-euler"
    precision: Precision = "float64"
    unit: str = "segments"

    @property
    def label(self) -> str:
        steps = f", {self.substeps} substeps, {self.integrator}" if self.substeps else ""
        return f"{self.segments} {self.unit}{steps}, tolerance {self.tolerance:g}, {self.precision}"


@dataclass(frozen=True)
class Ladder:
    """Variants that differ in one thing, coarsest first.

    nominal_order: where each rung is twice as fine as the one before, its error is 2 ** nominal_order times
        smaller; None where no order is to be expected (tolerances, float32's floor).
    """

    name: str
    variants: tuple[Variant, ...]
    nominal_order: float | None = None


class Outcome(NamedTuple):
    """What a run gave.

    value: (row_count, component_count), what the case measures.
    figures: what else is worth a column, e.g. {'iterations': 5}.
    failure: why this is no solution, for what all the same has a value (a solve that did not converge).
    """

    value: np.ndarray
    figures: dict[str, float]
    failure: str = ""


def unconverged(count: float, what: str) -> str:
    """`Outcome.failure` where so many of `what` did not converge."""
    return f"{count:g} {what} did not converge" if count else ""


class Trial(NamedTuple):
    """A case made ready: `run` is what is timed, `close` gives back what it held."""

    run: Callable[[], Outcome]
    close: Callable[[], None] = lambda: None


@dataclass(frozen=True)
class Known:
    """A reference from outside the solver. source: the equation or solution it is from."""

    value: np.ndarray
    source: str


@dataclass(frozen=True)
class Richardson:
    """A reference extrapolated from three runs, each twice as fine as the one before.

    It stands only if the order observed on the three is within `ORDER_MARGIN` of `nominal_order`.
    """

    levels: tuple[Variant, Variant, Variant]
    nominal_order: float


@dataclass(frozen=True)
class Case:
    """A question with a known answer.

    measure: what the error is, in words.
    scale: the error is the rms over the rows of |value - reference| / scale.
    prepare: builds what a variant needs; the runner times `Trial.run` alone.
    interval: [s] between samples, so that a step is interval / substeps; 0 for static cases.
    """

    name: str
    description: str
    measure: str
    scale: float
    prepare: Callable[[Variant, Hardware], Trial]
    reference: Known | Richardson
    ladders: tuple[Ladder, ...] = field(repr=False)
    interval: float = 0.0

    def error(self, value: np.ndarray, reference: np.ndarray) -> float:
        """Relative distance of `value` from `reference`, both (row_count, component_count)."""
        return float(np.sqrt(np.mean(np.sum((value - reference) ** 2, axis=1))) / self.scale)
