"""Contacts between edges of strands in a substep, their geometry and forces: host side."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.model import Model
from plait.solver.state import State
from plait.solver.strand_contact.acting_kernels import count_acting, list_acting
from plait.solver.strand_contact.edge_pairs import EdgePairs
from plait.solver.strand_contact.locating_kernels import locate
from plait.solver.strand_contact.meeting_kernels import (
    CROSSING,
    HELD_AN_EDGE,
    Held,
    Meetings,
    Nodes,
    Ways,
    expect,
    lose_room,
    make_room,
    recall,
    remember,
    resume,
)
from plait.solver.strand_contact.passing_kernels import inherit, pass_on
from plait.solver.strand_contact.pressing_kernels import hold, press
from plait.solver.strands.layout import Layout

# Costs of an item in units of `Launcher.launch`.
PAIR_WORK, LOCATE_WORK, LIST_WORK = 2, 6, 3
# The most room of a node over the least.
MOST_ROOM = 4.0
# Where more than this part of the nodes have strayed, all pairs are found again.
MANY = 0.3
# Pairs are found again for nodes that have used this part of their room.
STRAYED = 0.25
MEETING_ARRAYS = {
    "apart": wp.vec3d,
    "drawn": wp.float64,
    "clear_until": wp.float64,
    "place": wp.vec2d,
    "normal": wp.vec3d,
    "target": wp.float64,
    "gap": wp.float64,
    "slack": wp.float64,
    "fault": wp.int32,
    "turned": wp.int32,
    "stiffness": wp.float64,
    "stiffer": wp.float64,
    "overlap": wp.float64,
    "pressure": wp.float64,
    "traction": wp.vec3d,
    "sliding": wp.vec3d,
    "swings": wp.int32,
    "heir": wp.int32,
    "passed_pressure": wp.float64,
    "passed_traction": wp.vec3d,
    "acts": wp.int32,
    "force": wp.vec3d,
    "block": wp.mat33d,
}


class EdgeContacts:
    """Pairs of edges that may meet in a substep, where they touch, and what they do to each other.

    State arrays: strand_contact/other, pressure, traction of contacts that last, HELD_AN_EDGE slots an edge;
    strand_contact/room, of each node.

    pairs: the pairs of edges.  meetings: what is known of each.
    acting_first, acting: those of each edge that push, as in `EdgePairs`.  acting_count: of both edges.
    lasting: (strand_count,) int32, 1: strands that were in contact when the substep began.
    chosen: indices of the pairs that are looked at in a pass.
    widest: [m] the largest distance that strands keep.
    room: (node_count,) [m] how far each node may be from where pairs were found for, if more than `least_room`.
    """

    def __init__(self, model: Model, state: State, layout: Layout) -> None:
        self._launcher, self._layout, device = model.launcher, layout, model.launcher.device
        thickness = [
            np.full(last - first, strands.thickness)
            for strands, first, last in zip(
                model.scene.strands, layout.prim_strands[:-1], layout.prim_strands[1:], strict=True
            )
        ]
        reach = layout.radius + 0.5 * np.concatenate(thickness)[layout.node_strand]
        # Roots may be as near as they grow.
        tapered = reach.copy()
        tapered[layout.prescribed] = 0.0
        self._nodes = Nodes()
        self._nodes.reach = wp.array(tapered, dtype=wp.float64, device=device)
        self._nodes.radius = wp.array(layout.radius, dtype=wp.float64, device=device)
        self._nodes.friction = wp.array(layout.friction[layout.node_strand], dtype=wp.float64, device=device)
        self._nodes.drawn = wp.array(layout.position, dtype=wp.vec3d, device=device)
        self._nodes.strand = wp.array(layout.node_strand, dtype=wp.int32, device=device)
        self.widest = 2.0 * float(reach.max())
        self.pairs = EdgePairs(model.launcher, layout, reach, layout.prescribed)
        slots = layout.node_count * int(HELD_AN_EDGE)
        self._held = _allocate_held(slots, device)
        for name in ("other", "pressure", "traction"):
            state.arrays[f"strand_contact/{name}"] = getattr(self._held, name)
        self.room = state.arrays["strand_contact/room"] = wp.zeros(
            layout.node_count, dtype=wp.float64, device=device
        )
        self.least_room = 0.0
        self.lasting = wp.zeros(layout.strand_count, dtype=wp.int32, device=device)
        self._sought: wp.array | None = None
        self._meetings, self._before = Meetings(), Meetings()
        self._room = self._before_room = -1
        self.acting: wp.array | None = None
        self._every = wp.zeros(0, dtype=wp.int32, device=device)
        self.choose()

    # -- which pairs ---------------------------------------------------------------------------------------

    def find(self, held: Any, result: Any, length: float, least_room: float) -> tuple[bool, wp.array]:
        """Whether any edges may meet in a substep of `length` [s]; and where nodes were expected.

        held, result: the state at the start, and where strands would go by themselves. What was in contact is
        expected where its velocity leads, not where it would fall to.  least_room: [m] of any node.
        """
        self.least_room = least_room
        expected = result.position
        self.lasting.zero_()
        touching = (self._held.other.numpy() >= 0).reshape(-1, int(HELD_AN_EDGE)).any(axis=1)
        edges = np.flatnonzero(touching)
        if len(edges):
            self._allocate()
            others = self._held.other.numpy().reshape(-1, int(HELD_AN_EDGE))[edges]
            strand = self._layout.node_strand
            lasting = np.zeros(self._layout.strand_count, dtype=np.int32)
            lasting[strand[edges]] = 1
            lasting[strand[others[others >= 0]]] = 1
            self.lasting.assign(lasting)
            inputs = [
                self.lasting,
                self._nodes.strand,
                held.position,
                held.velocity,
                wp.float64(length),
                result.position,
            ]
            self._launcher.launch(expect, self._layout.node_count, inputs, [self._sought])
            expected = self._sought
        return self.pairs.find(held.position, expected, self.room, least_room), expected

    def find_again(
        self, start: wp.array, expected: wp.array, places: np.ndarray, everywhere: bool
    ) -> tuple[bool, wp.array]:
        """The same towards `places`, (node_count, 3) [m], of what has strayed from where it was `expected`, with
        more room, or of all `everywhere`; what is known of pairs is kept."""
        self._allocate()
        self._meetings, self._before = self._before, self._meetings
        self._room, self._before_room = self._before_room, self._room
        self._before.edges, self._before_first = wp.clone(self.pairs.pairs), wp.clone(self.pairs.first_pair)
        before = expected.numpy()
        stray = np.linalg.norm(places - before, axis=1) > STRAYED * np.maximum(self.room.numpy(), self.least_room)
        everywhere = everywhere or stray.mean() > MANY
        self._places.assign(places if everywhere else np.where(stray[:, None], places, before))
        self.make_room(expected, self._places)
        wp.copy(self._sought, self._places)
        found = [start, self._sought, self.room, self.least_room]
        if everywhere:
            return self.pairs.find(*found), self._sought
        stray[:-1] |= stray[1:]  # an edge, if either of its nodes has
        return self.pairs.find_again(*found, stray), self._sought

    def make_room(self, expected: wp.array, position: wp.array) -> None:
        """What has strayed from where it was expected is given room to do so again."""
        inputs = [wp.float64(MOST_ROOM * self.least_room), expected, position]
        self._launcher.launch(make_room, self._layout.node_count, inputs, [self.room])

    def recall(self) -> None:
        """Begins with the pairs last found, with the forces that they had."""
        self._allocate()
        self._hold_pairs()
        self._launch(recall, [self._held], PAIR_WORK)

    def resume(self, elsewhere: bool) -> None:
        """Goes on with the pairs found again, with all that is known of those found before.

        elsewhere: strands have not travelled to where they are now.
        """
        self._hold_pairs()
        self._launch(resume, [self._before, self._before_first, elsewhere], PAIR_WORK)

    def forget(self) -> None:
        """There are no contacts."""
        self._held.other.fill_(-1)

    def commit(self, start: wp.array, position: wp.array, ways: Ways, calm: float) -> None:
        """Forces at `position` are those to go on from; where strands moved less than `calm`, they are held."""
        self.choose()
        self._hold(start, position, ways, calm, np.inf)
        inputs, edges = [self.pairs.first, self.pairs.incident, self._meetings], self._layout.node_count - 1
        self._launcher.launch(remember, edges, inputs, [self._held], work_per_item=PAIR_WORK)
        self._launcher.launch(lose_room, self._layout.node_count, [], [self.room])

    # -- where and how they touch --------------------------------------------------------------------------

    def choose(self, playing: np.ndarray | None = None) -> None:
        """From now on pairs with a strand that is `playing`, (strand_count,) bool, are looked at; None: all."""
        if playing is None:
            self.chosen, self._chosen = np.arange(self.pairs.count, dtype=np.int32), self._every
            return
        either = playing[self._layout.node_strand][self.pairs.pairs.numpy()].any(axis=1)
        self.chosen = np.flatnonzero(either).astype(np.int32)
        self._chosen = wp.array(self.chosen, dtype=wp.int32, device=self._launcher.device)

    def locate(self, stiffness: wp.array, ways: Ways, steady: float, start: wp.array, position: wp.array) -> None:
        """Where pairs touch on their way from `start` to `position`.

        stiffness: (node_count,) [N/m] of nodes.  steady: what pushes keeps its place where strands moved less than
        this part of a segment.
        """
        inputs = [self._nodes, stiffness, ways, wp.float64(steady), start, position]
        self._launch_chosen(locate, inputs, LOCATE_WORK)

    def pass_on(self) -> None:
        """Contacts that have gone past a node go on with the forces that they had; after the first `locate`."""
        for kernel in (pass_on, inherit):
            self._launch(kernel, [self.pairs.first, self.pairs.incident], PAIR_WORK)

    def hold(self, start: wp.array, position: wp.array, ways: Ways, calm: float) -> None:
        """Contacts hold the forces that they now have, where strands have moved less than `calm` segments."""
        self._hold(start, position, ways, -1.0, calm)

    def _hold(self, start: wp.array, position: wp.array, ways: Ways, calmer: float, calm: float) -> None:
        limits = [wp.float64(calmer), wp.float64(calm)]
        self._launch_chosen(hold, [self._nodes, start, position, ways, *limits], PAIR_WORK)

    def press(self, start: wp.array, position: wp.array) -> None:
        """Forces and stiffnesses at `position`; lists what acts."""
        self._launch_chosen(press, [self._nodes, start, position], PAIR_WORK)
        launcher, edges = self._launcher, self._layout.node_count - 1
        pairs, acts = self.pairs, self._meetings.acts
        inputs = [pairs.first, pairs.incident, acts]
        launcher.launch(count_acting, edges, inputs, [self._counts], work_per_item=LIST_WORK)
        wp.utils.array_scan(self._counts, self.acting_first, inclusive=False)
        self.acting_count = int(self.acting_first[-1:].numpy()[0])
        inputs.append(self.acting_first)
        launcher.launch(list_acting, edges, inputs, [self.acting], work_per_item=LIST_WORK)

    def faults(self) -> np.ndarray:
        """(pair_count,) int32, of CROSSING, OUT_OF_PLACE and DEEP, added; after `press`."""
        return self.meetings.fault.numpy()[: self.pairs.count]

    def crossing(self) -> np.ndarray:
        """(n, 2) edges that have gone through each other; after `locate`."""
        return self.pairs.pairs.numpy()[: self.pairs.count][(self.faults() & int(CROSSING)) > 0]

    # -- room ----------------------------------------------------------------------------------------------

    def _launch(self, kernel: wp.Kernel, inputs: list[Any], work: int) -> None:
        self._launcher.launch(kernel, self.pairs.count, inputs, [self._meetings], work_per_item=work)

    def _launch_chosen(self, kernel: wp.Kernel, inputs: list[Any], work: int) -> None:
        outputs = [self._meetings]
        self._launcher.launch(kernel, len(self.chosen), [self._chosen, *inputs], outputs, work_per_item=work)

    @property
    def meetings(self) -> Meetings:
        return self._meetings

    def _allocate(self) -> None:
        """What contacts need, once there may be any."""
        if self._sought is not None:
            return
        device, nodes = self._launcher.device, self._layout.node_count
        self._sought, self._places = (wp.zeros(nodes, dtype=wp.vec3d, device=device) for _ in range(2))
        self._counts, self.acting_first = (wp.zeros(nodes + 1, dtype=wp.int32, device=device) for _ in range(2))

    def _hold_pairs(self) -> None:
        """Room for as many meetings as there are pairs."""
        count, device = self.pairs.count, self._launcher.device
        if count > self._room:
            self._room = 5 * count // 4
            self._meetings = Meetings()
            for name, dtype in MEETING_ARRAYS.items():
                setattr(self._meetings, name, wp.zeros(self._room, dtype=dtype, device=device))
        if self.acting is None or len(self.acting) < 2 * count:
            self.acting = wp.zeros(2 * self._room, dtype=wp.int32, device=device)
        if len(self._every) < count:
            self._every = wp.array(np.arange(self._room), dtype=wp.int32, device=device)
        self._meetings.edges = self.pairs.pairs
        self.choose()


def _allocate_held(slots: int, device: wp.Device) -> Held:
    held = Held()
    held.other = wp.full(slots, -1, dtype=wp.int32, device=device)
    held.pressure = wp.zeros(slots, dtype=wp.float64, device=device)
    held.traction = wp.zeros(slots, dtype=wp.vec3d, device=device)
    return held
