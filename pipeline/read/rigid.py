"""Rigid props: what UsdPhysics says of bodies that move without deforming, as the scene has them.

A body's rest space has the world's axes at the first frame and the origin of the body's prim: whatever scale or
shear lies above is in the rest points, and a pose is a rotation and a translation alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdPhysics

from plait.pipeline.config import Config
from plait.pipeline.read import parameters, values
from plait.pipeline.read.approximation import bounding_shape, tell_of_approximation
from plait.pipeline.read.masses import Part, read_mass
from plait.pipeline.read.motions import Placement, RigidMotion, WorldToLocal, transform
from plait.pipeline.read.parameter_table import RIGID
from plait.pipeline.read.roles import Role
from plait.pipeline.read.roots import Rooted
from plait.pipeline.read.solids import solid_shape
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Bodies, Body
from plait.pipeline.read.turns import rotation_of
from plait.pipeline.shot import TransformOutput
from plait.solver.scene import Joint, Motion, Pose, RigidBody, Surface

# What tells the shape of a mesh or simple shape.
SHAPED_BY = ("points", "size", "radius", "radiusBottom", "radiusTop", "height")
# The largest over the smallest scale of a body that still has a volume.
FLATTEST = 1e8
# [m/s], [rad/s]: no authored velocity is meant to be larger.
FASTEST, FASTEST_TURN = 1e4, 1e5


@dataclass
class HeldMotion:
    """Where the animation has a body until it is released: rest space to world, rigid."""

    source: Source
    placement: Placement

    @property
    def animated(self) -> bool:
        return self.placement.animated

    def pose(self, time: float) -> Pose:
        """What changes the body's shape after the first frame plays no part."""
        code = self.source.code(time)
        matrix = self.placement.metric(code)
        if not np.isfinite(matrix).all():
            name, mend = "xformOpOrder", "mend the transform operations"
            raise self.source.error(f"is not finite at time code {code:g}", self.placement.prim, name, mend)
        linear = matrix[:3, :3] @ np.linalg.inv(self.placement.at_start[:3, :3])
        matrix[:3, :3] = rotation_of(linear) if self.animated else np.eye(3)
        return Pose(matrix[None])


@dataclass
class FromRest:
    """time [s] -> (4, 4), rest space to scene coordinates, where the shot has the body's prim, and how large."""

    source: Source
    placement: Placement
    to_own: np.ndarray

    def __call__(self, time: float) -> np.ndarray:
        matrix = self.placement.metric(self.source.code(time))
        matrix[:3, :3] *= self.source.units.meters_per_unit
        return matrix @ self.to_own


