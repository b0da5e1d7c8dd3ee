"""Mass, centre of mass and inertia of a rigid body, by the rules of UsdPhysicsMassAPI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdPhysics

from plait.pipeline.read import values
from plait.pipeline.read.parameters import Given
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Body
from plait.pipeline.read.turns import of_quaternion, rotation_of
from plait.solver.rigid.mass_properties import MassProperties, of_mesh, of_shape

# How far the numbers of a plate, whose largest moment is the sum of the others, may be rounded.
ROUNDING = 1e-3


@dataclass(frozen=True)
class Part:
    """A collider of a rigid body, with its parameters."""

    body: Body
    given: Given


def read_mass(source: Source, prim: Usd.Prim, parts: Sequence[Part], rest: np.ndarray) -> MassProperties:
    """Of the body `prim`, in its rest space, to which `rest` (4, 4) takes the prim's own [stage units].

    As UsdPhysicsMassAPI has it, a mass of the body's own comes before those of its parts, a part's before its
    density; of densities that of the part comes first, then the body's, the material's, 1000 kg/m3. Centre and
    inertia of a part are its own where they are authored. What is not authored of the body is that of the parts,
    scaled to the mass. Scales above a prim move its authored centre, and change neither its mass nor its inertia.
    Raises InputError for a body of which that is not known.
    """
    mass = _mass(source, prim)
    center, inertia = _center(source, prim, rest), _inertia(source, prim, rest)
    if mass > 0.0 and center is not None and inertia is not None:
        return MassProperties(mass, center, inertia)
    if not parts:
        if mass > 0.0 and inertia is not None:
            return MassProperties(mass, np.zeros(3), inertia)
        mend = "author physics:mass and physics:diagonalInertia, or apply PhysicsCollisionAPI to a shape of it"
        raise source.error("has no collider to find its mass by", prim, "physics:mass", mend)
    found = _together([_of_part(source, part, part.body.prim == prim) for part in parts])
    return _as_authored(found, mass, center, inertia)


def _as_authored(
    found: MassProperties, mass: float, center: np.ndarray | None, inertia: np.ndarray | None
) -> MassProperties:
    """What is authored (a mass above 0, not None) in the place of what was found.

    As UsdPhysics computes it, an inertia that was found is then about the authored centre.
    """
    scale = mass / found.mass if mass > 0.0 else 1.0
    if center is None:
        center = found.center
    if inertia is None:
        inertia = scale * (found.inertia + _about(center, found))
    return MassProperties(scale * found.mass, center, inertia)


def _about(center: np.ndarray, part: MassProperties) -> np.ndarray:
    """(3, 3), what a part's inertia is larger by about a point than about its centre: Steiner's theorem."""
    away = part.center - center
    return part.mass * (away @ away * np.eye(3) - np.outer(away, away))


def _together(parts: Sequence[MassProperties]) -> MassProperties:
    mass = sum(part.mass for part in parts)
    center = sum(part.mass * part.center for part in parts) / mass
    return MassProperties(mass, center, sum(part.inertia + _about(center, part) for part in parts))


def _of_part(source: Source, part: Part, whole: bool) -> MassProperties:
    """whole: the part is the body's own prim, and what is authored there is of the body."""
    if whole:
        return _of_shape(source, part)
    prim, rest = part.body.prim, part.body.own_to_rest
    mass, center, inertia = _mass(source, prim), _center(source, prim, rest), _inertia(source, prim, rest)
    if mass > 0.0 and center is not None and inertia is not None:
        return MassProperties(mass, center, inertia)
    return _as_authored(_of_shape(source, part), mass, center, inertia)


def _of_shape(source: Source, part: Part) -> MassProperties:
    surface, density = part.body.surface, part.given["density"]
    if surface.shape is not None:
        return of_shape(surface.shape, density)
    try:
        return of_mesh(surface.points, surface.triangles, density)
    except ValueError as error:
        mend = "close it, or author physics:mass, physics:centerOfMass and physics:diagonalInertia of its body"
        raise source.error("encloses no volume, so its mass is not known", part.body.prim, mend=mend) from error


def _mass(source: Source, prim: Usd.Prim) -> float:
    """[kg], 0 where none is authored."""
    value = values.number(source, _authored(prim, "physics:mass"))
    if value is None or value == 0.0:
        return 0.0
    if not (np.isfinite(value) and value > 0.0):
        raise source.error(f"is {value:g}", prim, "physics:mass", "author a positive number")
    return value * source.units.kilograms_per_unit


def _center(source: Source, prim: Usd.Prim, rest: np.ndarray) -> np.ndarray | None:
    value = values.vector(source, _authored(prim, "physics:centerOfMass"))
    if value is None or np.all(value == -np.inf):  # the schema's 'not authored'
        return None
    if not np.isfinite(value).all():
        raise source.error("is not finite", prim, "physics:centerOfMass", "author finite numbers")
    return rest[:3, :3] @ value + rest[:3, 3]


def _inertia(source: Source, prim: Usd.Prim, rest: np.ndarray) -> np.ndarray | None:
    """(3, 3) [kg m2] in rest space."""
    units = source.units
    diagonal = values.vector(source, _authored(prim, "physics:diagonalInertia"))
    if diagonal is None or not np.any(diagonal):
        return None
    if not (np.isfinite(diagonal).all() and (diagonal > 0.0).all()):
        found = ", ".join(f"{value:g}" for value in diagonal)
        raise source.error(f"is ({found})", prim, "physics:diagonalInertia", "author three positive numbers")
    if 2.0 * diagonal.max() > (1.0 + ROUNDING) * diagonal.sum():
        text = f"is {tuple(map(float, diagonal))}, which no body has: one is above the sum of the others"
        source.warn(text, prim, "physics:diagonalInertia")
    turn = rotation_of(rest[:3, :3])
    axes = values.quaternion(source, _authored(prim, "physics:principalAxes"))
    if axes is not None and axes.GetLength() > 0.0:
        turn = turn @ of_quaternion(axes)
    return turn @ np.diag(diagonal) @ turn.T * units.kilograms_per_unit * units.meters_per_unit**2


def _authored(prim: Usd.Prim, name: str) -> Usd.Attribute:
    """Of UsdPhysicsMassAPI; an invalid one where it is not applied, or gives nothing."""
    attribute = prim.GetAttribute(name)
    given = prim.HasAPI(UsdPhysics.MassAPI) and attribute and attribute.HasAuthoredValue()
    return attribute if given else Usd.Attribute()
