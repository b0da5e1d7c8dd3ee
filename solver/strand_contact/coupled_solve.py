"""Newton steps of all strands in contact, solved by conjugate gradients: host side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from plait.solver.contact.planes import ContactPlanes
from plait.solver.launch import Launcher
from plait.solver.strand_contact.attachments import Attachments
from plait.solver.strand_contact.coupled_kernels import coupled_kernels
from plait.solver.strand_contact.edge_contacts import EdgeContacts
from plait.solver.strand_contact.meeting_kernels import Ways
from plait.solver.strands.layout import Layout
from plait.solver.strands.scratch import allocate_coupled_scratch
from plait.solver.strands.types import rod_types

# Conjugate gradients end when the residual's norm under the preconditioner has fallen to this part, or when what
# is left would move a strand by less than this part of a segment.
LINEAR_TOLERANCE, SMALL = 0.01, 1.5e-3
MAX_LINEAR_ITERATIONS = 40
# The same where strands are free, as what is left is momentum lost; and where ties are stiff between strands, as
# the preconditioner hardly sees their common motion.
FREE_TOLERANCE, TIED_TOLERANCE, MAX_TIED_ITERATIONS = 1e-5, 1e-10, 400
# The energy left in a free strand may be that of a move by so many times what is left to move.
STIFF = 2.0
# How far strands out of play move: less than not at all, so that nothing between them changes.
AT_REST = -2.0
# Costs of a node in units of `Launcher.launch`; in an iteration of the linear solve.
NODE_WORK, ITERATION_WORK = 8, 1


class CoupledSolve:
    """Strands on their way through a substep, and Newton steps of those that are in play.

    position: (node_count,) vec3d [m] where nodes of the strands begun are now.
    stiffness: (node_count,) [N/m] what a node resists a contact by.
    ways: how strands have moved.
    left: (strand_count,) the step over its segments that each would take next by itself, after `linearise`.
    """

    def __init__(
        self,
        launcher: Launcher,
        layout: Layout,
        rods: Any,
        real: type,
        contacts: EdgeContacts,
        ties: Attachments | None,
    ) -> None:
        device, nodes, strands = launcher.device, layout.node_count, layout.strand_count
        self._launcher, self._layout, self._rods, self._real = launcher, layout, rods, real
        self._contacts, self._ties = contacts, ties
        self._kernels = coupled_kernels(real)
        self._scratch = allocate_coupled_scratch(real, nodes, device)
        self._krylov = self._kernels.Krylov()
        for name in ("direction", "image", "step"):
            setattr(self._krylov, name, wp.zeros(nodes, dtype=rod_types(real).vec4, device=device))
        self.position = wp.zeros(nodes, dtype=wp.vec3d, device=device)
        self.stiffness = wp.zeros(nodes, dtype=wp.float64, device=device)
        self._inertia = wp.zeros(strands, dtype=real, device=device)
        self._product, self.left = (wp.zeros(strands, dtype=wp.float64, device=device) for _ in range(2))
        self.ways = Ways()
        for name, count in (("moved", strands), ("stray", strands), ("travel", nodes)):
            setattr(self.ways, name, wp.zeros(count, dtype=wp.float64, device=device))
        self._alpha, self._beta, self._relaxation = (
            wp.zeros(1, dtype=wp.float64, device=device) for _ in range(3)
        )
        self._definite = wp.zeros(strands, dtype=wp.int32, device=device)
        self._couplings, self._room = self._kernels.Couplings(), -1
        self._work, self._iteration_work = (n * max(1, nodes // strands) for n in (NODE_WORK, ITERATION_WORK))
        self.iterations = 0

    # -- which strands -------------------------------------------------------------------------------------

    def begin(self, method: Any, state: Any, alone: Any, roots: Any) -> None:
        """A substep from `state`, without any strands yet. alone: where strands would go by themselves."""
        self._method, self._state, self._alone, self._roots = method, state, alone, roots
        self.strands = np.zeros(0, dtype=np.int32)
        self._pace = np.full(self._layout.strand_count, np.nan)
        self._last_moved = np.zeros(self._layout.strand_count)

    def take(self, near: np.ndarray) -> None:
        """Strands flagged in `near`, (strand_count,) bool, take part too, and all are in play."""
        strands = np.flatnonzero(near).astype(np.int32)
        new = np.setdiff1d(strands, self.strands, assume_unique=True)
        inputs = [self._hold(new), self._method, self._rods, self._state, self._roots]
        inputs += [self._contacts.lasting, self._alone, self._scratch]
        outputs = [self.position, self.stiffness, self._inertia, self.ways]
        self._launcher.launch(self._kernels.begin, len(new), inputs, outputs, work_per_item=self._work)
        self.strands = np.union1d(self.strands, strands).astype(np.int32)
        segment = self._layout.mean_segment[self.strands]
        stiffness = self.stiffness.numpy()[self._layout.first_node[self.strands + 1] - 2]
        # Twice the energy of a move by a segment under a point load; by SMALL segments of what has the least.
        self._energy = np.zeros(self._layout.strand_count)
        self._energy[self.strands] = stiffness * segment**2
        self._enough = SMALL**2 * float(self._energy[self.strands].min())

    def play(
        self, planes: ContactPlanes, constrained: bool, expected: wp.array, strands: np.ndarray | None = None
    ) -> None:
        """Newton steps from now on are of `strands`, of all if None; the others stay where they are."""
        self._playing = self.strands if strands is None else strands
        moved = self.ways.moved.numpy()
        self._last_moved = np.where(moved == AT_REST, self._last_moved, moved)
        if self.all_play:
            self.ways.moved.assign(self._last_moved)
            self._contacts.choose()
        else:
            self._scratch.solution.zero_()
            moved = np.full(self._layout.strand_count, AT_REST)
            moved[self._playing] = self._last_moved[self._playing]
            self.ways.moved.assign(moved)
            self._contacts.choose(moved != AT_REST)
        self._count, self._active = len(self._playing), self._hold(self._playing)
        self._constrained = constrained
        self._record(planes, constrained, expected)

    def _record(self, planes: ContactPlanes, constrained: bool, expected: wp.array) -> None:
        """What is launched again and again."""
        kernels, krylov, scratch, rods, active = (
            self._kernels,
            self._krylov,
            self._scratch,
            self._rods,
            self._active,
        )

        def prepare(
            kernel: wp.Kernel, inputs: list[Any], outputs: list[Any], work: int = self._work
        ) -> Callable[[], None]:
            return self._launcher.prepare(kernel, self._count, inputs, outputs, work_per_item=work)

        system = [active, rods, planes, constrained, self._roots, self._inertia]
        outputs = [krylov, self._product, self._definite, self.left]
        self._linearise = prepare(kernels.linearise, [*system, scratch], outputs)
        outputs = [scratch, krylov, self._product]
        self._descend = prepare(kernels.descend, [active, self._alpha, rods], outputs, self._iteration_work)
        room = [self._contacts.room, wp.float64(self._contacts.least_room)]
        inputs = [*system, self._relaxation, krylov, scratch, expected, *room]
        self._advance = prepare(kernels.advance, inputs, [self.position, self.ways])
        if self._ties is not None:
            contacts = self._contacts
            place = [self.position, self.stiffness, scratch, krylov]
            self._ties.prepare(*place, contacts.meetings, contacts.pairs.count)

    # -- a step --------------------------------------------------------------------------------------------

    def linearise(self) -> None:
        """Each strand's matrix and what is left to balance, with the contacts that press; what `left` then is."""
        contacts, launcher = self._contacts, self._launcher
        acting = [contacts.acting_first, contacts.acting, contacts.meetings]
        self._hold_contacts(contacts.acting_count)
        inputs = [self._active, *acting, self._rods]
        self._launch(self._kernels.gather, inputs, [self._scratch, self._couplings])
        if self._ties is not None:
            self._ties.gather()
        self._linearise()
        self._image = launcher.prepare(
            self._kernels.image,
            self._count,
            [self._active, self._rods, acting[0], self._couplings, self._scratch, self._beta],
            [self._krylov, self._product],
            work_per_item=self._iteration_work,
        )

    def step(self, relaxation: float) -> None:
        """One Newton step of all strands in play together, after `linearise`; `relaxation` of it is taken."""
        left = self._products()
        enough, iterations = LINEAR_TOLERANCE**2 * left, MAX_LINEAR_ITERATIONS
        if self._layout.free[self._playing].any():
            enough = FREE_TOLERANCE**2 * left
        elif self._ties is None:
            enough = max(enough, self._enough)
        if self._ties is not None and self._ties.joins_strands:
            enough, iterations = TIED_TOLERANCE**2 * left, MAX_TIED_ITERATIONS
        self._beta.zero_()
        for done in range(iterations):
            if done == 1 and self._constrained:
                # What surfaces push strands out by is stiff, and each strand's own matrix has taken it away:
                # beside it what strands do to each other would be too little to solve for.
                enough = min(enough, max(LINEAR_TOLERANCE**2 * left, self._enough))
            if left <= enough:
                break
            self._image()
            curvature = self._products()
            if self._ties is not None:
                curvature += self._ties.image()
            self._alpha.fill_(left / curvature)
            self._descend()
            before, left = left, self._products()
            self._beta.fill_(left / before)
            self.iterations += 1
        self._relaxation.fill_(relaxation)
        self._advance()
        fresh = self._playing[np.isnan(self._pace[self._playing])]
        if len(fresh):
            self._pace[fresh] = self.ways.moved.numpy()[fresh]

    def largest(self, values: wp.array) -> float:
        """Over the strands in play, of (strand_count,)."""
        return float(values.numpy()[self._playing].max())

    def settled_strands(
        self, part: float, least: np.ndarray | float, most: np.ndarray, together: bool
    ) -> np.ndarray:
        """(strand_count,) bool: those out of play, and those with no more `left` than `part` of their first step.

        least, most: (strand_count,) or one [segments], limits of that.
        together: than `part` of the longest first step of any in play.
        """
        settled = np.ones(self._layout.strand_count, dtype=bool)
        pace = self._pace[self._playing].max() if together else self._pace
        allowed = np.clip(part * pace, least, most)
        settled[self._playing] = (self.left.numpy() <= allowed)[self._playing]
        # What is stiff, as stretch is, may move little and yet hold much energy, which in a heap of free strands
        # nothing but contact takes up.
        energy = self._product.numpy()[: self._count] / self._energy[self._playing]
        enough = energy <= (STIFF * np.broadcast_to(allowed, settled.shape)[self._playing]) ** 2
        settled[self._playing] &= enough | ~self._layout.free[self._playing]
        return settled

    @property
    def all_play(self) -> bool:
        return len(self._playing) == len(self.strands)

    @property
    def playing_count(self) -> int:
        return len(self._playing)

    @property
    def solved(self) -> bool:
        """Whether every strand's matrix could be factored."""
        return bool(self._definite.numpy()[: self._count].all())

    def _products(self) -> float:
        return float(self._product.numpy()[: self._count].sum())

    # -- its end -------------------------------------------------------------------------------------------

    def hold_back(self, part: np.ndarray, whole: wp.array) -> None:
        """Strands go only `part`, (strand_count,), of their way to `whole`, from where roots alone carry them."""
        parts = wp.array(part[self.strands], dtype=wp.float64, device=self._launcher.device)
        inputs = [self._hold(self.strands), parts, self._rods, self._state, self._roots, whole]
        outputs = [self._scratch, self.position]
        launch = self._launcher.launch
        launch(self._kernels.hold_back, len(self.strands), inputs, outputs, work_per_item=self._work)

    def finish(self, result: Any) -> None:
        """The strands' state at the substep's end into `result`."""
        inputs = [self._hold(self.strands), self._method, self._rods, self._roots, self._scratch, self.position]
        launch = self._launcher.launch
        launch(self._kernels.finish, len(self.strands), inputs, [result], work_per_item=self._work)

    def _hold_contacts(self, count: int) -> None:
        """Room for what `count` contacts do, each counted at both its edges."""
        if count <= self._room:
            return
        types, self._room = rod_types(self._real), 5 * count // 4
        for name, dtype in (("other", wp.int32), ("place", types.vec2), ("block", types.mat33)):
            setattr(self._couplings, name, wp.zeros(self._room, dtype=dtype, device=self._launcher.device))

    def _launch(self, kernel: wp.Kernel, inputs: list[Any], outputs: list[Any]) -> None:
        self._launcher.launch(kernel, self._count, inputs, outputs, work_per_item=self._work)

    def _hold(self, strands: np.ndarray) -> wp.array:
        return wp.array(strands, dtype=wp.int32, device=self._launcher.device)