class Props:
    """The rigid bodies of a shot, in the order of `Scene.rigid_bodies`.

    paths: of the bodies' prims.
    """

    def __init__(self, source: Source, bodies: Bodies, assigned: Sequence[Role], config: Config) -> None:
        """Puts the surfaces of all of them into `bodies`, which from now on gives them in their body's rest space,
        and with them what is drawn beneath the bodies and touches nothing.

        Raises InputError for what cannot be rigid, or has no mass.
        """
        self._source, self._surfaces = source, bodies
        self._parts: dict[str, list[Part]] = {}
        for role in assigned:
            if role.role == "rigid" and role.supported and role.body:
                parts = self._parts.setdefault(role.body, [])
                if role.collides:
                    parts.append(self._part(role, bodies, config))
        self.paths = tuple(self._parts)
        self._carry()
        bodies.place_by(self._take_along)

    def __len__(self) -> int:
        return len(self.paths)

    def placement(self, path: str) -> np.ndarray:
        """(4, 4), the prim's own space [stage units] to scene coordinates [m], at the first frame.

        Raises InputError where it is flat.
        """
        matrix = self._source.metric(self._source.placed_at_start(self._prim(path)))
        matrix[:3, :3] *= self._source.units.meters_per_unit
        if not np.any(matrix[:3, :3]) or np.linalg.cond(matrix[:3, :3]) > FLATTEST:
            mend = "scale it by more than 0"
            raise self._source.error("is scaled to nothing along an axis", self._prim(path), "xformOpOrder", mend)
        return matrix

    def rest(self, path: str) -> np.ndarray:
        """(4, 4), the prim's own space [stage units] to the rest space of its body [m]."""
        matrix = self.placement(path)
        matrix[:3, 3] = 0.0
        return matrix

    def rigid_bodies(self, surfaces: Sequence[Surface]) -> tuple[RigidBody, ...]:
        """surfaces: all of the scene, among them those of the bodies."""
        return tuple(self._rigid_body(index, path, surfaces) for index, path in enumerate(self.paths))

    def outputs(self) -> tuple[TransformOutput, ...]:
        """How the bodies' prims get their transforms back."""
        return tuple(self._output(index, path) for index, path in enumerate(self.paths))

    def carrying(self, path: str) -> int | None:
        """Which body, if any, carries the space of the prim at `path`, which may be still to be made."""
        prim = self._source.stage.GetPrimAtPath(path)
        while path != "/":
            if prim and UsdGeom.Xformable(prim).GetResetXformStack():
                return None
            path = str(Sdf.Path(path).GetParentPath())
            if path in self.paths:
                return self.paths.index(path)
            prim = self._source.stage.GetPrimAtPath(path)
        return None

    def carry_roots(self, rooted: Rooted, path: str) -> Rooted:
        """Where strands of the prim at `path` grow; on a carrier that nobody drew, as the body moves them all."""
        bodies = {body.surface.rigid for body in rooted.bodies}
        if not bodies and isinstance(rooted.surface.motion, RigidMotion):
            bodies = {self.carrying(path)}
        if not rooted.hidden or len(bodies) != 1 or None in bodies:
            return rooted
        (index,) = bodies
        to_world = self._rest_to_world(index)
        to_rest = np.linalg.inv(to_world) @ rooted.rest_to_world
        points = transform(to_rest, rooted.surface.points)
        surface = replace(rooted.surface, points=points, motion=self._motion(self.paths[index]), rigid=index)
        return replace(rooted, surface=surface, to_rest=to_rest @ rooted.to_rest, rest_to_world=to_world)

    def tell_of_left_behind(self, surfaces: Sequence[Surface], others: Iterable[str]) -> None:
        """Warns of prims that are drawn beneath a body and act where the shot has them.

        surfaces: all of the scene.  others: paths of prims that the animation moves.
        """
        # What nobody drew is called after the prim it is for: '/World/Hair (roots)'.
        left = [s.name.partition(" ")[0] for s in surfaces if s.rigid is None and s.body is None]
        for path in (*left, *others):
            index = self.carrying(path)
            if index is not None:
                problem = f"acts where the shot has it: it does not move with the rigid body {self.paths[index]}"
                self._source.warn(problem, path)

    def _prim(self, path: str) -> Usd.Prim:
        return self._source.stage.GetPrimAtPath(path)

    def _part(self, role: Role, bodies: Bodies, config: Config) -> Part:
        prim, holder = role.prim, self._prim(role.body)
        body = bodies.get(prim)
        if body is None:
            raise self._source.error("has no triangle with an area", prim, mend="give the rigid body a surface")
        if body.binding is not None:
            mend = "take its binding off, or make it a kinematic body"
            raise self._source.error("is skinned, which a rigid body cannot be", prim, "skel:skeleton", mend)
        for name in SHAPED_BY:
            self._source.tell_if_animated(prim.GetAttribute(name))
        return Part(body, parameters.resolve(self._source, prim, RIGID, config, holder))

    def _carry(self) -> None:
        for index, path in enumerate(self.paths):
            held, motion = self._parts[path], self._motion(path)
            for k, part in enumerate(held):
                held[k] = replace(part, body=self._carried(part, index, motion))
                self._surfaces.replace(held[k].body)

    def _motion(self, path: str) -> HeldMotion:
        return HeldMotion(self._source, Placement(self._source, self._prim(path)))

    def _take_along(self, body: Body) -> Body:
        """What is drawn beneath a rigid body, no part of it: it touches nothing, and carries what is on it."""
        index = self.carrying(body.path)
        if index is None or not isinstance(body.surface.motion, RigidMotion):
            return body
        held = self._in_rest_space(body, index, self._motion(self.paths[index]))
        return replace(held, surface=replace(held.surface, collides=False))

    def _rest_to_world(self, index: int) -> np.ndarray:
        """(4, 4), a body's rest space to scene coordinates at the first frame."""
        to_world = np.eye(4)
        to_world[:3, 3] = self.placement(self.paths[index])[:3, 3]
        return to_world

    def _in_rest_space(self, body: Body, index: int, motion: Motion) -> Body:
        """A surface in the rest space of a rigid body, which carries it."""
        to_world = self._rest_to_world(index)
        own_to_rest = np.linalg.inv(to_world) @ self.placement(body.path)
        surface = replace(body.surface, points=body.posed - to_world[:3, 3], motion=motion, rigid=index)
        return replace(
            body, surface=surface, rest_to_world=to_world, own_to_rest=own_to_rest, bind_to_rest=own_to_rest
        )

    def _carried(self, part: Part, index: int, motion: Motion) -> Body:
        """The part's surface in the rest space of its body."""
        held, given = self._in_rest_space(part.body, index, motion), part.given
        points, prim = held.surface.points, held.prim
        shape = solid_shape(self._source, prim, held.own_to_rest)
        if shape is None:
            own = transform(np.linalg.inv(held.own_to_rest), points)
            shape = bounding_shape(self._source, prim, own, held.own_to_rest)
        surface = replace(
            held.surface,
            triangles=_outward(points, held.surface.triangles),
            thickness=given["clearance"],
            friction=given["friction"] if "friction" in given else None,
            shape=shape,
        )
        tell_of_approximation(self._source, prim, surface)
        return replace(held, surface=surface)

    def _rigid_body(self, index: int, path: str, surfaces: Sequence[Surface]) -> RigidBody:
        prim, parts = self._prim(path), self._parts[path]
        mass = read_mass(self._source, prim, parts, self.rest(path))
        linear, angular = self._velocities(prim)
        return RigidBody(
            name=path,
            surfaces=tuple(i for i, surface in enumerate(surfaces) if surface.rigid == index),
            mass=mass.mass,
            center_of_mass=mass.center,
            inertia=mass.inertia,
            motion=self._motion(path),
            velocity=linear,
            angular_velocity=angular,
            restitution=max((part.given["restitution"] for part in parts), default=0.0),
        )

    def _velocities(self, prim: Usd.Prim) -> tuple[np.ndarray, np.ndarray]:
        """(3,) [m/s] and (3,) [rad/s], world.

        UsdPhysicsRigidBodyAPI has them "in the same space as the node's xform": that of the prim's parent, which
        may turn and scale; in stage units and degrees a second. A scale changes no turning.
        """
        source, body = self._source, UsdPhysics.RigidBodyAPI(prim)
        if values.flag(source, body.GetStartsAsleepAttr()):
            source.warn("is ignored: bodies start awake", prim, "physics:startsAsleep")
        to_world = source.placed_at_start(_frame_of(prim))[:3, :3]
        linear, angular = (
            _checked(source, attribute, most)
            for attribute, most in (
                (body.GetVelocityAttr(), FASTEST / source.units.meters_per_unit),
                (body.GetAngularVelocityAttr(), np.degrees(FASTEST_TURN)),
            )
        )
        return to_world @ linear * source.units.meters_per_unit, rotation_of(to_world) @ np.radians(angular)

    def _output(self, index: int, path: str) -> TransformOutput:
        prim = self._prim(path)
        # What moves with another body would be carried by it a second time.
        nested = any(path.startswith(f"{other}/") for other in self.paths)
        if nested and not UsdGeom.Xformable(prim).GetResetXformStack():
            self._source.warn("is within another rigid body, and does not move with it", prim, "xformOpOrder")
        resets = nested or UsdGeom.Xformable(prim).GetResetXformStack()
        frame = self._source.stage.GetPseudoRoot() if resets else prim.GetParent()
        rest = self.rest(path)
        in_shot = FromRest(self._source, Placement(self._source, prim), np.linalg.inv(rest))
        return TransformOutput(path, index, rest, WorldToLocal(self._source, frame), in_shot, resets)


