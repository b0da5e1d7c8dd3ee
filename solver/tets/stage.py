"""Elastic bodies of tetrahedra: the stage that owns their state and advances it."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import warp as wp

from plait.solver.diagnostics import Diverged
from plait.solver.model import Interval, Model
from plait.solver.state import State
from plait.solver.tets.layout import build_layout
from plait.solver.tets.skin import Skin
from plait.solver.tets.targets import Targets


def build(model: Model, state: State) -> TetStage | None:
    """The stage of the scene's bodies, at rest at `model.start_time`; None without bodies."""
    return TetStage(model, state) if model.scene.bodies else None


class TetStage:
    """All elastic bodies of a scene, each solved by itself.

    layout: nodes, tets and bodies.
    position, velocity: (node_count,) vec3d [m], [m/s], world.
    external_impulse: (node_count,) vec3d [kg m/s] that others add to; the next substep takes it up.
    warnings: lines for the user about what could not be taken as given.

    State arrays: tets/position, velocity, external_impulse.
    """

    name = "tets"

    def __init__(self, model: Model, state: State) -> None:
        self._model, self._launcher = model, model.launcher
        self.layout = build_layout(model.scene)
        self.real = wp.float64 if model.settings.precision == "float64" else wp.float32
        self.warnings: tuple[str, ...] = ()
        bodies, device = range(self.layout.body_count), self._launcher.device
        self._targets = [Targets(self.layout.bodies[b], self._launcher) for b in bodies]
        start = np.concatenate([targets.all_nodes(model.start_time) for targets in self._targets])
        self.position = wp.array(start, dtype=wp.vec3d, device=device)
        self.velocity = wp.zeros_like(self.position)
        self.external_impulse = wp.zeros_like(self.position)
        for name in ("position", "velocity", "external_impulse"):
            state.arrays[f"tets/{name}"] = getattr(self, name)
        self._skins = [Skin(self.layout, b, self._launcher, self.real) for b in bodies]
        self._kept: list[np.ndarray] = []
        self._bodies = [_Trial(self, b) for b in bodies]
        self._contact = self._make_contact(state)

    def _make_contact(self, state: State) -> Any:
        if importlib.util.find_spec("plait.solver.contact.body_contact") is None:
            return None
        from plait.solver.contact.body_contact import build_contact

        return build_contact(self._model, state, self.layout)

    # -- stepping ------------------------------------------------------------------------------------------

    def begin_frame(self, state: State, frame: Interval) -> None:
        """Nothing to decide."""

    def step(self, state: State, substep: Interval, last_resort: bool = False) -> bool:
        """Moves every body to the substep's end."""
        self._kept = [a.numpy().copy() for a in (self.position, self.velocity, self.external_impulse)]
        for body, targets in zip(self._bodies, self._targets, strict=True):
            targets.place(substep.end)
            body.step(substep.length, targets)
        self.external_impulse.zero_()
        contact = self._contact
        if contact is not None:
            start = wp.array(self._kept[0], dtype=wp.vec3d, device=self._launcher.device)
            if contact.begin_substep(substep, start, self.position):
                contact.resolve(start, self.position, self.velocity, substep.length)
                contact.separate(self.position)
        return True

    def retract(self, state: State, substep: Interval) -> None:
        """Everything as it was before the substep, bit for bit."""
        for array, kept in zip((self.position, self.velocity, self.external_impulse), self._kept, strict=True):
            array.assign(kept)

    def end_frame(self, state: State, frame: Interval) -> dict[str, Any]:
        """Raises `Diverged` for a node that is not finite."""
        finite = np.isfinite(self.position.numpy()).all(axis=1)
        if not finite.all():
            raise Diverged("position", self.layout.where(int(np.argmin(finite))), frame.end)
        return self._contact.end_frame() if self._contact is not None else {}

    # -- results -------------------------------------------------------------------------------------------

    def nodes(self, body: int) -> np.ndarray:
        """(node_count, 3) float64 [m]: the body's nodes, scene world."""
        return self.position.numpy()[self.layout.nodes(body)]

    def node_velocities(self, body: int) -> np.ndarray:
        """(node_count, 3) float64 [m/s] at the same nodes."""
        return self.velocity.numpy()[self.layout.nodes(body)]

    def points(self, body: int) -> np.ndarray:
        """(point_count, 3) float64 [m]: the points of the body's skin, scene world."""
        return self._on_skin(body, self.position)

    def velocities(self, body: int) -> np.ndarray:
        """(point_count, 3) float64 [m/s] at the same points."""
        return self._on_skin(body, self.velocity)

    def place_skin(self, body: int, points_out: wp.array, query_points_out: wp.array) -> None:
        """Writes the points of the body's skin: (point_count,) vec3d, and rounded to vec3f if given room."""
        self._skins[body].place(self.position, points_out, query_points_out)

    def _on_skin(self, body: int, values: wp.array) -> np.ndarray:
        out = wp.empty(self._skins[body].count, dtype=wp.vec3d, device=self._launcher.device)
        self._skins[body].place(values, out)
        return out.numpy()


