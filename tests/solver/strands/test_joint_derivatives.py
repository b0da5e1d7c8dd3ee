"""A joint's gradient and Hessian against finite differences of its energy, in the chart they are defined in."""

from __future__ import annotations

import numpy as np
import pytest

from .joint_probe import derivatives, energies, transport


class Chart:
    """Shapes of a joint near a random one, by the eight variables of the derivatives."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        unit = lambda v: v / np.linalg.norm(v)  # noqa: E731
        self.edges = random.normal(size=(2, 3))
        self.edges[1] += self.edges[0]  # a bend of some tens of degrees
        tangents = [unit(e) for e in self.edges]
        self.directors = np.array([unit(np.cross(t, random.normal(size=3))) for t in tangents])
        self.bend, self.stiffness = random.uniform(0.5, 2.0, 2)
        self.curvature = random.normal(size=2)
        self.rest_twist = random.normal()
        self.twist = self.angle(self.edges, self.directors)

    @staticmethod
    def angle(edges: np.ndarray, directors: np.ndarray) -> float:
        ta, tb = (e / np.linalg.norm(e) for e in edges)
        carried = transport(ta, tb, directors[0])
        return np.arctan2(np.cross(carried, directors[1]) @ tb, carried @ directors[1])

    def shape(self, step: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        edges = self.edges + step[:6].reshape(2, 3)
        directors = np.empty((2, 3))
        for k in range(2):
            t, to = (e / np.linalg.norm(e) for e in (self.edges[k], edges[k]))
            m = transport(t, to, self.directors[k])
            angle = step[6 + k]
            directors[k] = np.cos(angle) * m + np.sin(angle) * np.cross(to, m)
        twist = self.angle(edges, directors)
        return edges, directors, twist + 2 * np.pi * np.round((self.twist - twist) / (2 * np.pi))

    @property
    def constants(self) -> tuple:
        return self.bend, self.stiffness, self.curvature, self.rest_twist

    def energies(self, steps: np.ndarray) -> np.ndarray:
        shapes = [self.shape(step) for step in steps]
        return energies(*(np.array(values) for values in zip(*shapes, strict=True)), *self.constants)

    def derivatives(self, beta: float) -> tuple[np.ndarray, np.ndarray]:
        shape = self.edges[None], self.directors[None], np.array([self.twist])
        gradient, hessian = derivatives(*shape, *self.constants, beta)
        return gradient[0], hessian[0]


# Central differences of eighth order: weights of f(h k) - f(-h k), k = 1..4.
FIRST = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])


def difference_gradient(chart: Chart, step: float) -> np.ndarray:
    steps = np.array([s * k * step * e for e in np.eye(8) for k in range(1, 5) for s in (1, -1)])
    values = chart.energies(steps).reshape(8, 4, 2)
    return (values[..., 0] - values[..., 1]) @ FIRST / step


def difference_hessian(chart: Chart, step: float) -> np.ndarray:
    """Eighth-order differences in both directions, from the energy alone."""
    offsets = np.array([s * k for k in range(1, 5) for s in (1, -1)])
    weights = np.array([s * w for w in FIRST for s in (1, -1)])
    pairs = [(i, j) for i in range(8) for j in range(i + 1)]
    steps = np.array(
        [step * (p * np.eye(8)[i] + q * np.eye(8)[j]) for i, j in pairs for p in offsets for q in offsets]
    )
    values = chart.energies(steps).reshape(len(pairs), 8, 8)
    hessian = np.zeros((8, 8))
    for (i, j), value in zip(pairs, values, strict=True):
        hessian[i, j] = hessian[j, i] = weights @ value @ weights / step**2
    return hessian


@pytest.mark.parametrize("seed", range(5))
def test_gradient_and_hessian_are_those_of_the_energy(seed: int) -> None:
    """Figures asked of the rods: 1e-9 for the gradient, 1e-7 for the Hessian, relative, in float64."""
    chart = Chart(seed)
    gradient, hessian = chart.derivatives(beta=1.0)
    expected = difference_gradient(chart, 5e-3)
    assert np.abs(gradient - expected).max() < 1e-9 * np.abs(expected).max()
    expected = difference_hessian(chart, 1e-2)
    assert np.abs(hessian - expected).max() < 1e-7 * np.abs(expected).max()


@pytest.mark.parametrize("seed", range(5))
def test_gauss_newton_part_is_semi_definite(seed: int) -> None:
    """beta = 0 must give a matrix that the factorisation always takes."""
    _, hessian = Chart(seed).derivatives(beta=0.0)
    eigenvalues = np.linalg.eigvalsh(hessian)
    assert eigenvalues[0] > -1e-12 * eigenvalues[-1]
