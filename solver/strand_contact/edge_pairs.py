"""Which edges of the strands may meet in a substep: host side of the broad phase."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.strand_contact.edge_box_kernels import Boxes, Edges, Motion, StrandBoxes, bound_strands
from plait.solver.strand_contact.edge_pair_kernels import (
    CHUNK,
    RUN,
    Columns,
    Entries,
    Entry,
    Partners,
    Search,
    count_entries,
    end_runs,
    find_furthest,
    find_seconds,
    gather_entries,
    list_partners,
    number_pairs,
    write_entries,
    write_incident,
    write_pairs,
)
from plait.solver.strands.layout import Layout

# A strand that turns by less than about a quarter of a circle between two edges does not bring them together.
STRAIGHT = 0.9
# The common motion is fitted to about so many nodes, evenly chosen.
SAMPLES = 256
# A common turn larger than this [rad] is left in: distances seen in the turning frame would widen much.
LARGEST_TURN = 1.0
# A column is so many mean boxes wide.
COLUMN = 2.0
# [m] What is near has some size, if only to divide by: all of it may be one point, or gone astray.
LEAST_SIZE = 1.0e-20
# No box spans more columns along a side, and no side has more, by `LAST_COLUMN`.
MAX_SPAN, MAX_COLUMNS = 32.0, 32000.0
# Bits of a key, which must stay positive: at most so many for the table of columns, and for the way along them.
KEY_BITS, LARGEST_TABLE_BITS, LARGEST_SWEEP_BITS = 31, 17, 20
# Partners an edge for which room is kept at first.
FIRST_ROOM = 8
# Where more than this part of the strands had pairs, all are looked at.
THICK = 0.5
# Comparisons of strands' boxes a strand, beyond which what has met none is taken as near.
ROUNDS = 64
# Costs in units of `Launcher.launch`.
BOUND_WORK, ENTER_WORK, RUN_WORK, SEARCH_WORK, NUMBER_WORK = 3, 3, 200, 15, 2


class EdgePairs:
    """Pairs of edges, a before b, that may come near each other while nodes move linearly from start to end.

    Every pair of edges that at any time of that motion is nearer than the sum of its reaches and rooms is found,
    and none that stays further apart however its ends move against each other, seen in a frame that moves with the
    strands; a common motion, however large, costs nothing. An edge's reach, and room, is its nodes' larger one.
    No pairs are:
    - edges next to each other in their strand, and those with less strand than reach_a + reach_b between them;
    - edges of one strand that stays nearly straight from the one to the other (`straight`);
    - edges whose four nodes are all prescribed.

    The results are those of the last `find`; the next one overwrites the arrays.

    count: pairs found.  pairs: (count,) vec2i, edges (a, b), sorted by a, then b.
    first: (node_count + 1,) int32 and incident: (2 count,) int32: the pairs of edge k are incident[i] // 2 for i
    from first[k] to first[k + 1] - 1, in the order of the other edge; incident[i] % 2 is k's side in the pair.
    first_pair: (node_count + 1,) int32: edge k is the first of pairs first_pair[k] to first_pair[k + 1] - 1.
    near: (strand_count,) bool, strands with any pair.
    """

    def __init__(
        self,
        launcher: Launcher,
        layout: Layout,
        reach: np.ndarray,
        prescribed: np.ndarray | None = None,
        straight: float = STRAIGHT,
        near_only: bool = True,
    ) -> None:
        """reach: (node_count,) [m] half distances: edges interact below the sum of theirs.

        prescribed: (node_count,) bool, nodes that nothing moves; None: ghosts and roots.
        straight: chord over drawn length, from the outer ends of two edges of a strand, from which on they are no
        pair; infinite: all are.
        near_only: without, all pairs whose swept boxes overlap.
        """
        self._launcher = launcher
        self._near_only = near_only
        self._first_node = layout.first_node
        self._node_count, self._strand_count = layout.node_count, layout.strand_count
        self._edges = self._hold_edges(layout, reach, prescribed)
        self._edges.straight = straight
        self._no_room = self._full(self._node_count, wp.float64)
        self._boxes, self._strand_boxes = Boxes(), StrandBoxes()
        for boxes, count in ((self._boxes, self._node_count), (self._strand_boxes, self._strand_count)):
            # Slots that are no edge keep an empty box.
            boxes.lower = self._full(count, wp.vec3f, 1.0)
            boxes.upper = self._full(count, wp.vec3f, -1.0)
        self._strand_boxes.extent = self._full(self._strand_count, wp.vec3f)
        self._strand_boxes.largest = self._full(self._strand_count, wp.vec3f)
        self._strand_boxes.meets_itself = self._full(self._strand_count, wp.int32)
        self._buffers: dict[str, wp.array] = {}
        chunks = -(-self._node_count // CHUNK)
        self._partners = Partners()
        self._partners.first = self._full(self._node_count, wp.int32)
        # One more than is written, 0, so that running sums end with the whole.
        self._partners.count = self._full(self._node_count + 1, wp.int32)
        self._partners.needed = self._full(chunks, wp.int32)
        self._room = np.full(chunks, CHUNK * FIRST_ROOM, dtype=np.int64)
        self.first = self._full(self._node_count + 1, wp.int32)
        self._first_entry = self._full(self._node_count + 1, wp.int32)
        self.first_pair = self._full(self._node_count + 1, wp.int32)
        self._first_second = self._full(self._node_count + 1, wp.int32)
        self._clear()

    def find(self, start: wp.array, end: wp.array, room: wp.array | None = None, least_room: float = 0.0) -> bool:
        """Finds the pairs of a motion; whether there are any. One launch if no strand is near another or itself.

        start, end: (node_count,) vec3d [m] world.  room: (node_count,) float64 [m], beyond the reaches,
        and no less than `least_room`.
        """
        near = self._bound(start, end, room, least_room)
        if not near.any():
            self._clear()
            return False
        search = self._prepare(start, end, near)
        self._list_partners(search)
        self.count = count = _scan(self._partners.count, self.first_pair)
        if count == 0:
            self._clear()
            return False
        self.pairs = self._buffer("pairs", wp.vec2i, count)[:count]
        inputs = [self._partners, self.first_pair]
        self._launcher.launch(write_pairs, self._node_count, inputs, [self.pairs], work_per_item=NUMBER_WORK)
        self._index()
        return True

    def find_again(
        self, start: wp.array, end: wp.array, room: wp.array, least_room: float, sought: np.ndarray
    ) -> bool:
        """The same where only edges flagged in `sought`, (node_count,) bool, have another end, or more room."""
        pairs = self.pairs.numpy()
        pairs = pairs[~sought[pairs].any(axis=1)].astype(np.int64)
        near = self._bound(start, end, room, least_room)
        if near.any():
            search = self._prepare(start, end, near)
            search.again = True
            search.sought = wp.array(sought.astype(np.int32), dtype=wp.int32, device=self._launcher.device)
            self._list_partners(search)
            pairs = np.concatenate([pairs, self._listed(np.flatnonzero(sought))])
            pairs = pairs[np.argsort(pairs[:, 0] * self._node_count + pairs[:, 1], kind="stable")]
        self.count = count = len(pairs)
        if count == 0:
            self._clear()
            return False
        self.pairs = self._buffer("pairs", wp.vec2i, count)[:count]
        self.pairs.assign(pairs.astype(np.int32))
        first = np.searchsorted(pairs[:, 0], np.arange(self._node_count + 1))
        self.first_pair.assign(first.astype(np.int32))
        self._index()
        return True

    def _bound(self, start: wp.array, end: wp.array, room: wp.array | None, least_room: float) -> np.ndarray:
        """Boxes of edges and strands; (strand_count,) bool, strands that take part in the search."""
        self._motion = motion = _common_motion(start, end)
        self._edges.room = self._no_room if room is None else room
        self._edges.least_room = least_room
        # In a thick of strands, the search itself is cheaper than asking which take part.
        asked = self.near.mean() < THICK
        inputs = [self._edges, start, end, motion, asked]
        work = BOUND_WORK * max(1, self._node_count // self._strand_count)
        self._launcher.launch(
            bound_strands, self._strand_count, inputs, [self._boxes, self._strand_boxes], work_per_item=work
        )
        return self._strands_in_reach() if asked else np.ones(self._strand_count, dtype=bool)

    def _prepare(self, start: wp.array, end: wp.array, near: np.ndarray) -> Search:
        """A search among the edges of strands that are `near`."""
        search = Search()
        search.edges, search.start, search.end, search.motion = self._edges, start, end, self._motion
        search.near_only, search.again = self._near_only, False
        search.entries, search.node_count = self._enter(self._lay_columns(near), near), self._node_count
        return search

    # -- which strands -------------------------------------------------------------------------------------

    def _strands_in_reach(self) -> np.ndarray:
        """(strand_count,) bool: whose box meets another's, or who may meet themselves."""
        lower, upper = self._strand_boxes.lower.numpy(), self._strand_boxes.upper.numpy()
        near = self._strand_boxes.meets_itself.numpy() > 0
        axis = int(np.argmax(np.ptp(lower, axis=0)))
        order = np.argsort(lower[:, axis], kind="stable")
        lower, upper = lower[order], upper[order]
        met = near[order]
        left = np.arange(self._strand_count)
        for step in range(1, min(ROUNDS, self._strand_count) + 1):
            left = left[left + step < self._strand_count]
            left = left[upper[left, axis] >= lower[left + step, axis]]
            if len(left) == 0:
                break
            asked = left[~(met[left] & met[left + step])]
            meets = np.all((lower[asked] <= upper[asked + step]) & (lower[asked + step] <= upper[asked]), axis=1)
            met[asked[meets]] = met[asked[meets] + step] = True
        # Those with more in their way along the axis than was looked at are taken as near, and so is all of that.
        for strand in left:
            met[strand : np.searchsorted(lower[:, axis], upper[strand, axis], side="right")] = True
        near[order] = met
        return near

    # -- the search ----------------------------------------------------------------------------------------

    def _lay_columns(self, near: np.ndarray) -> Columns:
        """Columns across the longest side of what is near, about two boxes wide."""
        boxes = self._strand_boxes
        lower = boxes.lower.numpy()[near].min(axis=0)
        size = np.maximum(boxes.upper.numpy()[near].max(axis=0) - lower, LEAST_SIZE)
        edge_count = (np.diff(self._first_node) - 2)[near].sum()
        mean = boxes.extent.numpy()[near].sum(axis=0, dtype=float) / edge_count
        largest = boxes.largest.numpy()[near].max(axis=0)
        sweep = int(np.argmax(size))
        across = [axis for axis in range(3) if axis != sweep]
        width = np.maximum(COLUMN * mean, np.maximum(largest / MAX_SPAN, size / MAX_COLUMNS))[across]
        bits = np.ceil(np.log2(size[across] / width + 1.0)).astype(int)
        while bits.sum() > LARGEST_TABLE_BITS:
            bits[np.argmax(bits)] -= 1
        columns = Columns()
        columns.across, columns.sweep = wp.vec2i(*across), sweep
        columns.origin = wp.vec3f(*(float(x) for x in lower))
        columns.per_column = wp.vec2f(*(float(1.0 / w) for w in width))
        columns.bits = wp.vec2i(*(int(b) for b in bits))
        columns.sweep_bits = min(LARGEST_SWEEP_BITS, KEY_BITS - int(bits.sum()))
        columns.per_step = float(2.0**columns.sweep_bits / size[sweep])
        return columns

    def _enter(self, columns: Columns, near: np.ndarray) -> Entries:
        """The edges of strands that are near, in their columns, sorted."""
        launch, nodes = self._launcher.launch, self._node_count
        flags = wp.array(near.astype(np.int32), dtype=wp.int32, device=self._launcher.device)
        inputs = [columns, self._edges.strand, flags, self._boxes]
        counts = self._partners.count
        launch(count_entries, nodes, inputs, [counts], work_per_item=ENTER_WORK)
        entries = Entries()
        entries.first = self._first_entry
        entries.count = count = _scan(counts, self._first_entry)
        entries.key = self._buffer("key", wp.int32, 2 * count)  # sorting takes twice the room
        entries.entry = self._buffer("sorted", Entry, count)
        entries.furthest = self._buffer("furthest", wp.int32, count)
        entries.place = self._buffer("place", wp.int32, count)
        number, entry = self._buffer("number", wp.int32, 2 * count), self._buffer("entry", Entry, count)
        inputs = [columns, self._boxes, self._first_entry]
        launch(write_entries, nodes, inputs, [entries.key, number, entry], work_per_item=ENTER_WORK)
        wp.utils.radix_sort_pairs(entries.key, number, count)
        launch(gather_entries, count, [number, entry], [entries], work_per_item=ENTER_WORK)
        runs = -(-count // RUN)
        last = self._buffer("last", wp.int32, runs)
        launch(end_runs, runs, [count, entries.entry], [last], work_per_item=RUN_WORK)
        launch(find_furthest, runs, [count, entries.entry, last], [entries.furthest], work_per_item=RUN_WORK)
        return entries

    def _list_partners(self, search: Search) -> None:
        """Every edge's partners into the room kept for its chunk, which grows where it was too small."""
        partners, chunks = self._partners, len(self._room)
        while True:
            room = np.concatenate([[0], np.cumsum(self._room)])
            partners.room = wp.array(room, dtype=wp.int32, device=self._launcher.device)
            partners.edge = self._buffer("partner", wp.int32, int(room[-1]))
            self._launcher.launch(list_partners, chunks, [search], [partners], work_per_item=CHUNK * SEARCH_WORK)
            needed = partners.needed.numpy()
            short = needed > self._room
            if not short.any():
                return
            self._room[short] = needed[short] + needed[short] // 2

    def _listed(self, edges: np.ndarray) -> np.ndarray:
        """(n, 2) int64, the pairs of `edges` with the partners that they list, the lower edge first."""
        first, count = self._partners.first.numpy()[edges], self._partners.count.numpy()[edges]
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        partners = self._partners.edge.numpy()[np.repeat(first, count) + within]
        return np.sort(np.stack([np.repeat(edges, count), partners], axis=1), axis=1)

    def _index(self) -> None:
        """Gives the pairs to both their edges."""
        launch, nodes, count = self._launcher.launch, self._node_count, self.count
        self.incident = self._buffer("incident", wp.int32, 2 * count)[: 2 * count]
        # Sorting takes twice the room.
        second, number = (self._buffer(name, wp.int32, 2 * count) for name in ("second", "number"))
        launch(number_pairs, count, [self.pairs], [second, number])
        wp.utils.radix_sort_pairs(second, number, count)
        launch(find_seconds, count + 1, [count, second], [self._first_second])
        inputs, outputs = [self.first_pair, self._first_second, number], [self.first, self.incident]
        launch(write_incident, nodes, inputs, outputs, work_per_item=NUMBER_WORK)
        first = self.first.numpy()[self._first_node]
        self.near = first[1:] > first[:-1]

    # -- memory --------------------------------------------------------------------------------------------

    def _clear(self) -> None:
        """Nothing found."""
        self.count = 0
        self.pairs = self._full(0, wp.vec2i)
        self.incident = self._full(0, wp.int32)
        self.first.zero_()
        self.first_pair.zero_()
        self.near = np.zeros(self._strand_count, dtype=bool)

    def _hold_edges(self, layout: Layout, reach: np.ndarray, prescribed: np.ndarray | None) -> Edges:
        device = self._launcher.device
        if prescribed is None:
            prescribed = np.zeros(self._node_count, dtype=bool)
            prescribed[layout.first_node[:-1]] = prescribed[layout.first_node[:-1] + 1] = True
        both, larger = prescribed.copy(), np.array(reach, dtype=float)
        both[:-1] &= prescribed[1:]
        larger[:-1] = np.maximum(larger[:-1], reach[1:])
        along = np.concatenate([[0.0], np.cumsum(layout.edge_length)[:-1]])
        edges = Edges()
        edges.first_node = wp.array(layout.first_node, dtype=wp.int32, device=device)
        edges.strand = wp.array(layout.node_strand, dtype=wp.int32, device=device)
        edges.reach = wp.array(larger, dtype=wp.float64, device=device)
        edges.along = wp.array(
            along - along[layout.first_node[layout.node_strand]], dtype=wp.float64, device=device
        )
        edges.prescribed = wp.array(both.astype(np.int32), dtype=wp.int32, device=device)
        return edges

    def _buffer(self, name: str, dtype: Any, count: int) -> wp.array:
        """Room for at least `count`; grows by halves, contents are lost."""
        held = self._buffers.get(name)
        if held is None or len(held) < count:
            held = wp.empty(count + count // 2, dtype=dtype, device=self._launcher.device)
            self._buffers[name] = held
        return held

    def _full(self, count: int, dtype: Any, value: float = 0) -> wp.array:
        return wp.full(count, value, dtype=dtype, device=self._launcher.device)


def _scan(counts: wp.array, first: wp.array) -> int:
    """Running sums before each of `counts`, whose last is 0, into `first`; the whole sum."""
    wp.utils.array_scan(counts, first, inclusive=False)
    return int(first[-1:].numpy()[0])


def _common_motion(start: wp.array, end: wp.array) -> Motion:
    """The rigid motion nearest the nodes' (Kabsch 1976), and how paths and distances look in its frame.

    Points that move linearly to where a turn by theta takes them move as the affine map A = (1 - t) I + t R does:
    in its frame they rest. Another point that ends e away from there moves by t A^-1 R e in the frame, which
    leaves its chord by at most tan(theta / 2) / 2 |e|; and A shrinks no vector below cos(theta / 2) of its length.
    """
    stride = max(1, len(start) // SAMPLES)
    x, y = (_sample(points, stride) for points in (start, end))
    finite = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
    motion = Motion()
    motion.turn_back = wp.mat33d(np.eye(3))
    motion.widen = 1.0
    if not finite.any():
        return motion
    from_, to = x[finite].mean(axis=0), y[finite].mean(axis=0)
    motion.from_, motion.to = wp.vec3d(*from_), wp.vec3d(*to)
    u, _, vt = np.linalg.svd((y[finite] - to).T @ (x[finite] - from_))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    half_turn = 0.5 * np.arccos(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0))
    if half_turn <= 0.5 * LARGEST_TURN:
        motion.turn_back = wp.mat33d(rotation.T)
        motion.bulge = 0.5 * np.tan(half_turn)
        motion.widen = 1.0 / np.cos(half_turn)
    return motion


def _sample(points: wp.array, stride: int) -> np.ndarray:
    """Every `stride`-th point; only those leave a device."""
    return points.numpy()[::stride] if points.device.is_cpu else points[::stride].numpy()
