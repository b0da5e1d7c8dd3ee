"""Joints of UsdPhysics between rigid bodies, or of one with the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pxr import Usd, UsdPhysics

from plait.pipeline.read import values
from plait.pipeline.read.drives import read_drive
from plait.pipeline.read.joint_kinds import Drawn, drawn_kind
from plait.pipeline.read.motions import Placement
from plait.pipeline.read.rigid import Props
from plait.pipeline.read.roles import Role
from plait.pipeline.read.shapes import turn_from_z
from plait.pipeline.read.source import Source
from plait.pipeline.read.turns import of_quaternion, rotation_of
from plait.solver.scene import Drive, Joint, Pose, StaticMotion

# Of a turn, by which limits that are one may differ from it: float32.
ROUNDING = 1e-6


@dataclass
class CarriedFrame:
    """Where a prim that is no simulated body is, without its scale: what a joint is held to."""

    source: Source
    placement: Placement

    @property
    def animated(self) -> bool:
        return self.placement.animated

    def pose(self, time: float) -> Pose:
        matrix = self.placement.metric(self.source.code(time))
        matrix[:3, :3] = rotation_of(matrix[:3, :3])
        return Pose(matrix[None])


def read_joints(source: Source, assigned: Sequence[Role], props: Props) -> tuple[Joint, ...]:
    """All joints of the shot that hold a simulated body. Raises InputError for limits that cannot be."""
    found = [_read(source, role.prim, props) for role in assigned if role.supported and is_joint(role.prim)]
    return tuple(joint for joint in found if joint is not None)


def is_joint(prim: Usd.Prim) -> bool:
    return prim.IsA(UsdPhysics.Joint)


def _read(source: Source, prim: Usd.Prim, props: Props) -> Joint | None:
    joint = UsdPhysics.Joint(prim)
    source.tell_if_animated(joint.GetJointEnabledAttr())
    if values.flag(source, joint.GetJointEnabledAttr()) is False:
        return None
    holders = [_holder(source, prim, relation) for relation in (joint.GetBody0Rel(), joint.GetBody1Rel())]
    inactive = next((str(holder.GetPath()) for holder in holders if not holder.IsActive()), "")
    if inactive:
        source.warn(f"holds {inactive}, which is not active; left out", prim)
        return None
    bodies = tuple(_body(props, holder) for holder in holders)
    if bodies[0] == bodies[1]:
        source.warn("holds no simulated body to another or to the world; left out", prim)
        return None
    held = drawn_kind(source, prim)
    turn = turn_from_z(held.axis) if held.axis else np.eye(3)
    _tell_of_breaking(source, joint)
    locals_ = (
        (joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
        (joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
    )
    frames, motion, start = [], StaticMotion(), source.start / source.units.time_codes_per_second
    for holder, body, (place, rotation) in zip(holders, bodies, locals_, strict=True):
        frame = _frame(source, holder, place, rotation, turn)
        if body is None:
            motion = CarriedFrame(source, Placement(source, holder))
            frame = np.linalg.inv(motion.pose(start).joint_transforms[0]) @ frame
        else:
            frame[:3, 3] -= props.placement(props.paths[body])[:3, 3]
        frames.append(frame)
    limits, drive = _limits(source, prim, held), read_drive(source, prim, held)
    if held.kind == "revolute":
        frames[0], limits, drive = _within_half_a_turn(source, prim, frames[0], limits, drive)
    return Joint(
        name=str(prim.GetPath()),
        kind=held.kind,
        bodies=bodies,
        frames=(frames[0], frames[1]),
        limits=limits,
        cone=_cone(source, prim) if held.kind == "spherical" else None,
        drive=drive,
        motion=motion,
        collide=bool(values.flag(source, joint.GetCollisionEnabledAttr())),
    )


def _tell_of_breaking(source: Source, joint: UsdPhysics.Joint) -> None:
    for attribute in (joint.GetBreakForceAttr(), joint.GetBreakTorqueAttr()):
        if values.number(source, attribute) < np.inf:
            source.warn("is ignored: joints do not break", attribute.GetPrim(), attribute.GetName())


def _holder(source: Source, prim: Usd.Prim, relation: Usd.Relationship) -> Usd.Prim:
    """The prim that a side is held to; the pseudo-root, that is the world, where none is named."""
    targets = relation.GetTargets()
    if not targets:
        return source.stage.GetPseudoRoot()
    if len(targets) > 1:
        raise source.error(f"names {len(targets)} prims", prim, relation.GetName(), "name one body")
    holder = source.stage.GetPrimAtPath(targets[0])
    if not holder:
        raise source.error(f"names <{targets[0]}>, which is not there", prim, relation.GetName(), "name a body")
    return holder


def _body(props: Props, holder: Usd.Prim) -> int | None:
    """Index of the rigid body that the prim is or is part of."""
    while holder and not holder.IsPseudoRoot():
        if str(holder.GetPath()) in props.paths:
            return props.paths.index(str(holder.GetPath()))
        holder = holder.GetParent()
    return None


def _frame(
    source: Source, holder: Usd.Prim, place: Usd.Attribute, rotation: Usd.Attribute, turn: np.ndarray
) -> np.ndarray:
    """(4, 4), rigid: one side's joint frame, z its axis, to scene coordinates at the first frame."""
    matrix = source.metric(source.placed_at_start(holder))
    at, turned = values.vector(source, place), values.quaternion(source, rotation)
    for attribute, fine in ((place, np.isfinite(at).all()), (rotation, turned.GetLength() > 0.0)):
        if not fine:
            prim = attribute.GetPrim()
            raise source.error("is not a place or rotation", prim, attribute.GetName(), "author finite numbers")
    frame = np.eye(4)
    frame[:3, :3] = rotation_of(matrix[:3, :3]) @ of_quaternion(turned) @ turn
    frame[:3, 3] = matrix[:3, :3] @ at * source.units.meters_per_unit + matrix[:3, 3]
    return frame


