"""The referee itself: what it must find, what it must leave, and the invariants of links and braids."""

from __future__ import annotations

import ipctk
import numpy as np
import pytest

from . import referee, scenes


def sticks(random: np.random.Generator, count: int) -> np.ndarray:
    """(2 count, 3): `count` edges in a unit box."""
    middle, half = random.uniform(size=(count, 3)), 0.15 * random.normal(size=(count, 3))
    return np.stack([middle - half, middle + half], axis=1).reshape(-1, 3)


def test_missed_collisions_are_those_of_the_test_on_every_pair():
    """The broad phase loses none: against Tight Inclusion on all pairs of edges that move at random."""
    random = np.random.default_rng(0)
    start = sticks(random, 60)
    end = start + np.repeat(0.2 * random.normal(size=(60, 3)), 2, axis=0) + 0.05 * random.normal(size=start.shape)
    test, expected = ipctk.TightInclusionCCD(), set()
    for k in range(0, 120, 2):
        for j in range(k + 2, 120, 2):
            corners = [k, k + 1, j, j + 1]
            if test.edge_edge_ccd(*start[corners], *end[corners])[0]:
                expected.add((k, j))
    found = referee.MissedCollisions(np.arange(0, 120, 2, dtype=np.int32))(start, end)
    assert len(expected) > 20
    assert {tuple(pair) for pair in found.tolist()} == expected


def test_strands_that_pass_through_are_counted_once_for_each_crossing():
    """Two strands swung through each other at 5 m/s cross once; without contact the referee says so."""
    case = scenes.crossing(pairs=2, speed=(5.0, 5.0))
    simulation = case.start("none")
    judge = referee.Referee(simulation)
    simulation.advance_frame(1.0 / 24.0)
    assert judge.substeps == 8
    assert judge.missed >= 2
    strands = simulation.model.parts["strands"].layout.node_strand[sorted(judge.pairs)]
    assert {(0, 1), (2, 3)} == set(map(tuple, strands.tolist()))


@pytest.mark.parametrize("turns", [0, 1, -2])
def test_linking_number_of_a_helix_about_a_line(turns):
    """A closed curve that winds n times about another links it n times."""
    along = np.linspace(0.0, 1.0, 60)
    turn = 2.0 * np.pi * turns * along
    helix = np.stack([0.1 * np.cos(turn), -along, 0.1 * np.sin(turn)], axis=1)
    line = np.stack([0.0 * along, -along, 0.0 * along], axis=1)
    away = np.array([[0.5, -0.8, 0.0], [-0.5, -0.8, 0.0]])
    linked = referee.linking_matrix(np.array([helix, line]), away)[0, 1]
    beside = referee.linking_matrix(np.array([line + np.array([0.1, 0.0, 0.0]), line]), away)[0, 1]
    assert abs(linked - beside) == abs(turns)


def test_braid_invariant_tells_braids_apart():
    """Inverse braids multiply to one; a braid, its mirror image and one with a strand let through differ."""
    braid = np.array(scenes.braided(2, 0.3, 120, 0.01, 0.005))
    mirrored = braid * [1.0, 1.0, -1.0]
    undone = np.concatenate([braid, braid[:, ::-1][:, 1:] * [1.0, -1.0, 1.0] + [0.0, -0.6, 0.0]], axis=1)
    assert referee.braid_invariant(undone) == (0, (1, 0, 0, 1))
    through = braid.copy()
    through[0, 30:60, 2] *= -1.0
    found = {referee.braid_invariant(one) for one in (braid, mirrored, through)}
    assert len(found) == 3


def test_section_of_discs():
    """The hull of discs of radius r at a square's corners, side a: a^2 + 4 a r + pi r^2."""
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    assert referee.section_area(corners, 0.5) == pytest.approx(4.0 + 4.0 + np.pi / 4.0, rel=1e-12)


def test_inside_a_ball():
    """Points inside and outside of a ball of facets."""
    corners, triangles = scenes.sphere(20, 1.0)
    random = np.random.default_rng(0)
    points = random.normal(size=(500, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    assert referee.inside_convex(0.97 * points, corners, triangles).all()
    assert not referee.inside_convex(1.001 * points, corners, triangles).any()
