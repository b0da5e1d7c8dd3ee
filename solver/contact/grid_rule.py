"""The rule of the paper that this method comes from, to the letter: a variant for comparison only.

One grid for all bodies, no gate, the fully elastic factor 2, masses by element. It filters a lone body's own
rotation and vibration, and loses momentum: see `body_contact.py` for what is used otherwise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.grid_rule_kernels import change_nodes, change_particles
from plait.solver.contact.skin_contact import told_friction
from plait.solver.grid.sparse_grid import SparseGrid
from plait.solver.model import Model


class PaperRule:
    """Han 2019 §4.3 and §4.4, equations (15) to (25); all bodies' collision particles on one grid.

    Particles lie in a lattice, not at random. m_q is the mass of the tet that the particle lies in over the number
    of particles there (§4.1).
    """

    too_fast = False

    def __init__(self, model: Model, particles: CollisionParticles, mobile: np.ndarray) -> None:
        self._launcher, self._particles = model.launcher, particles
        self._grid = SparseGrid(particles.spacing, model.launcher)
        device, layout = model.launcher.device, particles.layout

        def hold(values: np.ndarray) -> wp.array:
            return wp.array(values, dtype=wp.float64, device=device)

        self._mass = hold(element_masses(particles))
        self._friction = hold(told_friction(model.scene, layout)[particles.body])
        self._mobile, self._node_mass = hold(mobile.astype(float)), layout.mass
        self._filtered, self._change = (wp.zeros_like(particles.position) for _ in range(2))
        self._node_change = wp.zeros(layout.node_count, dtype=wp.vec3d, device=device)

    def begin_substep(self, start: wp.array, position: wp.array, base: wp.array, lying: np.ndarray) -> bool:
        """True always: the rule has no gate. Particles are taken where the substep starts (16)."""
        self._grid.place(self._particles.evaluate_positions(start).numpy())
        self._particles.evaluate_normals()
        return True

    def begin_pass(
        self, position: wp.array, velocity: wp.array, displacement_per_velocity: float, inverse_mass: wp.array
    ) -> None:
        """Nothing to prepare."""
        self._swept = False

    def sweep(self, velocity: wp.array) -> None:
        """The rule knows one sweep a substep; any further do nothing."""
        if self._swept:
            return
        self._swept = True
        particles, grid, launch = self._particles, self._grid, self._launcher.launch
        at_particles = particles.evaluate_velocities(velocity)
        grid.to_grid(self._mass, at_particles)
        grid.from_grid(self._filtered)
        inputs = [particles.normal, self._friction, at_particles, self._filtered]
        launch(change_particles, particles.count, inputs, [self._change], work_per_item=2)
        inputs = [*particles.adjoint, self._mass, self._change, self._mobile]
        outputs = [velocity, self._node_change]
        launch(change_nodes, particles.layout.node_count, inputs, outputs, work_per_item=4)

    def add_impulses(self, on_nodes: wp.array) -> None:
        """Adds m_p Delta v_p [kg m/s]."""
        impulse = self._node_mass[:, None] * self._node_change.numpy()
        on_nodes.assign(on_nodes.numpy() + impulse)

    def separate(self, position: wp.array) -> None:
        """The rule moves no positions."""

    def retract(self) -> None:
        """The rule has no memory."""

    def end_frame(self) -> dict[str, Any]:
        """Nothing counted."""
        return {}


def element_masses(particles: CollisionParticles) -> np.ndarray:
    """(count,) [kg] each tet's mass, shared by the particles in it."""
    layout = particles.layout
    density = np.concatenate([np.broadcast_to(b.density, len(b.tets)) for b in layout.bodies])
    tets, sharing = np.unique(particles.tet, return_counts=True)
    return (density * layout.volume)[particles.tet] / sharing[np.searchsorted(tets, particles.tet)]
