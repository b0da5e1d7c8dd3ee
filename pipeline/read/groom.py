"""A strands prim on its way into the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd

from plait.pipeline.read.curves import Curves, Polylines
from plait.pipeline.read.parameters import Given
from plait.pipeline.read.roles import Role
from plait.pipeline.read.roots import Rooted


@dataclass(eq=False)
class Groom:
    """One strands prim: what is drawn, and what is found out about it.

    marked: (strand_count,) bool, marked as guides, by `mark`.
    leaders: the grooms whose simulated strands its curves follow; itself, where the unmarked follow the marked.
    guides, attachments: what is said of either in a report.
    """

    role: Role
    curves: Curves
    lines: Polylines
    given: Given
    marked: np.ndarray
    mark: str
    rooted: Rooted | None = None
    leaders: tuple[Groom, ...] = ()
    guides: str = ""
    attachments: tuple[str, ...] = ()

    @property
    def prim(self) -> Usd.Prim:
        return self.role.prim

    @property
    def path(self) -> str:
        return self.curves.path

    @property
    def free(self) -> np.ndarray:
        """(strand_count,) bool, strands that nothing holds at their roots."""
        return np.broadcast_to(self.given["free"], len(self.curves.counts))[self.lines.curves]

    @property
    def follows(self) -> bool:
        """Whether all its curves follow those of others."""
        return bool(self.leaders) and self not in self.leaders

    @property
    def simulated(self) -> np.ndarray:
        """(strand_count,) bool"""
        if not self.leaders:
            return np.ones(len(self.marked), dtype=bool)
        return np.zeros(len(self.marked), dtype=bool) if self.follows else self.marked
