"""What an elastic body tells of itself."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Tally:
    """What a frame's steps took."""

    steps: int = 0
    newton_iterations: int = 0
    linear_iterations: int = 0
    unconverged: int = 0
    pops: int = 0
    tangles: int = 0


@dataclass(frozen=True)
class Report:
    """Of a body at a frame's end: energies [J], the smallest J of its tets, how many are inside out."""

    kinetic_energy: float
    elastic_energy: float
    potential_energy: float
    least_volume: float
    inverted: int
