"""Rigid bodies for tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from plait.solver.build import build
from plait.solver.rigid.mass_properties import MassProperties, of_mesh, of_shape
from plait.solver.scene import Joint, RigidBody, Scene, Shape, StaticMotion, Surface
from plait.solver.settings import RigidSettings, Settings

from ..contact.shapes import ball
from ..contact.soft_scenes import solid_box

FRAME, SUBSTEPS = 1.0 / 24.0, 8


def pose(centre=(0.0, 0.0, 0.0), rotation: np.ndarray | None = None) -> StaticMotion:
    transform = np.eye(4)
    transform[:3, 3] = centre
    transform[:3, :3] = np.eye(3) if rotation is None else rotation
    return StaticMotion(transform)


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3), `angle` [rad] (Rodrigues)."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


class Prop:
    """A body and its one surface, still without their indices."""

    def __init__(
        self,
        surface: Surface,
        mass: MassProperties,
        motion: StaticMotion,
        **body: Any,
    ) -> None:
        self.surface, self.mass, self.motion, self.body = surface, mass, motion, body


def box(
    size=(0.2, 0.2, 0.2), centre=(0.0, 0.0, 0.0), rotation=None, *, density=1000.0, friction=None, **body
) -> Prop:
    """A box of triangles."""
    surface = solid_box("box", size, friction=friction)
    return Prop(surface, of_mesh(surface.points, surface.triangles, density), pose(centre, rotation), **body)


def shaped(
    kind: str, size, centre=(0.0, 0.0, 0.0), rotation=None, *, density=1000.0, friction=None, **body
) -> Prop:
    """A shape, drawn as a ball of its radius."""
    shape = Shape(kind, np.resize(np.asarray(size, dtype=np.float64), 3))
    points, triangles = ball(6, float(shape.size[0]))
    surface = Surface(kind, points, triangles, friction=friction, shape=shape)
    return Prop(surface, of_shape(shape, density), pose(centre, rotation), **body)


class Rigid:
    """A running scene of rigid bodies, their surfaces first."""

    def __init__(
        self,
        props: list[Prop],
        obstacles: list[Surface] | tuple = (),
        *,
        gravity=(0.0, -9.81, 0.0),
        joints: tuple[Joint, ...] = (),
        threads: int = 1,
        substeps: int = SUBSTEPS,
        filtered: tuple = (),
        rigid_start: float = -np.inf,
        **settings: Any,
    ) -> None:
        from dataclasses import replace

        surfaces = [replace(prop.surface, rigid=k, motion=prop.motion) for k, prop in enumerate(props)]
        bodies = tuple(
            RigidBody(f"body {k}", (k,), p.mass.mass, p.mass.center, p.mass.inertia, motion=p.motion, **p.body)
            for k, p in enumerate(props)
        )
        self.scene = Scene(
            surfaces=(*surfaces, *obstacles),
            rigid_bodies=bodies,
            gravity=np.array(gravity),
            joints=joints,
            filtered=filtered,
            rigid_start=rigid_start,
        )
        rigid = RigidSettings(**settings)
        self.simulation = build(self.scene, Settings(threads=threads, substeps=substeps, rigid=rigid))
        self.stage = self.simulation.model.parts["rigid"]
        self.mass = np.array([body.mass for body in bodies])

    def run(self, seconds: float) -> dict[str, Any]:
        """Goes on for whole frames; the metrics of the last."""
        start = round(self.time / FRAME)
        for k in range(round(seconds / FRAME)):
            metrics = self.simulation.advance_frame((start + k + 1) * FRAME)
        return metrics["rigid"]

    def substep(self, length: float = FRAME / SUBSTEPS) -> dict[str, Any]:
        return self.simulation.advance_frame(self.time + length, 1)["rigid"]

    @property
    def time(self) -> float:
        return self.simulation.state.time

    @property
    def position(self) -> np.ndarray:
        return self.stage.position.numpy().copy()

    @property
    def velocity(self) -> np.ndarray:
        return self.stage.velocity.numpy().copy()

    @property
    def spin(self) -> np.ndarray:
        """(n, 3) [rad/s], world."""
        rotation = self.rotation
        inertia = np.array([body.inertia for body in self.scene.rigid_bodies])
        local = np.einsum("nji,nj->ni", rotation, self.stage.angular_momentum.numpy())
        return np.einsum("nij,nj->ni", rotation, np.linalg.solve(inertia, local[..., None])[..., 0])

    @property
    def rotation(self) -> np.ndarray:
        """(n, 3, 3)."""
        return np.array([self.stage.pose(k)[:3, :3] for k in range(len(self.mass))])

    def points(self, body: int) -> np.ndarray:
        """(n, 3) [m] of a body's surface, world."""
        transform = self.stage.pose(body)
        return self.scene.surfaces[body].points @ transform[:3, :3].T + transform[:3, 3]

    def momenta(self) -> tuple[np.ndarray, np.ndarray]:
        """Linear and angular momentum of all, about the origin."""
        linear = self.mass[:, None] * self.velocity
        angular = self.stage.angular_momentum.numpy() + np.cross(self.position, linear)
        return linear.sum(axis=0), angular.sum(axis=0)
