"""Contact of strands with strands, inside the strands' own implicit solve: host side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from plait.solver.contact.planes import ContactPlanes
from plait.solver.model import Model
from plait.solver.state import State
from plait.solver.strand_contact.coupled_kernels import coupled_kernels
from plait.solver.strand_contact.edge_pairs import EdgePairs
from plait.solver.strand_contact.meeting_kernels import (
    HELD_AN_EDGE,
    Held,
    Meetings,
    locate,
    press,
    recall,
    remember,
)
from plait.solver.strands.layout import Layout
from plait.solver.strands.scratch import allocate_coupled_scratch
from plait.solver.strands.types import rod_types

# Conjugate gradients end when the residual's norm under the preconditioner has fallen to this part.
LINEAR_TOLERANCE = 0.01
MAX_LINEAR_ITERATIONS = 40
# A pass that moves no node further than this part of a segment leaves contact forces that are worth holding.
CALM = 0.03
# Contacts may be nearer by this part of their distance than they should.
OVERLAP = 0.1
# Pairs are found this much further apart than they interact, over the distance.
MARGIN = 1.0
# Cost of an item in units of `Launcher.launch`.
PAIR_WORK, NODE_WORK = 8, 8
MEETING_ARRAYS = {
    "place": wp.vec2d,
    "normal": wp.vec3d,
    "target": wp.float64,
    "gap": wp.float64,
    "crossing": wp.int32,
    "stiffness": wp.float64,
    "pressure": wp.float64,
    "traction": wp.vec3d,
    "acts": wp.int32,
    "force": wp.vec3d,
    "block": wp.mat33d,
    "answer": wp.vec3d,
    "answer_back": wp.vec3d,
}


@dataclass
class Tally:
    """Of a frame's substeps."""

    passes: int = 0
    linear_iterations: int = 0
    contacts: int = 0


