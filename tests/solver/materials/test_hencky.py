"""Hencky elasticity and Coulomb's return mapping: derivatives, admissible states, and known ones."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import warp as wp

from plait.solver.materials.drucker_prager import cone_slope, drucker_prager

from .law_probe import LAM, MU, energy_and_stress, random_rotations, with_stretches

STEP = 2e-5  # central differences: error STEP^2 times the third derivative, and rounding over STEP
FRICTION = 0.4
SLOPE = float(cone_slope(np.array(FRICTION)))


@cache
def _kernel() -> wp.Kernel:
    project = drucker_prager(wp.float64).project

    @wp.kernel(enable_backward=False, module="tests_drucker_prager")
    def kernel(
        F: wp.array(dtype=wp.mat33d),
        gained: wp.array(dtype=wp.float64),
        mu: wp.float64,
        lam: wp.float64,
        alpha: wp.float64,
        upright: wp.array(dtype=wp.int32),
    ):
        i = wp.tid()
        elastic, more, fine = project(F[i], gained[i], mu, lam, alpha)
        F[i] = elastic
        gained[i] = more
        upright[i] = wp.where(fine, 1, 0)

    return kernel


def projected(F: np.ndarray, gained: float | np.ndarray = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """F^E, the volume gained and whether F was one, after the return mapping."""
    count = len(F)
    elastic = wp.array(F, dtype=wp.mat33d, device="cpu")
    volume = wp.array(np.broadcast_to(gained, count).astype(float), dtype=wp.float64, device="cpu")
    upright = wp.zeros(count, dtype=wp.int32, device="cpu")
    wp.launch(_kernel(), count, [elastic, volume, MU, LAM, SLOPE, upright], device="cpu")
    return elastic.numpy(), volume.numpy(), upright.numpy() > 0


def hencky_strain(F: np.ndarray) -> np.ndarray:
    """(n, 3) ln of the principal stretches, largest first, by numpy."""
    return np.log(np.linalg.svd(F, compute_uv=False))


def excess(F: np.ndarray) -> np.ndarray:
    """(n,) |dev e| + alpha (3 lambda + 2 mu) / (2 mu) tr e: not above zero where F is admissible."""
    e = hencky_strain(F)
    dilation = e.sum(axis=1)
    shear = np.linalg.norm(e - dilation[:, None] / 3.0, axis=1)
    return shear + SLOPE * (3.0 * LAM + 2.0 * MU) / (2.0 * MU) * dilation


def states() -> np.ndarray:
    """(n, 3, 3): pressed, sheared and stretched, arbitrarily turned."""
    return with_stretches(np.exp(np.random.default_rng(0).uniform(-0.6, 0.4, (200, 3))), 5)


def test_stress_is_the_energys_derivative():
    """P = d psi / dF (Han 2019 (9), with the trace), to 1e-8 of the stress."""
    F = states()
    steps = STEP * np.eye(9).reshape(9, 1, 3, 3)
    both = np.stack([F + steps, F - steps]).reshape(-1, 3, 3)
    up, down = energy_and_stress("hencky", both)[0].reshape(2, 9, len(F))
    expected = ((up - down) / (2.0 * STEP)).T.reshape(-1, 3, 3)
    stress = energy_and_stress("hencky", F)[1]
    scale = np.maximum(1.0, np.abs(stress).max(axis=(1, 2)))
    assert (np.abs(stress - expected).max(axis=(1, 2)) / scale).max() < 1e-8


def test_energy_is_that_of_the_strain():
    """(8): mu tr(e^2) + lambda/2 (tr e)^2 with e by numpy; objective and isotropic through it."""
    F = states()
    e = hencky_strain(F)
    expected = MU * (e**2).sum(axis=1) + 0.5 * LAM * e.sum(axis=1) ** 2
    np.testing.assert_allclose(energy_and_stress("hencky", F)[0], expected, rtol=1e-11, atol=1e-14)


def test_projection_is_onto_the_cone():
    """Every state comes back admissible; what was outside under pressure, onto the cone at the same volume."""
    F = states()
    before, after = excess(F), projected(F)[0]
    assert (excess(after) < 1e-12).all()
    dilation = hencky_strain(F).sum(axis=1)
    pressed, outside = dilation < 0.0, before > 0.0
    assert (pressed & outside).sum() > 30 and (pressed & ~outside).sum() > 10 and (~pressed).sum() > 30
    np.testing.assert_allclose(excess(after)[pressed & outside], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(after)[pressed], np.exp(dilation[pressed]), rtol=1e-12)
    np.testing.assert_allclose(after[pressed & ~outside], F[pressed & ~outside], rtol=0, atol=1e-13)


def test_projection_is_the_nearest():
    """dev e only shrinks, along itself: with F = U diag(s) V^T, U and V stay."""
    F = states()
    pressed = hencky_strain(F).sum(axis=1) < 0.0
    after = projected(F)[0]
    before, back = (np.linalg.svd(G) for G in (F[pressed], after[pressed]))
    along = [np.log(s) - np.log(s).mean(axis=1, keepdims=True) for s in (before.S, back.S)]
    np.testing.assert_allclose(np.cross(*along), 0.0, atol=1e-12)
    rotation = [svd.U @ svd.Vh for svd in (before, back)]
    np.testing.assert_allclose(*rotation, atol=1e-12)


def test_projected_again_nothing_changes():
    F, gained, _ = projected(states())
    again = projected(F, np.minimum(gained, 0.0))[0]
    np.testing.assert_allclose(again, F, atol=1e-12)


def test_pure_compression_is_left_and_tension_is_let_go():
    """A pressure without shear is admissible; what is pulled apart is unstrained, and knows how far it came."""
    turn = random_rotations(1, 3)
    F, gained, _ = projected(0.8 * turn)
    np.testing.assert_allclose(F, 0.8 * turn, atol=1e-14)
    assert gained[0] == 0.0
    F, gained, _ = projected(1.2 * turn)
    np.testing.assert_allclose(F, turn, atol=1e-14)
    assert gained[0] == pytest.approx(3.0 * np.log(1.2), rel=1e-12)


def test_volume_gained_is_given_back_first():
    """Apart by 1.2 a side and back: no strain; a little further: that little (Tampubolon et al. 2017)."""
    F, gained, _ = projected(1.2 * np.eye(3)[None])
    half, left, _ = projected(F / 1.1, gained)
    np.testing.assert_allclose(half[0], np.eye(3), atol=1e-14)
    assert left[0] == pytest.approx(3.0 * np.log(1.2 / 1.1), rel=1e-12)
    pressed, left, _ = projected(half * 1.1 / 1.2 * 0.95, left)
    np.testing.assert_allclose(pressed[0], 0.95 * np.eye(3), rtol=1e-12)
    assert left[0] == 0.0


def test_the_cone_is_coulombs_in_triaxial_compression():
    """Sliding matter between plates: (t1 - t3) / (t1 + t3) = sin phi of the principal stresses, tan phi = mu."""
    F = projected(np.diag(np.exp([-0.5, 0.05, 0.05]))[None])[0]
    e = hencky_strain(F)[0]
    stress = 2.0 * MU * e + LAM * e.sum()
    most, least = stress.min(), stress.max()
    assert (most - least) / (most + least) == pytest.approx(np.sin(np.arctan(FRICTION)), rel=1e-10)


def test_what_is_no_deformation_begins_anew():
    mirrored = np.diag([1.0, 1.0, -0.1])
    flat = np.diag([1.0, 0.9, 0.0])
    F, gained, upright = projected(np.stack([mirrored, flat, np.eye(3)]), 0.3)
    assert upright.tolist() == [False, False, True]
    np.testing.assert_array_equal(F[:2], np.stack([np.eye(3)] * 2))
    assert not gained[:2].any()
