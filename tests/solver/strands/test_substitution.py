"""M z = r with the factor that is kept, for dense M = L D L^T with the blocks of strands, clamped and free."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from plait.solver.strands.scratch import allocate_coupled_scratch
from plait.solver.strands.substitution import substitution
from plait.solver.strands.types import rod_types

REAL = wp.float64
TYPES = rod_types(REAL)
FUNCTIONS = substitution(REAL)
INVERT, DIVIDE, DIVIDE_END = FUNCTIONS.invert, FUNCTIONS.divide_unit, FUNCTIONS.divide_unit_end
SOLVE, Krylov = FUNCTIONS.solve, FUNCTIONS.Krylov
mat44, mat43 = TYPES.mat44, TYPES.mat43
Rods, Scratch = TYPES.Rods, TYPES.Scratch
SEGMENTS = 7


@wp.kernel(enable_backward=False, module="tests_substitution")
def keep(
    factor: wp.array(dtype=mat44), lower1: wp.array(dtype=mat44), lower2: wp.array(dtype=mat43), scratch: Scratch
):
    slot = wp.tid()
    scratch.inverse[slot] = INVERT(factor[slot])
    if slot >= 1:
        scratch.left1[slot] = DIVIDE(lower1[slot], factor[slot - 1])
    if slot >= 2:
        scratch.left2[slot] = DIVIDE_END(lower2[slot], factor[slot - 2])


@wp.kernel(enable_backward=False, module="tests_substitution")
def solve(rods: Rods, alpha: REAL, scratch: Scratch, krylov: Krylov, product_out: wp.array(dtype=wp.float64)):
    product_out[0] = SOLVE(rods, scratch, krylov, 0, alpha)


def factors(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(4 n, 4 n) L, unit lower triangular, and (4 n,) pivots; the turn two segments before takes no part."""
    lower = np.eye(4 * SEGMENTS).reshape(SEGMENTS, 4, SEGMENTS, 4)
    for k in range(SEGMENTS):
        lower[k, :, k] += np.tril(random.normal(size=(4, 4)), -1)
        if k >= 1:
            lower[k, :, k - 1] = random.normal(size=(4, 4))
        if k >= 2:
            lower[k, :, k - 2, 1:] = random.normal(size=(4, 3))
    flat = lower.reshape(4 * SEGMENTS, 4 * SEGMENTS)
    return flat, random.uniform(0.5, 2.0, 4 * SEGMENTS)


@pytest.mark.parametrize("free", [0, 1])
def test_solves_with_the_matrix_again_and_again(free: int) -> None:
    """M z = r - alpha q and r . z, to rounding times the condition of M."""
    random = np.random.default_rng(free)
    lower, pivots = factors(random)
    dense = lower @ np.diag(pivots) @ lower.T
    blocks = lower.reshape(SEGMENTS, 4, SEGMENTS, 4)
    # A free strand's segment 0 is at its base, a clamped one's segment 1.
    begin = 1 - free
    nodes = SEGMENTS + 1 + begin
    factor, lower1, lower2 = np.zeros((nodes, 4, 4)), np.zeros((nodes, 4, 4)), np.zeros((nodes, 4, 3))
    for k in range(SEGMENTS):
        factor[begin + k] = np.tril(blocks[k, :, k], -1) + np.diag(1.0 / pivots[4 * k : 4 * k + 4])
        if k >= 1:
            lower1[begin + k] = blocks[k, :, k - 1]
        if k >= 2:
            lower2[begin + k] = blocks[k, :, k - 2, 1:]
    scratch = allocate_coupled_scratch(REAL, nodes, wp.get_device("cpu"))
    given = [wp.array(a, dtype=t) for a, t in ((factor, mat44), (lower1, mat44), (lower2, mat43))]
    wp.launch(keep, nodes, given, [scratch], device="cpu")
    rods, krylov, product = Rods(), Krylov(), wp.zeros(1, dtype=wp.float64)
    rods.first_node, rods.free = wp.array([0, nodes], dtype=wp.int32), wp.array([free], dtype=wp.int32)
    right, image, direction, step = random.normal(size=(4, nodes, 4))
    scratch.right = wp.array(right, dtype=TYPES.vec4)
    krylov.image, krylov.direction, krylov.step = (wp.array(a, dtype=TYPES.vec4) for a in (image, direction, step))
    alpha = 0.7
    wp.launch(solve, 1, [rods, alpha], [scratch, krylov, product], device="cpu")

    own = slice(begin, begin + SEGMENTS)
    left = (right - alpha * image)[own].ravel()
    exact = np.linalg.solve(dense, left)
    tolerance = np.linalg.cond(dense) * dense.shape[0] * np.finfo(float).eps
    z = scratch.solution.numpy()[own].ravel()
    assert np.linalg.norm(z - exact) <= tolerance * np.linalg.norm(exact)
    assert product.numpy()[0] == pytest.approx(left @ exact, rel=tolerance)
    assert scratch.right.numpy()[own].ravel() == pytest.approx(left, abs=1e-14)
    assert krylov.step.numpy()[own] == pytest.approx((step + alpha * direction)[own], abs=1e-14)
    assert tolerance < 1e-3
