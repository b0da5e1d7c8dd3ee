"""Linear solves of a body's step against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.linear.block_rows import BlockRows
from plait.solver.scene import Scene
from plait.solver.tets.elements import PAIRS
from plait.solver.tets.layout import TetLayout, build_layout
from plait.solver.tets.newton import Newton

from ..tets.lattices import box_body


def _layout(cells: tuple[int, int, int]) -> TetLayout:
    size = tuple(0.1 * count for count in cells)
    rest, _ = box_body(size, cells)
    body, skin = box_body(size, cells, pinned=np.isclose(rest.nodes[:, 0], rest.nodes[:, 0].min()))
    return build_layout(Scene(surfaces=(skin,), bodies=(body,)))


def _newton(cells: tuple[int, int, int], weight: float, real: type = wp.float64) -> tuple[Newton, np.ndarray]:
    """A clamped bar at rest, `weight` [N/m] on the diagonal of each unknown; the solver and its free nodes."""
    layout = _layout(cells)
    launcher = Launcher("cpu", 1)
    free = np.flatnonzero(~layout.pinned).astype(np.int32)
    newton = Newton(layout, 0, free, wp.array(layout.rest, dtype=wp.vec3d, device="cpu"), launcher, real)
    newton.unknowns.weight.fill_(weight)
    newton.assemble("semi_definite")
    return newton, free


def _dense(rows: BlockRows) -> np.ndarray:
    matrix = np.zeros((rows.count, 3, rows.count, 3))
    row = np.repeat(np.arange(rows.count), np.diff(rows.first_block))
    matrix[row, :, rows.column] = rows.data.block.numpy()
    return matrix.reshape(3 * rows.count, 3 * rows.count)


def test_rows_are_the_sum_of_the_tets():
    """Each block of a tet, and its transpose, where its corners are unknowns; the weight on the diagonal."""
    layout = _layout((2, 2, 2))
    launcher = Launcher("cpu", 1)
    unknown = np.full(layout.node_count, -1)
    unknown[~layout.pinned] = np.arange((~layout.pinned).sum())
    rows = BlockRows(unknown[layout.tets], int((~layout.pinned).sum()), launcher, wp.float64)
    blocks = np.random.default_rng(0).standard_normal((len(layout.tets), 10, 3, 3))
    blocks[:, :4] += np.swapaxes(blocks[:, :4], 2, 3)
    weight = np.random.default_rng(1).uniform(50.0, 60.0, rows.count)
    rows.assemble(
        wp.array(blocks.reshape(-1, 3, 3), dtype=wp.mat33d, device="cpu"),
        wp.array(weight, dtype=wp.float64, device="cpu"),
    )
    expected = np.zeros((rows.count, 3, rows.count, 3))
    for tet, stored in zip(unknown[layout.tets], blocks, strict=True):
        for (a, b), block in zip(PAIRS, stored, strict=True):
            if tet[a] >= 0 and tet[b] >= 0:
                expected[tet[a], :, tet[b]] += block
                if a != b:
                    expected[tet[b], :, tet[a]] += block.T
    expected = expected.reshape(3 * rows.count, -1) + np.diag(np.repeat(weight, 3))
    np.testing.assert_allclose(_dense(rows), expected, atol=1e-12)


@pytest.mark.parametrize("coarse", [False, True])
def test_conjugate_gradients_solve(coarse):
    """To the tolerance asked for, with and without the coarse correction."""
    newton, _ = _newton((6, 3, 3), weight=1.0)
    gradients, load = newton.gradients, np.random.default_rng(0).standard_normal((newton.rows.count, 3))
    correction = newton.choose_correction(reach=1e3) if coarse else None
    gradients.krylov.residual.assign(load)
    gradients.solve(1e-10, 1000, correction)
    exact = np.linalg.solve(_dense(newton.rows), load.ravel())
    error = np.abs(gradients.krylov.solution.numpy().ravel() - exact).max()
    assert gradients.definite and error <= 1e-8 * np.abs(exact).max()


def test_an_indefinite_matrix_is_noticed():
    newton, _ = _newton((3, 2, 2), weight=-1e7)
    newton.gradients.krylov.residual.assign(np.ones((newton.rows.count, 3)))
    newton.gradients.solve(1e-6, 100)
    assert not newton.gradients.definite


def test_the_coarse_correction_is_symmetric_and_positive():
    """z = D^-1 r + R P C P^T R^T r as a matrix, column by column: what conjugate gradients need of it."""
    newton, _ = _newton((4, 2, 2), weight=10.0)
    krylov, correction = newton.gradients.krylov, newton.choose_correction(reach=1e3)
    size = 3 * newton.rows.count
    columns = np.empty((size, size))
    for k in range(size):
        krylov.residual.assign(np.eye(size)[k].reshape(-1, 3))
        krylov.preconditioned.zero_()
        correction.add(0)
        columns[:, k] = krylov.preconditioned.numpy().ravel()
        assert krylov.descent.numpy()[0].sum() == pytest.approx(columns[k, k], abs=1e-14)
    np.testing.assert_allclose(columns, columns.T, atol=1e-12 * np.abs(columns).max())
    assert np.linalg.eigvalsh(0.5 * (columns + columns.T)).min() >= -1e-12 * np.abs(columns).max()


def test_iterations_do_not_grow_with_refinement():
    """Statics of a bar, refined twice: the block diagonal needs ever more, the correction hardly any."""
    taken = []
    for cells in ((8, 2, 2), (32, 8, 8)):
        newton, _ = _newton(cells, weight=1e-3, real=wp.float32)
        load = np.ones((newton.rows.count, 3))
        each = []
        for correction in (None, newton.choose_correction(reach=1e3)):
            newton.gradients.krylov.residual.assign(load)
            each.append(newton.gradients.solve(1e-3, 2000, correction))
        taken.append(each)
    (alone, corrected), (alone_fine, corrected_fine) = taken
    assert alone_fine > 2.5 * alone
    assert corrected_fine <= 1.5 * corrected + 5 and corrected_fine < 0.2 * alone_fine