class StrandContact:
    """Strands that come near each other in a substep are solved again, all at once.

    State arrays, HELD_AN_EDGE slots an edge: strand_contact/other, pressure, traction of contacts that last.
    """

    def __init__(self, model: Model, state: State, layout: Layout, rods: Any, real: type) -> None:
        self._launcher, self._layout, self._rods, self._real = model.launcher, layout, rods, real
        self._settings, device = model.settings.strand_contact, model.launcher.device
        thickness = [
            np.full(last - first, strands.thickness)
            for strands, first, last in zip(
                model.scene.strands, layout.prim_strands[:-1], layout.prim_strands[1:], strict=True
            )
        ]
        reach = layout.radius + 0.5 * np.concatenate(thickness)[layout.node_strand]
        # Roots may be as near as they grow.
        tapered = reach.copy()
        tapered[layout.first_node[:-1] + 1] = 0.0
        self._reach = wp.array(tapered, dtype=wp.float64, device=device)
        self._friction = wp.array(layout.friction[layout.node_strand], dtype=wp.float64, device=device)
        self._margin = MARGIN * 2.0 * float(reach.max())
        self.pairs = EdgePairs(model.launcher, layout, reach)
        slots = layout.node_count * int(HELD_AN_EDGE)
        self._held, self._kept = (_allocate_held(slots, device) for _ in range(2))
        for name in ("other", "pressure", "traction"):
            state.arrays[f"strand_contact/{name}"] = getattr(self._held, name)
        self._meets = False
        self._room = 0
        self.tally = Tally()

    def begin_frame(self) -> None:
        self.tally = Tally()

    def find(self, start: wp.array, end: wp.array) -> bool:
        """Whether strands come near each other between `start` and `end`, (node_count,) vec3d [m]."""
        meets = self.pairs.find(start, end, self._margin)
        if not meets and self._meets:
            self._held.other.fill_(-1)
        self._meets = meets
        return meets

    def solve(self, method: Any, result: Any, roots: Any, planes: ContactPlanes, constrained: bool) -> bool:
        """Solves the strands near each other into `result`; whether that stands.

        After `begin`; again from where it ended, with other planes, as often as need be.
        """
        stands = False
        for done in range(self._settings.passes + 1):
            self._locate()
            if done and self._settled():
                stands = True
                break
            if done == self._settings.passes:
                break
            self._newton(planes, constrained, roots)
            self._press(keep=float(self._furthest.numpy()[: len(self._strands)].max()) < CALM)
            self.tally.passes += 1
        self._launch(
            self._kernels.finish,
            [self._strands, method, self._rods, roots, self._scratch, self._position],
            [result],
        )
        return stands

    def commit(self) -> None:
        """The substep stands: its contacts are those to go on from."""
        if not self._meets:
            return
        inputs = [self.pairs.first, self.pairs.incident, self._meetings]
        self._launcher.launch(remember, self._layout.node_count - 1, inputs, [self._held], work_per_item=PAIR_WORK)

    # -- parts of a solve ----------------------------------------------------------------------------------

    def begin(self, method: Any, held: Any, roots: Any) -> None:
        """From the substep's start, `held`, for the strands that `find` found."""
        self._allocate()
        self._start = held.position
        near = np.flatnonzero(self.pairs.near).astype(np.int32)
        self._strands = wp.array(near, dtype=wp.int32, device=self._launcher.device)
        self._work = NODE_WORK * max(1, self._layout.node_count // self._layout.strand_count)
        self._hold_pairs()
        inputs = [self._strands, method, self._rods, held, roots, self._scratch]
        self._launch(self._kernels.begin, inputs, [self._position, self._stiffness, self._inertia])
        self._launcher.launch(recall, self.pairs.count, [self._held], [self._meetings], work_per_item=PAIR_WORK)

    def _locate(self) -> None:
        inputs = [self._reach, self._stiffness, self._start, self._position]
        self._launcher.launch(locate, self.pairs.count, inputs, [self._meetings], work_per_item=4 * PAIR_WORK)

    def _press(self, *, keep: bool) -> None:
        inputs = [self._friction, self._start, self._position, keep]
        self._launcher.launch(press, self.pairs.count, inputs, [self._meetings], work_per_item=PAIR_WORK)

    def _settled(self) -> bool:
        """Whether the last pass has changed little, and nothing is out of place."""
        count, meetings = self.pairs.count, self._meetings
        if meetings.crossing.numpy()[:count].any():
            return False
        gap = meetings.gap.numpy()[:count] / meetings.target.numpy()[:count]
        apart = np.max(gap, where=meetings.pressure.numpy()[:count] > 0.0, initial=0.0)
        furthest = float(self._furthest.numpy()[: len(self._strands)].max())
        return gap.min() >= -OVERLAP and apart <= OVERLAP and furthest <= 0.03

    def _newton(self, planes: ContactPlanes, constrained: bool, roots: Any) -> None:
        kernels, strands, krylov, scratch = self._kernels, self._strands, self._krylov, self._scratch
        pairs, meetings, rods = self.pairs, self._meetings, self._rods
        self._press(keep=False)
        incidence = [pairs.first, pairs.incident, meetings]
        self._launch(kernels.gather, [strands, *incidence, rods], [scratch])
        system = [strands, rods, planes, constrained, roots, self._inertia]
        self._launch(kernels.linearise, [*system, scratch], [krylov, self._product, self._definite])
        left = self._sum(self._product)
        enough = LINEAR_TOLERANCE**2 * left
        for _ in range(MAX_LINEAR_ITERATIONS):
            if left <= enough:
                break
            self._launcher.launch(kernels.answer, pairs.count, [meetings], [krylov], work_per_item=PAIR_WORK)
            self._launch(kernels.image, [strands, rods.first_node, *incidence], [krylov, self._product])
            alpha = left / self._sum(self._product)
            self._launch(kernels.descend, [strands, alpha, rods], [scratch, krylov, self._product])
            before, left = left, self._sum(self._product)
            self._launch(kernels.search, [strands, left / before, rods, scratch], [krylov])
            self.tally.linear_iterations += 1
        self._launch(kernels.advance, [*system, krylov], [scratch, self._position, self._furthest])

    def _sum(self, values: wp.array) -> float:
        return float(values.numpy()[: len(self._strands)].sum())

    def _launch(self, kernel: wp.Kernel, inputs: list[Any], outputs: list[Any]) -> None:
        self._launcher.launch(kernel, len(self._strands), inputs, outputs, work_per_item=self._work)

    # -- room ----------------------------------------------------------------------------------------------

    def _allocate(self) -> None:
        """What meetings need, once there are any."""
        if hasattr(self, "_scratch"):
            return
        device, nodes, strands = self._launcher.device, self._layout.node_count, self._layout.strand_count
        self._kernels = coupled_kernels(self._real)
        self._scratch = allocate_coupled_scratch(self._real, nodes, device)
        self._krylov = self._kernels.Krylov()
        for name in ("direction", "own", "image", "step"):
            setattr(self._krylov, name, wp.zeros(nodes, dtype=rod_types(self._real).vec4, device=device))
        self._position = wp.zeros(nodes, dtype=wp.vec3d, device=device)
        self._stiffness = wp.zeros(nodes, dtype=wp.float64, device=device)
        self._inertia = wp.zeros(strands, dtype=self._real, device=device)
        self._product, self._furthest = (wp.zeros(strands, dtype=wp.float64, device=device) for _ in range(2))
        self._definite = wp.zeros(strands, dtype=wp.int32, device=device)

    def _hold_pairs(self) -> None:
        """Room for as many meetings as there are pairs."""
        if self.pairs.count > self._room:
            self._room = 5 * self.pairs.count // 4
            self._meetings = Meetings()
            for name, dtype in MEETING_ARRAYS.items():
                setattr(self._meetings, name, wp.zeros(self._room, dtype=dtype, device=self._launcher.device))
        self._meetings.edges = self.pairs.pairs


def _allocate_held(slots: int, device: wp.Device) -> Held:
    held = Held()
    held.other = wp.full(slots, -1, dtype=wp.int32, device=device)
    held.pressure = wp.zeros(slots, dtype=wp.float64, device=device)
    held.traction = wp.zeros(slots, dtype=wp.vec3d, device=device)
    return held
