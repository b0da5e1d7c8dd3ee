"""Tets that a shot brings along: a UsdGeomTetMesh, or a file that `plait:tetMesh` names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.errors import InputError
from plait.pipeline.flesh import Lattice, read_tet_mesh, volumes
from plait.pipeline.read import values
from plait.pipeline.read.motions import transform
from plait.pipeline.read.polygons import check_indices
from plait.pipeline.read.source import Source

# A tet of less than this part of the mean volume is flat: float32 points say nothing of its shape.
FLAT = 1e-6


def read_tets(source: Source, prim: Usd.Prim, points: np.ndarray) -> tuple[Lattice, np.ndarray]:
    """The tets of a TetMesh with `points` (n, 3), its own at rest, and which of them are nodes, ascending.

    Points of no tet are left out. Tets of the wrong orientation are turned, with a warning; raises InputError for
    indices that name no point, and for tets without volume.
    """
    attribute = UsdGeom.TetMesh(prim).GetTetVertexIndicesAttr()
    tets = values.array(source, attribute).astype(np.int64)
    check_indices(source, attribute, tets, len(points))
    if not len(tets):
        raise source.error("is empty", prim, attribute.GetName(), "author tets, or plait:role = 'none'")
    left_handed = UsdGeom.TetMesh(prim).GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    if left_handed:
        tets = tets[:, [0, 2, 1, 3]]
    used, inverse = np.unique(tets, return_inverse=True)
    lattice = _oriented(source, prim, attribute.GetName(), points[used], inverse.reshape(-1, 4))
    return lattice, used


def read_tet_file(source: Source, prim: Usd.Prim, path: Path, own_to_rest: np.ndarray) -> Lattice:
    """The tets of a file in the prim's own space. own_to_rest: (4, 4), from there to rest points [m]."""
    try:
        held = read_tet_mesh(path)
    except InputError as error:
        raise source.error(str(error), prim, "plait:tetMesh") from error
    return _oriented(source, prim, "plait:tetMesh", transform(own_to_rest, held.nodes), held.tets)


def _oriented(source: Source, prim: Usd.Prim, name: str, nodes: np.ndarray, tets: np.ndarray) -> Lattice:
    volume = volumes(Lattice(nodes, tets))
    mirrored = np.median(volume) < 0.0  # by the prim's own transform, which turns all alike
    volume = -volume if mirrored else volume
    flat = np.abs(volume) <= FLAT * np.abs(volume).mean()
    if flat.any():
        problem = f"{int(flat.sum())} of {len(tets)} tets have no volume, the first is tet {int(np.argmax(flat))}"
        raise source.error(problem, prim, name, "mesh it again")
    wrong = volume < 0.0
    if wrong.any():
        source.warn(f"{int(wrong.sum())} of {len(tets)} tets are inside out; they are turned", prim, name)
    turned = wrong != mirrored
    tets = np.where(turned[:, None], tets[:, [0, 2, 1, 3]], tets)
    return Lattice(nodes, np.ascontiguousarray(tets, dtype=np.int32))
