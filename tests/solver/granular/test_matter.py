"""Transfers against dense sums, what they conserve, and the same bits whatever the order and the threads."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from .heaps import CELL, granular, in_order, matter, scattered

STEP = 1e-3


def weights(position: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(particle_count, node_count) quadratic B-splines."""
    d = np.abs(position[:, None] - nodes) / CELL
    return np.where(d < 0.5, 0.75 - d**2, np.where(d < 1.5, 0.5 * (1.5 - d) ** 2, 0.0)).prod(axis=2)


def strained(held) -> np.ndarray:
    """Gives the particles affine parts and small strains; returns tau (n, 3, 3) in the order given."""
    random, count = np.random.default_rng(3), held.count
    held.particles.affine.assign(random.normal(size=(count, 3, 3)))
    e = random.normal(size=(count, 6)) * 1e-3
    held.particles.strain.assign(e)
    material = held.materials.numpy()[0]
    tau = 2.0 * material["mu"] * e[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
    return tau + material["lam"] * e[:, :3].sum(axis=1)[:, None, None] * np.eye(3)


def test_to_grid_is_the_dense_sum():
    """m_i v_i = sum_q w_iq (m_q v_q + (m_q C_q - 4 dt/dx^2 V_q tau_q) (x_i - x_q)) (Hu et al. 2018)."""
    position, velocity = scattered(400)
    heap = granular(position, velocity)
    held = matter(heap)
    tau, C = strained(held), in_order(held, "affine")
    held.to_grid(STEP)
    nodes = held.grid.node_positions()
    found = held.grid.node.numpy()[: len(nodes)]
    w, mass = weights(position, nodes), heap.density * heap.volumes
    np.testing.assert_allclose(found[:, 3], w.T @ mass, atol=1e-12 * mass[0])
    A = mass[:, None, None] * C - 4.0 * STEP / CELL**2 * heap.volumes[:, None, None] * tau
    at_node = mass[:, None] * velocity - np.einsum("qab,qb->qa", A, position)
    expected = w.T @ at_node + np.einsum("qn,qab,nb->na", w, A, nodes, optimize=True)
    # Sums over particles some metres from the origin lose as many digits as those are cells away.
    np.testing.assert_allclose(found[:, :3], expected, atol=1e-10 * np.abs(expected).max())


def test_to_particles_is_the_dense_sum():
    """v_q = sum_i w_iq v_i, C_q = 4/dx^2 sum_i w_iq v_i (x_i - x_q)^T, x_q moved by dt v_q."""
    position, velocity = scattered(400)
    held = matter(granular(position, velocity), gravity=(0.0, -9.81, 1.0))
    held.to_grid(STEP)
    held.to_velocities()
    nodes = held.grid.node_positions()
    at_nodes = held.grid.velocity.numpy()[: len(nodes), :3]
    w = weights(position, nodes)
    assert held.to_particles()
    v = w @ at_nodes
    C = np.einsum("qn,na,qnb->qab", w, at_nodes, nodes - position[:, None], optimize=True) * 4.0 / CELL**2
    np.testing.assert_allclose(in_order(held, "velocity"), v, atol=1e-12)
    np.testing.assert_allclose(in_order(held, "affine"), C, atol=1e-9)
    np.testing.assert_allclose(in_order(held, "position"), position + STEP * v, atol=1e-13)
    assert held.speed == pytest.approx(np.abs(v).max(), rel=1e-12)


def step(held, length: float) -> None:
    held.to_grid(length)
    held.to_velocities()
    assert held.to_particles()


@pytest.mark.parametrize(("real", "tolerance"), [(wp.float64, 1e-12), (wp.float32, 1e-5)])
@pytest.mark.parametrize("law", ["sand", "snow"])
def test_momentum_in_free_flight(law, real, tolerance):
    """Linear and angular, of a turning, colliding cloud over a second, relative to the sum of their sizes."""
    random = np.random.default_rng(1)
    position = random.uniform(-0.4, 0.4, (4000, 3))
    spin = np.array([0.5, 0.2, -0.3])
    velocity = np.cross(spin, position) - 0.5 * position + [0.3, 0.1, 0.0]
    held = matter(granular(position, velocity, law, youngs_modulus=1e4, density=1000.0), real)
    mass = 1000.0 * CELL**3 / 8

    def momenta() -> tuple[np.ndarray, np.ndarray]:
        x, v = in_order(held, "position"), in_order(held, "velocity").astype(float)
        C = in_order(held, "affine").astype(float)
        # What an affine particle holds of spin: D = dx^2/4 times the antisymmetric part of C.
        own = (
            CELL**2 / 4 * np.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], 1)
        )
        return mass * v.sum(axis=0), mass * (np.cross(x, v) + own).sum(axis=0)

    linear, angular = momenta()
    size = mass * np.linalg.norm(velocity, axis=1).sum()
    time = 0.0
    while time < 1.0:
        length = min(held.stable_length(0.3), 5e-3)
        step(held, length)
        time += length
    now, turned = momenta()
    assert np.abs(now - linear).max() < tolerance * size
    assert np.abs(turned - angular).max() < tolerance * size


def test_same_bits_with_any_number_of_threads():
    """So also when run again."""
    position, velocity = scattered(30000)
    runs = []
    for threads in (1, 2, 3):
        held = matter(granular(position, velocity), wp.float32, threads, gravity=(0.0, -9.81, 0.0))
        for _ in range(4):
            step(held, STEP)
        runs.append([getattr(held.particles, name).numpy() for name in ("position", "strain", "affine", "number")])
    for run in runs[1:]:
        for a, b in zip(runs[0], run, strict=True):
            np.testing.assert_array_equal(a, b)


def test_sorted_seldom_is_as_sorted_always():
    """Particles that have drifted out of their blocks by up to a cell are transferred the same."""
    position, velocity = scattered(2000)
    seldom, always = (matter(granular(position, velocity)) for _ in range(2))
    for _ in range(60):
        step(seldom, STEP)
        always.sort()
        step(always, STEP)
    assert 2 <= seldom.sorts < 10
    np.testing.assert_allclose(in_order(seldom, "position"), in_order(always, "position"), atol=1e-10)


def test_blocks_are_those_in_use():
    """Two clouds 38 m apart need no more blocks than each by itself does."""
    position, velocity = scattered()
    counts = []
    for chosen in (slice(None), slice(0, None, 2), slice(1, None, 2)):
        held = matter(granular(position[chosen], velocity[chosen]))
        held.to_grid(STEP)
        counts.append(held.grid.node_block_count)
    assert counts[0] == counts[1] + counts[2]


def test_a_particle_that_is_not_finite_is_told():
    position, velocity = scattered(100)
    velocity[7] = np.nan
    held = matter(granular(position, velocity))
    held.to_grid(STEP)
    held.to_velocities()
    assert not held.to_particles()