class _Trial:
    """Backward Euler with a fixed-corotated Newton solve."""

    def __init__(self, stage: TetStage, body: int) -> None:
        layout = stage.layout
        self.stage, self.nodes = stage, layout.nodes(body)
        held = layout.bodies[body]
        tets = slice(int(layout.first_tet[body]), int(layout.first_tet[body + 1]))
        self.tets = layout.tets[tets] - self.nodes.start
        self.volume, self.mass = layout.volume[tets], layout.mass[self.nodes][:, None]
        rest = layout.rest[self.nodes][self.tets]
        inverse = np.linalg.inv(np.swapaxes(rest[:, 1:] - rest[:, :1], 1, 2))
        self.slopes = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
        young = np.broadcast_to(held.youngs_modulus, len(self.tets))
        nu = np.broadcast_to(held.poissons_ratio, len(self.tets))
        self.mu, self.lam = young / (2 + 2 * nu), young * nu / ((1 + nu) * (1 - 2 * nu))
        self.pinned, self.attachment = held.pinned, np.asarray(held.attachment)[:, None]
        self.gravity = stage._model.scene.gravity

    def step(self, h: float, targets: Targets) -> None:
        position, velocity = self.stage.position.numpy(), self.stage.velocity.numpy()
        start = position[self.nodes].copy()
        impulse = self.stage.external_impulse.numpy()[self.nodes]
        guess = start + h * (velocity[self.nodes] + impulse / self.mass + h * self.gravity)
        goal = guess.copy()
        goal[targets.driven] = targets.position.numpy()
        inertia = self.mass / h**2
        x = start.copy()
        x[self.pinned] = goal[self.pinned]
        before = np.inf
        for _ in range(30):
            gradient = (x[self.tets].swapaxes(1, 2)) @ self.slopes
            u, _, vt = np.linalg.svd(gradient)
            flip = np.sign(np.linalg.det(u @ vt))
            u[:, :, 2] *= flip[:, None]
            rotation = u @ vt
            columns = np.moveaxis(gradient, 2, 0)
            cofactor = np.stack([np.cross(columns[(i + 1) % 3], columns[(i + 2) % 3]) for i in range(3)], 2)
            j = np.einsum("ni,ni->n", gradient[:, :, 0], cofactor[:, :, 0])
            stress = 2 * self.mu[:, None, None] * (gradient - rotation)
            stress += (self.lam * (j - 1))[:, None, None] * cofactor
            residual = inertia * (guess - x) + self.attachment * (goal - x)
            residual -= self.sum_up(stress)
            residual[self.pinned] = 0
            norm = np.linalg.norm(residual)
            if norm < 1e-4 * before if np.isfinite(before) else norm == 0:
                break
            before = min(before, norm) if not np.isfinite(before) else before
            x += self.solve(residual, rotation, cofactor, inertia + self.attachment)
        position[self.nodes] = x
        velocity[self.nodes] = (x - start) / h

    def sum_up(self, stress: np.ndarray) -> np.ndarray:
        forces = (stress @ self.slopes.swapaxes(1, 2)).swapaxes(1, 2) * self.volume[:, None, None]
        rows = self.tets.ravel()
        return np.stack([np.bincount(rows, forces[..., i].ravel(), len(self.mass)) for i in range(3)], axis=1)

    def solve(
        self, residual: np.ndarray, rotation: np.ndarray, cofactor: np.ndarray, shift: np.ndarray
    ) -> np.ndarray:
        def product(p: np.ndarray) -> np.ndarray:
            d = p[self.tets].swapaxes(1, 2) @ self.slopes
            turned = rotation @ d.swapaxes(1, 2) @ rotation
            along = np.einsum("nij,nij->n", cofactor, d) * self.lam
            out = self.sum_up(self.mu[:, None, None] * (d + turned) + along[:, None, None] * cofactor) + shift * p
            out[self.pinned] = 0
            return out

        size = (self.slopes**2).sum(axis=2) * (self.volume * (self.mu * 4 / 3 + self.lam / 3))[:, None]
        diagonal = shift + np.bincount(self.tets.ravel(), size.ravel(), len(self.mass))[:, None]
        x, r = np.zeros_like(residual), residual.copy()
        z = r / diagonal
        p, rz = z.copy(), (r * z).sum()
        for _ in range(200):
            if np.linalg.norm(r) <= 0.01 * np.linalg.norm(residual):
                break
            q = product(p)
            alpha = rz / (p * q).sum()
            x, r = x + alpha * p, r - alpha * q
            z = r / diagonal
            rz, old = (r * z).sum(), rz
            p = z + rz / old * p
        return x
