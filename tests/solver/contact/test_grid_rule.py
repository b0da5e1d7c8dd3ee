"""The paper's rule is what the paper says: its equations written out with dense sums, on the same particles."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from plait.solver.contact.grid_rule import element_masses
from plait.solver.model import Interval
from plait.solver.scene import Scene

from ..tets.lattices import box_body, placed
from .explicit import Explicit

FRICTION = 0.3


def two_blocks(**grid: object) -> Explicit:
    first, skin = box_body(size=(0.1, 0.1, 0.1), cells=2, friction=FRICTION)
    second, other = box_body(
        size=(0.1, 0.1, 0.1), cells=2, index=1, surface=1, friction=FRICTION, transform=placed((0.02, 0.11, 0.01))
    )
    scene = Scene(surfaces=(skin, other), bodies=(first, second), gravity=np.zeros(3))
    return Explicit(scene, rule="paper", **grid)


def spline(d: np.ndarray) -> np.ndarray:
    d = np.abs(d)
    return np.where(d < 0.5, 0.75 - d**2, np.where(d < 1.5, 0.5 * (1.5 - d) ** 2, 0.0))


def as_printed(bodies: Explicit, velocity: np.ndarray) -> np.ndarray:
    """Delta v_p (24) of Han 2019, equation by equation."""
    particles = bodies.contact.particles
    b, nodes, m = particles.weights, particles.nodes, element_masses(particles)
    v_q = np.einsum("qk,qkd->qd", b, velocity[nodes])  # (15)
    x_q = np.einsum("qk,qkd->qd", b, bodies.position[nodes])  # (16)
    dx = particles.spacing
    lower, upper = np.floor(x_q.min(axis=0) / dx) - 2, np.ceil(x_q.max(axis=0) / dx) + 3
    axes = [np.arange(a, z) for a, z in zip(lower, upper, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) * dx
    w = spline((x_q[:, None] - grid) / dx).prod(axis=2)
    m_i = w.T @ m  # (17)
    v_i = np.divide(w.T @ (m[:, None] * v_q), m_i[:, None], out=np.zeros((len(grid), 3)), where=m_i[:, None] > 0)
    v_r = w @ v_i - v_q  # (18), (19), (20)
    n_q = particles.normal.numpy()
    along = np.einsum("qd,qd->q", v_r, n_q)
    impulse = np.where(along < 0.0, 2.0 * m * along, 0.0)  # (21), (22)
    v_t = v_r - along[:, None] * n_q
    length = np.linalg.norm(v_t, axis=1)
    slip = np.minimum(length, -FRICTION * impulse / m)
    change = (impulse / m)[:, None] * n_q + (slip / length)[:, None] * v_t  # (23)
    total, shares = np.zeros_like(velocity), np.zeros(len(velocity))
    for k in range(4):
        np.add.at(shares, nodes[:, k], b[:, k] * m)
        np.add.at(total, nodes[:, k], (b[:, k] * m)[:, None] * change)
    return np.divide(total, shares[:, None], out=np.zeros_like(total), where=shares[:, None] > 0)  # (24), (25)


@pytest.mark.parametrize("cell_size", [0.02, 0.05])
def test_the_rule_is_the_papers(cell_size):
    bodies = two_blocks(cell_size=cell_size)
    random = np.random.default_rng(0)
    velocity = random.normal(size=bodies.position.shape)
    step, contact = 1e-3, bodies.contact
    x0, x, v = (
        wp.array(a, dtype=wp.vec3d, device="cpu")
        for a in (bodies.position, bodies.position + step * velocity, velocity)
    )
    assert contact.begin_substep(Interval(0.0, step), x0, x)
    contact.resolve(x0, x, v, step)
    expected = as_printed(bodies, velocity)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(v.numpy() - velocity, expected, atol=1e-12)
    np.testing.assert_allclose(x.numpy(), bodies.position + step * (velocity + expected), atol=1e-12)  # (27)


def test_element_mass_is_shared_by_the_particles_in_it():
    """The particles of a tet have its mass together, 'the mass of the boundary element' (§4.1)."""
    particles = two_blocks(cell_size=0.03).contact.particles
    masses = element_masses(particles)
    for tet in np.unique(particles.tet):
        together = masses[particles.tet == tet].sum()
        assert together == pytest.approx(1000.0 * particles.layout.volume[tet], rel=1e-12)
