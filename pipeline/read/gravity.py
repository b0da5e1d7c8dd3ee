"""Gravity, from the shot's PhysicsScene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics

from plait.pipeline.read import values
from plait.pipeline.read.source import PREDICATE, Source

EARTH, STRONGEST = 9.81, 1e6


def read_gravity(source: Source) -> np.ndarray:
    """(3,) float64 [m/s2]: 9.81 down the up axis unless a PhysicsScene says otherwise.

    Of several the first that bodies name as their owner holds, else the first of all.
    As UsdPhysics has it: a negative magnitude (its fallback is -inf) asks for the earth's, direction zero is down.
    """
    down = (
        np.array([0.0, 0.0, -1.0]) if UsdGeom.GetStageUpAxis(source.stage) == "Z" else np.array([0.0, -1.0, 0.0])
    )
    scenes = [prim for prim in source.stage.Traverse(PREDICATE) if prim.IsA(UsdPhysics.Scene)]
    if not scenes:
        return EARTH * down
    prim = scenes[0]
    if len(scenes) > 1:
        prim = _owner(source, scenes)
        source.warn(f"one of {len(scenes)} physics scenes; gravity is taken from this one", prim)
    scene = UsdPhysics.Scene(prim)
    for attribute in (scene.GetGravityDirectionAttr(), scene.GetGravityMagnitudeAttr()):
        source.tell_if_animated(attribute)
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


def _owner(source: Source, scenes: Sequence[Usd.Prim]) -> Usd.Prim:
    """Of several scenes the first that a rigid body or collider names as its owner; else the first of all."""
    paths = {scene.GetPath(): scene for scene in scenes}
    for prim in source.stage.Traverse(PREDICATE):
        relation = prim.GetRelationship("physics:simulationOwner")
        for target in relation.GetTargets() if relation else ():
            if target in paths:
                return paths[target]
    return scenes[0]
