"""Laws of sand and snow: derivatives, return mappings, and the strain they live on."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from plait.solver.granular.laws import LAWS

from .law_probe import Probe, matter

STEP = 1e-5  # central differences: error STEP^2 times the third derivative, and rounding over STEP
# Stiffness of order one, so that absolute tolerances mean something.
UNIT = {"youngs_modulus": 2.0, "poissons_ratio": 0.3}
MU, LAM = 2.0 / 2.6, 2.0 * 0.3 / (1.3 * 0.4)
ANGLE = 0.6
SLOPE = np.sqrt(2.0) / 3.0 * np.tan(ANGLE)
each_law = pytest.mark.parametrize("law", sorted(LAWS))


def turns(count: int, seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(count, 3, 3)))
    q *= np.sign(np.einsum("nii->ni", r))[:, None]
    q[:, :, 0] *= np.linalg.det(q)[:, None]
    return q


def strains(size: float, count: int = 60, seed: int = 0) -> np.ndarray:
    """(n, 3, 3) symmetric, principal values up to `size`."""
    Q = turns(count, seed)
    values = np.random.default_rng(seed + 1).uniform(-size, size, (count, 3))
    return np.einsum("nij,nj,nkj->nik", Q, values, Q)


def of_matrix(function, A: np.ndarray) -> np.ndarray:
    """A function of symmetric matrices by numpy's eigenvectors."""
    values, vectors = np.linalg.eigh(A)
    return np.einsum("nij,nj,nkj->nik", vectors, function(values), vectors)


def hencky(F: np.ndarray) -> np.ndarray:
    return 0.5 * of_matrix(np.log, F @ F.transpose(0, 2, 1))


@pytest.mark.parametrize(("real", "tolerance"), [(wp.float64, 1e-14), (wp.float32, 6e-7)])
@pytest.mark.parametrize("size", [1e-4, 0.02, 0.4])
def test_strain_follows_the_deformation(real, tolerance, size):
    """e = ln(F F^T)/2 after (1 + G) F, near rest by series and far from it, relative to the strain."""
    e, G = strains(size, seed=4), np.random.default_rng(5).uniform(-size / 3, size / 3, (60, 3, 3))
    # What float32 is handed is rounded first.
    e, G = (x.astype(np.float32).astype(float) for x in (e, G))
    F = (np.eye(3) + G) @ of_matrix(np.exp, e)
    # numpy's own ln of what is near one loses digits: by the first two terms of its series there.
    found = Probe(matter("sand"), real).deform(e, G)
    scale = np.linalg.norm(e, axis=(1, 2)).max()
    assert np.abs(found - hencky(F)).max() < (tolerance + 5e-16 / scale) * scale * 4.0


@each_law
@pytest.mark.parametrize("size", [0.02, 0.3])
def test_stress_is_the_energys_derivative(law, size):
    """tau = (d psi / dF) F^T, to 1e-8 of the stress; objective, as psi is of F F^T alone."""
    probe, F = Probe(matter(law, **UNIT)), turns(60, 8) @ of_matrix(np.exp, strains(size))
    steps = STEP * np.eye(9).reshape(9, 1, 3, 3)
    up, down = (probe.state(hencky(G.reshape(-1, 3, 3)), 0.1)[0].reshape(9, -1) for G in (F + steps, F - steps))
    P = ((up - down) / (2.0 * STEP)).T.reshape(-1, 3, 3)
    stress = probe.state(hencky(F), 0.1)[1]
    assert np.abs(stress - P @ F.transpose(0, 2, 1)).max() < 1e-8 * np.abs(stress).max()


