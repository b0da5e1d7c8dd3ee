"""Time integrators: how the nodes' motion over a step follows from where they were.

The implicit ones share a scheme. With (x, v) at the step's start and (x', v') a step of length h' earlier,
    x_new = a (x) - b (x') + gamma h v_new,      v_new = a (v) - b (v') + gamma h M^-1 f(x_new),
so that x_new minimises |x - target|^2_M / (2 (gamma h)^2) + E(x).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

# Steps that grow faster than this are taken by backward Euler: variable BDF2 is unstable from 1 + sqrt 2 on.
MOST_GROWTH = 2.0


@dataclass(frozen=True)
class Scheme:
    """One implicit step. start, before: a and b; reach: gamma h [s]; length, length_before: h and h' [s]."""

    start: float
    before: float
    reach: float
    length: float
    length_before: float


def backward_euler(length: float, length_before: float) -> Scheme:
    """First order; damps what the step does not resolve."""
    return Scheme(1.0, 0.0, length, length, length_before)


def bdf2(length: float, length_before: float) -> Scheme:
    """Second order, with variable steps (Hairer, Norsett and Wanner, Solving ODEs I, III.5).

    length_before: 0 where there is no earlier state; backward Euler then.
    """
    if not 0.0 < length <= MOST_GROWTH * length_before:
        return backward_euler(length, length_before)
    ratio = length / length_before
    whole = 1.0 + 2.0 * ratio
    return Scheme(
        (1.0 + ratio) ** 2 / whole, ratio**2 / whole, length * (1.0 + ratio) / whole, length, length_before
    )


def symplectic_euler(length: float, length_before: float) -> Scheme:
    """First order, explicit, in steps of its own (see `explicit.py`); to contact it looks like backward Euler."""
    return backward_euler(length, length_before)


SCHEMES: dict[str, Callable[[float, float], Scheme]] = {
    "bdf2": bdf2,
    "backward-euler": backward_euler,
    "symplectic-euler": symplectic_euler,
}
