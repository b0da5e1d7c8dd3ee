"""Particles that emitters pour in."""

from __future__ import annotations

import numpy as np

from plait.solver.model import Interval
from plait.solver.scene import Emitter


def emitted(emitter: Emitter, poured: np.ndarray, substep: Interval) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) places [m] at the substep's end of the particles poured in during it, and their velocities [m/s].

    poured: (2,) how many have been so far, and the part of one that is on its way; brought up to date. Places in
    the box depend on the seed and that count alone, so that a run that is taken up again pours the same.
    """
    if not emitter.switch.on(substep.start):
        return np.zeros((0, 3)), np.zeros((0, 3))
    due = poured[1] + emitter.rate * substep.length
    count = int(min(np.floor(due), emitter.limit - poured[0]))
    random = np.random.default_rng([emitter.seed, int(poured[0])])
    age = substep.length * random.random((count, 1))
    places = np.asarray(emitter.lower) + random.random((count, 3)) * np.subtract(emitter.upper, emitter.lower)
    places, velocities = _moved(emitter, places, substep)
    poured[:] = poured[0] + count, due - np.floor(due)
    return places + age * velocities, velocities


def _moved(emitter: Emitter, places: np.ndarray, substep: Interval) -> tuple[np.ndarray, np.ndarray]:
    """Places in the box, (n, 3), as they are at the substep's end, and the velocities poured in with there."""
    end = emitter.motion.pose(substep.end).joint_transforms[0]
    moved = places @ end[:3, :3].T + end[:3, 3]
    u, _, vt = np.linalg.svd(end[:3, :3])
    velocities = np.broadcast_to((u @ vt) @ np.asarray(emitter.velocity, dtype=float), places.shape)
    if not emitter.motion.animated:
        return moved, velocities
    start = emitter.motion.pose(substep.start).joint_transforms[0]
    return moved, velocities + (moved - places @ start[:3, :3].T - start[:3, 3]) / substep.length
