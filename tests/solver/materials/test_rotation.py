"""The rotation of F = R S: the proper one nearest to F, without an SVD where that can be."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import warp as wp

from plait.solver.materials.rotation import ILL_FLOAT32, ILL_FLOAT64

from .law_probe import proper_svd, rotations, states, with_stretches

# Rounding, amplified by at most the inverse square of how ill-conditioned a state may be before the fall-back.
precisions = pytest.mark.parametrize(
    "real, tolerance",
    [
        (wp.float32, np.finfo(np.float32).eps / ILL_FLOAT32**2),
        (wp.float64, np.finfo(np.float64).eps / ILL_FLOAT64**2),
    ],
)


@precisions
def test_is_the_polar_factor(real, tolerance):
    """scipy's, where det F > 0."""
    F = states()
    F = F[np.linalg.det(F) > 1e-6]
    expected = np.array([scipy.linalg.polar(f)[0] for f in F])
    assert np.abs(rotations(F, real) - expected).max() < tolerance


@precisions
def test_mirrored_states_keep_a_proper_rotation(real, tolerance):
    """U V^T with the sign of det F on the least stretch: R is never a reflection."""
    rng = np.random.default_rng(3)
    F = with_stretches(np.c_[rng.uniform(0.8, 2.0, (200, 2)), -rng.uniform(0.0, 0.6, 200)], 3)
    U, _, V = proper_svd(F)
    assert np.abs(rotations(F, real) - U @ V.transpose(0, 2, 1)).max() < tolerance


@precisions
def test_any_state_has_a_rotation(real, tolerance):
    """Flat, rod-like, point-like, mirrored: R^T R = I, det R = 1, and tr(R^T F) is the greatest there is."""
    rng = np.random.default_rng(4)
    special = [[1, 1, 1], [1, 1, -1], [1, 1, 0], [1, 0, 0], [0, 0, 0], [2, 1e-3, -1e-3], [1e-4, 1e-4, 1e-4]]
    stretches = np.concatenate([special, rng.normal(size=(300, 3)) ** 3])
    F = np.concatenate([with_stretches(stretches, 5), np.array([np.diag(s) for s in special])])
    R = rotations(F, real).astype(float)
    assert np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max() < tolerance
    assert np.linalg.det(R).min() > 0.0
    _, s, _ = proper_svd(F)
    size = np.maximum(np.abs(s).max(axis=1), 1e-30)
    assert ((s.sum(axis=1) - np.einsum("nij,nij->n", R, F)) / size).max() < tolerance
