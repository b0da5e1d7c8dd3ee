"""What the coarse correction of a body's linear solves is made of."""

from __future__ import annotations

import numpy as np

from plait.solver.linear.coarse import Material
from plait.solver.tets.elements import lame_parameters
from plait.solver.tets.layout import TetLayout


def rest_material(layout: TetLayout, body: int, node: np.ndarray) -> Material:
    """Of the unknowns at `node`, (unknown_count,)."""
    tet_range = slice(int(layout.first_tet[body]), int(layout.first_tet[body + 1]))
    tets, volume = layout.tets[tet_range], layout.volume[tet_range]
    mu, lam = lame_parameters(layout.bodies[body].youngs_modulus, layout.bodies[body].poissons_ratio)
    slopes, pinned = layout.slopes(body), layout.pinned[tets]
    # A third of the trace of a diagonal block; and of what couples a corner to pinned ones, if that holds it back.
    modulus = (volume * (4.0 * mu + lam) / 3.0)[:, None]
    own = modulus * np.square(slopes).sum(axis=2)
    held = modulus * np.maximum(-np.einsum("tai,tbi,tb->ta", slopes, slopes, pinned), 0.0)

    def on_nodes(values: np.ndarray) -> np.ndarray:
        return np.bincount(tets.ravel(), values.ravel(), minlength=layout.node_count)[node]

    return Material(
        points=layout.rest[node],
        stiffness=on_nodes(own),
        penalty=on_nodes(held),
        centres=layout.rest[tets].mean(axis=1),
        mu=mu * volume,
        lam=lam * volume,
        edge=float(layout.edge[body]),
    )
