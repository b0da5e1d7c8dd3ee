"""The blocks of cells and nodes that particles reach, and the particles' order in them."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.granular.order_kernels import CHUNK, bound, find_keys, reorder
from plait.solver.granular.types import BLOCK, BLOCK_NODES, TILE, TILE_NODES, granular_types, rows_of
from plait.solver.launch import Launcher

CORNERS = np.indices((2, 2, 2)).reshape(3, -1).T
# Where the eight blocks of nodes start in a tile.
IN_TILE = (CORNERS * BLOCK) @ np.array([TILE * TILE, TILE, 1])
# What must grow grows by this more than asked, so that it seldom has to.
SLACK = 1.1
WORD = 4  # bytes
# Costs of a particle in units of `Launcher.launch`.
KEY_WORK, REORDER_WORK = 1, 1


class BlockGrid:
    """Nodes `cell_size` [m] apart, in blocks of 4 x 4 x 4, where particles are: cost and memory follow these.

    data: struct `Blocks`.  block_count: of cells.  node_block_count: of nodes.
    tile: rows of nodes, TILE_NODES for each block: what its particles add up to, and room to work in.
    tile_nodes: the same, (block_count * TILE_NODES,) vec4.
    node: (node_block_count * 64 or more,) vec4, momentum [kg m/s] and mass [kg].
    velocity: the same, velocity [m/s] and mass.  node_rows, velocity_rows: both seen as rows of nodes.
    """

    def __init__(self, cell_size: float, real: type, launcher: Launcher) -> None:
        self.cell_size, self._launcher, self._types = cell_size, launcher, granular_types(real)
        self.data = self._types.Blocks()
        self.block_count = self.node_block_count = 0
        device = launcher.device
        self._order = wp.zeros(0, dtype=wp.int32, device=device)
        self._room = wp.zeros(0, dtype=wp.uint8, device=device)
        self._hold_nodes(0)

    def sort(self, particles: object, count: int) -> None:
        """Puts the first `count` of a struct `Particles` in cell order, stably, and finds their blocks."""
        shape, lower, blocks = self._find_order(particles.position, count)
        first = np.flatnonzero(np.diff(blocks, prepend=-1))
        at = np.stack(np.unravel_index(blocks[first], shape), axis=1)
        self._lay_out(at, lower, np.append(first, count))
        for name in self._types.Particles.vars:
            self._reorder(getattr(particles, name), count)
        self.tile_nodes = self._take_room(self._types.vec4, self.block_count * TILE_NODES)
        self.tile = rows_of(self.tile_nodes, self._types.row)

    def node_cells(self, nodes: np.ndarray) -> np.ndarray:
        """(n, 3) int [cells] where `nodes` (n,) of `node` are."""
        block, local = np.divmod(nodes, BLOCK_NODES)
        return self.data.node_origin.numpy()[block] + np.stack(np.unravel_index(local, (BLOCK,) * 3), axis=1)

    def node_positions(self) -> np.ndarray:
        """(node_block_count * 64, 3) float64 [m]."""
        return self.node_cells(np.arange(self.node_block_count * BLOCK_NODES)) * self.cell_size

    def find_nodes(self, cells: np.ndarray) -> np.ndarray:
        """(n,) where in `node` the nodes at (n, 3) int [cells] are; -1 for those that no particle reaches."""
        origin = self.data.node_origin.numpy()[: self.node_block_count].astype(np.int64)
        lower = origin.min(axis=0)
        at = (origin - lower) // BLOCK
        shape = at.max(axis=0) + 1
        block, local = np.divmod(cells - lower, BLOCK)
        inside = ((block >= 0) & (block < shape)).all(axis=1)
        keys = np.ravel_multi_index(at.T, shape)
        wanted = np.ravel_multi_index(np.where(inside[:, None], block, 0).T, shape)
        order = np.argsort(keys)
        slot = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)]
        found = inside & (keys[slot] == wanted)
        return np.where(found, slot * BLOCK_NODES + np.ravel_multi_index(local.T, (BLOCK,) * 3), -1)

    @property
    def bytes(self) -> int:
        """What the grid and the sorting hold in memory."""
        data = (self.data.first, self.data.corner, self.data.source, self.data.origin, self.data.node_origin)
        return sum(array.capacity for array in (self._order, self._room, self.node, self.velocity, *data))

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(3,), (3,) [m] of all nodes that the particles reach until they are sorted again."""
        origin = self.data.node_origin.numpy()
        return origin.min(axis=0) * self.cell_size, (origin.max(axis=0) + BLOCK - 1) * self.cell_size

    def _find_order(self, position: wp.array, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fills `_order`. The box of blocks: its shape and first cell; and each particle's block in it, sorted."""
        launch, device, cells = self._launcher.launch, self._launcher.device, 1.0 / self.cell_size
        chunks = -(-count // int(CHUNK))
        bounds = [wp.zeros(chunks, dtype=wp.vec3i, device=device) for _ in range(2)]
        launch(bound, chunks, [position, count, cells], bounds, work_per_item=int(CHUNK))
        lower = bounds[0].numpy().min(axis=0).astype(np.int64) // BLOCK * BLOCK
        shape = (bounds[1].numpy().max(axis=0) - lower) // BLOCK + 1
        if len(self._order) < 2 * count:
            self._order = wp.zeros(int(2 * SLACK * count), dtype=wp.int32, device=device)
        keys = self._take_room(wp.int64, 2 * count)
        inputs = [position, cells, wp.vec3i(*lower.tolist()), wp.vec3i(*shape.tolist())]
        launch(find_keys, count, inputs, [keys, self._order], work_per_item=KEY_WORK)
        bits = int(np.prod(shape, dtype=object) * BLOCK_NODES).bit_length()
        wp.utils.radix_sort_pairs(keys, self._order, count, end_bit=bits)
        return shape, lower, keys.numpy()[:count] // BLOCK_NODES

    def _reorder(self, values: wp.array, count: int) -> None:
        words = wp.types.type_size_in_bytes(values.dtype) // WORD
        held = wp.array(ptr=values.ptr, dtype=wp.int32, shape=count * words, device=values.device)
        moved = self._take_room(wp.int32, count * words)
        inputs = [self._order, words, held]
        self._launcher.launch(reorder, count, inputs, [moved], work_per_item=REORDER_WORK)
        wp.copy(held, moved)

    def _lay_out(self, at: np.ndarray, lower: np.ndarray, first: np.ndarray) -> None:
        """Fills `data` for blocks of cells `at` (block_count, 3), whose particles start at `first`."""
        self.block_count, data = len(at), self.data
        shape = at.max(axis=0) + 2
        reached = np.ravel_multi_index((at[:, None] + CORNERS).transpose(2, 0, 1), shape)
        nodes, corner = np.unique(reached, return_inverse=True)
        corner = corner.reshape(-1, 8)
        self.node_block_count = len(nodes)
        source = np.full((len(nodes), 8), -1)
        source[corner, np.arange(8)] = np.arange(len(at))[:, None] * TILE_NODES + IN_TILE
        device = self._launcher.device

        def hold(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values.astype(np.int32), dtype=dtype, device=device)

        data.first, data.corner, data.source = (hold(x, wp.int32) for x in (first, corner, source))
        data.origin = hold(lower + at * BLOCK - 1, wp.vec3i)
        node_at = np.stack(np.unravel_index(nodes, shape), axis=1)
        data.node_origin = hold(lower + node_at * BLOCK - 1, wp.vec3i)
        if len(self.node) < len(nodes) * BLOCK_NODES:
            self._hold_nodes(int(SLACK * len(nodes)) * BLOCK_NODES)

    def _hold_nodes(self, count: int) -> None:
        vec4, row, device = self._types.vec4, self._types.row, self._launcher.device
        self.node, self.velocity = (wp.zeros(count, dtype=vec4, device=device) for _ in range(2))
        self.node_rows, self.velocity_rows = (rows_of(nodes, row) for nodes in (self.node, self.velocity))

    def _take_room(self, dtype: type, count: int) -> wp.array:
        """An array on memory that sorting and tiles share, as they are never needed at once."""
        asked = count * wp.types.type_size_in_bytes(dtype)
        if len(self._room) < asked:
            self._room = wp.zeros(int(SLACK * asked), dtype=wp.uint8, device=self._launcher.device)
        return wp.array(ptr=self._room.ptr, dtype=dtype, shape=count, device=self._launcher.device)
