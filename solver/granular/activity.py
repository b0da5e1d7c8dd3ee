"""Which blocks take part in a step: what is at rest and out of reach of all that moves sleeps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from plait.solver.granular.block_grid import BlockGrid
from plait.solver.granular.types import TILE, TILE_NODES


class Activity:
    """Blocks by what they do in a step, for the particles' present order.

    A block is awake unless all of it has been at rest for long. Awake blocks and those beside them gather: their
    particles move and deform. These and those beside them scatter, so that every node that one gathers from has
    all its momentum and mass. What is further away sleeps: nothing that it would change is looked at.

    scatters, gathers: (n,) int32 into the blocks of cells.  nodes: (n,) int32 into the blocks of nodes.
    stopped: (n,) int32 blocks of cells that have just fallen asleep.
    """

    def __init__(self, grid: BlockGrid) -> None:
        self._grid = grid
        self._awake: np.ndarray | None = None

    def forget(self) -> None:
        """Particles have been sorted: blocks are others."""
        self._awake, self._gathers = None, np.ones(self._grid.block_count, dtype=bool)

    def choose(self, awake: np.ndarray) -> bool:
        """Fills the lists; awake: (block_count,) bool. Whether they have changed."""
        if self._awake is not None and np.array_equal(awake, self._awake):
            return False
        self._awake, grid = awake.copy(), self._grid
        if awake.all():
            self.scatters = self.gathers = self._hold(np.arange(grid.block_count))
            self.nodes, self.stopped = self.every_node(), self._hold(np.zeros(0))
            self._gathers = awake.copy()
            return True
        corner, source = grid.data.corner.numpy(), grid.data.source.numpy()[: grid.node_block_count]
        gathers = _beside(awake, corner, source)
        nodes = np.unique(corner[gathers])
        self.gathers, self.nodes = self._hold(np.flatnonzero(gathers)), self._hold(nodes)
        self.scatters = self._hold(np.flatnonzero(_beside(gathers, corner, source)))
        self.stopped, self._gathers = self._hold(np.flatnonzero(self._gathers & ~gathers)), gathers
        # Contact finds no matter where none is told.
        grid.velocity.zero_()
        return True

    def every_node(self) -> wp.array:
        """(node_block_count,) `nodes` if nothing slept."""
        return self._hold(np.arange(self._grid.node_block_count))

    def _hold(self, values: np.ndarray) -> wp.array:
        return wp.array(values.astype(np.int32), dtype=wp.int32, device=self._grid.velocity.device)

    def within(self, boxes: Sequence[np.ndarray]) -> np.ndarray:
        """(block_count,) bool: whether a block's nodes reach into one of the boxes (2, 3) [m]."""
        grid = self._grid
        origin = grid.data.origin.numpy() * grid.cell_size
        reached = np.zeros(len(origin), dtype=bool)
        for box in boxes:
            reached |= ((origin <= box[1]) & (origin + TILE * grid.cell_size >= box[0])).all(axis=1)
        return reached


def _beside(blocks: np.ndarray, corner: np.ndarray, source: np.ndarray) -> np.ndarray:
    """(block_count,) bool: the blocks (block_count,) bool, and all that share nodes with them."""
    tiles = source[np.unique(corner[blocks])]
    reached = np.zeros(len(blocks), dtype=bool)
    reached[tiles[tiles >= 0] // TILE_NODES] = True
    return reached
