"""Elastic boxes among surfaces that the animation moves, for tests of contact."""

from __future__ import annotations

from typing import Any

import numpy as np

from plait.solver.build import build
from plait.solver.kinematics.colliders import Collider
from plait.solver.scene import Scene, Surface, TetBody
from plait.solver.settings import GridSettings, Settings

FRAME, SUBSTEPS = 1.0 / 24.0, 8
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def solid_box(name: str, size: tuple[float, float, float], centre=(0.0, 0.0, 0.0), **surface: Any) -> Surface:
    """A closed box facing out."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    triangles = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]]).astype(np.int32)
    return Surface(name, corners * size + np.asarray(centre), triangles, **surface)


def floor(name: str = "floor", rotation: np.ndarray | None = None, half: float = 10.0, **surface: Any) -> Surface:
    """A square sheet through the origin, its normal along y before `rotation`."""
    corners = half * np.array([[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    rotation = np.eye(3) if rotation is None else rotation
    triangles = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    return Surface(name, corners @ rotation.T, triangles, **surface)


def turn_z(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Soft:
    """A running scene of one or more elastic bodies, the skins first among the surfaces."""

    def __init__(
        self,
        bodies: list[tuple[TetBody, Surface]],
        obstacles: list[Surface],
        *,
        gravity: float = 9.81,
        cell_size: float = 0.0,
        **settings: Any,
    ) -> None:
        scene = Scene(
            surfaces=(*(skin for _, skin in bodies), *obstacles),
            bodies=tuple(body for body, _ in bodies),
            gravity=np.array([0.0, -gravity, 0.0]),
        )
        grid = GridSettings(cell_size=cell_size)
        self.simulation = build(scene, Settings(grid=grid, substeps=SUBSTEPS, **settings))
        self.tets = self.simulation.model.parts["tets"]
        self.mass = self.tets.layout.mass[:, None]

    def run(self, frames: int = 1) -> dict[str, Any]:
        """Goes on for whole frames; the metrics of the last."""
        for _ in range(frames):
            metrics = self.simulation.advance_frame((self.frames + 1) * FRAME)
        return metrics

    @property
    def frames(self) -> int:
        """How many have passed."""
        return round(self.simulation.state.time / FRAME)

    def substep(self) -> None:
        time = self.simulation.state.time
        self.simulation.advance_frame(time + FRAME / SUBSTEPS, 1)

    def push(self, velocity: np.ndarray) -> None:
        """Gives every node a velocity, (3,) or (node_count, 3) [m/s], at the next substep."""
        self.tets.external_impulse.assign(self.mass * (velocity - self.tets.velocity.numpy()))

    @property
    def nodes(self) -> np.ndarray:
        return self.tets.position.numpy().copy()

    @property
    def velocity(self) -> np.ndarray:
        """(3,) [m/s] of the centre of mass."""
        return (self.mass * self.tets.velocity.numpy()).sum(axis=0) / self.mass.sum()

    @property
    def centre(self) -> np.ndarray:
        return (self.mass * self.nodes).sum(axis=0) / self.mass.sum()

    @property
    def speed(self) -> float:
        """[m/s] root mean square over the mass."""
        return float(np.sqrt((self.mass * self.tets.velocity.numpy() ** 2).sum() / self.mass.sum()))

    @property
    def skin(self) -> np.ndarray:
        """(particle_count, 3) [m] of all skins: where contact acts."""
        particles = self.tets._contact.particles
        return particles.evaluate_positions(self.tets.position).numpy().copy()

    @property
    def obstacles(self) -> Any:
        return self.tets._contact.obstacles

    def collider(self, index: int) -> Collider:
        colliders = self.simulation.model.parts["kinematics"].colliders
        return next(item for item in colliders.items if item.index == index)
