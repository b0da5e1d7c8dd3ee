"""Tets over a skin: they cover it, weigh what it encloses, and join only what hangs together."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.flesh import embed, fill_anew, fractions, volumes
from plait.pipeline.tetrahedra.graphs import components
from plait.pipeline.tetrahedra.skin import Inside, prepare

SHAPES = (
    "cube",
    "ball",
    "inside out",
    "overlapping",
    "inside out beside",
    "hollow",
    "hollow inside out",
    "nested",
    "bowl",
    "plate",
    "sheet",
    "fork",
    "bunny",
)


@pytest.fixture(scope="module")
def lattices(shapes):
    return {name: fill_anew(shape.points, shape.triangles, budget=6000) for name, shape in shapes.items()}


def pieces(lattice, tets=slice(None)) -> int:
    """How many connected pieces the tets make."""
    chosen = lattice.tets[tets]
    label = components(len(lattice.nodes), np.concatenate([chosen[:, [0, k]] for k in (1, 2, 3)]))
    return len(np.unique(label[chosen]))


@pytest.mark.parametrize("name", SHAPES)
def test_covers_the_skin(name, shapes, lattices):
    """Tets of positive volume hold every point of the skin, in one piece, exactly at rest."""
    shape, lattice = shapes[name], lattices[name]
    assert 0.9 * 6000 <= len(lattice.tets) <= 1.05 * 6000  # the budget, and copies of shared tets
    assert volumes(lattice).min() > 0.0
    assert np.array_equal(np.unique(lattice.tets), np.arange(len(lattice.nodes)))
    assert pieces(lattice) == 1
    embedding, report = embed(shape.points, lattice)
    on_skin = np.isin(np.arange(len(shape.points)), shape.triangles)
    assert embedding.barycentric[on_skin].min() >= -1e-9
    assert report.count == (embedding.barycentric.min(axis=1) < -1e-9).sum()
    corners = lattice.nodes[lattice.tets[embedding.tet]]
    back = np.einsum("nk,nkd->nd", embedding.barycentric, corners)
    assert np.abs(back - shape.points).max() <= 1e-12 * np.linalg.norm(np.ptp(shape.points, axis=0))
    assert np.abs(embedding.barycentric.sum(axis=1) - 1.0).max() <= 1e-12


@pytest.mark.parametrize("name", [n for n in SHAPES if n not in ("bowl", "sheet", "bunny")])
def test_weighs_what_the_skin_encloses(name, shapes, lattices):
    """Sum of part times volume against the closed form; a plate thinner than a tenth of a tet included."""
    shape, lattice = shapes[name], lattices[name]
    part = fractions(lattice, shape.points, shape.triangles)
    assert part.min() > 0.0 and part.max() <= 1.0 + 1e-3
    assert np.sum(part * volumes(lattice)) == pytest.approx(shape.volume, rel=0.02 if name == "plate" else 0.01)


def test_parts_are_at_least_a_twentieth(shapes, lattices):
    shape = shapes["cube"]
    assert fractions(lattices["cube"], shape.points, shape.triangles).min() == pytest.approx(0.05, rel=1e-3)


def test_parts_of_tets_from_elsewhere(shapes, lattices):
    """Measured anew, the parts of a lattice weigh as much as those it was filled with."""
    shape, lattice = shapes["ball"], lattices["ball"]
    bare = type(lattice)(lattice.nodes, lattice.tets)
    part = fractions(bare, shape.points, shape.triangles)
    assert np.sum(part * volumes(bare)) == pytest.approx(shape.volume, rel=0.01)


@pytest.mark.parametrize("gap,edge", [(0.2, 0.1), (0.05, 0.1), (0.02, 0.07), (0.001, 0.1), (0.001, 0.13)])
def test_prongs_nearer_than_a_tet_are_not_welded(gap, edge, make_fork):
    """Above the bar, which ends at .3, the prongs of a fork share no node, whatever their distance."""
    shape = make_fork(gap)
    lattice = fill_anew(shape.points, shape.triangles, edge=edge)
    assert pieces(lattice) == 1
    above = lattice.nodes[lattice.tets].mean(axis=1)[:, 1] > 0.6
    assert pieces(lattice, above) == 2
    embedding, _ = embed(shape.points, lattice)
    label = components(len(lattice.nodes), np.concatenate([lattice.tets[above][:, [0, k]] for k in (1, 2, 3)]))
    of_point = label[lattice.tets[embedding.tet][:, 0]]
    left = (shape.points[:, 0] < 0.0) & (shape.points[:, 1] > 1.0)
    right = (shape.points[:, 0] > 0.0) & (shape.points[:, 1] > 1.0)
    assert len(np.unique(of_point[left])) == 1 and len(np.unique(of_point[right])) == 1
    assert of_point[left][0] != of_point[right][0]


def test_balls_that_do_not_touch_stay_apart(shapes):
    ball = shapes["ball"]
    points = np.concatenate([ball.points, ball.points + np.array([2.02, 0.0, 0.0])])
    lattice = fill_anew(points, np.concatenate([ball.triangles, ball.triangles + len(ball.points)]), edge=0.2)
    assert pieces(lattice) == 2


def test_a_crumb_is_held_by_what_it_lies_beside(shapes):
    """A button a little off a ball, within one of its tets, does not fall off."""
    ball = shapes["ball"]
    button = 0.03 * ball.points + np.array([1.06, 0.0, 0.0])
    points = np.concatenate([ball.points, button])
    lattice = fill_anew(points, np.concatenate([ball.triangles, ball.triangles + len(ball.points)]), edge=0.25)
    assert pieces(lattice) == 1


def test_edge_is_the_mean_edge(shapes):
    shape = shapes["ball"]
    lattice = fill_anew(shape.points, shape.triangles, edge=0.17)
    ends = lattice.nodes[lattice.tets]
    lengths = [np.linalg.norm(ends[:, a] - ends[:, b], axis=1) for a in range(4) for b in range(a)]
    assert np.mean(lengths) == pytest.approx(0.17, rel=1e-9)


def test_two_sides_of_a_sheet_stay_together(shapes):
    """A closed skin without any thickness is one piece, in which no tet is there twice."""
    sheet = shapes["sheet"]
    lattice = fill_anew(sheet.points, np.concatenate([sheet.triangles, sheet.triangles[:, ::-1]]), edge=0.1)
    assert pieces(lattice) == 1
    middles = np.round(lattice.nodes[lattice.tets].mean(axis=1), 9)
    assert len(np.unique(middles, axis=0)) == len(lattice.tets)


def test_the_same_every_time(shapes):
    shape = shapes["fork"]
    first, second = (fill_anew(shape.points, shape.triangles, budget=3000) for _ in range(2))
    for name, value in vars(first).items():
        assert np.array_equal(value, getattr(second, name)), name


@pytest.mark.parametrize("scale,offset", [(1e-3, 0.0), (1e3, 5e5)])
def test_any_unit_and_place(scale, offset, shapes):
    """Millimetres or a kilometre from the origin: the same tets."""
    shape = shapes["fork"]
    here = fill_anew(shape.points, shape.triangles, edge=0.1)
    there = fill_anew(scale * shape.points + offset, shape.triangles, edge=0.1 * scale)
    assert np.array_equal(here.tets, there.tets)
    rounding = 1e-15 * (np.abs(there.nodes).max() / scale + 10.0)
    assert np.abs((there.nodes - offset) / scale - here.nodes).max() <= 10.0 * rounding


def test_points_of_no_triangle_are_embedded_too(shapes):
    ball = shapes["ball"]
    stray = np.array([[0.1, 0.2, 0.3], [1.5, 0.0, 0.0]])
    points = np.concatenate([ball.points, stray])
    lattice = fill_anew(points, ball.triangles, edge=0.3)
    embedding, report = embed(points, lattice)
    back = np.einsum("nk,nkd->nd", embedding.barycentric, lattice.nodes[lattice.tets[embedding.tet]])
    assert np.abs(back - points).max() <= 1e-12
    assert report.count == 1 and report.strong == 1 and report.largest > 0.5


@pytest.mark.parametrize("name", ["cube", "ball", "fork", "hollow"])
def test_inside_as_rays_have_it(name, shapes):
    """The winding number's inside against ray parity, for closed skins, but for float32's rounding at them."""
    shape = shapes[name]
    skin = prepare(shape.points, shape.triangles)
    low, high = shape.points.min(axis=0) - 0.1, shape.points.max(axis=0) + 0.1
    places = np.random.default_rng(3).uniform(low, high, (600, 3))
    distance, _ = Inside.of(skin).query(places)
    clear = np.abs(distance) > 1e-5
    assert np.array_equal(distance[clear] < 0.0, crossings(places, shape)[clear] % 2 == 1)


def crossings(places: np.ndarray, shape) -> np.ndarray:
    """How often a ray from each place, in a crooked direction, passes the skin (Moeller & Trumbore 1997)."""
    direction = np.array([0.5377, 0.2218, 0.8134])
    a, b, c = (shape.points[shape.triangles[:, k]] for k in range(3))
    across = np.cross(direction, c - a)
    determinant = np.einsum("ti,ti->t", b - a, across)
    away = places[:, None] - a
    turned = np.cross(away, b - a)
    u = np.einsum("qti,ti->qt", away, across) / determinant
    v = turned @ direction / determinant
    distance = np.einsum("qti,ti->qt", turned, c - a) / determinant
    return ((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)).sum(axis=1)


def test_shells_that_are_inside_out_are_turned(shapes):
    turned = {}
    for name, shape in shapes.items():
        skin = prepare(shape.points, shape.triangles)
        changed = skin.triangles[(skin.triangles != skin.welded[shape.triangles]).any(axis=1)]
        shell = components(len(skin.points), skin.triangles[:, [0, 1, 1, 2]].reshape(-1, 2))
        turned[name] = len(np.unique(shell[changed]))
    expected = {"inside out": 1, "inside out beside": 1, "hollow inside out": 2}
    assert turned == {name: expected.get(name, 0) for name in shapes}
