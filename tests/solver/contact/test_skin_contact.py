"""Elastic bodies against each other and themselves, on an explicit elastic step that conserves momentum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.solver.scene import Scene

from ..tets.lattices import box_body, box_lattice, placed, tet_body, turn
from .explicit import Explicit

# Grid cells per edge of the tets.
RATIOS = [0.25, 0.5, 1.0, 2.0]


def boxes(*specs: dict, gravity: float = 0.0) -> Scene:
    made = [box_body(index=i, surface=i, name=f"box {i}", **spec) for i, spec in enumerate(specs)]
    bodies, skins = zip(*made, strict=True)
    return Scene(surfaces=skins, bodies=bodies, gravity=np.array([0.0, -gravity, 0.0]))


def turned(axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    return turn(np.array(axis) / np.linalg.norm(axis), np.radians(degrees))


def edge(scene: Scene) -> float:
    return float(Explicit(scene, contact=False).layout.edge.mean())


CUBE = {"size": (0.1, 0.1, 0.1), "cells": 3, "youngs_modulus": 1e5}


# -- what must not be touched ------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", ["spinning", "vibrating"])
def test_a_lone_body_is_the_same_to_the_bit(motion):
    """With contact on not one bit differs from contact off, whatever the body does by itself."""
    scene = boxes({**CUBE, "size": (0.3, 0.1, 0.05), "cells": (6, 2, 1)})
    bodies = [Explicit(scene), Explicit(scene, contact=False)]
    for body in bodies:
        x = body.position
        if motion == "spinning":
            body.velocity[:] = np.cross([30.0, 50.0, 80.0], x)
        else:
            body.velocity[:] = 10.0 * np.sin(20.0 * x[:, [1, 2, 0]])
    step = bodies[0].wave_step()
    for _ in range(150):
        assert not bodies[0].step(step)
        bodies[1].step(step)
    assert np.array_equal(bodies[0].position, bodies[1].position)
    assert np.array_equal(bodies[0].velocity, bodies[1].velocity)


def test_a_body_does_not_feel_others_that_collide():
    """Two blocks meet; a third one elsewhere moves as if it were alone, to the bit."""
    far = {**CUBE, "transform": placed((5.0, 0.0, 0.0))}
    pair = [CUBE, {**CUBE, "transform": placed((0.02, 0.105, 0.01))}]
    together, alone = Explicit(boxes(*pair, far)), Explicit(boxes(far))
    third = together.nodes(2)
    for body, nodes in ((together, third), (alone, slice(None))):
        body.velocity[nodes] = np.cross([10.0, 20.0, 30.0], body.position[nodes] - [5.0, 0.0, 0.0])
    together.velocity[together.nodes(1)] = [0.0, -1.0, 0.0]
    step = alone.wave_step()
    assert any([together.step(step) for _ in range(60)])
    for _ in range(60):
        alone.step(step)
    assert np.array_equal(together.position[third], alone.position)
    assert np.array_equal(together.velocity[third], alone.velocity)


def test_blocks_pulled_apart_feel_nothing():
    """Two blocks that touch and part: the impulse is exactly zero."""
    pair = Explicit(boxes(CUBE, {**CUBE, "transform": placed((0.0, 0.1, 0.0))}))
    pair.velocity[pair.nodes(1)] = [0.3, 0.5, 0.0]
    step = pair.wave_step()
    for _ in range(30):
        pair.step(step)
        assert not pair.impulse.any()


def test_skins_that_overlap_from_the_start_are_left_alone():
    """What begins inside another body belongs there: no impulse at rest, and none as one is pulled out."""
    pair = Explicit(boxes(CUBE, {**CUBE, "transform": placed((0.03, 0.06, 0.02))}))
    step = pair.wave_step()
    for speed in (0.0, 0.2):
        pair.velocity[pair.nodes(1)] = [0.0, speed, 0.0]
        for _ in range(30):
            pair.step(step)
            assert not pair.impulse.any()


def test_what_does_not_collide_is_passed_through():
    """A skin with `collides` off touches nothing, and its body is as fast afterwards."""
    scene = boxes(CUBE, {**CUBE, "transform": placed((0.0, 0.12, 0.0))})
    scene = replace(scene, surfaces=(scene.surfaces[0], replace(scene.surfaces[1], collides=False)))
    pair = Explicit(scene)
    assert (pair.contact.particles.mass[pair.contact.particles.body == 1] == 0.0).all()
    pair.velocity[pair.nodes(1)] = [0.0, -1.0, 0.0]
    step = pair.wave_step(0.5)
    while pair.time < 0.05:
        assert not pair.step(step)
    np.testing.assert_allclose(pair.velocity[pair.nodes(1)], np.tile([0.0, -1.0, 0.0], (64 + 27, 1)), atol=1e-9)


# -- impacts -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.5, 2.0])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_oblique_impact_conserves(ratio, friction):
    """Equal and opposite impulses, along the line between their points or in one point: both momenta stay.

    Energy is lost only, up to what the explicit elastic step itself gains and loses again: a hundredth.
    """
    block = {**CUBE, "friction": friction}
    scene = boxes(block, {**block, "transform": placed((0.03, 0.135, 0.02), turned((1, 2, 3), 25.0))})
    pair = Explicit(scene, cell_size=ratio * edge(scene))
    pair.velocity[pair.nodes(1)] = [0.2, -1.0, 0.1]
    momentum, spin, energy = pair.momentum(), pair.angular_momentum(), pair.energy()
    step = pair.wave_step(0.25)
    touched = False
    for _ in range(int(0.1 / step)):
        pair.step(step)
        touched |= bool(pair.impulse.any())
        assert pair.energy() <= 1.01 * energy
    assert touched and pair.velocity[pair.nodes(0)].mean(axis=0)[1] < -0.2
    assert np.abs(pair.momentum() - momentum).max() <= 1e-6 * np.linalg.norm(momentum)
    assert np.abs(pair.angular_momentum() - spin).max() <= 1e-4 * np.linalg.norm(spin)


@pytest.mark.parametrize("ratio", RATIOS)
def test_equal_bars_head_on(ratio):
    """Two equal elastic bars exchange velocities; they touch while a wave runs there and back, 2 L / c.

    One-dimensional waves: Poisson's ratio is zero.
    """
    length, young, speed = 1.0, 1e6, 0.5
    bar = {"size": (length, 0.1, 0.1), "cells": (20, 2, 2), "youngs_modulus": young, "poissons_ratio": 0.0}
    scene = boxes(bar, {**bar, "transform": placed((length + 0.002, 0.0, 0.0))})
    bars = Explicit(scene, cell_size=ratio * edge(scene))
    bars.velocity[bars.nodes(0), 0], bars.velocity[bars.nodes(1), 0] = speed / 2, -speed / 2
    step, period = bars.wave_step(0.5), 2.0 * length / np.sqrt(young / 1000.0)
    touching = []
    while bars.time < 1.4 * period:
        bars.step(step)
        if bars.impulse.any():
            touching.append(bars.time)
    mass = bars.layout.mass
    after = [np.average(bars.velocity[bars.nodes(b), 0], weights=mass[bars.nodes(b)]) for b in (0, 1)]
    assert after[1] - after[0] >= 0.94 * speed
    assert touching[-1] - touching[0] + step == pytest.approx(period, rel=0.05)


# -- resting and sliding -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [pytest.param(r, marks=pytest.mark.slow if r < 1.0 else ()) for r in RATIOS])
def test_a_soft_block_rests_on_a_held_one(ratio):
    """Overlap at most a tenth, gap at most half a cell, whatever the cells; its weight is what is held up."""
    held = np.ones(5**3 + 4**3, dtype=bool)
    scene = boxes(
        {**CUBE, "cells": 4, "youngs_modulus": 3e4, "transform": placed((0.012, 0.1005, 0.007))},
        {**CUBE, "size": (0.14, 0.1, 0.14), "cells": 4, "pinned": held},
        gravity=9.81,
    )
    pair = Explicit(scene, cell_size=ratio * edge(scene), damping=20.0)
    block, step = pair.nodes(0), pair.wave_step(0.5)
    rest = pair.layout.rest[block]
    low = np.isclose(rest[:, 1], rest[:, 1].min())
    upward = 0.0
    while pair.time < 0.5:
        pair.step(step)
        if pair.time > 0.3:
            upward += pair.impulse[block, 1].sum()
            height = pair.position[block][low, 1] - 0.05
            assert height.min() >= -0.1 * pair.contact.cell_size
            assert height.max() <= 0.5 * pair.contact.cell_size
    weight = pair.layout.mass[block].sum() * 9.81
    assert upward == pytest.approx(0.2 * weight, rel=0.05)


@pytest.mark.parametrize("friction", [0.15, 0.4])
def test_coulomb_friction_on_a_slope(friction):
    """A block on a held one, gravity turned by 15 degrees: stays for mu > tan, else slides by g (sin - mu cos).

    The block's soft underside is a tenth of its size from flat at the most, so the forces are that exact.
    """
    held, slope = np.ones(9 * 3 * 4 + 8 * 2 * 3, dtype=bool), np.radians(15.0)
    scene = boxes(
        {**CUBE, "youngs_modulus": 3e5, "friction": friction, "transform": placed((-0.05, 0.1002, 0.006))},
        {**CUBE, "size": (0.4, 0.1, 0.14), "cells": (8, 2, 3), "friction": friction, "pinned": held},
    )
    pair = Explicit(scene)
    pair.gravity = 9.81 * np.array([np.sin(slope), -np.cos(slope), 0.0])
    block, step = pair.nodes(0), pair.wave_step(0.5)
    # Settles with damping, which does not last.
    pair.damping = 100.0
    while pair.time < 0.05:
        pair.step(step)
    pair.damping, start = 0.0, pair.velocity[block].mean(axis=0)[0]
    while pair.time < 0.2:
        pair.step(step)
    acceleration = (pair.velocity[block].mean(axis=0)[0] - start) / 0.15
    expected = max(9.81 * (np.sin(slope) - friction * np.cos(slope)), 0.0)
    assert acceleration == pytest.approx(expected, abs=0.1 * expected + 0.01 * 9.81)


def test_no_contact_has_more_friction_than_coulomb_allows():
    """|J_t| <= mu J_n in each contact, and that much where it slips: all of a block that slides fast."""
    held = np.ones(9 * 3 * 4 + 8 * 2 * 3, dtype=bool)
    scene = boxes(
        {**CUBE, "friction": 0.2, "transform": placed((-0.08, 0.1002, 0.006))},
        {**CUBE, "size": (0.4, 0.1, 0.14), "cells": (8, 2, 3), "friction": 0.4, "pinned": held},
        gravity=9.81,
    )
    pair = Explicit(scene, damping=5.0)
    pair.velocity[pair.nodes(0)] = [1.5, 0.0, 0.0]
    step, seen = pair.wave_step(0.5), 0
    for _ in range(20):
        pair.step(step)
        normal, tangential = pair.contact.parts[0].impulses()
        assert (tangential <= 0.3 * normal * (1.0 + 1e-9)).all()
        pressed = normal > 0.1 * normal.max()
        seen += pressed.sum()
        np.testing.assert_allclose(tangential[pressed], 0.3 * normal[pressed], rtol=1e-6)
    assert seen > 100


# -- folds and thin things ---------------------------------------------------------------------------------


def hairpin(gap: float = 0.1, thickness: float = 0.05, length: float = 0.4, cells: int = 2) -> tuple:
    """Nodes and tets of two legs `gap` apart, joined at one end."""
    h, height = thickness / cells, 2.0 * thickness + gap
    nodes, tets = box_lattice((length, height, thickness), (round(length / h), round(height / h), cells))
    open_part = (nodes[:, 0] > thickness - length / 2 + 1e-9) & (np.abs(nodes[:, 1]) < gap / 2 - 1e-9)
    tets = tets[~open_part[tets].any(axis=1)]
    used, renumbered = np.unique(tets, return_inverse=True)
    return nodes[used], renumbered.reshape(-1, 4).astype(np.int32)


@pytest.mark.parametrize(("ratio", "speed"), [(0.5, 2.0), (1.0, 5.0), (2.0, 2.0)])
def test_a_body_folds_onto_itself_and_opens(ratio, speed):
    """The legs of a hairpin meet: they overlap by a quarter of a cell at most, and open without being held."""
    gap = 0.1
    body, skin = tet_body(*hairpin(gap), youngs_modulus=1e5)
    scene = Scene(surfaces=(skin,), bodies=(body,), gravity=np.zeros(3))
    pin = Explicit(scene, cell_size=ratio * edge(scene))
    rest = pin.layout.rest
    pin.velocity[:, 1] = -np.sign(rest[:, 1]) * speed * np.clip((rest[:, 0] + 0.15) / 0.35, 0.0, 1.0)
    upper, lower = (
        np.flatnonzero(np.isclose(rest[:, 1], side * gap / 2) & (rest[:, 0] > -0.1)) for side in (1.0, -1.0)
    )
    upper, lower = (nodes[np.lexsort((rest[nodes, 2], rest[nodes, 0]))] for nodes in (upper, lower))
    step, met, cell = pin.wave_step(0.5), 0, pin.contact.cell_size
    while pin.time < 0.2:
        opening = (pin.velocity[upper, 1] - pin.velocity[lower, 1]).min() > 0.0
        before = (pin.position[upper, 1] - pin.position[lower, 1]).min()
        pin.step(step)
        distance = pin.position[upper, 1] - pin.position[lower, 1]
        assert distance.min() >= -0.25 * cell
        if pin.impulse.any():
            met += 1
            assert not (opening and before > 0.1 * cell)
    assert met > 0
    assert distance.min() > 0.1 * cell


def passed(bodies: Explicit, above: int, below: int) -> bool:
    """Whether some node of one body lies in a tet of the other, or their middles have changed sides."""
    for one, other in ((above, below), (below, above)):
        x, tets = bodies.position[bodies.nodes(one)], bodies.layout.tets
        first = bodies.layout.first_tet
        corners = bodies.position[tets[first[other] : first[other + 1]]]
        inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
        w = np.einsum("tij,ntj->nti", inverse, x[:, None] - corners[:, 0])
        if ((w > 1e-6).all(axis=2) & (w.sum(axis=2) < 1.0 - 1e-6)).any():
            return True
    middle = [bodies.position[bodies.nodes(b)].mean(axis=0)[1] for b in (above, below)]
    return middle[0] < middle[1]


@pytest.mark.slow
@pytest.mark.parametrize("cfl", [0.1, 0.5, 1.0])
def test_thin_plates_at_ten_metres_a_second(cfl):
    """Three soft plates a tenth of a cell thick: nothing passes, in whatever steps they meet."""
    plate = {"size": (0.12, 0.004, 0.12), "cells": (6, 1, 6), "youngs_modulus": 1e6}
    scene = boxes(
        {**plate, "transform": placed((0.01, 0.02, 0.005), turned((1, 0, 2), 7.0))},
        plate,
        {**plate, "transform": placed((-0.01, -0.02, 0.0), turned((1, 0, 0.3), -5.0))},
    )
    plates = Explicit(scene, cell_size=0.04, cfl=cfl)
    plates.velocity[plates.nodes(0)] = [0.0, -10.0, 0.0]
    momentum, step, touched = plates.momentum(), plates.wave_step(0.35), set()
    while plates.time < 0.01:
        plates.step(step)
        touched |= {b for b in range(3) if plates.impulse[plates.nodes(b)].any()}
        assert not passed(plates, 0, 1) and not passed(plates, 1, 2)
    assert touched == {0, 1, 2}
    assert np.abs(plates.momentum() - momentum).max() <= 1e-6 * np.linalg.norm(momentum)


def test_three_blocks_meet_in_one_place():
    """Two blocks side by side, a third one falls on the joint: it touches both, and all keep apart."""
    pair = [{**CUBE, "transform": placed((side * 0.0501, 0.0, 0.0))} for side in (-1.0, 1.0)]
    three = Explicit(boxes(*pair, {**CUBE, "transform": placed((0.0, 0.103, 0.0))}))
    three.velocity[three.nodes(2)] = [0.0, -1.0, 0.0]
    momentum, step = three.momentum(), three.wave_step(0.5)
    while three.time < 0.03:
        three.step(step)
        assert not passed(three, 2, 0) and not passed(three, 2, 1)
    assert all(three.velocity[three.nodes(b)].mean(axis=0)[1] < -0.1 for b in (0, 1))
    assert np.abs(three.momentum() - momentum).max() <= 1e-6 * np.linalg.norm(momentum)


# -- the same again ----------------------------------------------------------------------------------------


def test_runs_are_the_same_to_the_bit_on_any_number_of_threads():
    results = []
    for threads in (1, 1, 3):
        pair = Explicit(boxes(CUBE, {**CUBE, "transform": placed((0.03, 0.11, 0.02))}), threads=threads)
        pair.velocity[pair.nodes(1)] = [0.2, -1.0, 0.1]
        step = pair.wave_step(0.5)
        for _ in range(40):
            pair.step(step)
        assert pair.contact.end_frame()["skin_contacts"] > 0
        results.append((pair.position, pair.velocity))
    for position, velocity in results[1:]:
        assert np.array_equal(position, results[0][0]) and np.array_equal(velocity, results[0][1])
