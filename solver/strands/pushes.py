"""Impulses that others give to strands."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.state import State
from plait.solver.strands.push_kernels import take_up


class Pushes:
    """What others add to `impulse`, (node_count,) vec3d [kg m/s], the strands' next substep takes up.

    State array: strands/impulse.
    """

    def __init__(self, mass: np.ndarray, prescribed: np.ndarray, launcher: Launcher, state: State) -> None:
        """mass: (node_count,) [kg].  prescribed: (node_count,) bool, nodes that no force moves."""
        self._launcher, device = launcher, launcher.device
        inverse = np.divide(1.0, mass, out=np.zeros_like(mass), where=~prescribed)
        self.inverse_mass = wp.array(inverse, dtype=wp.float64, device=device)
        self.impulse = wp.zeros(len(mass), dtype=wp.vec3d, device=device)
        self._before = [wp.zeros(len(mass), dtype=wp.vec3d, device=device) for _ in range(2)]
        state.arrays["strands/impulse"] = self.impulse

    def take_up(self, velocity: wp.array) -> None:
        """Changes velocities, (node_count,) vec3d [m/s]."""
        for kept, array in zip(self._before, (velocity, self.impulse), strict=True):
            wp.copy(kept, array)
        self._launcher.launch(take_up, len(velocity), [self.inverse_mass], [self.impulse, velocity])

    def retract(self, velocity: wp.array) -> None:
        """As before `take_up`."""
        for kept, array in zip(self._before, (velocity, self.impulse), strict=True):
            wp.copy(array, kept)
