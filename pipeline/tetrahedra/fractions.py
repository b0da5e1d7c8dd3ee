"""How much of each tet is flesh: those at the skin reach beyond it."""

from __future__ import annotations

import numpy as np

from plait.pipeline.tetrahedra.bcc import EDGES
from plait.pipeline.tetrahedra.mesh import Lattice, volumes
from plait.pipeline.tetrahedra.skin import Inside, prepare

FLOOR = 0.05
# The share that the floor is a part of: most tets have no more. One but for bodies thinner than their tets.
TYPICAL = 0.9
# A tet's eight parts, of its corners (0 to 3) and the middles of its edges (4 to 9, as in EDGES): four at the
# corners and four of the octahedron left, about the line between the middles of edges 0-1 and 2-3.
PARTS = np.array(
    [
        [0, 4, 5, 6],
        [1, 4, 7, 8],
        [2, 5, 7, 9],
        [3, 6, 8, 9],
        [4, 9, 5, 7],
        [4, 9, 7, 8],
        [4, 9, 8, 6],
        [4, 9, 6, 5],
    ]
)


def fractions(lattice: Lattice, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(tet_count,) the part of each tet that is inside the skin, at least 0.05 of what is usual in the body.

    Density and stiffness of a tet times this make mass and stiffness of what is drawn. The floor keeps the nodes
    of barely covered tets from weighing nothing, which would make the equations as ill conditioned as it is small;
    what it adds is taken off the other tets in proportion, so that the whole weighs what the inside of the skin
    does. A skin with no inside at all counts as full."""
    share = lattice.share
    if share is None:
        share = cut_fractions(Inside.of(prepare(points, triangles)), lattice.nodes, lattice.tets)
    floor = FLOOR * np.quantile(share, TYPICAL)
    if floor == 0.0:
        return np.ones(len(share))
    volume = volumes(lattice)
    low = share < floor
    added = ((floor - share) * volume)[low].sum()
    return np.where(low, floor, share * (1.0 - added / (share * volume)[~low].sum()))


def cut_fractions(inside: Inside, nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """(tet_count,) the part inside, the signed distance taken as linear in each eighth of a tet."""
    used, corners = np.unique(tets, return_inverse=True)
    corners = corners.reshape(-1, 4)
    distance, _ = inside.query(nodes[used])
    at = distance[corners]
    spread = np.linalg.norm(nodes[tets[:, 1:]] - nodes[tets[:, :1]], axis=2).max(axis=1, initial=0.0)
    result = (at[:, 0] < 0.0).astype(np.float64)
    # Where a corner is further from the skin than the tet is wide, no skin passes.
    near = np.flatnonzero(np.abs(at).max(axis=1) < spread)
    pairs = np.sort(tets[near][:, EDGES].reshape(-1, 2), axis=1).astype(np.int64)
    key, inverse = np.unique(pairs[:, 0] * len(nodes) + pairs[:, 1], return_inverse=True)
    start, end = np.divmod(key, len(nodes))
    middle, _ = inside.query(0.5 * (nodes[start] + nodes[end]))
    values = np.concatenate([at[near], middle[inverse].reshape(-1, 6)], axis=1)
    result[near] = _below_zero(values[:, PARTS].reshape(-1, 4)).reshape(-1, 8).mean(axis=1)
    return result


def _below_zero(values: np.ndarray) -> np.ndarray:
    """(n,) the part of a tet where a function, linear between `values` (n, 4) at its corners, is negative."""
    v = np.sort(values, axis=1)
    count = (v < 0.0).sum(axis=1)
    result = (count == 4).astype(np.float64)
    a, b, c, d = v.T
    with np.errstate(divide="ignore", invalid="ignore"):
        one = a**3 / ((a - b) * (a - c) * (a - d))
        three = 1.0 - d**3 / ((d - a) * (d - b) * (d - c))
        # Two below: a prism with a wedge, as three tets from the corners of the cut quadrilateral.
        ac, ad, bc, bd = a / (a - c), a / (a - d), b / (b - c), b / (b - d)
        two = ac * ad * (1.0 - bc) + ad * bc * (1.0 - bd) + bc * bd
    for k, part in ((1, one), (2, two), (3, three)):
        result[count == k] = part[count == k]
    return result
