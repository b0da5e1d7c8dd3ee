"""A prim's flesh on its way into the scene, and what can be said of it before it is filled: nothing heavy here."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read.motions import WorldToLocal
from plait.pipeline.read.parameters import Given
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Body
from plait.pipeline.shot import MeshOutput
from plait.solver.scene import Embedding, Surface, TetBody

# Of the lattice: mean edge over the side of a cell, and tets a cell.
EDGE, TETS = (2.0 + 4.0 * np.sqrt(0.75)) / 6.0, 12


@dataclass(frozen=True)
class Tissue:
    """body: the skin it was read as.  surface: what of that is simulated: the points that some triangle has.
    tets: its elastic body.  output: the way back.  sizes: for the report.
    """

    body: Body
    surface: Surface
    tets: TetBody
    output: MeshOutput
    sizes: dict[str, int]

    def placed(self, index: int, clearance: float, friction: float | None) -> Tissue:
        """As the scene's body `index`, with the parameters of contact."""
        surface = replace(self.surface, body=index, thickness=clearance, friction=friction)
        return replace(self, surface=surface, output=replace(self.output, body=index))


def is_tet_mesh(prim: Usd.Prim) -> bool:
    return prim.IsA(UsdGeom.TetMesh)


def estimate(source: Source, body: Body, given: Given) -> Tissue:
    """What filling the skin would give, but for its tets: sizes alone, about."""
    none, empty = np.zeros(0), np.zeros((0, 4))
    tets = TetBody(
        body.path,
        np.zeros((0, 3)),
        empty.astype(np.int32),
        -1,
        Embedding(none.astype(np.int32), empty),
        none,
        none,
        none,
        none.astype(bool),
        none,
    )
    output = MeshOutput(body.path, WorldToLocal(source, body.prim), -1, point_map=body.welded)
    count = 0
    if not is_tet_mesh(body.prim) and "tetMesh" not in given:
        count = _about(body.surface, given)
    sizes = {"tets (about)": count} if count else {}
    return Tissue(body, body.surface, tets, output, sizes)


def _about(skin: Surface, given: Given) -> int:
    """Tets of the given edge in the skin's volume and half a cell beyond it; else as many as the budget."""
    if given["tetEdge"] is None:
        return int(given["tetBudget"])
    cell = given["tetEdge"] / EDGE
    a, b, c = (skin.points[skin.triangles[:, k]] - skin.points.mean(axis=0) for k in range(3))
    volume = abs(float(np.einsum("ni,ni->", a, np.cross(b, c)))) / 6.0
    area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    return round(TETS * (volume + 0.5 * cell * area) / cell**3)
