"""How much of each tet is flesh: those at the skin reach beyond it."""

from __future__ import annotations

import numpy as np

from plait.pipeline.tetrahedra.filling import part_middles
from plait.pipeline.tetrahedra.mesh import Lattice
from plait.pipeline.tetrahedra.skin import Inside, prepare

SAMPLES = 4  # a tet: this cubed
FLOOR = 0.05


def fractions(lattice: Lattice, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(tet_count,) the part of each tet inside the skin, by the winding number at 64 samples; at least 0.05.

    Density and stiffness of a tet times this make mass and stiffness of what is drawn. The floor keeps the nodes
    of barely covered tets from weighing nothing, which would make the equations as ill conditioned as it is small.
    """
    skin = prepare(points, triangles)
    inside = Inside(skin.points, skin.triangles)
    corners = lattice.nodes[lattice.tets]
    middle = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    distance, _ = inside.query(middle)
    result = (distance < 0.0).astype(np.float64)
    near = np.flatnonzero(np.abs(distance) <= reach)
    weights = part_middles(SAMPLES)
    samples = np.einsum("sk,tkd->tsd", weights, corners[near])
    distance, _ = inside.query(samples.reshape(-1, 3))
    result[near] = (distance < 0.0).reshape(samples.shape[:2]).mean(axis=1)
    return np.maximum(result, FLOOR)
