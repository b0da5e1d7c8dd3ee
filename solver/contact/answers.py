"""How elastic bodies answer to impulses on their skins: at once, and after an elastic solve."""

from __future__ import annotations

import numpy as np

from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.tets.layout import TetLayout

# What stands on a floor or hangs on bone answers less than what is free; but it is not taken to be heavier than
# this many times the estimate for that, for between two such bodies no impulse would do.
MOST_TIMES_ESTIMATE = 8.0


class Answers:
    """Inverse masses of nodes, (node_count,) float64 [1/kg], zero for those that contact cannot move.

    at_once: of each node by itself, what an impulse after the elastic solve moves.
    """

    def __init__(self, layout: TetLayout, particles: CollisionParticles) -> None:
        self.mobile = ~layout.pinned & (layout.mass > 0.0)
        self.at_once = np.divide(1.0, layout.mass, out=np.zeros(layout.node_count), where=self.mobile)
        self._first_node, self._counts = layout.first_node, np.diff(layout.first_node)
        bodies = range(layout.body_count)
        volume = np.array([layout.volume[slice(*layout.first_tet[b : b + 2])].sum() for b in bodies])
        mass = np.array([layout.mass[layout.nodes(b)].sum() for b in bodies])
        area = np.bincount(particles.body, particles.area, layout.body_count)
        skin_mass = np.bincount(particles.body, particles.mass, layout.body_count)
        # A body that does not collide has neither.
        area, skin_mass = (np.where(area > 0.0, a, 1.0) for a in (area, skin_mass))
        # A third of a cube's side, a plate's thickness.
        self._depth = 2.0 * volume / area
        self._speed = np.sqrt([np.mean(body.youngs_modulus) for body in layout.bodies] / (mass / volume))
        self._layers = (mass / volume) * area / skin_mass

    def after_solve(self, time: float) -> np.ndarray:
        """What the same impulse moves as a force within an implicit solve over `time` [s], estimated.

        It takes along what an elastic wave reaches in that time, density times its way for each square metre of
        skin, as far as the body goes; the skin's own nodes hold less. Too little takes more passes; with too
        much, a block that may rock rattles.
        """
        return self.at_once / np.repeat(self._times_skin(time), self._counts)

    def as_shown(self, time: float, impulse: np.ndarray, change: np.ndarray) -> np.ndarray:
        """The same as a solve has shown it, and as estimated for bodies that felt nothing.

        impulse: (node_count, 3) [kg m/s] in the solve.  change: (node_count, 3) [m/s] that it made of velocities.
        """
        work = self._sum((impulse * change).sum(axis=1))
        of_skin = self._sum(self.at_once * np.square(impulse).sum(axis=1))
        estimate = self._times_skin(time)
        most = MOST_TIMES_ESTIMATE * estimate
        shown = np.divide(of_skin, work, out=most.copy(), where=work * most > of_skin)
        times_skin = np.where(of_skin > 0.0, np.maximum(shown, 1.0), estimate)
        return self.at_once / np.repeat(times_skin, self._counts)

    def _times_skin(self, time: float) -> np.ndarray:
        return np.maximum(self._layers * np.minimum(self._speed * time, self._depth), 1.0)

    def _sum(self, of_nodes: np.ndarray) -> np.ndarray:
        return np.add.reduceat(of_nodes, self._first_node[:-1])
