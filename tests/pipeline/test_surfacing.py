"""The surface about grains: closed, where the matter ends, whatever lies far off."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from plait.pipeline.surfacing import GrainSurface, surface_of

SPACING, RADIUS = 0.04, 0.4
CELL = 1.5 * SPACING


def ball() -> np.ndarray:
    """(n, 3) grains of a ball about the origin, each within a quarter of a spacing of a lattice's place."""
    random = np.random.default_rng(3)
    places = SPACING * (np.indices((24, 24, 24)).reshape(3, -1).T - 11.5)
    places += 0.25 * SPACING * random.uniform(-1.0, 1.0, places.shape)
    return places[np.linalg.norm(places, axis=1) < RADIUS]


def surface(places: np.ndarray, velocities: np.ndarray | None = None) -> GrainSurface:
    return surface_of(places, np.zeros_like(places) if velocities is None else velocities, SPACING**3, CELL)


def volume(found: GrainSurface) -> float:
    a, b, c = (found.points[found.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6.0


def test_the_surface_of_a_ball() -> None:
    """It lies at the ball's radius to a fraction of a cell, encloses its volume, is closed and faces outwards."""
    found = surface(ball())
    away = np.linalg.norm(found.points, axis=1)
    assert np.abs(away - RADIUS).max() < 0.5 * CELL
    # The error of the mean is that of a lattice's count, far below a layer of half a spacing.
    assert volume(found) == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=1.5 * SPACING / RADIUS / 2)
    edges = found.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert {tuple(e) for e in edges.tolist()} == {tuple(e[::-1]) for e in edges.tolist()}
    assert len(np.unique(edges, axis=0)) == len(edges)
    outwards = np.einsum("ni,ni->n", found.normals, found.points / away[:, None])
    assert outwards.min() > 0.8
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-12)


def test_finer_cells_are_not_needed_to_move_it() -> None:
    """Moved by whole cells, the same surface moved: the same cells, to rounding."""
    shift = CELL * np.array([1000.0, -20.0, 3.0])
    here, there = surface(ball()), surface(ball() + shift)
    np.testing.assert_array_equal(there.triangles, here.triangles)
    np.testing.assert_allclose(there.points, here.points + shift, atol=1e-9)


def test_it_goes_as_the_matter_goes() -> None:
    """Any rigid motion's velocity is taken over where the surface is, as far as a cell smooths it."""
    places = ball()
    spin, drift = np.array([0.0, 0.0, 2.0]), np.array([1.0, -3.0, 0.5])
    found = surface(places, np.cross(spin, places) + drift)
    expected = np.cross(spin, found.points) + drift
    assert np.abs(found.velocities - expected).max() < np.linalg.norm(spin) * CELL


def test_a_grain_far_off_costs_nothing_and_has_no_surface() -> None:
    places = ball()
    far = np.append(places, [[3e4, 0.0, 0.0], [0.0, -2e4, 1e4]], axis=0)
    tracemalloc.start()
    found = surface(far)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4000 * len(places), "memory follows the grains, not their box of 1e17 cells"
    assert np.abs(found.points).max() < RADIUS + CELL
    assert len(found.triangles) == len(surface(places).triangles)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_grains_have_none(count: int) -> None:
    found = surface(np.arange(3.0 * count).reshape(-1, 3))
    assert found.points.shape == found.velocities.shape == found.normals.shape == found.triangles.shape == (0, 3)


def test_the_same_grains_give_the_same_bits() -> None:
    first, second = surface(ball()), surface(ball())
    for name in ("points", "triangles", "normals", "velocities"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
