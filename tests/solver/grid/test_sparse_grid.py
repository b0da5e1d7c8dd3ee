"""Transfers of the sparse grid against dense sums over quadratic B-splines."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from plait.solver.grid.sparse_grid import SparseGrid
from plait.solver.launch import Launcher

CELL = 0.1


def spline(d: np.ndarray) -> np.ndarray:
    """The quadratic B-spline at `d` cells from its node, a box convolved with itself twice."""
    d = np.abs(d)
    return np.where(d < 0.5, 0.75 - d**2, np.where(d < 1.5, 0.5 * (1.5 - d) ** 2, 0.0))


def placed(position: np.ndarray, threads: int = 1) -> tuple[SparseGrid, Launcher]:
    launcher = Launcher(threads=threads)
    grid = SparseGrid(CELL, launcher)
    grid.place(position)
    return grid, launcher


def scattered(count: int = 300, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Particles around two far places on both sides of the origin, their masses and velocities."""
    random = np.random.default_rng(seed)
    position = random.normal(size=(count, 3)) * 0.3
    position[::2] += [-70.0, 5.0, 33.0]
    return position, random.uniform(0.5, 2.0, count), random.normal(size=(count, 3))


def on_device(mass: np.ndarray, velocity: np.ndarray) -> tuple[wp.array, wp.array]:
    return wp.array(mass, dtype=wp.float64, device="cpu"), wp.array(velocity, dtype=wp.vec3d, device="cpu")


def test_to_and_from_grid_are_the_dense_sums():
    """(17), (18) and (19) of Han 2019, over all pairs of particles and active nodes."""
    position, mass, velocity = scattered()
    grid, _ = placed(position)
    grid.to_grid(*on_device(mass, velocity))
    weights = spline((position[:, None] - grid.node_positions()) / CELL).prod(axis=2)
    node_mass = weights.T @ mass
    np.testing.assert_allclose(grid.mass.numpy(), node_mass, rtol=1e-9, atol=1e-12)
    momentum = weights.T @ (mass[:, None] * velocity)
    np.testing.assert_allclose(grid.mass.numpy()[:, None] * grid.velocity.numpy(), momentum, rtol=1e-9, atol=1e-9)
    back = wp.zeros(len(position), dtype=wp.vec3d, device="cpu")
    grid.from_grid(back)
    np.testing.assert_allclose(back.numpy(), weights @ grid.velocity.numpy(), rtol=1e-9, atol=1e-9)


def test_mass_and_momentum_arrive_whole():
    """Splines are a partition of unity: every particle's stencil is active."""
    position, mass, velocity = scattered(seed=1)
    grid, _ = placed(position)
    grid.to_grid(*on_device(mass, velocity))
    assert grid.mass.numpy().sum() == pytest.approx(mass.sum(), rel=1e-12)
    arrived = (grid.mass.numpy()[:, None] * grid.velocity.numpy()).sum(axis=0)
    np.testing.assert_allclose(arrived, mass @ velocity, atol=1e-10)


def test_a_uniform_velocity_comes_back():
    position, mass, _ = scattered(seed=2)
    grid, _ = placed(position)
    uniform = np.tile([1.0, -2.0, 3.0], (len(position), 1))
    grid.to_grid(*on_device(mass, uniform))
    back = wp.zeros(len(position), dtype=wp.vec3d, device="cpu")
    grid.from_grid(back)
    np.testing.assert_allclose(back.numpy(), uniform, rtol=1e-12)


def test_cost_follows_particles_not_space():
    """As many blocks for two clusters a kilometre apart as for each of them, together."""
    position = np.random.default_rng(3).uniform(0.0, 1.0, (200, 3))
    near, _ = placed(position)
    far, _ = placed(np.concatenate([position, position + 1024.0 * CELL * 4.0]))
    assert far.node_count == 2 * near.node_count
    # A stencil reaches no more than two blocks a direction.
    assert near.node_count <= 64 * (np.ceil((1.0 / CELL + 3.0) / 4.0) + 1.0) ** 3


def test_threads_do_not_change_a_bit():
    position, mass, velocity = scattered(4000, seed=4)
    results = []
    for threads in (1, 3):
        grid, _ = placed(position, threads)
        grid.to_grid(*on_device(mass, velocity))
        back = wp.zeros(len(position), dtype=wp.vec3d, device="cpu")
        grid.from_grid(back)
        results.append((grid.mass.numpy(), grid.velocity.numpy(), back.numpy()))
    for one, other in zip(*results, strict=True):
        assert np.array_equal(one, other)
