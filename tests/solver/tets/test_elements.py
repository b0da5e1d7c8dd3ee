"""A tet's energy, forces and stiffness against each other, and against what must not be felt."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from plait.solver.materials.laws import LAWS
from plait.solver.scene import Scene
from plait.solver.tets.elements import PAIRS, body_elements, element_kernels, element_types, lame_parameters
from plait.solver.tets.layout import TetLayout, build_layout

from ..materials.law_probe import LAM, MU, hessian, random_rotations
from .lattices import box_body

each_law = pytest.mark.parametrize("law", sorted(LAWS))
# What the forces of a body at rest are made of, by edge and modulus: a thousand times rounding, and the promise.
precisions = pytest.mark.parametrize("real, tolerance", [(wp.float32, 1e-5), (wp.float64, 1e-12)])
NU = 0.5 * LAM / (LAM + MU)
YOUNG = 2.0 * MU * (1.0 + NU)


class Elements:
    """The kernels on one box; results in numpy."""

    def __init__(self, law: str = "fixed-corotated", real: type = wp.float64, cells: Any = 2) -> None:
        body, skin = box_body((1.0, 0.8, 1.2), cells, law=law, youngs_modulus=YOUNG, poissons_ratio=NU)
        self.layout: TetLayout = build_layout(Scene(surfaces=(skin,), bodies=(body,)))
        self.rest, self.tets, self.real = self.layout.rest, self.layout.tets, real
        self.elements, self.kernels = body_elements(self.layout, 0, real, "cpu"), element_kernels(law, real)
        self.types = element_types(real)

    def run(self, name: str, position: np.ndarray, *outputs: tuple[int, Any]) -> list[np.ndarray]:
        arrays = [wp.zeros(count * len(self.tets), dtype=dtype, device="cpu") for count, dtype in outputs]
        held = wp.array(position, dtype=wp.vec3d, device="cpu")
        wp.launch(getattr(self.kernels, name), len(self.tets), [0, self.elements, held], arrays, device="cpu")
        return [array.numpy() for array in arrays]

    def energy(self, position: np.ndarray) -> float:
        return self.run("energy", position, (1, wp.float64))[0].sum()

    def force(self, position: np.ndarray) -> np.ndarray:
        """(node_count, 3) [N]"""
        corners, _ = self.run("force", position, (4, self.types.vec3), (1, self.real))
        out = np.zeros_like(self.rest)
        np.add.at(out, self.tets.ravel(), corners)
        return out

    def stiffness(self, kind: str, position: np.ndarray) -> np.ndarray:
        """(tet_count, 4, 3, 4, 3) [N/m]"""
        blocks = self.run(kind, position, (10, self.types.mat33))[0].reshape(-1, 10, 3, 3)
        out = np.zeros((len(self.tets), 4, 3, 4, 3))
        for k, (a, b) in enumerate(PAIRS):
            out[:, a, :, b] = blocks[:, k]
            out[:, b, :, a] = blocks[:, k].transpose(0, 2, 1)
        return out

    def shape_gradients(self) -> np.ndarray:
        """(tet_count, 4, 3) [1/m], from the rest positions."""
        rows = np.concatenate([np.ones((len(self.tets), 1, 4)), self.rest[self.tets].transpose(0, 2, 1)], axis=1)
        return np.linalg.inv(rows)[:, :, 1:]

    def shaken(self, part: float) -> np.ndarray:
        """Rest positions, each coordinate moved by up to `part` of an edge."""
        steps = np.random.default_rng(0).uniform(-1.0, 1.0, self.rest.shape)
        return self.rest + part * self.layout.edge[0] * steps


@each_law
def test_forces_are_the_energys_derivative(law):
    """f = -dE/dx by central differences, to 1e-8 of the largest."""
    box = Elements(law)
    x, step = box.shaken(0.15), 1e-5
    expected = np.zeros_like(x)
    for entry in np.ndindex(*x.shape):
        to = np.zeros_like(x)
        to[entry] = step
        expected[entry] = (box.energy(x - to) - box.energy(x + to)) / (2.0 * step)
    assert np.abs(box.force(x) - expected).max() < 1e-8 * np.abs(expected).max()


@each_law
@pytest.mark.parametrize("kind, floor", [("exact", -np.inf), ("projected", 0.0)])
def test_blocks_are_the_laws_hessian(law, kind, floor):
    """K_ab = V (d2 psi / dF dF : g_a : g_b), as it is, or with its eigenvalues clamped at zero."""
    box = Elements(law)
    x, g = box.shaken(0.25), box.shape_gradients()
    F = np.einsum("tai,taj->tij", x[box.tets], g)
    H = hessian(law, F, floor).reshape(-1, 3, 3, 3, 3)
    expected = np.einsum("t,tijkl,taj,tbl->taibk", box.layout.volume, H, g, g, optimize=True)
    assert (np.linalg.eigvalsh(hessian(law, F)) < 0.0).any()
    np.testing.assert_allclose(box.stiffness(kind, x), expected, atol=1e-10 * np.abs(expected).max())


def test_cheap_blocks_are_the_corotated_hessian():
    """K_ab = V (mu [(g_a . g_b) I + (R g_b)(R g_a)^T] + lambda (C g_a)(C g_b)^T), C = cof F."""
    box = Elements()
    x, g = box.shaken(0.15), box.shape_gradients()
    F = np.einsum("tai,taj->tij", x[box.tets], g)
    U, _, Vt = np.linalg.svd(F)
    assert (np.linalg.det(F) > 0.0).all()
    r = np.einsum("tij,taj->tai", U @ Vt, g)
    c = np.einsum("t,tji,taj->tai", np.linalg.det(F), np.linalg.inv(F), g)
    expected = MU * np.einsum("tac,tbc,ij->taibj", g, g, np.eye(3))
    expected += MU * np.einsum("tbi,taj->taibj", r, r) + LAM * np.einsum("tai,tbj->taibj", c, c)
    expected *= box.layout.volume[:, None, None, None, None]
    np.testing.assert_allclose(box.stiffness("semi_definite", x), expected, atol=1e-12 * np.abs(expected).max())


@each_law
@pytest.mark.parametrize("real, tolerance", [(wp.float32, 1e-5), (wp.float64, 1e-12)])
@pytest.mark.parametrize("kind", ["semi_definite", "projected"])
def test_stiffness_is_never_indefinite(law, kind, real, tolerance):
    """eigh of every tet's 12 x 12 matrix, also where tets are mirrored."""
    box = Elements(law, real)
    K = box.stiffness(kind, box.shaken(0.6)).reshape(-1, 12, 12)
    values = np.linalg.eigvalsh(K)
    assert (values[:, 0] > -tolerance * values[:, -1]).all()