@each_law
def test_agrees_with_linear_elasticity_at_rest(law):
    """tau = 2 mu e + lambda tr e, up to the strain squared; none at rest."""
    e = strains(1e-7)
    energy, stress = Probe(matter(law, **UNIT)).state(e)
    trace = np.einsum("nii->n", e)
    np.testing.assert_allclose(stress, 2 * MU * e + LAM * trace[:, None, None] * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(energy, MU * (e**2).sum(axis=(1, 2)) + LAM / 2 * trace**2, atol=1e-19)


@each_law
def test_among_others_a_law_is_itself(law):
    e, granular = strains(0.1), matter(law)
    alone, among = Probe(granular), Probe(granular, among=("snow", "sand", "elastic"))
    for a, b in zip((*alone.state(e), *alone.return_map(e)), (*among.state(e), *among.return_map(e)), strict=True):
        np.testing.assert_array_equal(a, b)


def excess(e: np.ndarray) -> np.ndarray:
    """|dev e| + alpha (3 lambda + 2 mu) / (2 mu) tr e (Klar et al. 2016): not above zero where admissible."""
    trace = np.einsum("nii->n", e)
    shear = np.linalg.norm(e - trace[:, None, None] / 3 * np.eye(3), axis=(1, 2))
    return shear + SLOPE * (3 * LAM + 2 * MU) / (2 * MU) * trace


def test_sand_goes_back_to_the_cone():
    """Apart: to no strain; inside: stays; outside under pressure: along dev e at the same volume."""
    e = strains(0.3, 400)
    after, gained = Probe(matter("sand", friction_angle=ANGLE, **UNIT)).return_map(e)
    trace, outside = np.einsum("nii->n", e), excess(e) > 0.0
    apart, inside, slides = trace >= 0.0, (trace < 0.0) & ~outside, (trace < 0.0) & outside
    assert min(apart.sum(), inside.sum(), slides.sum()) > 20
    assert not after[apart].any()
    np.testing.assert_allclose(gained, np.maximum(trace, 0.0), atol=1e-15)
    np.testing.assert_allclose(after[inside], e[inside], atol=1e-16)
    np.testing.assert_allclose(excess(after[slides]), 0.0, atol=1e-14)
    np.testing.assert_allclose(np.einsum("nii->n", after[slides]), trace[slides], atol=1e-14)
    dev = [x - np.einsum("nii->n", x)[:, None, None] / 3 * np.eye(3) for x in (e[slides], after[slides])]
    factor = np.linalg.norm(dev[1], axis=(1, 2)) / np.linalg.norm(dev[0], axis=(1, 2))
    np.testing.assert_allclose(dev[1], factor[:, None, None] * dev[0], atol=1e-14)


def test_sands_cone_is_coulombs():
    """Sliding in plane shear: the shear stress is tan phi times the pressure (Jop et al. 2006)."""
    probe = Probe(matter("sand", friction_angle=ANGLE, **UNIT))
    e, _ = probe.return_map(np.array([[[-0.02, 0.1, 0.0], [0.1, -0.02, 0.0], [0.0, 0.0, -0.02]]]))
    tau = probe.state(e)[1][0]
    assert tau[0, 1] == pytest.approx(-np.tan(ANGLE) * np.trace(tau) / 3.0, rel=1e-10)


def test_sand_gives_back_the_volume_it_gained():
    """Apart by .3 in all and back by .2: unstrained still, .1 kept; .15 more: pressed by .05 (Tampubolon 2017)."""
    probe, unit = Probe(matter("sand", **UNIT)), np.eye(3)[None] / 3
    e, gained = probe.return_map(0.3 * unit)
    e, gained = probe.return_map(e - 0.2 * unit, gained)
    assert not e.any() and gained[0] == pytest.approx(0.1)
    e, gained = probe.return_map(e - 0.15 * unit, gained)
    np.testing.assert_allclose(e, -0.05 * unit, atol=1e-15)
    assert gained[0] == 0.0


def test_snow_yields_at_its_critical_stretches():
    """Singular values stay within 1 - theta_c and 1 + theta_s; J of elastic times plastic stays; axes stay."""
    e, packed = strains(0.06, 200), np.linspace(-0.2, 0.1, 200)
    after, memory = Probe(matter("snow")).return_map(e, packed)
    expected = of_matrix(lambda s: np.clip(s, np.log(1 - 2.5e-2), np.log(1 + 7.5e-3)), e)
    np.testing.assert_allclose(after, expected, atol=1e-14)
    total = np.einsum("nii->n", e) + packed
    np.testing.assert_allclose(np.einsum("nii->n", after) + memory, total, atol=1e-14)


def test_snow_hardens_as_it_is_packed():
    """Stress times exp(xi (1 - J_P)), xi = 10 (Stomakhin et al. 2013)."""
    probe, e = Probe(matter("snow")), strains(0.01, 3)
    rest, hard = probe.state(e)[1], probe.state(e, np.log(0.9))[1]
    np.testing.assert_allclose(hard, np.exp(10 * 0.1) * rest, rtol=1e-12)


def test_snow_is_packed_and_torn_within_bounds():
    """J_P stays within [.6, 20], whatever flows; the elastic part yields as it would."""
    e = 4.0 * np.eye(3) * np.array([-1.0, 1.0])[:, None, None]
    after, memory = Probe(matter("snow")).return_map(e)
    np.testing.assert_allclose(np.exp(memory), [0.6, 20.0], rtol=1e-12)
    np.testing.assert_allclose(np.exp(after[:, 0, 0]), [1 - 2.5e-2, 1 + 7.5e-3], rtol=1e-12)
