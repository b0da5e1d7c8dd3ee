"""Strands that nothing holds at their roots: the rigid motion that stands in for a root's."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.state import State
from plait.solver.strands.free_kernels import FreeStrandsData, lead, note_acceleration
from plait.solver.strands.layout import Layout


class FreeStrands:
    """Leads free strands' frames along, as the skin leads those of the others.

    A free strand's frame is at its mass centre. Over a substep it goes the way the strand would go if it were
    rigid, by its momentum, its angular momentum and the acceleration of its mass centre in the substep before. The
    strand starts from there, and damping acts against motion relative to it: free flight and rest are not damped.

    State array 'strands/acceleration': (strand_count,) vec3d [m/s2], of free strands' mass centres.
    position, rotation: (strand_count,) of all strands' frames at the substep's end, as `Roots`.
    """

    def __init__(self, layout: Layout, launcher: Launcher, state: State, gained: float) -> None:
        """gained: the part of the speed a substep adds by which a constant force moves things in it."""
        self._launcher, self._gained, device = launcher, gained, launcher.device
        data = FreeStrandsData()
        data.strands = wp.array(np.flatnonzero(layout.free), dtype=wp.int32, device=device)
        data.first_node = wp.array(layout.first_node, dtype=wp.int32, device=device)
        data.mass = wp.array(layout.mass, dtype=wp.float64, device=device)
        data.turn_inertia = wp.array(layout.turn_inertia, dtype=wp.float64, device=device)
        self._data = data
        self._count, strands = len(data.strands), layout.strand_count
        mass, force = (np.add.reduceat(each, layout.first_node[:-1]) for each in (layout.mass, layout.force))
        self._acceleration = wp.array(force / mass[:, None], dtype=wp.vec3d, device=device)
        state.arrays["strands/acceleration"] = self._acceleration
        self._mean_velocity, self.position = (wp.zeros(strands, dtype=wp.vec3d, device=device) for _ in range(2))
        self.rotation = wp.zeros(strands, dtype=wp.mat33d, device=device)

    def lead(self, held: Any, kinematics: Any, length: float) -> None:
        """Frames at the end of a substep of `length` [s]; puts free strands' in `held` at their mass centres."""
        wp.copy(self.position, kinematics.root_position)
        wp.copy(self.rotation, kinematics.root_rotation)
        inputs = [self._data, length, self._gained, held.position, held.velocity, held.spin, held.root_rotation]
        outputs = [self._mean_velocity, held.root_position, self.position, self.rotation]
        self._launcher.launch(lead, self._count, [*inputs, self._acceleration], outputs)

    def commit(self, velocity: wp.array, length: float) -> None:
        """A substep that ends with `velocity`, (node_count,) vec3d [m/s], stands."""
        inputs = [self._data, length, self._mean_velocity, velocity]
        self._launcher.launch(note_acceleration, self._count, inputs, [self._acceleration])
