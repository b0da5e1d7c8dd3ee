"""From a skin to flesh: tets over it, points within them, joint weights and bone inside them.

    lattice = fill(points, triangles, budget=20_000)
    embedding, report = embed(points, lattice)
    part = fractions(lattice, points, triangles)
    weights = extend(lattice, embedding, skin_weights)
    bone = core(lattice, embedding, points, triangles, weights, joints, parents).pinned

Lengths are in whatever units the points are in. `fill` is deterministic, and cached by content.
"""

from __future__ import annotations

import numpy as np

from plait.pipeline.tetrahedra.cache import kept
from plait.pipeline.tetrahedra.core import DEPTH, Core, core
from plait.pipeline.tetrahedra.embedding import Extrapolation, embed
from plait.pipeline.tetrahedra.extension import extend, influences
from plait.pipeline.tetrahedra.files import read_tet_mesh
from plait.pipeline.tetrahedra.filling import BUDGET
from plait.pipeline.tetrahedra.filling import fill as fill_anew
from plait.pipeline.tetrahedra.fractions import fractions
from plait.pipeline.tetrahedra.mesh import Lattice, boundary, volumes

__all__ = [
    "BUDGET",
    "DEPTH",
    "Core",
    "Extrapolation",
    "Lattice",
    "boundary",
    "core",
    "embed",
    "extend",
    "fill",
    "fractions",
    "influences",
    "read_tet_mesh",
    "volumes",
]

# Counts up with every change to what `fill` makes, so that no older version's lattice is taken for this one's.
VERSION = 6


def fill(points: np.ndarray, triangles: np.ndarray, *, edge: float | None = None, budget: int = BUDGET) -> Lattice:
    """`tetrahedra.filling.fill`, from the cache if the same skin was filled before."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int32)
    inputs = {"points": points, "triangles": triangles, "edge": edge, "budget": budget if edge is None else 0}

    def make() -> dict[str, np.ndarray]:
        return vars(fill_anew(points, triangles, edge=edge, budget=budget))

    return Lattice(**kept("flesh", VERSION, inputs, make))
