"""Contact of strands with strands, inside the strands' own implicit solve: a substep's course."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from plait.solver.contact.planes import ContactPlanes
from plait.solver.model import Interval, Model
from plait.solver.state import State
from plait.solver.strand_contact.attachments import Attachments
from plait.solver.strand_contact.coupled_solve import CoupledSolve
from plait.solver.strand_contact.edge_contacts import EdgeContacts
from plait.solver.strand_contact.meeting_kernels import CROSSING, DEEP
from plait.solver.strands.layout import Layout

# A pass that moves no node further than this part of a segment leaves contact forces that are worth holding.
CALM = 0.003
# A strand is where it is to be when another pass would move it by less than this part of what the first one did,
# from so little of a segment to so much. After some passes, by less than this part of what the first did to any.
SETTLED, STILL, ADRIFT, PATIENT = 0.02, 0.003, 0.03, 3
# That much may be this part of the distance that strands keep, where segments are shorter.
ADRIFT_ACROSS = 0.06
# After so many passes contacts of strands that move less than this part of a segment keep their places.
FREE_PLACES, STEADY = 3, 0.2
# Strands that are not settled go on alone, with those that they push, where these are less than this part of all.
FEW = 0.5
# Passes with full steps; what then still goes to and fro is damped in every other pass, of which none is the last:
# it leaves stretch.
UNRELAXED, RELAXED = 5, 0.6
# After so many passes the most is enough; after so many contacts may be out of place, but not deep.
ENOUGH, LENIENT = 6, 10
# A pass of some strands counts for their part of all; yet no more than so many times as many are made.
MANY = 3
# Strands that would go further through each other than this part of a segment take shorter steps at once.
FURTHEST = 1.0
# As a last resort strands go half, a quarter, ... of their way, so often, then none of it.
HALVINGS = 6
# Nodes have room to stray from where pairs are found for, over the distance that strands keep.
ROOM = 0.25
# And over the way that gravity makes in a substep, which contact may or may not take away.
FALL = 1.25


@dataclass
class Tally:
    """Of a frame: Newton passes, iterations of their linear solves, most passes in a substep, strands
    that were held back as a last resort."""

    passes: int = 0
    linear_iterations: int = 0
    most_passes: int = 0
    held_back: int = 0


class StrandContact:
    """Strands that come near each other in a substep, or are attached, are solved again, all at once."""

    def __init__(self, model: Model, state: State, layout: Layout, rods: Any, real: type) -> None:
        self._launcher, self._layout, self._rods, self._real = model.launcher, layout, rods, real
        self._settings = model.settings.strand_contact
        self._in_contact = self._settings.method == "implicit" and layout.strand_count > 1
        self._gravity = float(np.linalg.norm(model.scene.gravity))
        self.contacts = EdgeContacts(model, state, layout)
        self.ties = Attachments(model, state, layout, real) if model.scene.attachments else None
        self._solve: CoupledSolve | None = None
        self._meets = False
        self._passes = 0
        self._calm, self._settled = CALM, False
        self.tally = Tally()

    def begin_frame(self) -> None:
        self.tally = Tally()

    @property
    def meets(self) -> bool:
        """Whether strands were near each other in the last substep."""
        return self._in_contact and self._meets

    @property
    def _near(self) -> np.ndarray:
        """(strand_count,) bool, strands that are near others or attached."""
        near = self.contacts.pairs.near
        return near if self.ties is None else near | self.ties.near

    @property
    def attached(self) -> np.ndarray | bool:
        """(strand_count,) bool, strands that something holds besides their roots."""
        return False if self.ties is None else self.ties.near

    @property
    def solved(self) -> np.ndarray:
        """(strand_count,) bool: the strands that `solve` moves."""
        solved = np.zeros(self._layout.strand_count, dtype=bool)
        solved[self._solve.strands] = True
        return solved

    def begin_substep(self, substep: Interval, position: wp.array) -> None:
        """Notes what is attached. position: (node_count,) vec3d [m] at the start."""
        if self.ties is not None:
            self.ties.begin_substep(substep, position)

    def find(self, held: Any, result: Any, length: float) -> bool:
        """Whether strands are attached, or near others in a substep of `length` [s] from `held` on.

        result: where they would go by themselves.
        """
        self._expected = result.position
        meets = False
        if self._in_contact:
            room = max(ROOM * self.contacts.widest, FALL * self._gravity * length**2)
            meets, self._expected = self.contacts.find(held, result, length, room)
            if not meets and self._meets:
                self.contacts.forget()
        self._meets, self._passes = meets, 0
        return meets or (self.ties is not None and self.ties.count > 0)

    def begin(self, method: Any, held: Any, result: Any, roots: Any) -> None:
        """From the substep's start, `held`, for the strands found near each other on their way to `result`."""
        if self._solve is None:
            self._solve = CoupledSolve(
                self._launcher, self._layout, self._rods, self._real, self.contacts, self.ties
            )
        self._start = held.position
        self._solve.begin(method, held, result, roots)
        self._solve.take(self._near)
        self.contacts.recall()

    def solve(self, result: Any, planes: ContactPlanes, constrained: bool, last_resort: bool) -> bool:
        """Solves the strands near each other into `result`; whether that stands.

        After `begin`; again from where it ended, with other planes, as often as need be. As a last resort what is
        still going through something is held back, and all stands.
        """
        solve, self._surfaces = self._solve, (planes, constrained)
        before, most = solve.iterations, self._settings.passes
        solve.play(planes, constrained, self._expected)
        self._settled = stands = full = False
        done, spent = 0, 0.0
        while True:
            self._find_places(done)
            if done == 1 and not last_resort and self._too_fast():
                break
            stands = self._balance(done, full)
            if stands or spent >= most or done == MANY * most:
                break
            if done >= FREE_PLACES and self.ties is None:
                self._let_others_be(done)
            full = done < UNRELAXED or done % 2 == 1
            solve.step(1.0 if full else RELAXED)
            spent += solve.playing_count / len(solve.strands)
            if self.ties is not None:
                self.ties.hold()
            done += 1
        self._passes += done
        self.tally.passes += done
        self.tally.linear_iterations += solve.iterations - before
        if not stands and last_resort:
            self._hold_back()
            stands = True
        solve.finish(result)
        if self._in_contact:
            self.contacts.make_room(self._expected, result.position)
        return stands

    def crossed(self, position: wp.array) -> bool:
        """Whether strands go through each other between the substep's start and `position`."""
        wp.copy(self._solve.position, position)
        self._find_again(elsewhere=True)
        self._locate()
        return len(self.contacts.crossing()) > 0

    def commit(self) -> None:
        """The substep stands: its contacts are those to go on from."""
        if self._meets:
            self.contacts.commit(self._start, self._solve.position, self._solve.ways, self._calm)
        if self.ties is not None:
            self.ties.commit()
        self.tally.most_passes = max(self.tally.most_passes, self._passes)

    def end_frame(self) -> dict[str, Any]:
        """Metrics: contacts that push at the frame's end, the least distance of surfaces [m], passes, strands held
        back."""
        contacts, least = 0, None
        if self.meets:
            count, meetings = self.contacts.pairs.count, self.contacts.meetings
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

    # -- a pass --------------------------------------------------------------------------------------------

    def _locate(self, steady: float = 0.0) -> None:
        """Where pairs and ties are now."""
        solve = self._solve
        self.contacts.locate(solve.stiffness, solve.ways, steady, self._start, solve.position)
        if self.ties is not None:
            self.ties.measure()

    def _find_places(self, done: int) -> None:
        """Where strands touch after so many passes; with pairs found again, if they have gone astray."""
        if done and self._solve.largest(self._solve.ways.stray) > 1.0:
            self._find_again()
        self._locate(STEADY if done >= FREE_PLACES else 0.0)
        if not self._passes and not done:
            self.contacts.pass_on()

    def _balance(self, done: int, full: bool) -> bool:
        """Forces and matrices where strands are after so many passes; whether they may stay there.

        full: the last pass was not damped.
        """
        solve = self._solve
        if done:
            # Where all is in balance nothing else brings contacts into place.
            self._calm = np.inf if self._settled else CALM
            self.contacts.hold(self._start, solve.position, solve.ways, self._calm)
        self.contacts.press(self._start, solve.position)
        solve.linearise()
        self._settled = bool(done) and self._in_balance(done)
        stands = self._settled and full and self._in_place(done)
        if stands and not solve.all_play:
            solve.play(*self._surfaces, self._expected)
            solve.linearise()
            self._settled = self._in_balance(done)
            stands = self._settled and self._in_place(done)
        return stands

    def _in_balance(self, done: int) -> bool:
        """Whether every strand in play is."""
        return self._solve.solved and bool(self._solve.settled_strands(*self._tolerance(done)).all())

    def _in_place(self, done: int) -> bool:
        """Whether every strand went through none, is in place and keeps to what it is tied to."""
        faults = self.contacts.faults()
        fault = int(np.bitwise_or.reduce(faults)) if len(faults) else 0
        tied = self.ties is None or self.ties.hold_exactly
        return tied and (fault == 0 or (done >= LENIENT and fault & int(CROSSING | DEEP) == 0))

    def _let_others_be(self, done: int) -> None:
        """Only strands that are not settled go on, with those that they push, where these are few."""
        solve, meetings = self._solve, self.contacts.meetings
        chosen = self.contacts.chosen
        restless = ~solve.settled_strands(*self._tolerance(done))
        strands = self._layout.node_strand[self.contacts.pairs.pairs.numpy()[chosen]]
        restless[strands[self.contacts.faults()[chosen] > 0]] = True
        pushing = strands[meetings.acts.numpy()[chosen] > 0]
        beside = restless.copy()
        beside[pushing[restless[pushing].any(axis=1)]] = True
        if 0 < beside.sum() < FEW * solve.playing_count:
            solve.play(*self._surfaces, self._expected, np.flatnonzero(beside).astype(np.int32))
            solve.linearise()

    def _tolerance(self, done: int) -> tuple[float, np.ndarray | float, np.ndarray, bool]:
        """What `settled_strands` asks for after so many passes."""
        most = np.maximum(ADRIFT, ADRIFT_ACROSS * self.contacts.widest / self._layout.mean_segment)
        return SETTLED, most if done >= ENOUGH else STILL, most, done >= PATIENT

    def _too_fast(self) -> bool:
        """Whether strands now go further through each other than passes can put right."""
        meetings = self.contacts.meetings
        through = np.flatnonzero(self.contacts.faults() & int(CROSSING))
        edges = meetings.edges.numpy()[through]
        segment = self._layout.mean_segment[self._layout.node_strand[edges]].min(axis=1)
        return bool((-meetings.gap.numpy()[through] > FURTHEST * segment).any())

    def _find_again(self, *, elsewhere: bool = False) -> None:
        """Strands have left the places for which pairs were found; `elsewhere`: not by steps."""
        solve = self._solve
        nodes = self.solved[self._layout.node_strand]
        places = np.where(nodes[:, None], solve.position.numpy(), self._expected.numpy())
        if self._in_contact:
            meets, self._expected = self.contacts.find_again(self._start, self._expected, places, elsewhere)
            self._meets = meets or self._meets
            self.contacts.resume(elsewhere)
        solve.take(self._near)
        solve.play(*self._surfaces, self._expected)

    def _hold_back(self) -> None:
        """Strands that still go through others go less far, in the end no further than their roots carry them."""
        whole = wp.clone(self._solve.position)
        part = np.ones(self._layout.strand_count)
        while True:
            strands = np.unique(self._layout.node_strand[self.contacts.crossing()])
            strands = strands[part[strands] > 0.0]
            if not len(strands):
                break
            part[strands] = np.where(part[strands] > 0.5**HALVINGS, 0.5 * part[strands], 0.0)
            self.tally.held_back += len(strands)
            self._solve.hold_back(part, whole)
            known = self.solved
            self._find_again(elsewhere=True)
            new = (self.solved & ~known)[self._layout.node_strand]
            whole.assign(np.where(new[:, None], self._solve.position.numpy(), whole.numpy()))
            self._locate()
