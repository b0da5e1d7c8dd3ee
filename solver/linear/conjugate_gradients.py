"""Preconditioned conjugate gradients on block rows, in two launches an iteration."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.linear.block_kernels import block_kernels
from plait.solver.linear.block_rows import PRODUCT_WORK, BlockRows
from plait.solver.linear.chunks import chunk_size, reader

UPDATE_WORK = 2
# On a GPU each look at the residual waits for the device.
LOOK_EVERY_CUDA = 8


class Correction(Protocol):
    """What a preconditioner adds to the block diagonal's."""

    def add(self, parity: int) -> None:
        """z += C r, and r . z anew into `descent[parity]`."""


class Reduction(Protocol):
    """What is taken off the matrix."""

    def subtract(self, krylov: Any) -> None:
        """From the product with z, and from z . A z."""


class ConjugateGradients:
    """Solves A x = b with the inverse diagonal blocks as preconditioner, and what `correction` adds to it.

    The recurrences are those of Chronopoulos and Gear 1989 (one product, one pass over the vectors an iteration).
    Sums are taken over chunks of fixed size, so their bits do not depend on the number of threads.

    reduction: taken off the matrix of the rows, if any; what is left is positive definite.
    krylov: struct `Krylov`; `residual` is b before and what remains of it after `solve`, `solution` is x.
    """

    def __init__(self, rows: BlockRows, launcher: Launcher, real: type) -> None:
        self._launcher, self._rows = launcher, rows
        self._kernels = block_kernels(real)
        types, device, count = self._kernels.types, launcher.device, rows.count
        krylov = types.Krylov()
        krylov.chunk = chunk_size(count, device)
        self.count = count
        self.chunk_count = chunks = -(-count // krylov.chunk)
        names = ("solution", "residual", "preconditioned", "product", "direction", "direction_product")
        for name in names:
            setattr(krylov, name, wp.zeros(count, dtype=types.vec3, device=device))
        krylov.descent = wp.zeros((2, chunks), dtype=wp.float64, device=device)
        krylov.curvature = wp.zeros(chunks, dtype=wp.float64, device=device)
        krylov.residual_square = wp.zeros(chunks, dtype=wp.float64, device=device)
        krylov.memory = wp.zeros((2, 2), dtype=wp.float64, device=device)
        self.krylov = krylov
        self._memory, self._squares = reader(krylov.memory), reader(krylov.residual_square)
        kernels, data, a_row = self._kernels, rows.data, krylov.chunk
        prepare = launcher.prepare
        self._begin = prepare(kernels.begin, chunks, [data], [krylov], work_per_item=UPDATE_WORK * a_row)
        self._multiply = prepare(kernels.multiply, chunks, [data], [krylov], work_per_item=PRODUCT_WORK * a_row)
        self._update = [
            prepare(kernels.update, chunks, [data, krylov, parity], work_per_item=UPDATE_WORK * a_row)
            for parity in (0, 1)
        ]
        self.reduction: Reduction | None = None
        self._look_every = LOOK_EVERY_CUDA if device.is_cuda else 1

    def solve(self, tolerance: float, max_iterations: int, correction: Correction | None = None) -> int:
        """Until |b - A x| <= tolerance |b|, or A proves not to be positive definite; the number of iterations.

        Then x is what had been found before, which reduces b . x / 2 (Steihaug 1983), and `definite` is False.
        """
        self.definite = True
        self._begin()
        if correction is not None:
            correction.add(0)
        aim = tolerance**2 * self._residual_square()
        for iteration in range(max_iterations):
            if iteration % self._look_every == 0 and self._residual_square() <= aim:
                return iteration
            parity = iteration % 2
            self._multiply()
            if self.reduction is not None:
                self.reduction.subtract(self.krylov)
            self._update[parity]()
            if iteration % self._look_every == 0 and self._memory()[parity, 1] == 0.0:
                self.definite = False
                return iteration + 1
            if correction is not None:
                correction.add(1 - parity)
        return max_iterations

    def _residual_square(self) -> float:
        return float(np.sum(self._squares()))
