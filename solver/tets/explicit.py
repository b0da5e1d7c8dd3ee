"""Symplectic Euler for one body, in as many steps of its own as stability asks for."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.tets.elements import lame_parameters
from plait.solver.tets.explicit_kernels import explicit_kernels
from plait.solver.tets.layout import TetLayout
from plait.solver.tets.newton import Newton
from plait.solver.tets.rpic import RpicDamping

# Of the longest stable step of the undeformed body; squeezed tets are stiffer.
SAFETY = 0.5
NODE_WORK = 12


class ExplicitSteps:
    """v += dt M^-1 f(x), x += dt v (Han et al. 2019 eq. 10 to 14 with alpha = 0)."""

    def __init__(
        self, newton: Newton, layout: TetLayout, body: int, rpic_damping: float, launcher: Launcher, real: type
    ) -> None:
        """rpic_damping: see `rpic.py`; none at all where it is 0."""
        self._newton, self._launcher = newton, launcher
        self._kernels, self._nodes = explicit_kernels(real), layout.nodes(body)
        self._rpic = RpicDamping(layout, body, rpic_damping, launcher) if rpic_damping > 0.0 else None
        self.longest = SAFETY * _stable_step(layout, body)
        unknown = np.full(self._nodes.stop - self._nodes.start, -1, dtype=np.int32)
        free = ~layout.pinned[self._nodes]
        unknown[free] = np.arange(free.sum())
        self._unknown = wp.array(unknown, dtype=wp.int32, device=launcher.device)
        self._previous = wp.zeros(layout.node_count, dtype=wp.vec3d, device=launcher.device)

    def advance(self, step: Any, motion: Any) -> None:
        """From the step's start to its end; `step` and `motion` as in `body_kernels`, goals in place."""
        count = max(1, math.ceil(step.length / self.longest))
        launch, kernels, nodes = self._launcher.launch, self._kernels, len(self._unknown)
        launch(kernels.begin, nodes, [step], [motion])
        damping = self._newton.damping
        for k in range(count):
            force = self._newton.find_forces()
            if damping is not None:
                launch(kernels.retrace, nodes, [step, count, motion], [self._previous])
                damping.begin(self._previous, motion.position, self._previous, 0.5, step.length / count)
                damping.add_forces(motion.position, force)
            inputs = [step, count, k, self._newton.rows.incidence, self._unknown, force]
            launch(kernels.kick, nodes, inputs, [motion], work_per_item=NODE_WORK)
            if self._rpic is not None:
                self._rpic.apply(motion)
            launch(kernels.drift, nodes, [step, count], [motion])


def _stable_step(layout: TetLayout, body: int) -> float:
    """[s] A lower bound of 2 / omega for the highest frequency, with Rayleigh's damping, at rest.

    No frequency of a whole exceeds that of its parts: a tet with a quarter of its mass at each corner has at most
    omega^2 = 4 (2 mu + 3 lambda) / rho times the largest eigenvalue of the sum of g_a g_a^T.
    """
    held = layout.bodies[body]
    slopes = layout.slopes(body)
    mu, lam = lame_parameters(held.youngs_modulus, held.poissons_ratio)
    largest = np.linalg.eigvalsh(np.einsum("tai,taj->tij", slopes, slopes))[:, 2]
    square = float((4.0 * (2.0 * mu + 3.0 * lam) / held.density * largest).max())
    nodes = layout.nodes(body)
    square += float((np.asarray(held.attachment) / layout.mass[nodes]).max())
    omega = math.sqrt(square)
    damping = 0.5 * held.stiffness_damping * omega
    return 2.0 / omega * (math.sqrt(1.0 + damping**2) - damping)
