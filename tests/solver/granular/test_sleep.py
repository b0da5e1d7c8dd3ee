"""Grains at rest sleep, out of reach of what moves, and wake when it comes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.solver.build import build
from plait.solver.granular.activity import Activity
from plait.solver.scene import KeyedMotion, Scene
from plait.solver.settings import GranularSettings, Settings

from .heaps import CELL, FRAME, granular, in_order, lattice, matter, plate, run, simulated
from .test_stage import box_inside, heap

LENGTH = 48  # cells of a trough, 4 wide and deep
NEVER = GranularSettings(still=0.0)


def trough(*surfaces) -> Scene:
    size = (LENGTH * CELL, 1.0, 4 * CELL)
    sand = heap(lattice((LENGTH, 4, 4)), youngs_modulus=1e6, density=1600.0)
    return Scene(surfaces=(box_inside(size, friction=0.5), *surfaces), granular=(sand,))


def asleep(scene: Scene, frames: int = 48):
    simulation = simulated(scene)
    metrics = run(simulation, frames)
    assert metrics[-1]["awake"] == 0 and metrics[-1]["steps"] == 0
    return simulation


def test_a_heap_at_rest_costs_no_step_and_stays():
    """All of it sleeps; nothing is launched but the frame's sorting and its sums, and no grain moves."""
    simulation = asleep(trough())
    places = simulation.model.parts["granular"].grains(0).positions
    before = simulation.model.launcher.launches["granular"]
    run(simulation, 1)
    fields = len(simulation.model.parts["granular"].matter.types.Particles.vars)
    assert simulation.model.launcher.launches["granular"] - before <= fields + 4
    np.testing.assert_array_equal(simulation.model.parts["granular"].grains(0).positions, places)


@pytest.fixture(scope="module")
def resting() -> dict[str, np.ndarray]:
    """The state of a trough of sand, asleep, of which the first 4 cells have just been thrown on."""
    state = asleep(trough()).state
    held = state.to_numpy()
    struck = held["granular/position"][:, 0] < 4 * CELL
    held["granular/velocity"][struck] = [1.5, 0.5, 0.0]
    held["granular/rest"][struck] = 0.0
    return held


def struck(kept: dict[str, np.ndarray], frames: int, **settings):
    simulation = simulated(trough(), **settings)
    simulation.state.restore(kept)
    return simulation, run(simulation, frames)


def test_what_is_hit_wakes_and_moves_as_if_it_had_not_slept(resting):
    """Momentum given to a sleeping heap goes through it as through one that never slept.

    Where grains sleep the other run may move by as much as counts as rest: `still` sqrt(g dx) for so long. Of what
    the blow moves, in all, that is the error; the far end sleeps all the while.
    """
    frames = 6
    simulation, metrics = struck(resting, frames)
    never, _ = struck(resting, frames, granular=NEVER)
    found, expected = (s.model.parts["granular"].matter for s in (simulation, never))
    assert 0 < metrics[-1]["awake"] < metrics[-1]["blocks"]
    moved = [in_order(m, "position")[:, 0] for m in (found, expected)]
    rest = GranularSettings().still * np.sqrt(9.81 * CELL) * frames * FRAME
    assert np.abs(moved[0] - moved[1]).mean() < rest
    number = resting["granular/number"]
    start = np.empty_like(moved[0])
    start[number] = resting["granular/position"][:, 0]
    way = [x - start for x in moved]
    assert way[1].mean() * len(start) > 0.0
    assert way[0].sum() == pytest.approx(way[1].sum(), rel=0.05)


def test_a_surface_that_comes_wakes_what_it_meets():
    """A plate that sinks into the sand at one end displaces it; the other end sleeps on."""
    times = np.array([0.0, 48 * FRAME, 60 * FRAME])
    keys = np.tile(np.eye(4), (3, 1, 1, 1)).reshape(3, 1, 4, 4)
    keys[:, 0, 1, 3] = 8 * CELL, 8 * CELL, 2 * CELL
    stamp = replace(plate(4 * CELL, (0.0, -1.0, 0.0)), motion=KeyedMotion(times, keys))
    simulation = asleep(trough(stamp))
    stage = simulation.model.parts["granular"]
    before = stage.grains(0).positions
    metrics = run(simulation, 12)
    pressed = (before[:, 0] < 2 * CELL) & (before[:, 1] > 3 * CELL)
    assert np.abs(stage.grains(0).positions - before)[pressed].max(axis=1).mean() > 0.5 * CELL
    far = before[:, 0] > 40 * CELL
    np.testing.assert_array_equal(stage.grains(0).positions[far], before[far])
    assert 0 < metrics[-1]["awake"] < metrics[-1]["blocks"]


def test_nodes_gathered_from_have_all_their_mass_and_momentum():
    """With one block of a row awake, its particles and those beside it gather what they would if all were.

    What sleeps stands.
    """
    places = lattice((40, 4, 4))
    near = places[:, 0] < 8 * CELL
    velocity = np.where(near[:, None], np.random.default_rng(0).normal(size=places.shape), 0.0)
    values = []
    for still in (False, True):
        held = matter(granular(places, velocity))
        held.sort()
        if still:
            told = held._told.numpy()
            told[:, 2] = np.inf
            told[held.grid.data.origin.numpy()[:, 0] == -1, 2] = 0.0
            held._told.assign(told)
            held._rest = 1.0
        held.to_grid(1e-3)
        held.to_velocities()
        assert held.to_particles()
        values.append((in_order(held, "velocity"), in_order(held, "affine")))
    for all_awake, one_awake in zip(*values, strict=True):
        np.testing.assert_array_equal(one_awake[near], all_awake[near])


def test_same_bits_with_any_number_of_threads_and_taken_up_again(resting):
    runs = []
    for threads in (1, 2):
        simulation = build(trough(), Settings(threads=threads, substeps=2))
        simulation.state.restore(resting)
        run(simulation, 2)
        if threads == 2:
            kept = simulation.state.to_numpy()
            simulation = simulated(trough())
            simulation.state.restore(kept)
        run(simulation, 2)
        runs.append(simulation.state.to_numpy())
    for name, values in runs[0].items():
        np.testing.assert_array_equal(runs[1][name], values, err_msg=name)


def test_activity_is_forgotten_with_the_order():
    held = matter(granular(lattice((8, 4, 4)), np.zeros((8 * 4 * 4 * 8, 3))))
    held.sort()
    activity = Activity(held.grid)
    activity.forget()
    everything = np.ones(held.grid.block_count, dtype=bool)
    assert activity.choose(everything) and not activity.choose(everything)
