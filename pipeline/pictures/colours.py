"""Colours as a stage authors them: displayColor, else a preview material's; linear RGB, (n, 3) in 0 to 1."""

from __future__ import annotations

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdShade

from plait.pipeline.read.surfaces import Body

CLAY = (0.42, 0.40, 0.38)  # of surfaces without a colour
BROWN = (0.16, 0.085, 0.045)  # of curves without a colour


def to_bytes(linear: np.ndarray) -> np.ndarray:
    """(n, 3) uint8 sRGB of (n, 3) linear RGB (IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    curved = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1.0 / 2.4) - 0.055)
    return np.rint(255.0 * curved).astype(np.uint8)


def of_corners(body: Body, code: float) -> np.ndarray:
    """(triangle_count, 3, 3) the colour at each corner of a body's triangles."""
    prim, triangles = body.prim, body.authored_points
    shape = (*triangles.shape, 3)
    found = _display(prim, code)
    if found is not None:
        data, interpolation = found
        index = {
            "vertex": triangles,
            "varying": triangles,
            "faceVarying": body.authored_corners,
            "uniform": np.repeat(body.face_of[:, None], 3, axis=1),
        }.get(interpolation)
        if index is not None and index.max(initial=-1) < len(data):
            return data[index]
        return np.broadcast_to(data[0], shape)
    result = np.broadcast_to(_material(prim) or CLAY, shape).copy()
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        colour = _material(subset.GetPrim())
        if colour:
            result[np.isin(body.face_of, np.array(subset.GetIndicesAttr().Get(code) or []))] = colour
    return result


def of_points(prim: Usd.Prim, code: float, count: int, owner: np.ndarray) -> np.ndarray:
    """(count, 3) the colour at each point of curves or points. owner: (count,) the curve of each point."""
    found = _display(prim, code)
    if found is None:
        return np.broadcast_to(_material(prim) or BROWN, (count, 3))
    data, _ = found
    if len(data) == count:
        return data
    if len(data) == owner.max(initial=-1) + 1:
        return data[owner]
    return np.broadcast_to(data[0], (count, 3))


def _display(prim: Usd.Prim, code: float) -> tuple[np.ndarray, str] | None:
    """displayColor with its interpolation, None where there is none that can be used."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    held = primvar.ComputeFlattened(code) if primvar and primvar.HasValue() else None
    if held is None or len(held) == 0:
        return None
    data = np.array(held, dtype=np.float64).reshape(len(held), -1)
    if data.shape[1] != 3 or not np.isfinite(data).all():
        return None
    return data, str(primvar.GetInterpolation())


def _material(prim: Usd.Prim) -> tuple[float, float, float] | None:
    """The diffuse colour of the preview material bound to the prim, if it is a plain one."""
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    if not material:
        return None
    shader = material.ComputeSurfaceSource()[0]
    given = shader.GetInput("diffuseColor") if shader else None
    for attribute in given.GetValueProducingAttributes() if given else ():
        value = attribute.Get()
        if isinstance(value, Gf.Vec3f):
            return tuple(value)
    return None
