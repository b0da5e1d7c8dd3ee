"""Constitutive laws: derivatives, projection, objectivity, and closed-form homogeneous states."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.materials.laws import LAWS

from .law_probe import LAM, MU, energy_and_stress, hessian, random_rotations, states

STEP = 2e-5  # central differences: error STEP^2 times the third derivative, and rounding over STEP
each_law = pytest.mark.parametrize("law", sorted(LAWS))


def perturbed(F: np.ndarray) -> np.ndarray:
    """(2, 9, n, 3, 3): each entry of F a step up, and down."""
    steps = STEP * np.eye(9).reshape(9, 1, 3, 3)
    return np.stack([F + steps, F - steps])


@each_law
def test_stress_is_the_energys_derivative(law):
    """P = d psi / dF, to 1e-8 of the stress."""
    F = states()
    up, down = energy_and_stress(law, perturbed(F).reshape(-1, 3, 3))[0].reshape(2, 9, len(F))
    expected = ((up - down) / (2.0 * STEP)).T.reshape(-1, 3, 3)
    stress = energy_and_stress(law, F)[1]
    scale = np.maximum(1.0, np.abs(stress).max(axis=(1, 2)))
    assert (np.abs(stress - expected).max(axis=(1, 2)) / scale).max() < 1e-8


@each_law
def test_hessian_is_the_stresss_derivative(law):
    """d P / dF, to 1e-7 of its norm."""
    F = states()
    up, down = energy_and_stress(law, perturbed(F).reshape(-1, 3, 3))[1].reshape(2, 9, len(F), 9)
    expected = ((up - down) / (2.0 * STEP)).transpose(1, 2, 0)
    exact = hessian(law, F)
    norm = np.linalg.norm(exact, axis=(1, 2))
    assert (np.linalg.norm(exact - expected, axis=(1, 2)) / norm).max() < 1e-7


@each_law
def test_projection_is_that_of_the_eigenvalues(law):
    """Negative eigenvalues made zero, the rest kept: as numpy's eigh does it."""
    F = states(1)
    exact = hessian(law, F)
    values, vectors = np.linalg.eigh(exact)
    assert (values < -1e-3).any(axis=1).mean() > 0.2  # there is something to project
    expected = np.einsum("nij,nj,nkj->nik", vectors, np.maximum(values, 0.0), vectors)
    projected = hessian(law, F, floor=0.0)
    norm = np.linalg.norm(exact, axis=(1, 2))
    assert (np.linalg.norm(projected - expected, axis=(1, 2)) / norm).max() < 1e-10


@each_law
def test_agrees_with_linear_elasticity_at_rest(law):
    """psi(I) = 0, P(I) = 0, dP = 2 mu sym(dF) + lambda tr(dF) I at rest."""
    rest = np.eye(3)[None]
    energy, stress = energy_and_stress(law, rest)
    assert abs(energy[0]) < 1e-15 and np.abs(stress).max() < 1e-15
    d = np.eye(3)
    expected = MU * (np.einsum("ik,jl->ijkl", d, d) + np.einsum("il,jk->ijkl", d, d))
    expected += LAM * np.einsum("ij,kl->ijkl", d, d)
    np.testing.assert_allclose(hessian(law, rest)[0], expected.reshape(9, 9), atol=1e-12)


@each_law
def test_objective_and_isotropic(law):
    """psi(Q F) = psi(F Q) = psi(F), P(Q F) = Q P(F), P(F Q) = P(F) Q for rotations Q."""
    F = states(2)
    Q = random_rotations(len(F), 9)
    energy, stress = energy_and_stress(law, F)
    before, stress_before = energy_and_stress(law, Q @ F)
    after, stress_after = energy_and_stress(law, F @ Q)
    np.testing.assert_allclose(before, energy, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(after, energy, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(stress_before, Q @ stress, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(stress_after, stress @ Q, rtol=1e-11, atol=1e-11)


def test_fixed_corotated_homogeneous_states(shared):
    """Uniaxial, equibiaxial, dilation and uniaxial strain at E = 1 against the reference values, to 1e-10."""
    rows = np.loadtxt(shared / "references/fixed_corotated_homogeneous_E1.csv", delimiter=",", skiprows=1)
    nu, stretch, lateral, uniaxial, thickness, equibiaxial, dilation, strain = rows.T
    mu, lam = 1.0 / (2.0 * (1.0 + nu)), nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    one, zero = np.ones_like(stretch), np.zeros_like(stretch)
    cases = (
        ((stretch, lateral, lateral), (uniaxial, zero, zero)),
        ((stretch, stretch, thickness), (equibiaxial, equibiaxial, zero)),
        ((stretch, stretch, stretch), (dilation, dilation, dilation)),
        ((stretch, one, one), (strain, lam * (stretch - 1.0) * stretch, lam * (stretch - 1.0) * stretch)),
    )
    for diagonal, expected in cases:
        F = np.einsum("kn,kij->nij", np.array(diagonal), np.eye(3)[:, :, None] * np.eye(3)[:, None, :])
        _, stress = energy_and_stress("fixed-corotated", F, mu, lam)
        np.testing.assert_allclose(np.einsum("nii->in", stress), np.array(expected), atol=1e-10)
