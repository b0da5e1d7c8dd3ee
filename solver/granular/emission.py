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
    poured[:] = poured[0] + count, due - np.floor(due)
    end = emitter.motion.pose(substep.end).joint_transforms[0]
    u, _, vt = np.linalg.svd(end[:3, :3])
    out = np.broadcast_to((u @ vt) @ np.asarray(emitter.velocity, dtype=float), places.shape)
    # It has gone along with the box until it left it: against the box, it has flown out for its age.
    return _placed(end, places) + age * out, out + _carried(emitter, places, substep)


def _carried(emitter: Emitter, places: np.ndarray, substep: Interval) -> np.ndarray:
    """(n, 3) [m/s] velocities of the box itself at places in it."""
    if not emitter.motion.animated:
        return np.zeros(places.shape)
    start, end = (emitter.motion.pose(time).joint_transforms[0] for time in (substep.start, substep.end))
    return (_placed(end, places) - _placed(start, places)) / substep.length


def _placed(pose: np.ndarray, places: np.ndarray) -> np.ndarray:
    return places @ pose[:3, :3].T + pose[:3, 3]
