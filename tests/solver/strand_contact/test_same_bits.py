"""The same bits from a run taken up again in mid-contact, and from any number of threads."""

from __future__ import annotations

import numpy as np

from plait.solver import launch
from plait.solver.step import Simulation

from . import scenes

TAKEN_UP, LAST = 4, 6  # frames; the bundles meet in the third


def start(threads: int = 1) -> Simulation:
    return scenes.tubes(strands=20, segments=30).start(threads=threads)


def play(simulation: Simulation, first: int, last: int) -> int:
    """Contacts that push at the end of frame `first`."""
    found = [simulation.advance_frame((k + 1) / scenes.FRAMES_PER_SECOND) for k in range(first, last)]
    return found[0]["strands"]["strand_contacts"]


def same(one: Simulation, other: Simulation) -> bool:
    a, b = one.state.to_numpy(), other.state.to_numpy()
    return all(np.array_equal(a[name], b[name]) for name in a)


def test_a_run_taken_up_in_mid_contact_goes_on_to_the_bit():
    """What a contact needs to go on, its forces and what they hold, is all in the state."""
    through, resumed = start(), start()
    play(through, 0, TAKEN_UP)
    resumed.state.restore(through.state.to_numpy())
    assert (resumed.state.arrays["strand_contact/other"].numpy() >= 0).sum() > 20
    assert play(through, TAKEN_UP, LAST) > 20
    play(resumed, TAKEN_UP, LAST)
    assert same(through, resumed)


def test_the_bits_do_not_depend_on_the_number_of_threads(monkeypatch):
    """Even with every launch shared between two threads, however small."""
    monkeypatch.setattr(launch, "MIN_WORK_A_THREAD", 1)
    one, two = start(1), start(2)
    assert play(one, 0, TAKEN_UP) == play(two, 0, TAKEN_UP) == 0
    assert play(one, TAKEN_UP, LAST) == play(two, TAKEN_UP, LAST) > 20
    assert same(one, two)
