"""Contact of elastic bodies within the implicit solve, as a shot runs it: mixed precision, few substeps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.solver.build import build
from plait.solver.scene import Scene
from plait.solver.settings import FleshSettings, GridSettings, Settings
from plait.solver.step import Simulation

from ..tets.lattices import placed
from .soft_scenes import floor
from .test_skin_contact import CUBE, boxes, turned

RATE = 192


def simulate(scene: Scene, integrator: str = "bdf2", threads: int = 1, **grid: object) -> Simulation:
    flesh = FleshSettings(integrator=integrator)
    return build(scene, Settings(threads=threads, flesh=flesh, grid=GridSettings(**grid)))


def advance(simulation: Simulation, steps: int) -> list[dict]:
    first = round(simulation.state.time * RATE)
    return [simulation.advance_frame((first + i + 1) / RATE, 1) for i in range(steps)]


def set_velocity(simulation: Simulation, body: int, velocity: np.ndarray) -> None:
    tets = simulation.model.parts["tets"]
    all_nodes = tets.velocity.numpy().copy()
    all_nodes[tets.layout.nodes(body)] = velocity
    tets.velocity.assign(all_nodes)


def momenta(simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    tets = simulation.model.parts["tets"]
    momentum = tets.layout.mass[:, None] * tets.velocity.numpy()
    return momentum.sum(axis=0), np.cross(tets.position.numpy(), momentum).sum(axis=0)


@pytest.mark.parametrize("motion", ["spinning", "vibrating"])
def test_a_lone_body_is_the_same_to_the_bit(motion):
    """With the contact stage on not one bit differs from contact off."""
    scene = boxes({**CUBE, "size": (0.3, 0.1, 0.05), "cells": (6, 2, 1)})
    results = []
    for contact in (True, False):
        simulation = simulate(scene)
        tets = simulation.model.parts["tets"]
        if not contact:
            tets._contact = None
        x = tets.nodes(0)
        spinning = np.cross([3.0, 5.0, 8.0], x)
        set_velocity(simulation, 0, spinning if motion == "spinning" else np.sin(20.0 * x[:, [1, 2, 0]]))
        advance(simulation, 40)
        results.append((tets.position.numpy().copy(), tets.velocity.numpy().copy()))
    for with_contact, without in zip(*results, strict=True):
        assert np.array_equal(with_contact, without)


@pytest.mark.parametrize("integrator", ["backward-euler", "bdf2"])
def test_oblique_impact_conserves(integrator):
    """Linear momentum to 1e-6 in mixed precision, angular to 1e-4, and no kinetic energy out of nothing."""
    scene = boxes(CUBE, {**CUBE, "transform": placed((0.03, 0.135, 0.02), turned((1, 2, 3), 25.0))})
    simulation = simulate(scene, integrator)
    set_velocity(simulation, 1, np.array([0.2, -1.0, 0.1]))
    momentum, spin = momenta(simulation)
    contacts = sum(frame["tets"]["skin_contacts"] for frame in advance(simulation, 24))
    after, spin_after = momenta(simulation)
    assert contacts > 0
    assert np.abs(after - momentum).max() <= 1e-6 * np.linalg.norm(momentum)
    assert np.abs(spin_after - spin).max() <= 1e-4 * np.linalg.norm(spin)
    tets = simulation.model.parts["tets"]
    kinetic = 0.5 * (tets.layout.mass[:, None] * tets.velocity.numpy() ** 2).sum()
    assert kinetic <= 0.5 * tets.layout.mass[tets.layout.nodes(1)].sum() * 1.05


@pytest.mark.parametrize("passes", [1, 2, 3])
def test_a_sleeping_body_feels_what_strikes_it(passes):
    """Also where the last pass of contact is the first to touch it: linear momentum to 1e-6."""
    scene = boxes(CUBE, {**CUBE, "transform": placed((0.0, 0.105, 0.0))})
    simulation = simulate(scene, "backward-euler", passes=passes)
    asleep = advance(simulation, 3)[-1]["tets"]["asleep"]
    set_velocity(simulation, 1, np.array([0.0, -1.0, 0.0]))
    simulation.state.arrays["tets/asleep"].assign(np.array([1, 0], dtype=np.int32))
    momentum, _ = momenta(simulation)
    contacts = sum(frame["tets"]["skin_contacts"] for frame in advance(simulation, 12))
    after, _ = momenta(simulation)
    assert asleep == 2 and contacts > 0
    assert np.abs(after - momentum).max() <= 1e-6 * np.linalg.norm(momentum)
    assert np.abs(simulation.model.parts["tets"].node_velocities(0)).max() > 0.1


@pytest.mark.parametrize("integrator", ["backward-euler", "bdf2"])
@pytest.mark.parametrize("young", [1e5, 1e7])
def test_a_block_dropped_on_one_that_stands_on_a_floor(integrator, young):
    """Corner down, and heavier: contact does no work, so energy never rises by more than a hundredth of it."""
    standing = {**CUBE, "cells": 2, "youngs_modulus": young, "transform": placed((0.0, 0.051, 0.0))}
    dropped = {**standing, "density": 3000.0, "transform": placed((0.02, 0.2, 0.01), turned((1, 0, 2), 40.0))}
    scene = boxes(standing, dropped, gravity=9.81)
    scene = replace(scene, surfaces=(*scene.surfaces, floor()))
    simulation = simulate(scene, integrator)
    set_velocity(simulation, 1, np.array([0.2, -3.0, 0.1]))
    contacts, energies = 0, []
    for frame in advance(simulation, 60):
        contacts += frame["tets"]["skin_contacts"]
        energies.append(sum(frame["tets"][f"{kind}_energy"] for kind in ("kinetic", "elastic", "potential")))
    rise = energies - np.minimum.accumulate(energies)
    assert contacts > 0
    assert rise.max() <= 0.01 * energies[0]


@pytest.mark.parametrize("young", [1e5, 1e7])
def test_what_rests_is_at_rest(young):
    """A block on a held one, soft or stiff: it stands still, its gap below half a cell, overlap below a tenth."""
    held = np.ones(5**3 + 4**3, dtype=bool)
    scene = boxes(
        {**CUBE, "cells": 4, "youngs_modulus": young, "transform": placed((0.012, 0.1005, 0.007))},
        {**CUBE, "size": (0.14, 0.1, 0.14), "cells": 4, "pinned": held},
        gravity=9.81,
    )
    simulation = simulate(scene)
    tets = simulation.model.parts["tets"]
    advance(simulation, 80)
    rest = tets.layout.rest[tets.layout.nodes(0)]
    low = np.isclose(rest[:, 1], rest[:, 1].min())
    before = tets.nodes(0)
    for _ in range(10):
        advance(simulation, 1)
        gap = tets.nodes(0)[low, 1] - 0.05
        cell = tets._contact.cell_size
        assert -0.1 * cell <= gap.min() and gap.max() <= 0.5 * cell
        # A hundredth of what gravity makes of it in a substep.
        assert np.linalg.norm(tets.node_velocities(0), axis=1).max() <= 0.01 * 9.81
    assert np.abs(tets.nodes(0) - before).max() <= 1e-3 * cell


def test_thin_plates_meet_at_ten_metres_a_second_in_long_steps():
    """Plates a tenth of a cell thick, five centimetres a substep: steps are halved, and nothing passes."""
    plate = {"size": (0.12, 0.004, 0.12), "cells": (5, 1, 5), "youngs_modulus": 1e6}
    scene = boxes({**plate, "transform": placed((0.01, 0.03, 0.005), turned((1, 0, 2), 7.0))}, plate)
    simulation = simulate(scene, cell_size=0.04)
    set_velocity(simulation, 0, np.array([0.0, -10.0, 0.0]))
    tets, taken = simulation.model.parts["tets"], 0
    for _ in range(4):
        taken += advance(simulation, 1)[0]["substeps"]
        upper, lower = (tets.nodes(body).mean(axis=0)[1] for body in (0, 1))
        assert upper > lower
    assert taken > 4
    assert tets.node_velocities(1).mean(axis=0)[1] < -1.0


def test_a_run_taken_up_again_goes_on_to_the_bit():
    """The state in the middle of an impact, restored into a new simulation, on other threads."""
    scene = boxes(CUBE, {**CUBE, "transform": placed((0.03, 0.105, 0.02))})
    first, second = simulate(scene), simulate(scene, threads=2)
    set_velocity(first, 1, np.array([0.2, -1.0, 0.1]))
    assert advance(first, 5)[-1]["tets"]["skin_contacts"] > 0
    second.state.restore(first.state.to_numpy())
    for simulation in (first, second):
        advance(simulation, 5)
    for name, array in first.state.arrays.items():
        assert np.array_equal(array.numpy(), second.state.arrays[name].numpy()), name
