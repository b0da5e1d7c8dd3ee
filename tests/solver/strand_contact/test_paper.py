"""Han 2019's strand contact, 5.2 and 5.3: what its two steps conserve, stop and leave alone."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.model import Model
from plait.solver.scene import Scene
from plait.solver.settings import Settings, StrandContactSettings
from plait.solver.state import State
from plait.solver.strand_contact.paper import PaperStrandContact
from plait.solver.strands.layout import Layout, build_layout

from ..strands.rod_scenes import line, rod_scene
from . import referee, scenes

STEP = 1.0 / 192.0
RADIUS, THICKNESS = 0.3e-3, 0.4e-3
CLOSE = 2.0 * RADIUS + THICKNESS
FRICTION = 0.3


class Strands:
    """Strands without the stage that solves them: the variant, what it works on, and the state it keeps."""

    def __init__(self, shapes: list[np.ndarray], xi: float = 0.0, held: bool = False, **settings: object) -> None:
        """held: whether roots are prescribed."""
        scene = rod_scene(shapes, radius=RADIUS, friction=FRICTION)
        prims = tuple(replace(s, thickness=THICKNESS, pic_fraction=xi) for s in scene.strands)
        self.scene: Scene = replace(scene, strands=prims)
        self.layout: Layout = build_layout(self.scene)
        prescribed = np.zeros(self.layout.node_count, dtype=bool)
        prescribed[self.layout.first_node[:-1]] = True
        if held:
            prescribed[self.layout.first_node[:-1] + 1] = True
        threads = settings.pop("threads", 1)
        given = Settings(threads=threads, strand_contact=StrandContactSettings(method="paper", **settings))
        self.state = State()
        self.model = Model(self.scene, given, Launcher(threads=threads), 0.0)
        self.contact = PaperStrandContact(self.model, self.state, self.layout, prescribed)
        self.position = self.layout.position.copy()
        self.velocity = np.zeros_like(self.position)

    def apply(self, step: float = STEP) -> tuple[np.ndarray, np.ndarray]:
        """A substep of strands without stiffness or weight; position and velocity at its end, which are kept."""
        start, end, velocity = (
            wp.array(x, dtype=wp.vec3d, device="cpu")
            for x in (self.position, self.position + step * self.velocity, self.velocity)
        )
        self.contact.apply(start, end, velocity, step)
        self.position, self.velocity = end.numpy(), velocity.numpy()
        return self.position, self.velocity

    def momentum(self) -> np.ndarray:
        return self.layout.mass @ self.velocity

    def kinetic_energy(self) -> float:
        return 0.5 * float(self.layout.mass @ (self.velocity**2).sum(axis=1))


def bundle(count: int, spacing: float, segments: int = 12, seed: int = 0) -> list[np.ndarray]:
    """Strands through a ball about the origin in all directions, or so; no two of them aligned."""
    random = np.random.default_rng(seed)
    shapes = []
    for _ in range(count):
        direction = random.normal(size=3)
        shape = line(0.05, segments, tuple(direction))
        shapes.append(shape - shape.mean(axis=0) + spacing * random.normal(size=3))
    return shapes


def crossed(distance: float, segments: int = 9) -> list[np.ndarray]:
    """Two strands along x and y, `distance` apart in z, the first above, that cross in the middle of an edge."""
    along_x, along_y = line(0.09, segments), line(0.09, segments, (0.0, 1.0, 0.0))
    return [along_x - [0.045, 0.0, -distance], along_y - [0.0, 0.045, 0.0]]


def pressed(strands: Strands, seed: int = 1) -> None:
    """Elastic states under pressure, within the cone, and velocities at random."""
    random = np.random.default_rng(seed)
    turns = np.linalg.qr(random.normal(size=(strands.layout.node_count, 3, 3)))[0]
    stretch = np.exp(random.uniform(-0.22, -0.18, (strands.layout.node_count, 3)))
    elastic = np.einsum("nij,nj,nkj->nik", turns, stretch, turns)
    strands.state.arrays["strand_paper/elastic"].assign(elastic)
    strands.state.arrays["strand_paper/affine"].assign(random.normal(size=elastic.shape))
    strands.velocity = random.normal(size=strands.position.shape)


@pytest.mark.parametrize("xi", [0.0, 0.05, 1.0])
def test_momentum_is_conserved(xi):
    """(31), (33) and the impulses: sum m v to 1e-12, with no node prescribed."""
    strands = Strands(bundle(12, 2e-3), xi)
    pressed(strands)
    before, scale = strands.momentum(), strands.layout.mass @ np.linalg.norm(strands.velocity, axis=1)
    given = strands.velocity.copy()
    strands.apply()
    assert strands.contact.end_frame()["close_pairs"] > 5
    assert np.abs(strands.velocity - given).max() > 0.1
    np.testing.assert_allclose(strands.momentum(), before, rtol=0, atol=1e-12 * scale)


def test_prescribed_nodes_are_left():
    strands = Strands(bundle(12, 2e-3), 0.05, held=True)
    pressed(strands)
    told = strands.layout.first_node[:-1] + 1
    start, velocity = strands.position[told].copy(), strands.velocity[told].copy()
    strands.apply()
    np.testing.assert_array_equal(strands.velocity[told], velocity)
    np.testing.assert_array_equal(strands.position[told], start + STEP * velocity)


def test_unstrained_matter_passes_no_impulse():
    """With xi = 0 and F^E = I the grid changes nothing, whatever the velocities: the same bits."""
    strands = Strands([line(0.05, 12)])
    strands.velocity = np.random.default_rng(2).normal(size=strands.velocity.shape)
    given = strands.velocity.copy()
    strands.apply()
    np.testing.assert_array_equal(strands.velocity, given)


def test_a_lone_strand_in_free_flight():
    """A uniform velocity is kept: its gradient on the grid is that of rounding, and nothing strains."""
    strands = Strands([line(0.05, 12, (1.0, 0.3, -0.2))])
    strands.velocity[:] = [0.3, -1.0, 0.7]
    for _ in range(50):
        strands.apply()
    np.testing.assert_allclose(strands.velocity - [0.3, -1.0, 0.7], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        strands.position - strands.layout.position, np.tile(50 * STEP * strands.velocity[:1], (14, 1)), atol=1e-12
    )


def test_a_uniform_velocity_passes_pic():
    """xi = 1 is PIC, which filters velocities but for uniform ones."""
    strands = Strands([line(0.05, 12)], 1.0)
    strands.velocity[:] = [0.3, -1.0, 0.7]
    strands.apply()
    moving = strands.layout.mass > 0.0
    np.testing.assert_allclose(strands.velocity[moving] - [0.3, -1.0, 0.7], 0.0, atol=1e-13)


def closing(strands: Strands) -> np.ndarray:
    """(3,) [m/s] of the first strand's point over the crossing less the second's."""
    first, second = strands.layout.first_node[:2] + 1
    before = strands.layout.first_node[1] // 2 - 1  # nodes before the edge in the middle
    a, b = (strands.velocity[node + before : node + before + 2].mean(axis=0) for node in (first, second))
    return a - b


def test_a_pair_on_a_colliding_trajectory_stops_approaching():
    """5.3: one inelastic impulse ends the approach, and friction takes mu of that from the slip."""
    strands = Strands(crossed(0.8 * CLOSE))
    upper = strands.layout.first_node[0], strands.layout.first_node[1]
    strands.velocity[slice(*upper)] = [0.6, 0.8, -2.0]
    strands.apply()
    left = closing(strands)
    assert left[2] == pytest.approx(0.0, abs=1e-12)
    # The velocities that an impulse along -v_t and n changes alike: |change of v_t| = mu |change of v_n|.
    np.testing.assert_allclose(left[:2], (1.0 - FRICTION * 2.0) * np.array([0.6, 0.8]), atol=1e-12)
    assert strands.contact.end_frame() == {"overturned": 0, "close_pairs": 1, "still_approaching": 0}


def test_slow_slip_is_held():
    """Friction takes no more than the slip."""
    strands = Strands(crossed(0.8 * CLOSE))
    strands.velocity[: strands.layout.first_node[1]] = [0.1, 0.0, -2.0]
    strands.apply()
    np.testing.assert_allclose(closing(strands), 0.0, atol=1e-12)


@pytest.mark.parametrize(("distance", "speed"), [(1.01, -2.0), (0.8, 2.0)])
def test_apart_or_parting_no_impulse(distance, speed):
    strands = Strands(crossed(distance * CLOSE))
    strands.velocity[: strands.layout.first_node[1], 2] = speed
    given = strands.velocity.copy()
    strands.apply()
    np.testing.assert_array_equal(strands.velocity, given)


def test_passes_bring_many_pairs_to_rest():
    """Jacobi: each pass takes energy, and once converged no pair is on a colliding trajectory."""
    energies, left = [], []
    for passes in (1, 5, 100, 2000):
        strands = Strands(bundle(12, 1e-3), geometric_passes=passes)
        strands.velocity = -20.0 * strands.position
        before = strands.kinetic_energy()
        strands.apply()
        energies.append(strands.kinetic_energy() / before)
        left.append(strands.contact.end_frame())
    assert 1.0 > energies[0] > energies[1] > energies[2] > energies[3]
    assert left[0]["still_approaching"] > 50 and left[3]["still_approaching"] == 0


def test_the_grid_resists_being_pressed_together():
    """5.2: strands further apart than any impulse reaches, on their way together, are slowed by the stress."""
    spacing = 2.0 * CLOSE
    places = [np.array([0.0, spacing * i, spacing * j]) for i in range(4) for j in range(4)]
    strands = Strands([line(0.05, 12) + place for place in places])
    middle = strands.layout.position[strands.layout.mass > 0.0].mean(axis=0)
    strands.velocity = -8.0 * (strands.position - middle) * [0.0, 1.0, 1.0]
    before = strands.kinetic_energy()
    for _ in range(4):
        strands.apply()
    counts = strands.contact.end_frame()
    assert counts["close_pairs"] == 0 and counts["overturned"] == 0
    assert strands.kinetic_energy() < 0.9 * before


def test_the_explicit_update_is_stable():
    """omega dt <= 1: pressed strands, left to the grid alone, spring apart and never gain more than that energy.

    The elastic energy at the start is bounded by 3/2 (3 lambda + 2 mu) max |e|^2 a mass.
    """
    strands = Strands(bundle(12, 2e-3), geometric_passes=1)
    pressed(strands)
    strands.velocity[:] = 0.0
    strands.state.arrays["strand_paper/affine"].zero_()
    law = strands.contact.law(STEP)
    bound = 1.5 * (3.0 * law.lam + 2.0 * law.mu) * 0.22**2 * strands.layout.mass.sum()
    for _ in range(100):
        strands.apply()
        assert strands.kinetic_energy() < bound


def test_a_substep_too_long_is_counted():
    """Where the grid turns over in a substep F^E begins anew: nothing is NaN, and the metrics say so."""
    strands = Strands(bundle(12, 1e-3))
    strands.velocity = -1e3 * strands.position
    strands.apply()
    assert strands.contact.end_frame()["overturned"] > 0
    assert all(np.isfinite(array.numpy()).all() for array in strands.state.arrays.values())


def run(strands: Strands, substeps: int) -> list[np.ndarray]:
    for _ in range(substeps):
        strands.apply()
    return [strands.position, strands.velocity, *(array.numpy() for array in strands.state.arrays.values())]


def falling_together(**settings: object) -> Strands:
    strands = Strands(bundle(16, 1e-3), 0.05, held=True, **settings)
    strands.velocity = -10.0 * strands.position + np.random.default_rng(3).normal(size=strands.position.shape)
    return strands


def test_a_restart_gives_the_same_bits():
    whole = falling_together()
    expected = run(whole, 4)
    half = falling_together()
    run(half, 2)
    restarted = falling_together()
    restarted.state.restore(half.state.to_numpy())
    restarted.position, restarted.velocity = half.position, half.velocity
    for one, other in zip(run(restarted, 2), expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_retract_undoes_a_substep():
    strands = falling_together()
    run(strands, 2)
    before = strands.state.to_numpy()
    strands.apply()
    strands.contact.retract()
    after = strands.state.to_numpy()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_threads_do_not_change_a_bit():
    for one, other in zip(run(falling_together(), 3), run(falling_together(threads=2), 3), strict=True):
        np.testing.assert_array_equal(one, other)


def missed(method: str) -> tuple[int, dict[str, object]]:
    """Of two strands that swing at each other at .3 m/s, a quarter of their distance to keep a substep."""
    case = scenes.crossing(pairs=1, speed=(0.3, 0.3))
    simulation = case.start(method, substeps=32)
    judge = referee.Referee(simulation)
    metrics = [simulation.advance_frame((frame + 1) / scenes.FRAMES_PER_SECOND)["strands"] for frame in range(3)]
    assert max(frame["strain_max"] for frame in metrics) < 0.02
    return judge.missed, metrics[-1]


def test_strands_are_stopped_by_the_variant():
    """As a setting of a whole simulation; the same without contact pass through each other."""
    assert missed("none")[0] > 0
    stopped, metrics = missed("paper")
    assert stopped == 0
    assert metrics.keys() >= {"overturned", "close_pairs", "still_approaching"}


def test_what_is_not_selected_is_not_loaded():
    code = """
import sys
from tests.solver.strand_contact.scenes import crossing
simulation = crossing(pairs=1).start("none")
assert not any(name.startswith("strand_paper") for name in simulation.state.arrays)
assert not [name for name in sys.modules if "strand_contact.paper" in name or "sparse_grid" in name]
"""
    root = Path(__file__).parents[3]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
