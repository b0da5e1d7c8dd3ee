"""Which meshes lie beside a groom, told from their extents: others are not read."""

from __future__ import annotations

import itertools

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read import values
from plait.pipeline.read.curves import Curves
from plait.pipeline.read.motions import transform
from plait.pipeline.read.source import Source

Box = tuple[np.ndarray, np.ndarray]


class Neighbourhood:
    """The boxes a groom fills, in the world and in its own coordinates: it may lie beside a skin in either."""

    def __init__(self, source: Source, curves: Curves) -> None:
        self._source = source
        placed = transform(source.placed_at_start(curves.prim), curves.points)
        self._boxes = _box(placed), _box(curves.points)

    def touches(self, prim: Usd.Prim) -> bool:
        """Whether a mesh's box touches the groom's at the first frame."""
        extent = _extent(self._source, prim)
        if extent is None:
            return False
        corners = np.array(list(itertools.product(*zip(*extent, strict=True))))
        placed = transform(self._source.placed_at_start(prim), corners)
        return _touch(self._boxes[0], _box(placed)) or _touch(self._boxes[1], extent)


def _extent(source: Source, prim: Usd.Prim) -> Box | None:
    mesh = UsdGeom.Mesh(prim)
    authored = mesh.GetExtentAttr().Get(source.start)
    if authored is not None and len(authored) == 2:
        low, high = np.array(authored, dtype=np.float64)
        if np.all(low <= high):
            return low, high
    points = values.vectors(source, mesh.GetPointsAttr())
    return _box(points) if len(points) else None


def _box(points: np.ndarray) -> Box:
    return points.min(axis=0), points.max(axis=0)


def _touch(a: Box, b: Box) -> bool:
    # A quarter of the groom's own size beyond it, as far as a strand may lie from what it grows on.
    margin = 0.25 * np.linalg.norm(a[1] - a[0])
    return bool(np.all(a[0] - margin <= b[1]) and np.all(b[0] <= a[1] + margin))
