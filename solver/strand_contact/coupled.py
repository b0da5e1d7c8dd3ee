"""Contact of strands with strands, inside the strands' own implicit solve: host side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from plait.solver.contact.planes import ContactPlanes
from plait.solver.model import Interval, Model
from plait.solver.state import State
from plait.solver.strand_contact.attachments import Attachments
from plait.solver.strand_contact.coupled_kernels import coupled_kernels
from plait.solver.strand_contact.edge_pairs import EdgePairs
from plait.solver.strand_contact.meeting_kernels import (
    HELD_AN_EDGE,
    Held,
    Meetings,
    expect,
    hold,
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
# The same where strands are free, as what is left is momentum lost; and where ties are stiff between strands, as
# the preconditioner hardly sees their common motion.
FREE_TOLERANCE, TIED_TOLERANCE, MAX_TIED_ITERATIONS = 1e-5, 1e-10, 400
# A pass that moves no node further than this part of a segment leaves contact forces that are worth holding.
CALM = 0.003
# A pass that moves no node further than this part of a segment, with nothing out of place, is the last.
SETTLED = 0.03
# Passes with full steps; what then still goes to and fro is damped.
UNRELAXED, RELAXED = 5, 0.6
# After so many passes contacts may be so many times as near as they otherwise may.
ENOUGH, DEEPEST = 6, 5.0
# Strands that would go further through each other than this part of a segment take shorter steps at once.
FURTHEST = 1.0
# As a last resort strands go half, a quarter, ... of their way, so often, then none of it.
HALVINGS = 6
# Pairs are found this much further apart than they interact, over the distance.
MARGIN, WIDER = 0.5, 4.0
# And over the way that gravity makes in a substep, which contact may or may not take away.
FALL = 2.5
# Cost of an item in units of `Launcher.launch`.
PAIR_WORK, LOCATE_WORK, NODE_WORK = 4, 16, 8
MEETING_ARRAYS = {
    "apart": wp.vec3d,
    "place": wp.vec2d,
    "normal": wp.vec3d,
    "target": wp.float64,
    "gap": wp.float64,
    "slack": wp.float64,
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
    """Of a frame: Newton passes, iterations of their linear solves, most passes in a substep, strands
    that were held back as a last resort."""

    passes: int = 0
    linear_iterations: int = 0
    most_passes: int = 0
    held_back: int = 0


class StrandContact:
    """Strands that come near each other in a substep, or are attached, are solved again, all at once.

    State arrays, HELD_AN_EDGE slots an edge: strand_contact/other, pressure, traction of contacts that last.
    """

    def __init__(self, model: Model, state: State, layout: Layout, rods: Any, real: type) -> None:
        self._launcher, self._layout, self._rods, self._real = model.launcher, layout, rods, real
        self._settings, device = model.settings.strand_contact, model.launcher.device
        self._in_contact = self._settings.method == "implicit" and layout.strand_count > 1
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
        self._reach = wp.array(tapered, dtype=wp.float64, device=device)
        self._friction = wp.array(layout.friction[layout.node_strand], dtype=wp.float64, device=device)
        self._widest, self._gravity = 2.0 * float(reach.max()), float(np.linalg.norm(model.scene.gravity))
        self._margin = 0.0
        self.pairs = EdgePairs(model.launcher, layout, reach, layout.prescribed)
        slots = layout.node_count * int(HELD_AN_EDGE)
        self._held, self._kept = (_allocate_held(slots, device) for _ in range(2))
        for name in ("other", "pressure", "traction"):
            state.arrays[f"strand_contact/{name}"] = getattr(self._held, name)
        self._meets = False
        self._passes = 0
        self._room = -1
        self.ties = Attachments(model, state, layout, real) if model.scene.attachments else None
        self.tally = Tally()

    def begin_frame(self) -> None:
        self.tally = Tally()

    @property
    def meets(self) -> bool:
        """Whether strands were near each other in the last substep."""
        return self._in_contact and self._meets

    @property
    def near(self) -> np.ndarray:
        """(strand_count,) bool, strands that are near others or attached."""
        return self.pairs.near if self.ties is None else self.pairs.near | self.ties.near

    @property
    def attached(self) -> np.ndarray | bool:
        """(strand_count,) bool, strands that something holds besides their roots."""
        return False if self.ties is None else self.ties.near

    def begin_substep(self, substep: Interval, position: wp.array) -> None:
        """Notes what is attached. position: (node_count,) vec3d [m] at the start."""
        if self.ties is not None:
            self.ties.begin_substep(substep, position)

    def find(self, held: Any, result: Any, length: float) -> bool:
        """Whether strands are attached, or near others in a substep of `length` [s] from `held` on.

        result: where they would go by themselves.
        """
        self._expected = result.position
        self._margin = max(MARGIN * self._widest, FALL * self._gravity * length**2)
        meets = self._in_contact and self._find_pairs(held, result, length)
        if not meets and self._meets:
            self._held.other.fill_(-1)
        self._meets, self._passes = meets, 0
        return meets or (self.ties is not None and self.ties.count > 0)

    def begin(self, method: Any, held: Any, result: Any, roots: Any) -> None:
        """From the substep's start, `held`, for the strands found near each other on their way to `result`."""
        self._allocate()
        self._method, self._state, self._roots = method, held, roots
        self._start, self._room_to_stray = held.position, self._margin
        self._strands = np.zeros(0, dtype=np.int32)
        self._take_pairs(self._held)

    def solve(self, result: Any, planes: ContactPlanes, constrained: bool, last_resort: bool) -> bool:
        """Solves the strands near each other into `result`; whether that stands.

        After `begin`; again from where it ended, with other planes, as often as need be. As a last resort what is
        still going through something is held back, and all stands.
        """
        self._surfaces = planes, constrained
        self._prepare(planes, constrained)
        stands = False
        for done in range(self._settings.passes + 1):
            if done and self._largest(self._stray) > 0.5 * self._room_to_stray:
                self._find_again(planes, constrained)
            self._locate_all()
            if done and (self._settled() or (done >= ENOUGH and self._harmless())):
                stands = True
                break
            if done == self._settings.passes or (done == 1 and not last_resort and self._too_fast()):
                break
            self._relaxation.fill_(1.0 if done < UNRELAXED else RELAXED)
            self._newton()
            self._hold(CALM)
            if self.ties is not None:
                self.ties.hold()
            self.tally.passes += 1
            self._passes += 1
        inputs = [self._active, self._method, self._rods, self._roots, self._scratch, self._position]
        if not stands and last_resort:
            self._hold_back(planes, constrained)
            stands = True
        self._launch(self._kernels.finish, inputs, [result])
        return stands

    @property
    def solved(self) -> np.ndarray:
        """(strand_count,) bool: the strands that `solve` moves."""
        solved = np.zeros(self._layout.strand_count, dtype=bool)
        solved[self._strands] = True
        return solved

    def crossed(self, position: wp.array) -> bool:
        """Whether strands go through each other between the substep's start and `position`."""
        wp.copy(self._position, position)
        self._find_again(*self._surfaces)
        self._locate_all()
        return bool(self._meetings.crossing.numpy()[: self.pairs.count].any())

    def commit(self) -> None:
        """The substep stands: its contacts are those to go on from."""
        if self._meets:
            self._hold(np.inf)
            self._remember(self._held)
        if self.ties is not None:
            self.ties.commit()
        self.tally.most_passes = max(self.tally.most_passes, self._passes)

    def end_frame(self) -> dict[str, Any]:
        """Metrics: contacts that push at the frame's end, the least distance of surfaces [m], passes, strands held
        back."""
        contacts, least = 0, None
        if self.meets:
            count, meetings = self.pairs.count, self._meetings
            known = np.flatnonzero(meetings.stiffness.numpy()[:count] > 0.0)
            contacts = int(np.count_nonzero(meetings.pressure.numpy()[:count]))
            if len(known):
                radius = self._layout.radius[meetings.edges.numpy()[known]].sum(axis=1)
                least = float((meetings.gap.numpy()[known] + meetings.target.numpy()[known] - radius).min())
        return {
            "strand_contacts": contacts,
            "strand_gap_min": least,
            "strand_passes": self.tally.most_passes,
            "strand_linear_iterations": self.tally.linear_iterations,
            "strands_held_back": self.tally.held_back,
        }

    # -- pairs ---------------------------------------------------------------------------------------------

    def _find_pairs(self, held: Any, result: Any, length: float) -> bool:
        """What was in contact is expected where its velocity leads, not where it would fall to."""
        touching = (self._held.other.numpy() >= 0).reshape(-1, int(HELD_AN_EDGE)).any(axis=1)
        edges = np.flatnonzero(touching)
        if len(edges):
            self._allocate()
            others = self._held.other.numpy().reshape(-1, int(HELD_AN_EDGE))[edges]
            strand = self._layout.node_strand
            lasting = np.zeros(self._layout.strand_count, dtype=np.int32)
            lasting[strand[edges]] = 1
            lasting[strand[others[others >= 0]]] = 1
            flags = wp.array(lasting, dtype=wp.int32, device=self._launcher.device)
            inputs = [flags, self._strand, held.position, held.velocity, wp.float64(length), result.position]
            self._launcher.launch(expect, self._layout.node_count, inputs, [self._sought])
            self._expected = self._sought
        return self.pairs.find(held.position, self._expected, self._margin)

    def _take_pairs(self, forces: Held) -> None:
        """The pairs last found, with the forces they had; begins strands that are new among them."""
        launcher = self._launcher
        strands = np.flatnonzero(self.near).astype(np.int32)
        new = np.setdiff1d(strands, self._strands, assume_unique=True)
        device = launcher.device
        work = NODE_WORK * max(1, self._layout.node_count // self._layout.strand_count)
        inputs = [wp.array(new, dtype=wp.int32, device=device), self._method, self._rods, self._state, self._roots]
        outputs = [self._position, self._stiffness, self._inertia]
        launcher.launch(self._kernels.begin, len(new), [*inputs, self._scratch], outputs, work_per_item=work)
        self._strands = np.union1d(self._strands, strands).astype(np.int32)
        self._count, self._work = len(self._strands), work
        self._active = wp.array(self._strands, dtype=wp.int32, device=device)
        self._hold_pairs()
        inputs = [self._start, forces]
        launcher.launch(recall, self.pairs.count, inputs, [self._meetings], work_per_item=PAIR_WORK)

    def _find_again(self, planes: ContactPlanes, constrained: bool) -> None:
        """Strands have left the places for which pairs were found."""
        self._remember(self._kept)
        nodes = self.solved[self._layout.node_strand]
        places = np.where(nodes[:, None], self._position.numpy(), self._expected.numpy())
        self._sought.assign(places)
        self._expected = self._sought
        # The further they stray, the further they may in the passes to come.
        widest = WIDER * self._margin
        self._room_to_stray = float(np.clip(4.0 * self._largest(self._stray), self._margin, widest))
        if self._in_contact:
            self._meets = self.pairs.find(self._start, self._expected, self._room_to_stray) or self._meets
        self._take_pairs(self._kept)
        self._prepare(planes, constrained)

    def _remember(self, forces: Held) -> None:
        inputs = [self.pairs.first, self.pairs.incident, self._meetings]
        self._launcher.launch(remember, self._layout.node_count - 1, inputs, [forces], work_per_item=PAIR_WORK)

    def _too_fast(self) -> bool:
        """Whether strands now go further through each other than passes can put right."""
        through = np.flatnonzero(self._meetings.crossing.numpy()[: self.pairs.count])
        edges = self._meetings.edges.numpy()[through]
        segment = self._layout.mean_segment[self._layout.node_strand[edges]].min(axis=1)
        return bool((-self._meetings.gap.numpy()[through] > FURTHEST * segment).any())

    # -- a Newton pass -------------------------------------------------------------------------------------

    def _prepare(self, planes: ContactPlanes, constrained: bool) -> None:
        """Records what is launched again and again."""
        kernels, krylov, scratch, rods = self._kernels, self._krylov, self._scratch, self._rods
        pairs, meetings, active = self.pairs, self._meetings, self._active

        def of_strands(kernel: wp.Kernel, inputs: list[Any], outputs: list[Any]) -> Callable[[], None]:
            return self._launcher.prepare(kernel, self._count, inputs, outputs, work_per_item=self._work)

        def of_pairs(kernel: wp.Kernel, inputs: list[Any], work: int) -> Callable[[], None]:
            return self._launcher.prepare(kernel, pairs.count, inputs, [meetings], work_per_item=work)

        places = [self._start, self._position]
        self._locate = of_pairs(locate, [self._reach, self._stiffness, *places], LOCATE_WORK)
        system = [active, rods, planes, constrained, self._roots, self._inertia]
        self._linearise = of_strands(
            kernels.linearise, [*system, scratch], [krylov, self._product, self._definite]
        )
        self._descend = of_strands(kernels.descend, [active, self._alpha, rods], [scratch, krylov, self._product])
        self._search = of_strands(kernels.search, [active, self._beta, rods, scratch], [krylov])
        self._advance = of_strands(
            kernels.advance,
            [*system, self._relaxation, krylov, scratch, self._expected],
            [self._position, self._furthest, self._stray],
        )
        if self.ties is not None:
            self.ties.prepare(self._position, self._stiffness, scratch, krylov, meetings, pairs.count)

    def _locate_all(self) -> None:
        """Where pairs and ties are now."""
        self._locate()
        taking_part = self._meetings.stiffness.numpy()[: self.pairs.count] > 0.0
        self._part = np.flatnonzero(taking_part).astype(np.int32)
        part = wp.array(self._part, dtype=wp.int32, device=self._launcher.device)
        self._pushing = [part, self._friction, self._start, self._position]
        if self.ties is not None:
            self.ties.measure()

    def _press(self) -> Callable[[], None]:
        """Forces and stiffnesses of pairs that take part, at their nodes; what makes images of directions."""
        launcher, meetings = self._launcher, self._meetings
        device = launcher.device
        launcher.launch(press, len(self._part), self._pushing, [meetings], work_per_item=PAIR_WORK)
        act = self._part[meetings.acts.numpy()[self._part] > 0]
        edges = meetings.edges.numpy()[act].ravel()
        order = np.argsort(edges, kind="stable")
        incident = (2 * act[:, None] + np.arange(2)).ravel()[order]
        first = np.searchsorted(edges[order], np.arange(self._layout.node_count + 1))
        acting = [wp.array(values.astype(np.int32), dtype=wp.int32, device=device) for values in (first, incident)]
        inputs = [self._active, *acting, meetings, self._rods]
        self._launch(self._kernels.gather, inputs, [self._scratch])
        acts = wp.array(act, dtype=wp.int32, device=device)
        answer = launcher.prepare(
            self._kernels.answer, len(act), [acts, meetings], [self._krylov], work_per_item=PAIR_WORK
        )
        combine = launcher.prepare(
            self._kernels.image,
            self._count,
            [self._active, self._rods, *acting, meetings],
            [self._krylov, self._product],
            work_per_item=self._work,
        )

        def image() -> None:
            answer()
            combine()

        return image

    def _hold(self, calm: float) -> None:
        """Holds the forces that pairs now have."""
        inputs = [*self._pushing, self._strand, self._furthest, wp.float64(calm)]
        self._launcher.launch(hold, len(self._part), inputs, [self._meetings], work_per_item=PAIR_WORK)

    def _newton(self) -> None:
        """One Newton step of all strands together."""
        image = self._press()
        if self.ties is not None:
            self.ties.gather()
        self._linearise()
        left = self._products()
        tolerance, iterations = LINEAR_TOLERANCE, MAX_LINEAR_ITERATIONS
        if self._layout.free[self._strands].any():
            tolerance = FREE_TOLERANCE
        if self.ties is not None and self.ties.joins_strands:
            tolerance, iterations = TIED_TOLERANCE, MAX_TIED_ITERATIONS
        enough = tolerance**2 * left
        for _ in range(iterations):
            if left <= enough:
                break
            image()
            curvature = self._products()
            if self.ties is not None:
                curvature += self.ties.image()
            self._alpha.fill_(left / curvature)
            self._descend()
            before, left = left, self._products()
            self._beta.fill_(left / before)
            self._search()
            self.tally.linear_iterations += 1
        self._advance()

    def _settled(self) -> bool:
        """Whether the last pass has changed little, and nothing is out of place."""
        count, meetings = self.pairs.count, self._meetings
        gap, allowed = meetings.gap.numpy()[:count], meetings.slack.numpy()[:count]
        under = (gap < -allowed) | ((gap > allowed) & (meetings.pressure.numpy()[:count] > 0.0))
        return self._at_an_end() and not under.any()

    def _harmless(self) -> bool:
        """Whether what the last pass left out of place, it left outside of each other."""
        count, meetings = self.pairs.count, self._meetings
        near_enough = meetings.gap.numpy()[:count] >= -DEEPEST * meetings.slack.numpy()[:count]
        return self._at_an_end() and bool(near_enough.all())

    def _at_an_end(self) -> bool:
        """Whether every strand was solved, hardly moves, has gone through none and keeps to what it is tied to."""
        solved = self._definite.numpy()[: self._count].all()
        through = self._meetings.crossing.numpy()[: self.pairs.count].any()
        return bool(solved and not through and self._tied() and self._largest(self._furthest) <= SETTLED)

    def _tied(self) -> bool:
        return self.ties is None or self.ties.hold_exactly

    def _hold_back(self, planes: ContactPlanes, constrained: bool) -> None:
        """Strands that still go through others go less far, in the end no further than their roots carry them."""
        whole = wp.clone(self._position)
        part = np.ones(self._layout.strand_count)
        strand_of = self._layout.node_strand
        for _ in range(HALVINGS + 1):
            through = self.pairs.pairs.numpy()[: self.pairs.count][
                self._meetings.crossing.numpy()[: self.pairs.count] > 0
            ]
            if not len(through):
                break
            strands = np.unique(strand_of[through])
            part[strands] = np.where(part[strands] > 0.5**HALVINGS, 0.5 * part[strands], 0.0)
            self.tally.held_back += len(strands)
            self._hold_part(part, whole)
            self._find_again(planes, constrained)
            self._locate_all()

    def _hold_part(self, part: np.ndarray, whole: wp.array) -> None:
        parts = wp.array(part[self._strands], dtype=wp.float64, device=self._launcher.device)
        inputs = [self._active, parts, self._rods, self._state, self._roots, whole]
        self._launch(self._kernels.hold_back, inputs, [self._scratch, self._position])

    def _largest(self, values: wp.array) -> float:
        """Over the strands solved, of (strand_count,)."""
        return float(values.numpy()[self._strands].max())

    def _products(self) -> float:
        return float(self._product.numpy()[: self._count].sum())

    def _launch(self, kernel: wp.Kernel, inputs: list[Any], outputs: list[Any]) -> None:
        self._launcher.launch(kernel, self._count, inputs, outputs, work_per_item=self._work)

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
        self._kept = _allocate_held(nodes * int(HELD_AN_EDGE), device)
        self._position, self._sought = (wp.zeros(nodes, dtype=wp.vec3d, device=device) for _ in range(2))
        self._stiffness = wp.zeros(nodes, dtype=wp.float64, device=device)
        self._inertia = wp.zeros(strands, dtype=self._real, device=device)
        self._product, self._furthest, self._stray = (
            wp.zeros(strands, dtype=wp.float64, device=device) for _ in range(3)
        )
        self._alpha, self._beta, self._relaxation = (
            wp.zeros(1, dtype=wp.float64, device=device) for _ in range(3)
        )
        self._strand = wp.array(self._layout.node_strand, dtype=wp.int32, device=device)
        self._definite = wp.zeros(strands, dtype=wp.int32, device=device)

    def _hold_pairs(self) -> None:
        """Room for as many meetings as there are pairs."""
        if self.pairs.count > self._room:
            self._room, device = 5 * self.pairs.count // 4, self._launcher.device
            self._meetings = Meetings()
            for name, dtype in MEETING_ARRAYS.items():
                setattr(self._meetings, name, wp.zeros(self._room, dtype=dtype, device=device))
        self._meetings.edges = self.pairs.pairs


def _allocate_held(slots: int, device: wp.Device) -> Held:
    held = Held()
    held.other = wp.full(slots, -1, dtype=wp.int32, device=device)
    held.pressure = wp.zeros(slots, dtype=wp.float64, device=device)
    held.traction = wp.zeros(slots, dtype=wp.vec3d, device=device)
    return held
