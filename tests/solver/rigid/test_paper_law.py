"""The potential and return mapping of Han 2019 (34)-(36), against the same with QR factors, as printed."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from plait.solver.rigid.paper_law import SHEAR, energy_of, longest_step, returned, traction_of
from plait.solver.warp_start import start_warp

start_warp()
STIFFNESS, FRICTION = 1e5, 0.4
GAMMA = float(SHEAR) * STIFFNESS


@wp.kernel(enable_backward=False)
def evaluate(
    director: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d),
    stiffness: wp.float64,
    friction: wp.float64,
    energy_out: wp.array(dtype=wp.float64),
    traction_out: wp.array(dtype=wp.vec3d),
    returned_out: wp.array(dtype=wp.vec3d),
):
    q = wp.tid()
    energy_out[q] = energy_of(director[q], normal[q], stiffness)
    traction_out[q] = traction_of(director[q], normal[q], stiffness)
    returned_out[q] = returned(director[q], normal[q], friction)


def law(director: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energies [J/m3], tractions [Pa] and elastic directors of (n, 3) directors at (n, 3) normals."""
    with wp.ScopedDevice("cpu"):
        held = [wp.array(values, dtype=wp.vec3d) for values in (director, normal)]
        energy = wp.zeros(len(director), dtype=wp.float64)
        traction, back = (wp.zeros(len(director), dtype=wp.vec3d) for _ in range(2))
        wp.launch(evaluate, len(director), [*held, STIFFNESS, FRICTION], [energy, traction, back])
        return energy.numpy(), traction.numpy(), back.numpy()


class Triangles:
    """Rigid triangles somewhere, turned from rest, and directors: pressed, stretched and sheared."""

    def __init__(self, count: int = 200) -> None:
        random = np.random.default_rng(4)
        rest = random.normal(size=(count, 3, 3))
        turn, _ = np.linalg.qr(random.normal(size=(count, 3, 3)))
        turn *= np.sign(np.linalg.det(turn))[:, None, None]
        edges = rest[:, 1:] - rest[:, :1]
        # The triangle's own axes: along its first edge, across it, along its normal.
        first = _unit(edges[:, 0])
        last = _unit(np.cross(edges[:, 0], edges[:, 1]))
        axes = np.stack([first, np.cross(last, first), last], axis=1)
        self.rest = np.concatenate(
            [np.einsum("nij,nkj->nik", axes, edges), np.eye(3)[:, 2:] + 0.0 * rest[:, :, :1]], 2
        )
        self.edges = np.einsum("nij,nkj->nik", turn, edges)
        self.normal = np.einsum("nij,nj->ni", turn, last)
        self.director = self.normal * random.uniform(0.3, 1.2, (count, 1)) + 0.1 * random.normal(size=(count, 3))

    def factors(self, director: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Q and R, with a positive diagonal, of F = d D^-1."""
        gradient = np.concatenate([self.edges, director[:, :, None]], axis=2) @ np.linalg.inv(self.rest)
        q, r = np.linalg.qr(gradient)
        signs = np.sign(np.diagonal(r, axis1=1, axis2=2))
        # The third may be negative: then the surface is inside out. Not here.
        return q * signs[:, None, :], r * signs[:, :, None]

    def energy(self, director: np.ndarray) -> np.ndarray:
        """(34) from the entries of R."""
        _, r = self.factors(director)
        pressed = np.where(r[:, 2, 2] <= 1.0, STIFFNESS / 3.0 * (1.0 - r[:, 2, 2]) ** 3, 0.0)
        return pressed + 0.5 * GAMMA * (r[:, 0, 2] ** 2 + r[:, 1, 2] ** 2)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_the_energy_is_that_of_the_factors():
    """(34) by QR of F = d D^-1: Q's third column is the normal, the director in Q's axes the third column of R."""
    held = Triangles()
    q, r = held.factors(held.director)
    assert r[:, :2, :2] == pytest.approx(np.broadcast_to(np.eye(2), (len(r), 2, 2)), abs=1e-9)
    assert np.einsum("ni,ni->n", q[:, :, 2], held.normal) == pytest.approx(np.ones(len(q)), abs=1e-9)
    energy, _, _ = law(held.director, held.normal)
    assert energy == pytest.approx(held.energy(held.director), rel=1e-9, abs=1e-9 * STIFFNESS)


def test_the_traction_is_the_energys_gradient():
    """dpsi/dd_3 of the printed energy by central differences, in the step's second order; 1e-6 of k^c."""
    held, step = Triangles(), 1e-5
    _, traction, _ = law(held.director, held.normal)
    for k in range(3):
        way = step * np.eye(3)[k]
        slope = (held.energy(held.director + way) - held.energy(held.director - way)) / (2.0 * step)
        assert traction[:, k] == pytest.approx(slope, abs=1e-6 * STIFFNESS)


def test_the_return_mapping_is_that_of_the_factors():
    """Q R with (35) and (36): third columns agree; nothing stretched, |shear stress| <= c_F |pressure|."""
    held = Triangles()
    q, r = held.factors(held.director)
    _, _, back = law(held.director, held.normal)
    r33 = np.minimum(r[:, 2, 2], 1.0)
    size = np.hypot(r[:, 0, 2], r[:, 1, 2])
    h = np.minimum(1.0, FRICTION * STIFFNESS * (1.0 - r33) ** 2 / (GAMMA * size))
    printed = np.einsum("nij,nj->ni", q, np.stack([h * r[:, 0, 2], h * r[:, 1, 2], r33], axis=1))
    assert back == pytest.approx(printed, abs=1e-9)
    _, traction, again = law(back, held.normal)
    assert again == pytest.approx(back, abs=1e-12)
    pressure = -np.einsum("ni,ni->n", traction, held.normal)
    shear = np.linalg.norm(traction + pressure[:, None] * held.normal, axis=1)
    rounding = 1e-12 * STIFFNESS
    assert (pressure >= -rounding).all() and (shear <= FRICTION * pressure + rounding).all()
    # Both kinds are among them: what slips, and what holds.
    assert (h < 1.0).any() and (h == 1.0).any() and (r[:, 2, 2] > 1.0).any()


def test_what_is_not_pressed_neither_pushes_nor_holds():
    """r_33 > 1: no pressure (34), and all of the shear is given up (36)."""
    normal = _unit(np.random.default_rng(1).normal(size=(20, 3)))
    director = 1.1 * normal + 0.05 * _unit(np.cross(normal, [0.3, 0.5, 0.8]))
    _, _, back = law(director, normal)
    assert back == pytest.approx(normal, abs=1e-15)


def test_no_response_is_stiffer_than_the_longest_step_takes_it_for():
    """The largest curvature of psi along the way of a director in a grid's flow, d -> (1 + e) d, is 8/27 k^c."""
    along, step = np.linspace(0.0, 1.0, 400)[1:-1], 1e-4
    normal = np.tile([0.0, 0.0, 1.0], (len(along), 1))

    def slope(factor: float) -> np.ndarray:
        return law(factor * along[:, None] * normal, normal)[1][:, 2]

    stiffness = (slope(1.0 + step) - slope(1.0 - step)) / (2.0 * step * along) * along**2
    assert stiffness.max() == pytest.approx(8.0 / 27.0 * STIFFNESS, rel=1e-4)
    assert longest_step(30.0, 0.02, STIFFNESS) == pytest.approx(2.0 / np.sqrt(16.0 / 9.0 * STIFFNESS / 0.6))