def _limits(source: Source, prim: Usd.Prim, held: Drawn) -> tuple[float, float] | None:
    """Lower and upper in SI; None where neither limits anything."""
    if held.kind not in ("revolute", "prismatic", "distance"):
        return None
    attributes = [prim.GetAttribute(name) for name in (held.lower, held.upper)]
    for attribute in attributes:
        source.tell_if_animated(attribute)
    authored = [values.number(source, attribute) for attribute in attributes]
    lower, upper = (
        none if value is None else value for value, none in zip(authored, (-np.inf, np.inf), strict=True)
    )
    if held.kind == "distance":  # below zero: none
        lower, upper = (lower if lower > 0.0 else 0.0), (np.inf if upper < 0.0 else upper)
    if np.isnan([lower, upper]).any() or lower > upper:
        raise source.error(f"is {lower:g}, above {upper:g}", prim, held.lower, "author the lower one first")
    if held.kind == "distance" and lower == 0.0:
        lower = -np.inf
    if held.kind != "revolute":
        lower, upper = (limit * source.units.meters_per_unit for limit in (lower, upper))
        return None if lower == -np.inf and upper == np.inf else (lower, upper)
    if lower == -np.inf and upper == np.inf:
        return None
    return float(np.radians(lower)), float(np.radians(upper))


def _within_half_a_turn(
    source: Source,
    prim: Usd.Prim,
    frame: np.ndarray,
    limits: tuple[float, float] | None,
    drive: Drive | None,
) -> tuple[np.ndarray, tuple[float, float] | None, Drive | None]:
    """The first frame, limits and drive of a hinge, such that angles are within half a turn: more are not counted.

    Limits beyond are measured from their middle, to which the frame, z its axis, is turned.
    """
    middle = 0.0
    if limits is not None and not np.isfinite(limits).all():
        source.warn("has one limit; half a turn the other way is taken as the other", prim, "physics:lowerLimit")
        limits = max(limits[0], -np.pi), min(limits[1], np.pi)
    elif limits is not None and limits[1] - limits[0] >= 2.0 * np.pi:
        if limits[1] - limits[0] > 2.0 * np.pi * (1.0 + ROUNDING):
            source.warn("allows more than a turn; turns are not counted, none is", prim, "physics:upperLimit")
        limits = None
    elif limits is not None and (limits[0] < -np.pi or limits[1] > np.pi):
        middle = 0.5 * (limits[0] + limits[1])
        limits = limits[0] - middle, limits[1] - middle
        frame = frame @ _about_z(middle)
    return frame, limits, drive and replace(drive, target=drive.target - middle)


def _about_z(angle: float) -> np.ndarray:
    """(4, 4)"""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return turn


def _cone(source: Source, prim: Usd.Prim) -> float | None:
    """[rad]; UsdPhysics has an angle either way, below zero for none: a round cone takes the smaller."""
    if not prim.IsA(UsdPhysics.SphericalJoint):
        return None
    angles = [values.number(source, prim.GetAttribute(f"physics:coneAngle{k}Limit")) for k in (0, 1)]
    if np.isnan(angles).any():
        raise source.error("is not a number", prim, "physics:coneAngle0Limit", "author an angle in degrees")
    given = [angle for angle in angles if angle >= 0.0]
    if not given or min(given) >= 180.0:
        return None
    if not min(given) > 0.0:
        raise source.error("is 0", prim, "physics:coneAngle0Limit", "author an angle above 0, or a revolute joint")
    if angles[0] != angles[1]:
        source.warn(
            f"differs from the other; {min(given):g} degrees hold all round", prim, "physics:coneAngle0Limit"
        )
    return float(np.radians(min(given)))
