"""A preconditioner's coarse part: the elasticity at rest on nested grids, turned with the material.

With R_i how the material around unknown i has turned and P the trilinear weights from the finest grid, of about
twice the tets' size, it adds
    z += R P C P^T R^T r,
C being one multigrid cycle (a damped block Jacobi step before and after) for the stiffness of the undeformed body
and the step's inertia. All that is laid out once; a step renews rotations and, if its length changed, diagonals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.linear.block_rows import BlockRows
from plait.solver.linear.coarse_kernels import coarse_kernels
from plait.solver.linear.conjugate_gradients import ConjugateGradients
from plait.solver.linear.grids import CORNERS, Grid, lay_grid, transpose

# Grids are made until one has so few nodes that its matrix is inverted outright.
COARSEST = 48
POWER_ITERATIONS = 20
# Of the smoother: safely under 2, and best for the upper half of the spectrum at 4 / 3.
DAMPING = 4.0 / 3.0
ROW_WORK, PROLONG_WORK = 10, 4


@dataclass(frozen=True)
class Material:
    """What the coarse stiffness is made of, at rest.

    points: (unknown_count, 3) float64 [m].
    stiffness, penalty: (unknown_count,) [N/m] on the diagonal: of each unknown, and towards pinned nodes alone.
    centres: (tet_count, 3) float64 [m].  mu, lam: (tet_count,) [N m] Lame parameters times volume.
    edge: [m] mean edge of the tets.
    """

    points: np.ndarray
    stiffness: np.ndarray
    penalty: np.ndarray
    centres: np.ndarray
    mu: np.ndarray
    lam: np.ndarray
    edge: float


class CoarseCorrection:
    """`Correction` for one body's unknowns.

    turn: (unknown_count,) mat33, the rotations; to be kept up to date by the owner through `turn_with`.
    """

    def __init__(
        self, material: Material, gradients: ConjugateGradients, rows: BlockRows, launcher: Launcher, real: type
    ) -> None:
        self._launcher, self._rows, self._real = launcher, rows, real
        self._kernels = coarse_kernels(real)
        self._krylov = gradients.krylov
        count, device = len(material.points), launcher.device
        self.turn = wp.zeros(count, dtype=self._kernels.types.mat33, device=device)
        grids = [lay_grid(material.points, 2.2 * material.edge)]
        while grids[-1].count > COARSEST and (len(grids) == 1 or grids[-1].count < grids[-2].count):
            grids.append(grids[-1].coarsen())
        self._levels = [self._lay_out(grid) for grid in grids]
        self._assemble(material, grids)
        self._inverse = wp.zeros((3 * grids[-1].count) ** 2, dtype=real, device=device)
        self._stiffness = _dense(self._levels[-1])
        self._find_damping()
        self._prepare(gradients.chunk_count)

    # -- building ------------------------------------------------------------------------------------------

    def _hold(self, values: np.ndarray, dtype: Any = wp.int32) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self._launcher.device)

    def _lay_out(self, grid: Grid) -> Any:
        types, real, device = self._kernels.types, self._real, self._launcher.device
        level = types.Level()
        first, column, _ = grid.pattern()
        level.first_block, level.column = self._hold(first), self._hold(column)
        level.block = wp.zeros(len(column), dtype=types.mat33, device=device)
        first, child, weight = transpose(grid.parent, grid.weight, grid.count)
        level.first_child, level.child = self._hold(first), self._hold(child)
        level.child_weight = self._hold(weight, real)
        level.parent, level.parent_weight = (
            self._hold(grid.parent, types.vec8i),
            self._hold(grid.weight, types.vec8),
        )
        level.weight = wp.zeros(grid.count, dtype=real, device=device)
        level.smoother = wp.zeros(grid.count, dtype=types.mat33, device=device)
        level.damping = wp.ones(1, dtype=real, device=device)
        for name in ("residual", "solution", "spare"):
            setattr(level, name, wp.zeros(grid.count, dtype=types.vec3, device=device))
        return level

    def _assemble(self, material: Material, grids: list[Grid]) -> None:
        launch, kernels, levels = self._launcher.launch, self._kernels, self._levels
        first, child, weight = transpose(grids[0].parent, grids[0].weight, grids[0].count)
        rows = np.repeat(np.arange(grids[0].count), np.diff(first))
        penalty = np.bincount(rows, weight * material.penalty[child], minlength=grids[0].count)
        cells = self._sort_into_cells(material, grids[0])
        inputs = [cells, self._hold(penalty, self._real)]
        launch(kernels.assemble_cells, grids[0].count, inputs, [levels[0]], work_per_item=1000)
        for grid, finer, level in zip(grids[1:], levels[:-1], levels[1:], strict=True):
            inputs = [self._hold(grid.pattern()[2]), self._hold(grid.index, wp.vec3i), finer]
            launch(kernels.assemble_coarser, grid.count, inputs, [level], work_per_item=1000)

    def _sort_into_cells(self, material: Material, grid: Grid) -> Any:
        """Tets whose centre's cell has no node are left out: no unknown near them."""
        place = (material.centres - grid.origin) / grid.spacing
        limit = np.array(grid.number.shape) - 3
        lower = np.clip(np.floor(place).astype(np.int64), -1, limit)
        keys, cell = np.unique(np.ravel_multi_index(tuple((lower + 1).T), grid.number.shape), return_inverse=True)
        order = np.argsort(cell, kind="stable")
        number = np.full(grid.number.size, -1, dtype=np.int64)
        number[keys] = np.arange(len(keys))
        mine = number.reshape(grid.number.shape)[tuple(np.moveaxis(grid.index[:, None] - CORNERS + 1, -1, 0))]
        cells = self._kernels.types.Cells()
        cells.cell, cells.slot = self._hold(mine), self._hold(grid.pattern()[2])
        cells.first_tet = self._hold(np.searchsorted(cell[order], np.arange(len(keys) + 1)))
        cells.place = self._hold((place - lower)[order], self._kernels.types.vec3)
        cells.mu = self._hold(material.mu[order] / grid.spacing**2, self._real)
        cells.lam = self._hold(material.lam[order] / grid.spacing**2, self._real)
        return cells

    def _prepare(self, chunks: int) -> None:
        """The launches of a cycle: down the levels, and up again."""
        kernels, levels, prepare = self._kernels, self._levels, self._launcher.prepare
        counts = [len(level.residual) for level in levels]

        def on(k: int, kernel: wp.Kernel, inputs: list[Any], work: int) -> Any:
            return prepare(kernel, counts[k], inputs, [levels[k]], work_per_item=work)

        inputs = [self._krylov.residual, self.turn]
        self._cycle = [on(0, kernels.restrict_turned, inputs, ROW_WORK)]
        for k in range(1, len(levels)):
            self._cycle.append(on(k - 1, kernels.find_rest, [], ROW_WORK))
            self._cycle.append(on(k, kernels.restrict, [levels[k - 1]], ROW_WORK))
        self._cycle.append(on(len(levels) - 1, kernels.solve_coarsest, [self._inverse], COARSEST))
        for k in reversed(range(len(levels) - 1)):
            self._cycle.append(on(k, kernels.prolong, [levels[k + 1]], PROLONG_WORK))
            self._cycle.append(on(k, kernels.smooth, [], ROW_WORK))
        self._add = [
            prepare(
                kernels.prolong_turned,
                chunks,
                [levels[0], self.turn, parity],
                [self._krylov],
                work_per_item=PROLONG_WORK * self._krylov.chunk,
            )
            for parity in (0, 1)
        ]

    # -- use -------------------------------------------------------------------------------------------------

    def weigh(self, weight: wp.array) -> None:
        """Takes up the diagonal of a step, (unknown_count,) real [N/m]."""
        launch, kernels = self._launcher.launch, self._kernels
        for level in self._levels:
            launch(kernels.restrict_weight, len(level.weight), [weight], [level])
            weight = level.weight
        for level in self._levels:
            launch(kernels.prepare_smoother, len(level.weight), [], [level])
        dense = self._stiffness + np.diag(np.repeat(self._levels[-1].weight.numpy().astype(np.float64), 3))
        self._inverse.assign(np.linalg.inv(dense).ravel())

    def turn_with(self, volume: wp.array, gradient: wp.array) -> None:
        """Takes the rotations from the tets around each unknown: (tet_count,) real and mat33."""
        inputs = [self._rows.incidence, volume, gradient]
        self._launcher.launch(
            self._kernels.turn_nodes, self._rows.count, inputs, [self.turn], work_per_item=ROW_WORK
        )

    def add(self, parity: int) -> None:
        """z += R P C P^T R^T r, and r . z anew into `descent[parity]`."""
        for launch in self._cycle:
            launch()
        self._add[parity]()

    def _find_damping(self) -> None:
        """From the largest eigenvalue of D^-1 K of each level, by power iteration; inertia only lowers it."""
        launch, kernels = self._launcher.launch, self._kernels
        for level in self._levels[:-1]:
            count = len(level.weight)
            launch(kernels.prepare_smoother, count, [], [level])
            level.residual.zero_()
            vector = np.random.default_rng(0).standard_normal((count, 3))
            for _ in range(POWER_ITERATIONS):
                vector /= np.linalg.norm(vector)
                level.solution.assign(vector)
                launch(kernels.smooth, count, [], [level])
                vector = vector - level.spare.numpy()
            level.damping.fill_(DAMPING / float(np.linalg.norm(vector)))


def _dense(level: Any) -> np.ndarray:
    """A level's stiffness as a (3 count, 3 count) float64 matrix."""
    first, column, block = level.first_block.numpy(), level.column.numpy(), level.block.numpy()
    count = len(first) - 1
    dense = np.zeros((count, 3, count, 3))
    dense[np.repeat(np.arange(count), np.diff(first)), :, column] = block
    return dense.reshape(3 * count, 3 * count)
