"""Bodies at rest cost nothing, and wake when something happens; which bodies are looked at."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from ..contact.soft_scenes import floor
from ..tets.lattices import keyed, placed
from .rigid_scenes import FRAME, Rigid, box, shaped


def stack(*more, obstacles=None) -> Rigid:
    """Three boxes, one on the other, at rest long enough to sleep."""
    boxes = [box(centre=(0.0, 0.1 + 0.2 * k, 0.0)) for k in range(3)]
    scene = Rigid([*boxes, *more], obstacles or [floor()])
    metrics = scene.run(1.5)
    assert metrics["asleep"] == 3
    return scene


def test_what_sleeps_stays_and_is_not_solved():
    scene = stack()
    position = scene.position
    metrics = scene.run(1.0)
    assert np.array_equal(scene.position, position)
    assert not scene.velocity.any() and not scene.spin.any()
    assert metrics["sweeps_max"] == 0 and metrics["unconverged"] == 0


def test_what_is_struck_wakes_with_all_that_it_touches():
    """By an impulse at the top one's side, twice its weight for a tenth of a second: it slides off."""
    scene = stack()
    impulse = np.zeros((3, 3))
    impulse[2, 0] = 2.0 * 9.81 * 0.1 * scene.mass[2]
    scene.stage.impulse.assign(impulse)
    metrics = scene.substep()
    assert metrics["asleep"] == 0
    scene.run(1.0)
    assert scene.position[2, 0] > 0.1


def test_what_it_stood_on_being_taken_away_it_falls():
    """The lowest box is struck out: those above end a box's height lower."""
    scene = stack()
    impulse = np.zeros((3, 3))
    impulse[0, 0] = 20.0 * scene.mass[0]
    scene.stage.impulse.assign(impulse)
    scene.run(1.0)
    assert scene.position[2, 1] < 0.45


def test_a_floor_that_moves_wakes_what_is_on_it():
    """It rises by 10 cm from 2 s to 2.5 s."""
    motion = keyed([0.0, 2.0, 2.5], [placed(), placed(), placed((0.0, 0.1, 0.0))])
    scene = stack(obstacles=[floor(motion=motion)])
    scene.run(2.0)
    assert scene.position[:, 1] == pytest.approx([0.2, 0.4, 0.6], abs=2e-3)


def test_a_body_that_lands_on_sleepers_wakes_them():
    """A ball let fall from so high that it lands after they have fallen asleep."""
    scene = stack(shaped("sphere", 0.1, (0.02, 0.7 + 0.5 * 9.81 * 1.6**2, 0.0)))
    asleep = [scene.substep()["asleep"] for _ in range(48)]
    assert asleep[0] == 3 and min(asleep) == 0


def test_what_turns_slowly_in_place_does_not_sleep():
    """A top on its axis, at half a radian a second."""
    scene = Rigid([shaped("sphere", 0.1, (0.0, 0.1, 0.0), angular_velocity=[0.0, 0.5, 0.0])], [floor()])
    scene.run(1.0)
    assert scene.spin[0, 1] == pytest.approx(0.5, rel=1e-3)


def test_a_state_saved_in_sleep_goes_on_with_the_same_bits():
    scene = stack()
    held = scene.simulation.state.to_numpy()
    other = Rigid([box(centre=(0.0, 0.1 + 0.2 * k, 0.0)) for k in range(3)], [floor()])
    other.simulation.state.restore(held)
    for each in (scene, other):
        each.run(2 * FRAME)
        impulse = np.zeros((3, 3))
        impulse[1, 0] = 10.0
        each.stage.impulse.assign(impulse)
        each.run(0.25)
    assert np.array_equal(scene.position, other.position)


def test_all_pairs_of_balls_that_are_near_are_found_and_no_others():
    """Of sixty at random places, spread out along one axis or another, against distances between all."""
    random = np.random.default_rng(5)
    centres = random.uniform(-0.5, 0.5, size=(60, 3)) * [1.0, 0.6, 0.8]
    for turn in (centres, centres[:, [1, 2, 0]], centres[::-1]):
        scene = Rigid([shaped("sphere", 0.1, centre) for centre in turn], gravity=(0.0, 0.0, 0.0))
        scene.substep()
        contact = scene.stage.contact
        counts, partner = contact.contacts.count.numpy(), contact.contacts.geom.numpy()
        first = contact.table.first_slot
        found = {tuple(sorted((a, int(b)))) for a in range(60) for b in partner[first[a] : first[a] + counts[a]]}
        margin = contact.table.geoms.margin.numpy()[0]
        near = {(a, b) for a, b in combinations(range(60), 2) if np.linalg.norm(turn[a] - turn[b]) - 0.2 <= margin}
        assert found == near and near
