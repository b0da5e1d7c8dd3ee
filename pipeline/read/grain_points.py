"""Points that are grains: taken as they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read import values
from plait.pipeline.read.motions import Placement, transform
from plait.pipeline.read.parameters import Given
from plait.pipeline.read.skeletons import SkeletonBinding
from plait.pipeline.read.source import Source
from plait.pipeline.read.turns import nearest_axes

# Points in the cell of a typical one, between which a cell tells how densely they lie.
FEW, MANY = 8.0, 64.0


@dataclass(frozen=True)
class Drawn:
    """Grains as drawn at the first frame.

    positions, velocities: (n, 3) float64 [m], [m/s], scene world.  ids: (n,) int64.
    widths: (n,) [m], None where none are authored.  spacing: [m], the cube of which is the room of each.
    """

    positions: np.ndarray
    velocities: np.ndarray
    ids: np.ndarray
    widths: np.ndarray | None
    spacing: float

    @property
    def box(self) -> np.ndarray:
        """(2, 3) [m], scene world."""
        return np.array([self.positions.min(axis=0), self.positions.max(axis=0)])


def read_drawn(source: Source, prim: Usd.Prim, given: Given, binding: SkeletonBinding | None) -> Drawn:
    """Raises InputError for values that are not finite, or whose number is not that of the points."""
    if binding is not None and binding.query.HasJointInfluences():
        raise source.error("is skinned, which grains cannot be", prim, "skel:skeleton", "take its binding off")
    points, meters = UsdGeom.Points(prim), source.units.meters_per_unit
    held = values.vectors(source, points.GetPointsAttr())
    source.tell_if_animated(points.GetPointsAttr())
    placement = Placement(source, prim)
    linear = placement.at_start[:3, :3]
    positions = transform(placement.metric(source.start), held * meters)
    count = len(positions)
    velocities = values.vectors(source, points.GetVelocitiesAttr())
    if len(velocities):
        values.check_fits(source, points.GetVelocitiesAttr(), velocities, (count,))
        velocities = velocities @ linear.T * meters
    else:
        along = given["velocity"] if "velocity" in given else np.zeros(3)
        velocities = np.broadcast_to(nearest_axes(linear) @ along, positions.shape)
    widths = _widths(source, points, count, np.cbrt(abs(np.linalg.det(linear))) * meters)
    if "width" in given:
        widths = np.full(count, given["width"])
    drawn = 0.0 if widths is None else float(np.median(widths))
    spacing = given["spacing"] or find_spacing(positions) or drawn
    if not spacing > 0.0:
        problem = "cannot be told from so few points, or points that lie at one place"
        raise source.error(problem, prim, "plait:spacing", "author it, or widths")
    return Drawn(positions, velocities, _ids(source, points, count), widths, spacing)


def _widths(source: Source, points: UsdGeom.Points, count: int, scale: float) -> np.ndarray | None:
    """(n,) [m]"""
    primvar = UsdGeom.PrimvarsAPI(points).GetPrimvar("widths")
    attribute = primvar.GetAttr() if primvar and primvar.HasAuthoredValue() else points.GetWidthsAttr()
    widths = values.scalars(source, attribute)
    if not len(widths):
        return None
    values.check_fits(source, attribute, widths, (1, count))
    if not (widths >= 0.0).all():
        raise source.error("holds negative values", points.GetPrim(), attribute.GetName(), "author diameters")
    return scale * np.broadcast_to(widths, (count,))


def _ids(source: Source, points: UsdGeom.Points, count: int) -> np.ndarray:
    attribute = points.GetIdsAttr()
    held = attribute.Get(source.start)
    if held is None or not len(held):
        return np.arange(count)
    ids = np.array(held, dtype=np.int64)
    values.check_fits(source, attribute, ids, (count,))
    if len(np.unique(ids)) < count:
        raise source.error("names some grains alike", points.GetPrim(), "ids", "author each once, or none")
    if ids.max() > np.iinfo(np.int64).max - (1 << 32):
        raise source.error("is too large to number on from", points.GetPrim(), "ids", "author smaller ones")
    return ids


def find_spacing(positions: np.ndarray) -> float:
    """[m] side of the cube that a typical one of (n, 3) positions has for itself; 0 where they do not tell.

    Those of a cell share it: where a typical point (the median over points) has so many about it that their number
    tells, and so few that the cells are small against the whole.
    """
    size = float(np.ptp(positions, axis=0).max()) if len(positions) else 0.0
    if len(positions) < MANY or size == 0.0:
        return 0.0
    cell = size
    for _ in range(200):
        held = _companions(positions, cell)
        if held > MANY:
            cell *= 0.5
        elif held < FEW:
            cell *= 1.5
        else:
            return cell / held ** (1.0 / 3.0)
    return 0.0


def _companions(positions: np.ndarray, cell: float) -> float:
    """How many the cell of a typical point holds."""
    # What lies too far off to be numbered shares the last cells.
    at = np.minimum((positions - positions.min(axis=0)) / cell, 2.0**63).astype(np.uint64)
    with np.errstate(over="ignore"):
        # Few cells that differ share a key, and do no harm.
        keys = at @ np.array([73856093, 19349663, 83492791], np.uint64)
    _, of_point, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return float(np.median(counts[of_point]))
