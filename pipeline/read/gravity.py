"""Gravity, from the shot's PhysicsScene."""

from __future__ import annotations

import numpy as np
from pxr import UsdGeom, UsdPhysics

from plait.pipeline.read import values
from plait.pipeline.read.source import PREDICATE, Source

EARTH, STRONGEST = 9.81, 1e6


def read_gravity(source: Source) -> np.ndarray:
    """(3,) float64 [m/s2]: 9.81 down the up axis unless a PhysicsScene says otherwise.

    As UsdPhysics has it: a negative magnitude (its fallback is -inf) asks for the earth's, direction zero is down.
    """
    down = (
        np.array([0.0, 0.0, -1.0]) if UsdGeom.GetStageUpAxis(source.stage) == "Z" else np.array([0.0, -1.0, 0.0])
    )
    scenes = [prim for prim in source.stage.Traverse(PREDICATE) if prim.IsA(UsdPhysics.Scene)]
    if not scenes:
        return EARTH * down
    if len(scenes) > 1:
        source.warn(f"one of {len(scenes)} physics scenes; gravity is taken from this one", scenes[0])
    prim = scenes[0]
    scene = UsdPhysics.Scene(prim)
    direction = values.vector(source, scene.GetGravityDirectionAttr())
    magnitude = values.number(source, scene.GetGravityMagnitudeAttr())
    if not np.all(np.isfinite(direction)):
        raise source.error("is not finite", prim, "physics:gravityDirection", "author a direction")
    most = STRONGEST / source.units.meters_per_unit
    if not magnitude <= most:
        raise source.error(f"is {magnitude:g}", prim, "physics:gravityMagnitude", f"author {most:g} or less")
    size = np.linalg.norm(direction)
    direction = direction / size if size > 0.0 else down
    return direction * (EARTH if magnitude < 0.0 else magnitude * source.units.meters_per_unit)
