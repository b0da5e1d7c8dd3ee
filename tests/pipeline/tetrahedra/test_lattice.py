"""The lattice itself: locating, nesting, boundaries, parts."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.tetrahedra.bcc import Grid
from plait.pipeline.tetrahedra.cover import adjacent_parts, part_middles
from plait.pipeline.tetrahedra.crossings import triangles_through
from plait.pipeline.tetrahedra.filling import fill
from plait.pipeline.tetrahedra.fractions import cut_fractions
from plait.pipeline.tetrahedra.graphs import components
from plait.pipeline.tetrahedra.mesh import Lattice, barycentric, boundary, volumes
from plait.pipeline.tetrahedra.skin import winding_numbers

GRID = Grid(np.array([5, 6, 7]))
PLACES = np.random.default_rng(5).uniform(1.0, [4.0, 5.0, 6.0], (4000, 3))


def lattice_of(names: np.ndarray) -> Lattice:
    used, tets = np.unique(GRID.nodes_of(names), return_inverse=True)
    return Lattice(GRID.places_of(used), tets.reshape(-1, 4))


def test_a_place_lies_in_the_tet_it_is_located_in():
    names = GRID.locate(PLACES)
    lattice = lattice_of(names)
    assert np.abs(volumes(lattice) - 1.0 / 12.0).max() <= 1e-15
    assert barycentric(lattice, np.arange(len(names)), PLACES).min() >= -1e-13


def test_neighbours_share_the_face():
    names = np.unique(GRID.locate(PLACES))
    nodes, behind = GRID.nodes_of(names), GRID.neighbours(names)
    for corner in range(4):
        theirs = GRID.nodes_of(behind[:, corner])
        shared = (nodes[:, :, None] == theirs[:, None]).any(axis=2)
        assert np.array_equal(shared, np.arange(4) != np.full((len(names), 1), corner))


@pytest.mark.parametrize("factor", [2, 3])
def test_a_finer_lattice_nests(factor):
    """Each tet is factor³ of a lattice factor times finer, and they hang together."""
    fine = GRID.refined(factor)
    inner = np.unique(fine.locate(PLACES * factor))
    corners = fine.places_of(fine.nodes_of(inner)) / factor
    name = GRID.locate(corners.mean(axis=1))
    at = barycentric(lattice_of(name), np.repeat(np.arange(len(name)), 4), corners.reshape(-1, 3))
    assert at.min() >= -1e-12
    middles = part_middles(factor)
    assert len(middles) == factor**3 and middles.min() > 0.0
    assert np.abs(middles.mean(axis=0) - 0.25).max() <= 1e-12
    assert components(factor**3, adjacent_parts(factor)).max() == 0


def test_boundary_is_outward_and_closed(shapes):
    shape = shapes["ball"]
    lattice = fill(shape.points, shape.triangles, edge=0.3)
    faces = boundary(lattice)
    corners = lattice.nodes[faces]
    enclosed = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert enclosed == pytest.approx(volumes(lattice).sum(), rel=1e-12)
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    key, mirrored = ends @ [len(lattice.nodes), 1], ends @ [1, len(lattice.nodes)]
    assert np.array_equal(np.sort(key), np.sort(mirrored))
    assert winding_numbers(np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), corners) == pytest.approx(
        [1, 0], abs=1e-9
    )


class Half:
    """Inside is where a . x < b."""

    def __init__(self, a: np.ndarray, b: float) -> None:
        self.a, self.b = a / np.linalg.norm(a), b

    def query(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return places @ self.a - self.b, np.zeros(len(places), dtype=int)


@pytest.mark.parametrize("level", [-0.2, 0.0, 0.1, 0.3, 0.55])
def test_a_plane_cuts_exactly(level):
    """The part of a tet below a plane, against the integral of its cross sections' squares: two random samples in
    the mean of 200 000 lie within 4 / sqrt(200 000 * 4) of it."""
    nodes = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    plane = Half(np.array([1.0, 2.0, -0.5]), level)
    part = cut_fractions(plane, nodes, np.array([[0, 1, 2, 3]]))[0]
    inside = np.random.default_rng(1).dirichlet(np.ones(4), 200_000) @ nodes
    assert part == pytest.approx((plane.query(inside)[0] < 0.0).mean(), abs=4.5e-3)


def test_triangles_cross_where_one_edge_pierces_the_other():
    still = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    through = np.array([[0.5, 0.5, -1.0], [0.5, 0.5, 1.0], [9.0, 9.0, 0.5]])
    beside = through + np.array([5.0, 5.0, 0.0])
    above = still + np.array([0.0, 0.0, 0.1])
    meets, where = triangles_through(np.stack([through, beside, above]), np.stack([still] * 3))
    assert meets.tolist() == [True, False, False]
    assert where[0] == pytest.approx([0.5, 0.5, 0.0])


def test_components_of_a_long_chain():
    count = 5000
    order = np.random.default_rng(0).permutation(count)
    label = components(count + 2, np.stack([order[:-1], order[1:]], axis=1))
    assert len(np.unique(label[:count])) == 1 and len(np.unique(label)) == 3
