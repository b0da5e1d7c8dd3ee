"""A grid that exists only where particles are."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.grid.transfer_kernels import BLOCK, BLOCK_NODES, Grid, from_grid, to_grid, to_grid_affine
from plait.solver.launch import Launcher

# Blocks are numbered by 21 bits a direction, from the middle.
BITS = 21
CORNERS = np.indices((2, 2, 2)).reshape(3, -1).T
# Cost of a node and of a particle, in units of `Launcher.launch`.
NODE_WORK, AFFINE_WORK, PARTICLE_WORK = 20, 30, 20


class SparseGrid:
    """Nodes `cell_size` [m] apart, in blocks of 4 x 4 x 4; the active ones, in sorted order, are kept.

    What it holds and what it costs follow the particles, wherever in space they are.

    data: struct `Grid`.
    node_count: of the active blocks.  particle_count: as last placed.
    mass: (node_count,) float64 [kg] and velocity: vec3d [m/s], by `to_grid`.
    """

    def __init__(self, cell_size: float, launcher: Launcher) -> None:
        self.cell_size, self._launcher = cell_size, launcher
        self.node_count = self.particle_count = 0

    def place(self, position: np.ndarray) -> None:
        """Activates the blocks that the stencils of particles at (particle_count, 3) [m] reach."""
        cells = position / self.cell_size
        base = np.floor(cells - 0.5).astype(np.int64)
        first, last = base // BLOCK, (base + 2) // BLOCK
        keys = [_key(np.where(corner, last, first)) for corner in CORNERS]
        blocks = np.unique(np.concatenate(keys))
        at = _unkey(blocks)
        slot = np.searchsorted(blocks, _key(first))
        local = base - first * BLOCK
        node = slot * BLOCK_NODES + (local[:, 0] * BLOCK + local[:, 1]) * BLOCK + local[:, 2]
        self.node_count = len(blocks) * BLOCK_NODES
        self.particle_count = len(position)

        def hold(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=self._launcher.device)

        def neighbours(direction: int) -> wp.array:
            wanted = _key(at[:, None] + direction * CORNERS)
            found = np.minimum(np.searchsorted(blocks, wanted), len(blocks) - 1)
            return wp.array(
                np.where(blocks[found] == wanted, found, -1), dtype=wp.int32, device=self._launcher.device
            )

        grid = Grid()
        grid.after, grid.before = neighbours(1), neighbours(-1)
        grid.base, grid.offset = hold(node, wp.int32), hold(cells - base, wp.vec3d)
        counts = np.bincount(node, minlength=self.node_count)
        grid.cell_first = hold(np.concatenate([[0], np.cumsum(counts)]), wp.int32)
        grid.particles = hold(np.argsort(node, kind="stable"), wp.int32)
        self.data = grid
        self.mass = wp.zeros(self.node_count, dtype=wp.float64, device=self._launcher.device)
        self.velocity = wp.zeros(self.node_count, dtype=wp.vec3d, device=self._launcher.device)
        self._blocks = at

    def node_positions(self) -> np.ndarray:
        """(node_count, 3) float64 [m]."""
        nodes = self._blocks[:, None] * BLOCK + np.indices((BLOCK,) * 3).reshape(3, -1).T
        return nodes.reshape(-1, 3) * self.cell_size

    def reached_blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of particles (n,) and slots (n,) of blocks that these particles' stencils reach."""
        base, after = self.data.base.numpy(), self.data.after.numpy()
        local = base[:, None] // [BLOCK * BLOCK, BLOCK, 1] % BLOCK
        reaches = (CORNERS <= (local + 2)[:, None] // BLOCK).all(axis=2)
        particle, corner = np.nonzero(reaches)
        return particle, after[base[particle] // BLOCK_NODES, corner]

    def to_grid(self, mass: wp.array, velocity: wp.array) -> None:
        """Fills `mass` and `velocity` from the particles': (particle_count,) float64 [kg], vec3d [m/s]."""
        inputs = [self.data, mass, velocity]
        outputs = [self.mass, self.velocity]
        self._launcher.launch(to_grid, self.node_count, inputs, outputs, work_per_item=NODE_WORK)

    def to_grid_affine(self, mass: wp.array, velocity: wp.array, affine: wp.array) -> None:
        """As `to_grid`, for particles that carry v_q + C_q (x - x_q), with C in `affine`, mat33d [1/s]."""
        inputs = [self.data, self.cell_size, mass, velocity, affine]
        outputs = [self.mass, self.velocity]
        self._launcher.launch(to_grid_affine, self.node_count, inputs, outputs, work_per_item=AFFINE_WORK)

    def from_grid(self, velocity_out: wp.array) -> None:
        """The grid's velocity at each particle, (particle_count,) vec3d [m/s]."""
        inputs = [self.data, self.velocity]
        launch = self._launcher.launch
        launch(from_grid, self.particle_count, inputs, [velocity_out], work_per_item=PARTICLE_WORK)


def _key(block: np.ndarray) -> np.ndarray:
    """One number for a block's place, (..., 3) -> (...,)."""
    shifted = block + (1 << (BITS - 1))
    return (shifted[..., 0] << (2 * BITS)) + (shifted[..., 1] << BITS) + shifted[..., 2]


def _unkey(key: np.ndarray) -> np.ndarray:
    mask = (1 << BITS) - 1
    return np.stack([key >> (2 * BITS), (key >> BITS) & mask, key & mask], axis=-1) - (1 << (BITS - 1))
