"""Damping by a background grid: velocities go to it and back, only what turns as a whole being kept in full.

Transfers are affine (APIC, Jiang et al. 2015; 2017 with RPIC damping), as in Han et al. 2019, section 4.2: node q
carries the velocity v_q + C_q (x - x_q) to the grid,
    v_i = sum_q w_iq m_q (v_q + C_q (x_i - x_q)) / m_i,      v_q = sum_i w_iq v_i,
and damping d replaces C by (1 - d) C + d (C - C^T) / 2. C is the velocity gradient that fits the node and its
neighbours best, so that nothing has to be carried along and rigid motions come back as they were.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.grid.sparse_grid import SparseGrid
from plait.solver.launch import Launcher
from plait.solver.linear.block_rows import incidences
from plait.solver.tets.layout import TetLayout
from plait.solver.tets.rpic_kernels import Star, fit_gradient, from_grid_to_free

GRADIENT_WORK, PARTICLE_WORK = 60, 20


class RpicDamping:
    """One body's, on a grid of its tets' mean edge."""

    def __init__(self, layout: TetLayout, body: int, damping: float, launcher: Launcher) -> None:
        """damping: d, 0 to 1."""
        self._launcher, self._damping, self._nodes = launcher, damping, layout.nodes(body)
        count, device = self._nodes.stop - self._nodes.start, launcher.device
        tets = layout.tets[layout.first_tet[body] : layout.first_tet[body + 1]] - self._nodes.start
        order, first = incidences(tets, count)
        self._star = Star()
        self._star.first = wp.array(first, dtype=wp.int32, device=device)
        self._star.corner = wp.array(order, dtype=wp.int32, device=device)
        self._star.tet = wp.array(tets, dtype=wp.vec4i, device=device)
        self._grid = SparseGrid(float(layout.edge[body]), launcher)
        self._gradient = wp.zeros(count, dtype=wp.mat33d, device=device)

    def apply(self, motion: Any) -> None:
        """To the velocities of the body's free nodes; `motion` as in `body_kernels`."""
        launch, grid, nodes = self._launcher.launch, self._grid, self._nodes
        position, velocity, mass, pinned = (
            field[nodes] for field in (motion.position, motion.velocity, motion.mass, motion.pinned)
        )
        count = len(self._gradient)
        inputs = [self._star, self._damping, mass, position, velocity]
        launch(fit_gradient, count, inputs, [self._gradient], work_per_item=GRADIENT_WORK)
        grid.place(np.asarray(position.numpy()))
        grid.to_grid_affine(mass, velocity, self._gradient)
        inputs = [grid.data, grid.velocity, pinned]
        launch(from_grid_to_free, count, inputs, [velocity], work_per_item=PARTICLE_WORK)
