"""Sparse symmetric matrices of 3x3 blocks in compressed rows, assembled from tets."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.linear.block_kernels import block_kernels

# Cost of a row's assembly and product in units of `Launcher.launch`.
ASSEMBLY_WORK, PRODUCT_WORK = 40, 5


class BlockRows:
    """The matrix that tets couple `count` unknown vectors by, with its pattern fixed.

    data: struct `Rows` of `block_kernels`: first_block (count + 1,), column and block (block_count,),
        inverse_diagonal (count,).
    incidence: struct `Incidence`: where in the tets' arrays the entries of each row come from.
    """

    def __init__(self, corners: np.ndarray, count: int, launcher: Launcher, real: type) -> None:
        """corners: (tet_count, 4) int, the unknown at each corner, or -1 where there is none."""
        self.count, self._launcher = count, launcher
        self._kernels = block_kernels(real)
        device = launcher.device
        first, column = _pattern(corners, count)
        self.first_block, self.column = first, column
        order, first_incidence = incidences(corners, count)
        self._slots = _slots(corners, order, first, column)

        def hold(values: np.ndarray, dtype: Any = wp.int32) -> wp.array:
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

        types = self._kernels.types
        self.data = types.Rows()
        self.data.first_block, self.data.column = hold(first), hold(column)
        self.data.block = wp.zeros(len(column), dtype=types.mat33, device=device)
        self.data.inverse_diagonal = wp.zeros(count, dtype=types.mat33, device=device)
        self.incidence = types.Incidence()
        self.incidence.first = hold(first_incidence)
        self.incidence.corner = hold(order)
        self.incidence.slot = hold(self._slots, wp.vec4i)

    def assemble(self, tet_block: wp.array, weight: wp.array) -> None:
        """Sums the tets' blocks (see `elements.PAIRS`) and the diagonal `weight`, (count,) real [N/m]."""
        self._launcher.launch(
            self._kernels.assemble,
            self.count,
            [self.incidence, tet_block, weight],
            [self.data],
            work_per_item=ASSEMBLY_WORK,
        )


def _pattern(corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """first_block and column of the rows, columns ascending, the diagonal among them."""
    pairs = np.array([(a, b) for a in range(4) for b in range(a + 1, 4)])
    ends = np.sort(corners[:, pairs].reshape(-1, 2), axis=1).astype(np.int64)
    ends = ends[ends[:, 0] >= 0]
    edges = np.unique(ends[:, 0] * count + ends[:, 1])
    lower, upper = edges // count, edges % count
    here = np.arange(count, dtype=np.int64)
    keys = np.sort(np.concatenate([edges, upper * count + lower, here * count + here]))
    row = keys // count
    return np.searchsorted(row, np.arange(count + 1)).astype(np.int32), (keys % count).astype(np.int32)


def incidences(corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Entries 4 t + a of `corners` row by row, in ascending order, and where each row begins."""
    flat = corners.ravel()
    order = np.argsort(flat, kind="stable")
    order = order[np.searchsorted(flat[order], 0) :]
    return order.astype(np.int32), np.searchsorted(flat[order], np.arange(count + 1)).astype(np.int32)


def _slots(corners: np.ndarray, order: np.ndarray, first: np.ndarray, column: np.ndarray) -> np.ndarray:
    """(incidence_count, 4): which block the corners of an entry's tet have in the entry's row; -1 for none."""
    count = np.int64(len(first) - 1)
    keys = np.repeat(np.arange(count), np.diff(first)) * count + column
    others = corners[order // 4].astype(np.int64)
    wanted = corners.ravel()[order].astype(np.int64)[:, None] * count + others
    return np.where(others >= 0, np.searchsorted(keys, wanted), -1).astype(np.int32)
