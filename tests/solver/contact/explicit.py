"""Elastic bodies stepped by symplectic Euler in plain numpy, so that contact can be judged by itself.

Fixed corotated elasticity in float64: v* = v + h f(x) / m, x* = x + h v*, then contact (Han 2019 (10) to (14)).
"""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.contact.body_contact import BodyContact
from plait.solver.kinematics import stage as kinematics
from plait.solver.launch import Launcher
from plait.solver.model import Interval, Model
from plait.solver.scene import Scene
from plait.solver.settings import GridSettings, Settings
from plait.solver.state import State
from plait.solver.step import MAX_HALVINGS
from plait.solver.tets.layout import build_layout


class Explicit:
    """A scene's bodies; `step` moves them, with contact unless told otherwise.

    position, velocity: (node_count, 3) float64 [m], [m/s].  impulse: (node_count, 3) of contact in the last step.
    """

    def __init__(
        self, scene: Scene, *, contact: bool = True, damping: float = 0.0, threads: int = 1, **grid: object
    ) -> None:
        settings = Settings(threads=threads, grid=GridSettings(**{"passes": 1, **grid}))
        self.layout = build_layout(scene)
        self.state, self.gravity, self.damping = State(), scene.gravity, damping
        self.launcher = Launcher("cpu", threads)
        model = Model(scene, settings, self.launcher, 0.0)
        model.parts["kinematics"] = kinematics.build(model, self.state)
        self.position = np.concatenate([_placed(body) for body in self.layout.bodies])
        # As the stage of bodies has it by when it makes contact.
        self.state.arrays["tets/position"] = wp.array(self.position, dtype=wp.vec3d, device="cpu")
        self.contact = BodyContact(model, self.state, self.layout) if contact else None
        self.velocity = np.zeros_like(self.position)
        self.impulse = np.zeros_like(self.position)
        self.time = 0.0
        self._prepare()

    def _prepare(self) -> None:
        layout = self.layout
        rest = layout.rest[layout.tets]
        inverse = np.linalg.inv(np.swapaxes(rest[:, 1:] - rest[:, :1], 1, 2))
        self._slopes = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
        young, nu = (
            np.concatenate([np.broadcast_to(getattr(b, name), len(b.tets)) for b in layout.bodies])
            for name in ("youngs_modulus", "poissons_ratio")
        )
        self._mu, self._lambda = young / (2 + 2 * nu), young * nu / ((1 + nu) * (1 - 2 * nu))

    def nodes(self, body: int) -> slice:
        return self.layout.nodes(body)

    def _strain(self) -> tuple[np.ndarray, ...]:
        gradient = self.position[self.layout.tets].swapaxes(1, 2) @ self._slopes
        u, sigma, vt = np.linalg.svd(gradient)
        handed = np.sign(np.linalg.det(u @ vt))
        u[:, :, 2] *= handed[:, None]
        sigma[:, 2] *= handed
        return gradient, u @ vt, sigma

    def forces(self) -> np.ndarray:
        """(node_count, 3) [N]: -dPsi/dx of psi = mu |F - R|^2 + lambda/2 (J - 1)^2 (H (3))."""
        gradient, rotation, _ = self._strain()
        columns = np.moveaxis(gradient, 2, 0)
        cofactor = np.stack([np.cross(columns[(i + 1) % 3], columns[(i + 2) % 3]) for i in range(3)], axis=2)
        j = np.einsum("ni,ni->n", gradient[:, :, 0], cofactor[:, :, 0])
        stress = 2 * self._mu[:, None, None] * (gradient - rotation)
        stress += (self._lambda * (j - 1))[:, None, None] * cofactor
        per_tet = -(stress @ self._slopes.swapaxes(1, 2)).swapaxes(1, 2) * self.layout.volume[:, None, None]
        rows, count = self.layout.tets.ravel(), len(self.position)
        return np.stack([np.bincount(rows, per_tet[..., i].ravel(), count) for i in range(3)], axis=1)

    def elastic_energy(self) -> float:
        """[J]"""
        _, _, sigma = self._strain()
        j = sigma.prod(axis=1)
        density = self._mu * ((sigma - 1) ** 2).sum(axis=1) + 0.5 * self._lambda * (j - 1) ** 2
        return float((density * self.layout.volume).sum())

    def energy(self) -> float:
        """[J] elastic and kinetic."""
        return self.elastic_energy() + float(0.5 * (self.layout.mass[:, None] * self.velocity**2).sum())

    def momentum(self) -> np.ndarray:
        """(3,) [kg m/s]"""
        return (self.layout.mass[:, None] * self.velocity).sum(axis=0)

    def angular_momentum(self) -> np.ndarray:
        """(3,) [kg m2/s]"""
        return np.cross(self.position, self.layout.mass[:, None] * self.velocity).sum(axis=0)

    def step(self, h: float) -> bool:
        """Moves on by h [s], in halves where contact asks for it; whether contact found anything near."""
        self.impulse[:] = 0.0
        return self._advance(h, MAX_HALVINGS)

    def _advance(self, h: float, halvings: int) -> bool:
        start, free = self.position.copy(), ~self.layout.pinned[:, None]
        acceleration = self.forces() / self.layout.mass[:, None] + self.gravity
        velocity = (self.velocity + h * acceleration * free) / (1.0 + h * self.damping)
        position = start + h * velocity
        interval, near = Interval(self.time, self.time + h), False
        if self.contact is not None:
            x0, x, v = (wp.array(a, dtype=wp.vec3d, device="cpu") for a in (start, position, velocity))
            near = self.contact.begin_substep(interval, x0, x)
            if near and self.contact.too_fast and halvings:
                self.contact.retract(interval)
                return any([self._advance(0.5 * h, halvings - 1) for _ in range(2)])
            if near:
                self.contact.resolve(x0, x, v, h)
                self.contact.separate(x)
                position, velocity = x.numpy().copy(), v.numpy().copy()
                self.impulse += self.contact.impulse.numpy()
        self.position, self.velocity, self.time = position, velocity, self.time + h
        return near

    def wave_step(self, courant: float = 0.3) -> float:
        """[s] A step in which a pressure wave crosses this part of the shortest edge."""
        rest = self.layout.rest[self.layout.tets]
        edges = np.linalg.norm(rest[:, [0, 0, 0, 1, 1, 2]] - rest[:, [1, 2, 3, 2, 3, 3]], axis=2)
        density = np.concatenate([np.broadcast_to(b.density, len(b.tets)) for b in self.layout.bodies])
        speed = np.sqrt((self._lambda + 2 * self._mu) / density)
        return float(courant * (edges.min(axis=1) / speed).min())


def _placed(body: object) -> np.ndarray:
    transform = body.motion.pose(0.0).joint_transforms[0]
    return body.nodes @ transform[:3, :3].T + transform[:3, 3]
