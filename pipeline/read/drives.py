"""Drives of UsdPhysics: springs and motors of joints."""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdPhysics

from plait.pipeline.read import values
from plait.pipeline.read.joint_kinds import Drawn
from plait.pipeline.read.source import Source
from plait.solver.scene import Drive

FREEDOMS = ("linear", "angular", "transX", "transY", "transZ", "rotX", "rotY", "rotZ", "distance")
NAMES = ("stiffness", "damping", "targetPosition", "targetVelocity", "maxForce")


def read_drive(source: Source, prim: Usd.Prim, held: Drawn) -> Drive | None:
    """The drive along what a joint leaves free; a warning names those of others, which have nothing to move.

    UsdPhysicsDriveAPI has angles in degrees: stiffness in mass distance^2 / (degree s^2), damping in mass
    distance^2 / (degree s), the largest force in mass distance^2 / s^2; along a way in mass / s^2, mass / s and
    mass distance / s^2. Of type 'acceleration' mass, or mass distance^2, is not in the former two.

    Raises InputError for numbers that cannot be.
    """
    drive = None
    for name in FREEDOMS:
        if not prim.HasAPI(UsdPhysics.DriveAPI, name):
            continue
        if name == held.drive:
            drive = _read(source, UsdPhysics.DriveAPI(prim, name), held.kind == "revolute")
        else:
            source.warn(
                "its drive plays no part: nothing is free there, or more than one axis", prim, f"drive:{name}"
            )
    return drive


def _read(source: Source, api: UsdPhysics.DriveAPI, turns: bool) -> Drive:
    units, per_inertia = source.units, api.GetTypeAttr().Get(source.start) == "acceleration"
    size = units.meters_per_unit  # of what it moves along
    inertia = units.kilograms_per_unit * (size**2 if turns else 1.0)
    angle = np.pi / 180.0 if turns else size
    per = 1.0 / angle if turns else 1.0
    stiffness, damping, position, velocity, most = (_number(source, api, name) for name in NAMES)
    scale = per * (1.0 if per_inertia else inertia)
    return Drive(
        stiffness=scale * stiffness,
        damping=scale * damping,
        target=angle * position,
        target_velocity=angle * velocity,
        most=most * inertia * (1.0 if turns else size),
        per_inertia=per_inertia,
    )


def _number(source: Source, api: UsdPhysics.DriveAPI, name: str) -> float:
    attribute = getattr(api, f"Get{name[0].upper()}{name[1:]}Attr")()
    value, target = values.number(source, attribute), name.startswith("target")
    finite = np.isfinite(value) or (value == np.inf and name == "maxForce")
    if not (finite and (target or value >= 0.0)):
        mend = "author a finite number" if target else "author a number from 0 up"
        raise source.error(f"is {value:g}", attribute.GetPrim(), attribute.GetName(), mend)
    source.tell_if_animated(attribute)
    return value
