"""UsdGeom's simple shapes as what they are, not as the polygons that are drawn for them."""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read.shapes import end_radii, turn_to_axis
from plait.pipeline.read.source import Source
from plait.solver.scene import Shape, ShapeKind

# How far from square axes, or from one scale, a transform's float32 rounding takes it.
ROUNDING = 1e-5


def solid_shape(source: Source, prim: Usd.Prim, placed: np.ndarray) -> Shape | None:
    """The shape that `placed`, (4, 4) from the prim's own space [stage units] to metres, makes of it.

    None for a mesh, for what has two radii, and, told of in a warning, for what is scaled or sheared into another
    shape: its polygons are what is meant then.
    """
    kind = next((kind for schema, kind in KINDS.items() if prim.IsA(schema)), None)
    if kind is None or (prim.HasAttribute("radiusTop") and len(set(end_radii(source, prim))) == 2):
        return None
    placed = placed.copy()
    if kind not in ("box", "sphere"):
        placed[:3, :3] = placed[:3, :3] @ turn_to_axis(source, prim)
    return shape_in(source, prim, kind, _size(source, prim, kind), placed)


def shape_in(
    source: Source, prim: Usd.Prim, kind: ShapeKind, size: np.ndarray, placed: np.ndarray
) -> Shape | None:
    """A shape of `size` (3,) in the space that `placed` leads from, or None, as of `solid_shape`."""
    scale = np.linalg.norm(placed[:3, :3], axis=0)
    axes = placed[:3, :3] / scale
    if not (_square(axes) and _keeps(kind, scale)):
        source.warn(f"is no {NAMES[kind]} as it is scaled; its polygons touch", prim, "xformOpOrder")
        return None
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]  # mirrored: the same shape
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = axes, placed[:3, 3]
    along = scale if kind in ("box", "sphere") else scale[[0, 2, 2]]
    return Shape(kind, size * along, frame)


KINDS = {
    UsdGeom.Cube: "box",
    UsdGeom.Sphere: "sphere",
    UsdGeom.Cylinder: "cylinder",
    UsdGeom.Cone: "cone",
    UsdGeom.Capsule: "capsule",
    UsdGeom.Cylinder_1: "cylinder",
    UsdGeom.Capsule_1: "capsule",
}
NAMES = {"box": "box", "sphere": "ball", "cylinder": "cylinder", "cone": "cone", "capsule": "capsule"}


def _size(source: Source, prim: Usd.Prim, kind: str) -> np.ndarray:
    """(3,) of `Shape`, in the prim's own space, to be scaled axis by axis."""

    def held(name: str) -> float:
        return float(prim.GetAttribute(name).Get(source.start))

    if kind == "box":
        return np.full(3, 0.5 * held("size"))
    if kind == "sphere":
        return np.full(3, held("radius"))
    return np.array([end_radii(source, prim)[0], 0.5 * held("height"), 0.0])


def _square(axes: np.ndarray) -> bool:
    return bool(np.abs(axes.T @ axes - np.eye(3)).max() < ROUNDING)


def _keeps(kind: str, scale: np.ndarray) -> bool:
    """Whether the scales along its axes leave a shape what it is."""
    alike = {"box": scale[:1], "cylinder": scale[:2], "cone": scale[:2]}.get(kind, scale)
    return bool(np.ptp(alike) < ROUNDING * scale.max())
