"""UsdGeom's simple shapes as closed polygon meshes."""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.read import values
from plait.pipeline.read.source import Source

SIDES = 32
RINGS = 16

Polygons = tuple[np.ndarray, np.ndarray, np.ndarray]


def is_shape(prim: Usd.Prim) -> bool:
    return any(prim.IsA(schema) for schema in _SHAPES)


def polygons(source: Source, prim: Usd.Prim) -> Polygons:
    """(points (n, 3) [stage units, the prim's own space], face counts, face indices), counter-clockwise outside.

    Inscribed: vertices lie on the shape. Raises InputError for a size that is not a positive number.
    """
    for schema, make in _SHAPES.items():
        if prim.IsA(schema):
            return make(source, prim)
    raise source.error(f"{prim.GetTypeName()} has no surface", prim, mend="use a Mesh")


def _size(source: Source, prim: Usd.Prim, name: str, zero: bool = False) -> float:
    value = values.number(source, prim.GetAttribute(name))
    if not (np.isfinite(value) and (value > 0.0 or (zero and value == 0.0))):
        raise source.error(f"is {value:g}", prim, name, "author a positive number")
    return value


def _cube(source: Source, prim: Usd.Prim) -> Polygons:
    half = 0.5 * _size(source, prim, "size")
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) * half
    quads = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
    return corners, np.full(6, 4), np.array(quads)


def _sphere(source: Source, prim: Usd.Prim) -> Polygons:
    angles = np.linspace(0.0, np.pi, RINGS + 1)
    radius = _size(source, prim, "radius")
    return _lathe(radius * np.sin(angles), -radius * np.cos(angles), "Z")


def _cylinder(source: Source, prim: Usd.Prim) -> Polygons:
    (bottom, top), half = end_radii(source, prim), 0.5 * _size(source, prim, "height")
    return _lathe(np.array([0.0, bottom, top, 0.0]), np.array([-half, -half, half, half]), _axis(source, prim))


def _cone(source: Source, prim: Usd.Prim) -> Polygons:
    radius, half = _size(source, prim, "radius"), 0.5 * _size(source, prim, "height")
    return _lathe(np.array([0.0, radius, 0.0]), np.array([-half, -half, half]), _axis(source, prim))


def _capsule(source: Source, prim: Usd.Prim) -> Polygons:
    """Two half balls and what is between them."""
    (bottom, top), half = end_radii(source, prim), 0.5 * _size(source, prim, "height", zero=True)
    angles = np.linspace(0.0, 0.5 * np.pi, RINGS // 2 + 1)
    across, along = np.sin(angles), np.cos(angles)
    lower = np.column_stack([bottom * across, -half - bottom * along])
    upper = np.column_stack([top * across, half + top * along])[::-1]
    profile = np.concatenate([lower, upper])
    if half == 0.0 and bottom == top:
        profile = np.delete(profile, len(lower), axis=0)
    return _lathe(profile[:, 0], profile[:, 1], _axis(source, prim))


def end_radii(source: Source, prim: Usd.Prim) -> tuple[float, float]:
    """[stage units], of a cylinder or capsule at its bottom and its top, which newer types have apart."""
    names = ("radiusBottom", "radiusTop") if prim.HasAttribute("radiusTop") else ("radius", "radius")
    bottom, top = (_size(source, prim, name) for name in names)
    return bottom, top


def _plane(source: Source, prim: Usd.Prim) -> Polygons:
    width, length = 0.5 * _size(source, prim, "width"), 0.5 * _size(source, prim, "length")
    corners = np.array([[-width, -length, 0], [width, -length, 0], [width, length, 0], [-width, length, 0]], float)
    return corners @ turn_from_z(_axis(source, prim)).T, np.array([4]), np.arange(4)


def turn_to_axis(source: Source, prim: Usd.Prim) -> np.ndarray:
    """(3, 3), the rotation that takes Z to the prim's axis."""
    return turn_from_z(_axis(source, prim))


def _axis(source: Source, prim: Usd.Prim) -> str:
    axis = str(prim.GetAttribute("axis").Get(source.start))
    if axis not in ("X", "Y", "Z"):
        raise source.error(f"is {axis!r}", prim, "axis", "author X, Y or Z")
    return axis


def turn_from_z(axis: str) -> np.ndarray:
    """The rotation (a cyclic swap) that takes Z to the axis."""
    return np.roll(np.eye(3), {"Z": 0, "X": 1, "Y": 2}[axis], axis=0)


def _lathe(radii: np.ndarray, heights: np.ndarray, axis: str) -> Polygons:
    """A profile turned about the axis; radius zero at both ends, rising."""
    around = 2.0 * np.pi * np.arange(SIDES) / SIDES
    circle = np.column_stack([np.cos(around), np.sin(around)])
    rings = [
        np.column_stack([r * circle, np.full(SIDES, h)]) for r, h in zip(radii[1:-1], heights[1:-1], strict=True)
    ]
    points = np.concatenate([[[0.0, 0.0, heights[0]]], *rings, [[0.0, 0.0, heights[-1]]]])
    here, after = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    last, top = 1 + (len(rings) - 1) * SIDES, len(points) - 1
    bottom = np.column_stack([np.zeros(SIDES, int), 1 + after, 1 + here])
    lid = np.column_stack([np.full(SIDES, top), last + here, last + after])
    quads = [
        np.column_stack([s + here, s + after, s + SIDES + after, s + SIDES + here])
        for s in 1 + SIDES * np.arange(len(rings) - 1)
    ]
    indices = np.concatenate([bottom.ravel(), *(quad.ravel() for quad in quads), lid.ravel()])
    counts = np.concatenate([np.full(SIDES, 3), np.full(SIDES * len(quads), 4), np.full(SIDES, 3)])
    return points @ turn_from_z(axis).T, counts, indices


_SHAPES = {
    UsdGeom.Cube: _cube,
    UsdGeom.Sphere: _sphere,
    UsdGeom.Cylinder: _cylinder,
    UsdGeom.Cone: _cone,
    UsdGeom.Capsule: _capsule,
    UsdGeom.Capsule_1: _capsule,
    UsdGeom.Cylinder_1: _cylinder,
    UsdGeom.Plane: _plane,
}
