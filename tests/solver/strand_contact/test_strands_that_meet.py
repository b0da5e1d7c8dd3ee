"""Strands in contact with strands: nothing passes through, nothing is torn, links and friction hold."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.benchmarks.strand_scenes import CAPSTAN_LOAD
from plait.solver.step import Simulation

from . import scenes
from .referee import Referee, braid_invariant, inside_convex, linking_matrix, section, section_area

FRAME = 1.0 / scenes.FRAMES_PER_SECOND


def curves(simulation: Simulation) -> np.ndarray:
    """(strand_count, point_count, 3) of the first prim, whose strands have as many points each."""
    stage, strands = simulation.model.parts["strands"], simulation.model.scene.strands[0]
    return stage.points(0).reshape(strands.strand_count, -1, 3)


SMALL, FULL = {"strands": 16, "segments": 24}, {"strands": 90, "segments": 60}
TUBES = [pytest.param(SMALL, 8, id="small"), pytest.param(FULL, 30, id="full", marks=pytest.mark.slow)]


@pytest.mark.parametrize(("size", "frames"), TUBES)
def test_tubes_do_not_pass_through_each_other(size, frames):
    """No collision missed on any substep that was committed; strain below 2 %, its median below .5 %."""
    simulation = scenes.tubes(**size).start()
    judge = Referee(simulation)
    medians = []
    for frame in range(frames):
        simulation.advance_frame((frame + 1) * FRAME)
        medians.append(np.median(np.abs(judge.strains())))
    assert judge.substeps >= 8 * frames
    assert judge.missed == 0
    assert judge.largest_strain < 0.02
    assert max(medians) < 0.005


def test_without_contact_the_tubes_pass_through_each_other():
    """Every upper strand through every lower one: what the test above would see if contact did nothing."""
    simulation = scenes.tubes(**SMALL).start("none")
    judge = Referee(simulation)
    for frame in range(5):
        simulation.advance_frame((frame + 1) * FRAME)
    assert judge.missed >= 8 * 8


CROSSINGS = [pytest.param(4, id="4 pairs"), pytest.param(30, id="30 pairs", marks=pytest.mark.slow)]


@pytest.mark.parametrize("pairs", CROSSINGS)
def test_fast_crossings_stop_without_gaining_energy(pairs):
    """At 5 to 20 m/s none passes, strain stays below 10 %, and energy, which nothing adds to, never rises."""
    case = scenes.crossing(pairs)
    simulation = case.start(substeps=1)
    mass = simulation.model.parts["strands"].layout.mass[simulation.model.parts["strands"].layout.point_node]
    judge = Referee(simulation)
    energies = [0.5 * float(mass @ (case.velocity**2).sum(axis=1))]
    for substep in range(12):
        found = simulation.advance_frame((substep + 1) * FRAME / 8)["strands"]
        energies.append(found["kinetic_energy"] + found["elastic_energy"])
    assert judge.missed == 0
    assert judge.largest_strain < 0.1
    # 1e-9 of the energy is the rounding of sums over nodes and of rest lengths.
    assert np.diff(energies).max() <= 1e-9 * energies[0]


HEADS = [
    pytest.param({"strands": 80, "segments": 12}, 8, id="small"),
    pytest.param({"strands": 300, "segments": 30}, 8, id="large", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("size", "frames"), HEADS)
def test_hair_on_a_shaken_head(size, frames):
    """Nothing passes through, no point is inside the head, strain below 3 %."""
    case = scenes.head(**size)
    ball = next(surface for surface in case.scene.surfaces if surface.name == "head")
    simulation = case.start()
    judge = Referee(simulation)
    for frame in range(frames):
        simulation.advance_frame((frame + 1) * FRAME)
        transform = scenes.head_transform((frame + 1) * FRAME)
        local = (simulation.model.parts["strands"].points(0) - transform[:3, 3]) @ transform[:3, :3]
        assert not inside_convex(local, ball.points, ball.triangles).any()
    assert judge.missed == 0
    assert judge.largest_strain < 0.03


BRAIDS = [
    pytest.param({"periods": 2, "segments": 40}, 4, id="small"),
    pytest.param({}, 100, id="full", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("size", "frames"), BRAIDS)
def test_a_braid_pulled_tight_stays_a_braid(size, frames):
    """Linking numbers stay; so does the braid itself from when its ends have been pulled apart on."""
    simulation = scenes.braid(**size).start()
    judge = Referee(simulation)
    away = scenes.braid_pull(curves(simulation))
    linked, braids = [linking_matrix(curves(simulation), away)], []
    for frame in range(frames):
        simulation.advance_frame((frame + 1) * FRAME)
        linked.append(linking_matrix(curves(simulation), away))
        braids.append(braid_invariant(curves(simulation)))
    assert judge.missed == 0
    assert (np.array(linked) == linked[0]).all()
    assert set(braids) == {braids[0]}
    # Ends moved apart can take away or add a crossing each, no more.
    assert abs(np.trace(np.reshape(braids[0][1], (2, 2)))) > 3


CAPSTANS = [
    pytest.param(0.3, 180.0),
    *(
        pytest.param(friction, angle, marks=pytest.mark.slow)
        for friction in (0.1, 0.3, 0.5)
        for angle in (90.0, 180.0, 360.0, 720.0)
        if (friction, angle) != (0.3, 180.0)
    ),
]


@pytest.mark.parametrize(("friction", "degrees"), CAPSTANS)
def test_capstan(friction, degrees):
    """T2 / T1 = exp(friction * angle), Euler and Eytelwein, within 2 % while the strand slides."""
    simulation = scenes.capstan(friction, np.radians(degrees)).start()
    ratios = []
    for frame in range(16):
        simulation.advance_frame((frame + 1) * FRAME)
        pull = simulation.state.arrays["strands/tension"].numpy()[2]  # of the second edge; the first is clamped
        ratios.append(pull / CAPSTAN_LOAD)
    assert np.mean(ratios[8:]) == pytest.approx(np.exp(friction * np.radians(degrees)), rel=0.02)


@pytest.mark.slow
def test_a_bundle_keeps_its_section():
    """Landed, the hull of its strands' discs is no less than their sum, and no more than 1.5 times that."""
    simulation = scenes.landing().start()
    judge = Referee(simulation)
    radius = scenes.TUBE.radius + 0.5 * scenes.TUBE_THICKNESS
    for frame in range(48):
        simulation.advance_frame((frame + 1) * FRAME)
    assert judge.missed == 0
    for x in (0.1, 0.2):
        places = section(curves(simulation), np.array([x, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
        own = len(places) * np.pi * radius**2
        assert len(places) == 37
        assert own <= section_area(places, radius) <= 1.5 * own


def test_strands_that_never_meet_are_left_alone():
    """Bit for bit as without contact, for no more than one launch a substep."""
    runs = [scenes.alone(strands=4).start(method) for method in ("none", "implicit")]
    launches = []
    for simulation in runs:
        found = [simulation.advance_frame((frame + 1) * FRAME)["launches"]["strands"] for frame in range(3)]
        launches.append(found[1:])  # the first frame may prepare
    for name, array in runs[0].state.arrays.items():
        assert np.array_equal(array.numpy(), runs[1].state.arrays[name].numpy()), name
    assert (np.array(launches[1]) - launches[0] <= 8).all()


def test_one_strand_alone_has_no_contact():
    """Not even the search for pairs: the same launches as without."""
    simulations = [scenes.alone(strands=1).start(method) for method in ("none", "implicit")]
    first, second = (simulation.advance_frame(FRAME)["launches"] for simulation in simulations)
    assert first == second
