"""Pairs of edges that may meet: none lost, few too many, at no cost to strands that are alone."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.strand_contact.edge_pairs import EdgePairs

from .pairs_of_edges import layout_of
from .referee import edges_of

LAUNCHER = Launcher("cpu", threads=1)
REACH, MARGIN = 4e-4, 1e-3


def found(
    pairs: EdgePairs, start: np.ndarray, end: np.ndarray, margin: float | np.ndarray = MARGIN
) -> set[tuple[int, int]]:
    """margin: [m], or of each node, (node_count,)."""
    arrays = [wp.array(x, dtype=wp.vec3d) for x in (start, end)]
    room = wp.array(np.broadcast_to(0.5 * margin, len(start)), dtype=wp.float64)
    assert pairs.find(*arrays, room) == (pairs.count > 0)
    return set(map(tuple, pairs.pairs.numpy().tolist()))


def edge_pairs(layout: SimpleNamespace, reach: float = REACH, launcher: Launcher = LAUNCHER) -> EdgePairs:
    return EdgePairs(launcher, layout, np.full(layout.node_count, reach))


def tangle(strands: int = 45, points: int = 10, size: float = 0.02, seed: int = 1) -> SimpleNamespace:
    """Strands of 4 mm segments in all directions from roots in a cube."""
    random = np.random.default_rng(seed)
    roots = random.uniform(0.0, size, (strands, 1, 3))
    ways = random.standard_normal((strands, points, 3)) + 2.0 * random.standard_normal((strands, 1, 3))
    ways *= 4e-3 / np.linalg.norm(ways, axis=2, keepdims=True)
    return layout_of(list(roots + np.cumsum(ways, axis=1)))


def rotation(angle: float) -> np.ndarray:
    """About an axis that is none of the frame's."""
    x, y, z = np.array([2.0, -1.0, 2.0]) / 3.0
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def of_two_strands(layout: SimpleNamespace) -> np.ndarray:
    """(count, 2) all pairs of edges of different strands."""
    edges = edges_of(layout.first_node)
    a, b = (edges[k] for k in np.triu_indices(len(edges), 1))
    return np.stack([a, b], axis=1)[layout.node_strand[a] != layout.node_strand[b]]


def near_on_the_way(
    layout: SimpleNamespace, start: np.ndarray, end: np.ndarray, within: float | np.ndarray
) -> set:
    """Pairs of edges of different strands with two of 9 points nearer than `within` in one of 5 poses."""
    pairs, parts = of_two_strands(layout), np.linspace(0.0, 1.0, 9)[:, None]
    least = np.full(len(pairs), np.inf)
    for t in parts[::2]:
        x = (1.0 - t) * start + t * end
        points = x[:-1, None] + parts * np.diff(x, axis=0)[:, None]
        for k in range(9):
            gaps = np.linalg.norm(points[pairs[:, 0]][:, k, None] - points[pairs[:, 1]], axis=2)
            least = np.minimum(least, gaps.min(axis=1))
    return set(map(tuple, pairs[least < within].tolist()))


@pytest.mark.parametrize("angle, shift", [(0.0, 0.1), (0.3, 0.02), (0.9, 5.0), (2.0, 0.0)])
def test_none_is_lost(angle, shift):
    """All pairs nearer than the reaches and the margin at any time, whatever the common motion; 30 m away too."""
    layout = tangle()
    start = layout.position + 30.0
    end = layout.position @ rotation(angle).T + 30.0 + shift
    end += 1e-3 * np.random.default_rng(2).standard_normal(end.shape)
    near = near_on_the_way(layout, start, end, 2.0 * REACH + MARGIN)
    assert len(near) > 80 and near <= found(edge_pairs(layout), start, end)


def test_nodes_have_room_of_their_own():
    """All pairs nearer than their reaches and the rooms of their roomier nodes; fewer than if all had the most."""
    layout, random = tangle(), np.random.default_rng(5)
    start = layout.position
    end = start + 1e-3 * random.standard_normal(start.shape)
    margin = MARGIN * random.choice([0.2, 2.0], len(start), p=[0.9, 0.1])
    room = 0.5 * np.maximum(margin, np.append(margin[1:], 0.0))
    near = near_on_the_way(layout, start, end, 2.0 * REACH + room[of_two_strands(layout)].sum(axis=1))
    listed = found(edge_pairs(layout), start, end, margin)
    assert len(near) > 50 and near <= listed
    assert listed < found(edge_pairs(layout), start, end, margin.max())


