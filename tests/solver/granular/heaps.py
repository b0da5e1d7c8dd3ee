"""Heaps of particles, by themselves and in scenes."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.build import build
from plait.solver.granular.matter import Matter
from plait.solver.launch import Launcher
from plait.solver.scene import Granular, Scene, Surface
from plait.solver.settings import Settings

CELL = 0.1
FRAME = 1.0 / 24.0


def granular(position: np.ndarray, velocity: np.ndarray, law: str = "sand", **values) -> Granular:
    """Eight particles to a cell of CELL."""
    count = len(position)
    volume, width = np.full(count, CELL**3 / 8), np.full(count, CELL / 2)
    return Granular("heap", law, position, velocity, volume, width, np.arange(count), **values)


def scattered(count: int = 3000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Two clouds far apart on both sides of the origin: places and velocities."""
    random = np.random.default_rng(seed)
    position = random.normal(size=(count, 3)) * 0.4
    position[::2] += [-17.0, 5.0, 33.0]
    return position, random.normal(size=(count, 3))


def matter(heap: Granular, real: type = wp.float64, threads: int = 1, gravity=(0.0, 0.0, 0.0)) -> Matter:
    held = Matter((heap,), len(heap.positions), CELL, np.array(gravity), real, Launcher(threads=threads))
    held.add(0, heap.positions, heap.velocities, heap.volumes)
    return held


def in_order(held: Matter, name: str) -> np.ndarray:
    """A field of the particles, as they were given."""
    return getattr(held.particles, name).numpy()[np.argsort(held.particles.number.numpy())]


def lattice(cells: tuple[int, int, int], corner=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Eight places to a cell, from `corner` [m]."""
    places = np.indices(2 * np.array(cells)).reshape(3, -1).T + 0.5
    return places * CELL / 2 + corner


def plate(size: float, normal=(0.0, 1.0, 0.0), **values) -> Surface:
    """A square through the origin, facing along `normal`."""
    n = np.array(normal) / np.linalg.norm(normal)
    a = np.cross(n, [0.0, 0.0, 1.0] if abs(n[2]) < 0.9 else [1.0, 0.0, 0.0])
    a *= size / np.linalg.norm(a)
    b = np.cross(n, a)
    points = np.array([-a - b, a - b, a + b, b - a])
    return Surface("plate", points, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), **values)


def run(simulation, frames: int) -> list[dict]:
    start = simulation.state.time
    return [simulation.advance_frame(start + (k + 1) * FRAME)["granular"] for k in range(frames)]


def simulated(scene: Scene, **settings):
    return build(scene, Settings(threads=1, substeps=2, **settings))
