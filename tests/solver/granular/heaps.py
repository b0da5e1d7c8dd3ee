"""Heaps of particles without a scene around them."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.granular.matter import Matter
from plait.solver.launch import Launcher
from plait.solver.scene import Granular

CELL = 0.1


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