@each_law
@precisions
def test_rigid_motion_is_not_felt(law, real, tolerance):
    """No force on any node, wherever the body is turned or moved to; by the modulus and an edge squared."""
    box = Elements(law, real)
    scale = YOUNG * box.layout.edge[0] ** 2
    for rotation in random_rotations(5, 1):
        assert np.abs(box.force(box.rest @ rotation.T)).max() < tolerance * scale
    # Moved by a kilometre in float64, an edge keeps 1e-13 m.
    far = box.rest @ rotation.T + np.array([800.0, -300.0, 500.0])
    assert np.abs(box.force(far)).max() < max(tolerance, 1e-11) * scale


@each_law
@precisions
def test_affine_patch(law, real, tolerance):
    """x = A X + c on all nodes: every inner node is in balance, and each tet has the same energy density."""
    box = Elements(law, real, cells=3)
    A = np.array([[1.2, 0.1, -0.2], [0.05, 0.9, 0.1], [0.1, -0.15, 1.1]])
    x = box.rest @ A.T + np.array([0.3, 0.2, -0.1])
    outer = (np.abs(np.abs(box.rest) - 0.5 * np.array([1.0, 0.8, 1.2])) < 1e-9).any(axis=1)
    assert np.abs(box.force(x)[~outer]).max() < tolerance * YOUNG * box.layout.edge[0] ** 2
    density = box.run("energy", x, (1, wp.float64))[0] / box.layout.volume
    assert np.ptp(density) < tolerance * density.mean()


@precisions
def test_deformation_gradient_and_dilation(real, tolerance):
    """F of an affine map is its matrix, J its determinant, negative for a mirror."""
    box = Elements(real=real)
    A = np.array([[1.2, 0.1, -0.2], [0.05, 0.9, 0.1], [0.1, -0.15, -1.1]])
    _, J = box.run("force", box.rest @ A.T, (4, box.types.vec3), (1, real))
    (F,) = box.run("deformation", box.rest @ A.T, (1, box.types.mat33))
    assert np.abs(J - np.linalg.det(A)).max() < tolerance
    assert np.abs(F - A).max() < tolerance


def test_lame_parameters():
    """E = mu (3 lambda + 2 mu) / (lambda + mu), nu = lambda / (2 (lambda + mu))."""
    mu, lam = lame_parameters(np.array([2.0, 5.0]), np.array([0.0, 0.45]))
    np.testing.assert_allclose(mu * (3.0 * lam + 2.0 * mu) / (lam + mu), [2.0, 5.0], rtol=1e-14)
    np.testing.assert_allclose(lam / (2.0 * (lam + mu)), [0.0, 0.45], rtol=1e-14)