def describe(bodies: Sequence[RigidBody], joints: Sequence[Joint]) -> dict[str, str]:
    """By prim path, what a report says of bodies and joints."""
    told = {}
    for body in bodies:
        about = ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(body.inertia))
        told[body.name] = f"{body.mass:.4g} kg, inertia {about} kg m2, {len(body.surfaces)} colliders"
    for joint in joints:
        first, second = ("the world" if side is None else bodies[side].name for side in joint.bodies)
        driven = ", driven" if joint.drive is not None else ""
        told[joint.name] = f"{joint.kind}{driven}: holds {second} to {first}"
    return told


def _checked(source: Source, attribute: Usd.Attribute, most: float) -> np.ndarray:
    """(3,), a velocity as authored; raises InputError for one that is not below `most`."""
    value = values.vector(source, attribute)
    value = np.zeros(3) if value is None else value
    if not (np.abs(value) <= most).all():
        found = ", ".join(f"{part:g}" for part in value)
        mend = f"author three numbers, each from {-most:g} to {most:g}"
        raise source.error(f"is ({found})", attribute.GetPrim(), attribute.GetName(), mend)
    return value


def _frame_of(prim: Usd.Prim) -> Usd.Prim:
    """The prim in whose space its transform is."""
    if UsdGeom.Xformable(prim).GetResetXformStack():
        return prim.GetStage().GetPseudoRoot()
    return prim.GetParent()


def _outward(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles, turned where what they enclose has a volume below zero: drawn inside out, or mirrored."""
    a, b, c = (points[triangles[:, k]] - points.mean(axis=0) for k in range(3))
    inside_out = np.einsum("ni,ni->", a, np.cross(b, c)) < 0.0
    return np.ascontiguousarray(triangles[:, ::-1]) if inside_out else triangles
