"""Grains among strands: host side."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.granular.matter import Matter
from plait.solver.granular.near_surfaces import NearSurfaces
from plait.solver.granular.strand_exchange_kernels import (
    Meetings,
    Strands,
    collect,
    find_normals,
    present_velocities,
    strand_exchange_kernels,
)
from plait.solver.grid.sparse_grid import SparseGrid
from plait.solver.model import Interval, Model
from plait.solver.state import State

# Strands may go so far [cells] before nodes in contact are found again.
DRIFT = 0.5
# Costs in units of `Launcher.launch`.
NORMAL_WORK, PRESENT_WORK, EXCHANGE_WORK, COLLECT_WORK = 40, 2, 3, 20


def build(model: Model, state: State, matter: Matter, surfaces: NearSurfaces | None, real: type) -> StrandExchange:
    return StrandExchange(model, matter, real)


class StrandExchange:
    """An `Exchange` with strands, through a grid of their own with the same nodes: the two phases share none.

    What comes against strands pushes them, what goes away from them is let go; within a mass of strands, which has
    no side, grains are taken along. They give way as their mass alone, whatever holds them: hair is so light that
    an impulse that its roots were to bear would throw it far where they turn out not to.
    """

    def __init__(self, model: Model, matter: Matter, real: type) -> None:
        self._launcher, self._matter, self._stage = model.launcher, matter, model.parts["strands"]
        self._kernel, layout = strand_exchange_kernels(real).exchange, self._stage.layout
        self._grid = SparseGrid(matter.grid.cell_size, model.launcher)
        self._strands = strands = Strands()
        strands.inverse_mass, strands.velocity = self._stage.pushes.inverse_mass, self._stage.velocity
        strands.given = wp.zeros(layout.node_count, dtype=wp.vec3d, device=self._launcher.device)
        # What is held moves with the skin it grows on, which grains meet for itself.
        self._gives_way = strands.inverse_mass.numpy() > 0.0
        self._mass, self._friction = layout.mass, layout.friction[layout.node_strand]
        self.speed = self._found_at = 0.0
        self.begin_frame()

    def begin_frame(self) -> None:
        self._count = 0

    def begin_substep(self, substep: Interval) -> None:
        self._length = substep.length
        self._strands.given.zero_()
        self.find(0.0)
        velocity = self._stage.velocity.numpy()
        self.speed = float(np.abs(velocity[self._chosen]).max(initial=0.0))

    def _place(self, since: float) -> None:
        """Where the strands' nodes are so long [s] after the substep's start."""
        velocity = self._stage.velocity.numpy()
        self._position = self._stage.position.numpy() - (self._length - since) * velocity

    def _near(self, margin: float) -> np.ndarray:
        """(n,) nodes that give way within `margin` [m] of the grains."""
        lower, upper = self._matter.grid.bounds()
        x = self._position
        return np.flatnonzero(((x >= lower - margin) & (x <= upper + margin)).all(axis=1) & self._gives_way)

    def find(self, since: float) -> None:
        self._place(since)
        self._found_at, self._count = since, 0
        grains, grid, strands, device = self._matter.grid, self._grid, self._strands, self._launcher.device
        self._chosen = chosen = self._near(grains.cell_size)
        if not len(chosen):
            return
        grid.place(self._position[chosen])
        strands.node = wp.array(chosen, dtype=wp.int32, device=device)
        strands.mass = wp.array(self._mass[chosen], dtype=wp.float64, device=device)
        strands.friction = wp.array(self._friction[chosen], dtype=wp.float64, device=device)
        self._velocity = wp.zeros(len(chosen), dtype=wp.vec3d, device=device)
        grid.to_grid(strands.mass, self._velocity)
        of_grains = grains.find_nodes(np.rint(grid.node_positions() / grid.cell_size).astype(np.int64))
        both = np.flatnonzero((of_grains >= 0) & (grid.mass.numpy() > 0.0))
        self._count, self._node_count = len(both), len(chosen)
        meetings = Meetings()
        meetings.of_strands = wp.array(both, dtype=wp.int32, device=device)
        meetings.of_grains = wp.array(of_grains[both], dtype=wp.int32, device=device)
        meetings.normal = wp.zeros(len(both), dtype=wp.vec3d, device=device)
        meetings.friction = wp.zeros(len(both), dtype=wp.float64, device=device)
        inputs = [grid.data, strands, meetings]
        self._launcher.launch(find_normals, len(both), inputs, work_per_item=NORMAL_WORK)
        self._meetings, self._change = meetings, wp.zeros(grid.node_count, dtype=wp.vec3d, device=device)

    def act(self, moment: wp.array, passes: int) -> None:
        """In one pass: a node's strands and grains meet nowhere else."""
        since = float(moment.numpy()["since"][0])
        if (since - self._found_at) * self.speed > DRIFT * self._grid.cell_size:
            self.find(since)
        if not self._count:
            return
        grid, launch, strands = self._grid, self._launcher.launch, self._strands
        launch(present_velocities, self._node_count, [strands], [self._velocity], work_per_item=PRESENT_WORK)
        grid.to_grid(strands.mass, self._velocity)
        inputs = [self._meetings, grid.mass, grid.velocity]
        outputs = [self._matter.grid.velocity, self._change]
        launch(self._kernel, self._count, inputs, outputs, work_per_item=EXCHANGE_WORK)
        inputs = [grid.data, strands, self._change]
        launch(collect, self._node_count, inputs, work_per_item=COLLECT_WORK)

    def end_substep(self) -> None:
        given, pushes = self._strands.given.numpy(), self._stage.pushes
        if given.any():
            pushes.impulse.assign(pushes.impulse.numpy() + given)
