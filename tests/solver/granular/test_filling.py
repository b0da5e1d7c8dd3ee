"""Filling a closed surface with particles."""

from __future__ import annotations

import numpy as np
import trimesh

from plait.solver.granular.filling import fill_surface
from plait.solver.launch import Launcher

CELL = 0.1


def filled(mesh: trimesh.Trimesh, threads: int = 1, **options):
    return fill_surface(mesh.vertices, mesh.faces, CELL, 8, Launcher(threads=threads), **options)


def test_volume_is_the_surfaces():
    """Particles times their volume: that of the solid, up to the cells that its surface cuts."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.6)
    places, volume = filled(ball)
    # The count of lattice points in a ball errs by far less than the points of its outer half spacing.
    assert abs(len(places) * volume - ball.volume) < 0.02 * ball.volume
    assert (np.linalg.norm(places, axis=1) < 0.6).all()


def test_eight_a_cell_and_none_near_another():
    """A box on the lattice holds `per_cell` in each cell; with jitter j none is nearer than 1 - j spacings."""
    box = trimesh.creation.box((4 * CELL,) * 3)
    places, volume = filled(box, jitter=0.5)
    cells, counts = np.unique(np.floor(places / CELL), axis=0, return_counts=True)
    assert len(cells) == 64 and (counts == 8).all()
    np.testing.assert_allclose(volume, CELL**3 / 8)
    gaps = np.linalg.norm(places[:, None] - places, axis=2)
    assert gaps[~np.eye(len(places), dtype=bool)].min() >= 0.5 * CELL / 2 - 1e-12


def test_hollows_stay_empty():
    """A shell with its inner wall turned inwards: the winding number inside that is zero."""
    outer, inner = trimesh.creation.icosphere(3, radius=0.6), trimesh.creation.icosphere(3, radius=0.4)
    inner.invert()
    places, _ = filled(trimesh.util.concatenate([outer, inner]))
    assert len(places) and (np.linalg.norm(places, axis=1) > 0.39).all()


def test_same_places_with_any_number_of_threads():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.9)
    np.testing.assert_array_equal(filled(ball, 1)[0], filled(ball, 2)[0])