def test_found_again_are_the_pairs_of_what_went_elsewhere():
    """A tenth of the nodes end elsewhere, with more room: pairs with one of their edges are those of a new search,
    the others as they were, and all are sorted and known to their edges as ever.
    """
    layout, random = tangle(), np.random.default_rng(6)
    start, count = layout.position, layout.node_count
    end = start + 1e-3 * random.standard_normal(start.shape)
    pairs = edge_pairs(layout)
    before = found(pairs, start, end)
    elsewhere = random.random(count) < 0.1
    end[elsewhere] += 3e-3 * random.standard_normal((int(elsewhere.sum()), 3))
    margin = np.where(elsewhere, 2.0 * MARGIN, MARGIN)
    sought = elsewhere | np.append(elsewhere[1:], False)
    arrays = [wp.array(x, dtype=wp.vec3d) for x in (start, end)]
    assert pairs.find_again(*arrays, wp.array(0.5 * margin, dtype=wp.float64), 0.0, sought)
    rows = [tuple(row) for row in pairs.pairs.numpy().tolist()]
    new = found(edge_pairs(layout), start, end, margin)
    of_sought = {pair for pair in new if sought[list(pair)].any()}
    assert of_sought - before and {pair for pair in before if sought[list(pair)].any()} - of_sought
    assert rows == sorted(of_sought | {pair for pair in before if not sought[list(pair)].any()})
    first, incident = pairs.first.numpy(), pairs.incident.numpy()
    for edge in range(count):
        own = [rows[i // 2][1 - i % 2] for i in incident[first[edge] : first[edge + 1]]]
        assert own == sorted({a + b - edge for a, b in rows if edge in (a, b)})


def test_none_is_beyond_the_padding():
    """Every pair found has swept boxes, seen from the strands' mean motion, that overlap when so padded.

    To the search's resolution: 1 / 2^14 of the strands' extent, and float32 coordinates.
    """
    layout = tangle()
    start = layout.position
    own = 0.05 * (start - start.mean(axis=0))  # swelling, which is no rigid motion at all
    pairs = np.array(sorted(found(edge_pairs(layout), start, start + own + 0.2)))
    apart = layout.node_strand[pairs[:, 0]] != layout.node_strand[pairs[:, 1]]
    ends = np.stack([start[:-1], start[1:], (start + own)[:-1], (start + own)[1:]])
    lower, upper = ends.min(axis=0) - REACH - 0.5 * MARGIN, ends.max(axis=0) + REACH + 0.5 * MARGIN
    a, b = pairs[apart].T
    gap = np.maximum(lower[a] - upper[b], lower[b] - upper[a]).max(axis=1)
    assert len(gap) > 100 and gap.max() <= np.ptp(start) / 2**14


@pytest.mark.parametrize("angle, shift", [(0.0, 0.5), (0.1, 0.02)])
def test_a_common_motion_costs_nothing(angle, shift):
    """Strands carried rigidly have the pairs of strands at rest, but for the widening by 1 / cos(angle / 2)."""
    layout = tangle(strands=60)
    pairs = edge_pairs(layout)
    at_rest = found(pairs, layout.position, layout.position)
    carried = found(pairs, layout.position, layout.position @ rotation(angle).T + shift)
    widened = found(pairs, layout.position, layout.position, MARGIN * 1.02)
    assert len(at_rest) > 100 and at_rest - carried == set() and len(carried) <= len(widened)


def test_pairs_are_sorted_and_each_edge_knows_its_own():
    layout = tangle()
    pairs = edge_pairs(layout)
    listed = found(pairs, layout.position, layout.position)
    rows = [tuple(row) for row in pairs.pairs.numpy().tolist()]
    assert rows == sorted(listed) and all(a < b for a, b in rows)
    first, incident = pairs.first.numpy(), pairs.incident.numpy()
    own = np.repeat(np.arange(layout.node_count), np.diff(first))
    np.testing.assert_array_equal(np.array(rows)[incident // 2, incident % 2], own)
    np.testing.assert_array_equal(np.sort(incident), np.arange(2 * pairs.count))
    with_pairs = np.zeros(layout.strand_count, dtype=bool)
    with_pairs[layout.node_strand[np.array(rows)]] = True
    np.testing.assert_array_equal(pairs.near, with_pairs)


def test_same_bits_on_two_threads():
    layout = tangle(strands=200, points=20, size=0.05)
    results = []
    for threads in (1, 2):
        launcher = Launcher("cpu", threads=threads)
        pairs = edge_pairs(layout, launcher=launcher)
        found(pairs, layout.position, layout.position + 1e-3)
        results.append([array.numpy().copy() for array in (pairs.pairs, pairs.first, pairs.incident)])
        launcher.close()
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)


def test_strands_apart_cost_one_launch():
    """A field of strands 2 cm apart that sway by 5 mm and are carried 0.2 m; one alone, straight, bent, curled."""
    s = np.linspace(0.0, 0.05, 20)
    upright = np.stack([0.0 * s, 0.0 * s, s], axis=1)
    places = 0.02 * np.stack(np.meshgrid(np.arange(12), np.arange(12), [0.0]), axis=-1).reshape(-1, 1, 3)
    bent = 0.05 * np.stack([np.sin(30.0 * s), 0.0 * s, np.cos(30.0 * s)], axis=1)
    curled = np.stack([5e-3 * np.sin(300.0 * s), 5e-3 * np.cos(300.0 * s), 0.2 * s], axis=1)
    for strands in (list(places + upright), [upright], [bent], [curled]):
        layout, launcher = layout_of(strands), Launcher("cpu", threads=1)
        pairs = edge_pairs(layout, launcher=launcher)
        sway = 5e-3 * np.sin(layout.position[:, 2:] * 30.0) * [1.0, 0.0, 0.0] + 0.2
        assert found(pairs, layout.position, layout.position + sway) == set()
        assert launcher.launches.total() == 1 and not pairs.near.any()


def test_only_strands_in_reach_have_pairs():
    """Of a row of upright strands, two that cross: they are near, the others are not."""
    s = np.linspace(0.0, 0.05, 11)
    strands = [np.stack([0.0 * s + 0.05 * k, 0.0 * s, s], axis=1) for k in range(6)]
    strands[3] = np.stack([0.1 - 0.025 + s, 0.0 * s + 5e-4, 0.0 * s + 0.0272], axis=1)
    layout = layout_of(strands)
    pairs = edge_pairs(layout)
    listed = found(pairs, layout.position, layout.position, margin=1e-3)
    assert np.flatnonzero(pairs.near).tolist() == [2, 3] and 1 <= len(listed) <= 4


def test_a_strand_meets_itself_where_it_turns_back():
    """A hairpin whose legs are 1 mm apart; not along its legs, nor next to the bend within the reach's length."""
    s = np.linspace(0.0, 0.02, 21)
    down, up = np.stack([0.0 * s, 0.0 * s, -s], axis=1), np.stack([0.0 * s + 1e-3, 0.0 * s, s - 0.02], axis=1)
    layout = layout_of([np.vstack([down, up])])
    listed = found(edge_pairs(layout, 6e-4), layout.position, layout.position, margin=1e-5)
    bend = 1 + 20  # the last node of the way down
    assert all(a < bend < b for a, b in listed)
    facing = {(k, 2 * bend - k) for k in range(2, bend - 1)}
    assert facing <= listed
    assert all(layout.edge_length[a + 1 : b].sum() >= 1.2e-3 for a, b in listed)


def test_edges_that_nothing_moves_are_no_pair():
    """Of two crossing strands all nodes of which are prescribed; with one node free, they are one."""
    s = np.linspace(-5e-3, 5e-3, 5) + 1e-4
    layout = layout_of([np.stack([s, 0 * s, 0 * s], axis=1), np.stack([0 * s, s, 0 * s + 1e-4], axis=1)])
    prescribed = np.ones(layout.node_count, dtype=bool)
    reach = np.full(layout.node_count, REACH)
    arrays = [wp.array(layout.position, dtype=wp.vec3d)] * 2
    assert not EdgePairs(LAUNCHER, layout, reach, prescribed).find(*arrays)
    prescribed[3] = False
    assert EdgePairs(LAUNCHER, layout, reach, prescribed).find(*arrays)


def test_crowds_and_long_edges():
    """60 strands in one place, more partners than room is kept for, and an edge 1000 times the others' length."""
    random = np.random.default_rng(4)
    strands = list(1e-3 * np.cumsum(random.standard_normal((60, 4, 3)), axis=1))
    strands.append(np.array([[-1.0, -2.0, -1.5], [1.0, 2.0, 1.5]]))
    layout = layout_of(strands)
    pairs = edge_pairs(layout, 1e-5)
    near = near_on_the_way(layout, layout.position, layout.position, 2e-5 + 3e-3)
    listed = found(pairs, layout.position, layout.position, margin=3e-3)
    assert near <= listed and np.diff(pairs.first.numpy()).max() > 100
    assert any(b == layout.first_node[-2] + 1 for _, b in listed)


def test_a_strand_gone_astray_is_no_pair():
    """Positions that are no numbers are left out; the others' pairs stay."""
    layout = tangle()
    pairs = edge_pairs(layout)
    listed = found(pairs, layout.position, layout.position)
    broken = layout.position.copy()
    broken[layout.node_strand == 3] = np.nan
    left = found(pairs, layout.position, broken)
    assert left and left <= listed and not pairs.near[3]
    assert found(pairs, layout.position, np.full_like(broken, np.nan)) == set()
