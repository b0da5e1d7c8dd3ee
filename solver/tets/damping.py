"""Rayleigh's damping by the stiffness, made to leave rotations alone.

Over an implicit step, x = base + gamma h v, the power lost is that of a linear material turned with each tet:
with R its rotation, E = sym R^T (F(x) - F(base)) and V its volume, the step's potential gains
    V beta / (gamma h) (mu |E|^2 + lambda / 2 (tr E)^2).
R is taken where the velocity belongs: at the step's end for second order, halfway for backward Euler; a body that
turns as a whole then has no E to the order of the scheme.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from plait.solver.launch import Launcher
from plait.solver.tets.damping_kernels import damping_kernels
from plait.solver.tets.elements import element_types

LAY_WORK, FORCE_WORK, BLOCK_WORK = 8, 5, 12


class StiffnessDamping:
    """One body's; what it adds to the energy, forces and stiffness of its tets."""

    def __init__(self, elements: Any, coefficient: float, launcher: Launcher, real: type) -> None:
        """elements: struct `Elements`.  coefficient: beta [s]."""
        self._elements, self._launcher, self._coefficient = elements, launcher, coefficient
        self._count = len(elements.volume)
        self._kernels, device = damping_kernels(real), launcher.device
        self._data = self._kernels.types.Damping()
        self._data.rotation = wp.zeros(self._count, dtype=element_types(real).mat33, device=device)
        self._data.base = wp.zeros(self._count, dtype=wp.mat33d, device=device)

    def begin(self, start: wp.array, predicted: wp.array, base: wp.array, share: float, reach: float) -> None:
        """For a step of `reach` [s], from `start` to about `predicted`, (node_count,) vec3d, with velocities that
        belong to `share` of the way between them."""
        self._data.rate = self._coefficient / reach
        inputs = [self._elements, start, predicted, base, share]
        self._launcher.launch(self._kernels.lay, self._count, inputs, [self._data], work_per_item=LAY_WORK)

    def add_forces(self, position: wp.array, force_out: wp.array) -> None:
        """Onto (4 tet_count,) vec3 [N], at the tets' corners."""
        inputs = [self._elements, self._data, position]
        self._launcher.launch(self._kernels.force, self._count, inputs, [force_out], work_per_item=FORCE_WORK)

    def add_energy(self, position: wp.array, energy_out: wp.array) -> None:
        """Onto (tet_count,) float64 [J]."""
        inputs = [self._elements, self._data, position]
        self._launcher.launch(self._kernels.energy, self._count, inputs, [energy_out], work_per_item=FORCE_WORK)

    def add_stiffness(self, block_out: wp.array) -> None:
        """Onto (10 tet_count,) mat33 [N/m], in the order of `PAIRS`."""
        inputs = [self._elements, self._data]
        self._launcher.launch(self._kernels.stiffness, self._count, inputs, [block_out], work_per_item=BLOCK_WORK)
