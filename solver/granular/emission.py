"""Particles that emitters pour in."""

from __future__ import annotations

import numpy as np

from plait.solver.model import Interval
from plait.solver.scene import Emitter


def emitted(emitter: Emitter, poured: np.ndarray, substep: Interval) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) places [m] at the substep's end of the particles poured in during it, and their velocities [m/s].

    poured: (2,) how many have been so far, and the part of one that is on its way; brought up to date. Places
    depend on the seed and that count alone, so that a run that is taken up again pours the same.
    """
    if not emitter.switch.on(substep.start):
        return np.zeros((0, 3)), np.zeros((0, 3))
    due = poured[1] + emitter.rate * substep.length
    count = int(min(np.floor(due), emitter.limit - poured[0]))
    random = np.random.default_rng([emitter.seed, int(poured[0])])
    age = substep.length * random.random((count, 1))
    places = np.asarray(emitter.lower) + random.random((count, 3)) * np.subtract(emitter.upper, emitter.lower)
    velocities = np.broadcast_to(np.asarray(emitter.velocity, dtype=float), (count, 3))
    poured[:] = poured[0] + count, due - np.floor(due)
    return places + age * velocities, velocities
