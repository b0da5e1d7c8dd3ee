"""Counts strands that have passed through each other: an independent judge of what was committed."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.strand_contact.edge_pairs import EdgePairs
from plait.solver.strand_contact.missed_kernels import find_missed
from plait.solver.strands.layout import Layout

# Cost of a pair in units of `Launcher.launch`.
PAIR_WORK = 20


class MissedCollisions:
    """Pairs of edges that touch at any time between two poses, their nodes moving linearly.

    Every pair of edges without a common node is looked at whose swept boxes overlap, without any padding; whether
    they touch is told by the roots of the cubic of coplanarity (`missed_kernels`), nothing that the solver uses to
    keep strands apart. Edges nearer than 1e-9 of their length touch. Edges drawn through each other are left out.

    pairs: (n, 2) int32, edges (a, b) that touched in the last `count`.
    """

    def __init__(self, launcher: Launcher, layout: Layout) -> None:
        self._launcher = launcher
        nowhere = np.zeros(layout.node_count)
        self._drawn = wp.array(layout.position, dtype=wp.vec3d, device=launcher.device)
        self._radius = wp.array(layout.radius, dtype=wp.float64, device=launcher.device)
        self._edge_pairs = EdgePairs(
            launcher, layout, nowhere, prescribed=nowhere > 0.0, straight=np.inf, near_only=False
        )
        self.pairs = np.zeros((0, 2), dtype=np.int32)

    def count(self, start: wp.array, end: wp.array) -> int:
        """How many pairs touched. start, end: (node_count,) vec3d [m] world, two poses in turn."""
        found = self._edge_pairs
        found.find(start, end)
        missed = wp.empty(found.count, dtype=wp.int32, device=self._launcher.device)
        inputs = [found.pairs, self._drawn, self._radius, start, end]
        self._launcher.launch(find_missed, found.count, inputs, [missed], work_per_item=PAIR_WORK)
        self.pairs = found.pairs.numpy()[missed.numpy() == 1]
        return len(self.pairs)
