"""What the surfaces of the scene do to one elastic body, as its implicit solve sees it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from plait.solver.contact.obstacle_force_kernels import (
    evaluate_pushes,
    hold_forces,
    leave_planes,
    strike,
    tet_kernels,
)
from plait.solver.contact.obstacle_search_kernels import SLOTS, find_obstacle_planes

if TYPE_CHECKING:
    from plait.solver.contact.obstacles import Obstacles
    from plait.solver.contact.yielding import Yielding

# Solves in a substep, at most; fewer when no force changes by more than this part of the largest pressure, or than
# would move its plane by this part of the distance kept from a surface.
MAX_ROUNDS = 8
OF_PRESSURE = 0.02
LASTING = 1e-3
# [m/s] Surfaces met more slowly than this are not struck: what a bounce at half that speed rises is not seen.
IMPACT_SPEED = 0.1
# Cost of a point in units of `Launcher.launch`.
SEARCH_WORK, FORCE_WORK = 40, 20


class ObstacleForces:
    """Contact of one body's particles with surfaces, as energy, forces and stiffness of the tets they lie in.

    active: (active_count,) int32, the particles that have planes, in the order of their tets.
    rounds: how often the body has been solved with them in this substep.
    slots: of all planes, those of the body's particles.
    holds: whether the body stays where it is, with the planes that it had.
    """

    def __init__(self, obstacles: Obstacles, body: int) -> None:
        self._shared, self._launcher = obstacles, obstacles.launcher
        particles = obstacles.particles
        self._first, self._count = int(particles.first[body]), int(np.diff(particles.first)[body])
        own = slice(self._first, self._first + self._count)
        self._tet = particles.tet[own] - particles.layout.first_tet[body]
        self._weights = particles.weights[own]
        self._kernels = tet_kernels(obstacles.real)
        self._inertia = 0.0  # [1/s2] over the square of the reach
        self.slots = slice(self._first * int(SLOTS), (self._first + self._count) * int(SLOTS))
        self.holds = False
        self.yielding: Yielding | None = None
        if obstacles.carriers is not None:
            from plait.solver.contact.yielding import Yielding

            self.yielding = Yielding(obstacles, body)
        self._forget()

    @property
    def count(self) -> int:
        return len(self.active)

    # -- for the solve of the body -------------------------------------------------------------------------

    def energy(self, position: wp.array) -> float:
        """[J] with the nodes, (node_count,) vec3d [m], at `position`."""
        self._evaluate(position)
        of_rigid = self.yielding.energy() if self.gives_way else 0.0
        return float(self._energy.numpy().sum()) + of_rigid

    def add_forces(self, position: wp.array, tet_force: wp.array) -> None:
        """Adds the forces [N] at `position` to those on corner a of the body's tet t at 4 t + a."""
        self._evaluate(position)
        inputs = [self._tets, self._first_point, self._weight, self._force]
        self._launcher.launch(self._kernels.add_forces, len(self._tets), inputs, [tet_force])

    def add_stiffness(self, tet_block: wp.array) -> None:
        """Adds the stiffness [N/m], where forces were last asked for, to pair k of tet t at 10 t + k.

        Positive semi-definite; pairs as in `tets.elements.PAIRS`.
        """
        inputs = [self._tets, self._first_point, self._weight, self._stiffness]
        self._launcher.launch(self._kernels.add_stiffness, len(self._tets), inputs, [tet_block])

    @property
    def gives_way(self) -> bool:
        """Whether a rigid body holds one of the planes."""
        return self.yielding is not None and self.yielding.count > 0

    # -- a substep -----------------------------------------------------------------------------------------

    def examine(self, start: wp.array, position: wp.array, *, anew: bool = False) -> None:
        """Finds the planes met between `start` and `position`; `anew` forgets those found before."""
        shared = self._shared
        moving = [shared.surfaces, shared.travel, shared.points, start, position, shared.exit_distance]
        inputs = [self._first, int(anew), *moving, shared.before]
        self._launcher.launch(
            find_obstacle_planes, self._count, inputs, [shared.planes], work_per_item=SEARCH_WORK
        )
        held = shared.planes.surface.numpy()[self.slots].reshape(-1, int(SLOTS))
        self._take(np.flatnonzero((held >= 0).any(axis=1)))
        self.holds = False

    def hold(self) -> None:
        """The body stays where it is in this substep: nothing is asked for."""
        self._forget()
        self.holds = True

    def meets(self, surfaces: np.ndarray, *, before: bool = False) -> bool:
        """Whether any of these, by index into `Scene.surfaces`, is in reach, or was in the substep before."""
        planes = self._shared.before if before else self._shared.planes
        return len(surfaces) > 0 and bool(np.isin(planes.surface.numpy()[self.slots], surfaces).any())

    def pushes(self, position: wp.array, reach: float) -> bool:
        """Whether any force acts at `position`; makes ready for a solve.

        reach: [s] the nodes' displacement over their change of velocity, in that solve.
        """
        self._inertia, self.rounds = 1.0 / reach**2, 0
        if not self.count:
            return False
        self._evaluate(position)
        return bool(np.any(self._force.numpy()))

    def strikes(self, position: wp.array) -> bool:
        """Whether a surface that did not push before does at `position`: an impact, not lasting contact.

        Where the body is elastic in impacts, it is from then on asked to leave such surfaces.
        """
        struck = wp.zeros(self.count, dtype=wp.int32, device=self._launcher.device)
        approach = IMPACT_SPEED * self._shared.length
        inputs = [self.active, self._shared.points, self._shared.restitution, position, approach]
        self._launcher.launch(strike, self.count, inputs, [self._shared.planes, struck])
        return bool(struck.numpy().any())

    def alternate(self, start: wp.array, position: wp.array, solve: Callable[[], bool]) -> bool:
        """Solves, holds the forces found, looks for planes met on the way, again until the forces last.

        solve: moves the body from `position`, in place, to where forces that change as these do take it, and says
        whether it converged. Returns whether the last did.
        """
        if self.gives_way:
            self.yielding.take(self.slots)
        for _ in range(MAX_ROUNDS):
            converged = solve()
            self.rounds += 1
            planes, lasts = self.count, self._hold(position)
            self.examine(start, position)
            if lasts and self.count == planes:
                break
        return converged

    def total(self, base: wp.array) -> tuple[np.ndarray, np.ndarray]:
        """(3,) [N], (3,) [N m] about the origin, of the forces held, acting at `base`, (node_count,) vec3d [m]."""
        planes, slots = self._shared.planes, self.slots
        held = planes.surface.numpy()[slots] >= 0
        forces = planes.normal.numpy()[slots] * planes.pressure.numpy()[slots][:, None]
        forces = (forces + planes.traction.numpy()[slots])[held]
        places = self._shared.particles.evaluate_positions(base).numpy()
        places = np.repeat(places[self._first :][: self._count], int(SLOTS), axis=0)[held]
        return forces.sum(axis=0), np.cross(places, forces).sum(axis=0)

    def leave(self, position: wp.array) -> float:
        """Notes for the next substep how planes have been left; how deep [m] the deepest particle is."""
        if not self.count:
            return 0.0
        deepest = wp.empty(self.count, dtype=wp.float64, device=self._launcher.device)
        inputs = [self.active, self._shared.points, position]
        self._launcher.launch(leave_planes, self.count, inputs, [self._shared.planes, deepest])
        return float(deepest.numpy().max())

    def _hold(self, position: wp.array) -> bool:
        """Whether the forces at `position`, now held, are those held before."""
        if not self.count:
            return True
        if self.gives_way:
            self.yielding.settle(position, self._inertia)
        change, pressure = (wp.empty(self.count, dtype=wp.float64, device=self._launcher.device) for _ in range(2))
        inputs = [self.active, self._shared.points, self._shared.planes, self._inertia, position]
        self._launcher.launch(hold_forces, self.count, inputs, [change, pressure], work_per_item=FORCE_WORK)
        return float(change.numpy().max()) <= max(LASTING, OF_PRESSURE * float(pressure.numpy().max()))

    def _evaluate(self, position: wp.array) -> None:
        if self.gives_way:
            self.yielding.settle(position, self._inertia)
        inputs = [self.active, self._shared.points, self._shared.planes, self._inertia, position]
        outputs = [self._energy, self._force, self._stiffness]
        self._launcher.launch(evaluate_pushes, self.count, inputs, outputs, work_per_item=FORCE_WORK)

    def _forget(self) -> None:
        self.rounds = 0
        self._take(np.zeros(0, dtype=np.int64))

    def _take(self, own: np.ndarray) -> None:
        """Makes these of the body's particles the active ones."""
        device = self._launcher.device
        own = own[np.argsort(self._tet[own], kind="stable")]
        tets, first = np.unique(self._tet[own], return_index=True)

        def hold(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        self.active = hold(own + self._first, wp.int32)
        self._tets, self._first_point = hold(tets, wp.int32), hold(np.append(first, len(own)), wp.int32)
        self._weight = hold(self._weights[own], wp.vec4d)
        self._energy = wp.zeros(len(own), dtype=wp.float64, device=device)
        self._force = wp.zeros(len(own), dtype=wp.vec3d, device=device)
        self._stiffness = wp.zeros(len(own), dtype=wp.mat33d, device=device)
        if self.yielding is not None:
            self.yielding.take(self.slots)
