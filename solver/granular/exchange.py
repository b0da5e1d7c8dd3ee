"""What exchanges of momentum between grains and others have in common."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import warp as wp

from plait.solver.granular.exchange_kernels import expect
from plait.solver.launch import Launcher
from plait.solver.model import Interval
from plait.solver.state import State

# Cost in units of `Launcher.launch`.
EXPECT_WORK = 2


class Expectation:
    """Of nodes that give way, what they are given in a substep and what of that they are expected to bear.

    inverse_mass: (node_count,) float64 [1/kg].  given, expected: (node_count,) vec3d [kg m/s].

    State arrays: granular/given_`name`, and granular/velocity_`name`: (node_count,) vec3d [m/s] at the end of the
    substep before.
    """

    def __init__(
        self, inverse_mass: wp.array, gravity: np.ndarray, launcher: Launcher, state: State, name: str
    ) -> None:
        self._launcher, self._gravity, self.inverse_mass = launcher, wp.vec3d(*gravity), inverse_mass
        self.given, self.expected, self._velocity_before = (
            wp.zeros(len(inverse_mass), dtype=wp.vec3d, device=launcher.device) for _ in range(3)
        )
        state.arrays |= {f"granular/given_{name}": self.given, f"granular/velocity_{name}": self._velocity_before}

    def begin_substep(self, velocity: wp.array, length: float) -> None:
        """velocity: (node_count,) vec3d [m/s], at its end, when the nodes have taken up what they were given."""
        inputs = [self.inverse_mass, velocity, self._gravity, length]
        outputs = [self._velocity_before, self.given, self.expected]
        self._launcher.launch(expect, len(velocity), inputs, outputs, work_per_item=EXPECT_WORK)


class Exchange(Protocol):
    """Momentum that passes between grains and one kind of what they meet, node by node (Han 2019 (46)-(50)).

    Inelastic with Coulomb friction, the friction impulse one vector of opposite signs, which the printed (49) and
    (50) are not where it sticks. What is met has moved already in this substep of the simulation; the grains then
    take many steps in it. Within these it gives way as its mass lets it, and takes up what the grains gave it in
    its next substep.
    """

    speed: float  # [m/s] no part of what is met goes faster along an axis

    def begin_frame(self) -> None:
        """Forgets all that is not state."""

    def begin_substep(self, substep: Interval) -> None:
        """Nothing has been given yet."""

    def find(self, since: float) -> None:
        """Takes up the nodes in contact, whenever particles have been sorted or the surfaces are others."""

    def act(self, moment: wp.array, passes: int) -> None:
        """On `grid.velocity`, in a step at `moment`, (1,) struct `Moment`; at most so many passes."""

    def end_substep(self) -> None:
        """Hands over what has been given."""
