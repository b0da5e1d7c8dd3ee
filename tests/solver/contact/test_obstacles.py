"""Elastic bodies against surfaces that the animation moves: the laws of contact, and that nothing passes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from plait.assets.jelly import off_shape
from plait.pipeline.benchmarks.scenes import FormulaMotion
from plait.solver.contact.obstacles import REACH
from plait.solver.model import Interval
from plait.solver.scene import Surface

from ..tets.lattices import box_body, placed
from .shapes import Played, grid
from .soft_scenes import FRAME, SUBSTEPS, Soft, floor, solid_box, turn_z

GRAVITY = 9.81
CELL = 0.1


def block(
    centre=(0.0, 0.0, 0.0), size=(0.3, 0.2, 0.2), youngs_modulus=1e6, rotation=None, friction=0.5, **body
) -> tuple:
    """A box of cells of 0.1 m: `centre` [m]; see `box_body`."""
    cells = tuple(round(side / CELL) for side in size)
    transform = placed(centre, rotation)
    return box_body(size, cells, youngs_modulus=youngs_modulus, transform=transform, friction=friction, **body)


def standing(edge: float, half_height: float = 0.1) -> float:
    """[m] height of the centre of a block that stands on y = 0, unloaded."""
    return half_height + REACH * edge


def edge_of(scene: Soft) -> float:
    return float(scene.tets.layout.edge[0])


EDGE = 0.0951  # [m] mean of the tets' edges


# -- Coulomb's law -------------------------------------------------------------------------------------------


def slide(angle: float, friction: float, frames: int = 24, **body) -> tuple[Soft, np.ndarray]:
    """A block laid onto an incline; its velocity down the slope after each frame."""
    rotation = turn_z(angle)
    height = standing(EDGE)
    scene = Soft(
        [block(height * rotation[:, 1], rotation=rotation, friction=friction, **body)],
        [floor(rotation=rotation, friction=friction)],
    )
    along = []
    for _ in range(frames):
        scene.run()
        along.append(scene.velocity @ -rotation[:, 0])
    return scene, np.array(along)


@pytest.mark.parametrize("angle", [pytest.param(10.0, marks=pytest.mark.slow), 25.0])
def test_an_incline_is_slid_down_below_the_threshold_and_not_above(angle):
    """Coulomb: sliding where tan(angle) > mu. Beside the threshold by 0.005, in a second: 0 or 0.005 g cos."""
    threshold = np.tan(np.radians(angle))
    _, held = slide(angle, threshold + 0.005, youngs_modulus=1e7)
    _, let = slide(angle, threshold - 0.005, youngs_modulus=1e7)
    expected = 0.005 * GRAVITY * np.cos(np.radians(angle))
    assert abs(held[-1]) < 0.1 * expected
    assert let[-1] - let[11] == pytest.approx(0.5 * expected, rel=0.2)


@pytest.mark.parametrize("youngs_modulus", [1e6, pytest.param(1e7, marks=pytest.mark.slow)])
@pytest.mark.parametrize("angle, friction", [(25.0, 0.3), (40.0, 0.6), (15.0, 0.0)])
def test_an_incline_gives_the_acceleration_of_coulombs_law(angle, friction, youngs_modulus):
    """a = g (sin - mu cos) within 1 % of g, over a second after the block has settled."""
    _, velocity = slide(angle, friction, 36, youngs_modulus=youngs_modulus)
    slope = np.radians(angle)
    expected = GRAVITY * (np.sin(slope) - friction * np.cos(slope))
    measured = np.polyfit(np.arange(24) * FRAME, velocity[12:], 1)[0]
    assert abs(measured - expected) < 0.01 * GRAVITY


def test_a_floor_moving_under_a_block_drags_it_by_friction_times_weight():
    """a = mu g while it slips."""
    motion = FormulaMotion(lambda time: placed((20.0 * time, 0.0, 0.0)))
    scene = Soft([block((0.0, standing(EDGE), 0.0))], [floor(half=50.0, motion=motion, friction=0.5)])
    scene.run(6)
    before = scene.velocity[0]
    scene.run(12)
    assert (scene.velocity[0] - before) / (12 * FRAME) == pytest.approx(0.5 * GRAVITY, rel=0.01)


@pytest.mark.parametrize("given, expected", [((0.2, 0.6), 0.4), ((None, 0.6), 0.6), ((0.2, None), 0.2)])
def test_friction_of_a_pair_is_the_mean_and_what_is_not_told_follows(given, expected):
    of_floor, of_body = given
    motion = FormulaMotion(lambda time: placed((20.0 * time, 0.0, 0.0)))
    scene = Soft(
        [block((0.0, standing(EDGE), 0.0), friction=of_body)], [floor(half=50.0, motion=motion, friction=of_floor)]
    )
    scene.run(4)
    before = scene.velocity[0]
    scene.run(4)
    assert (scene.velocity[0] - before) / (4 * FRAME) == pytest.approx(expected * GRAVITY, rel=0.05)


def test_a_block_rides_a_turntable():
    """Below the slip speed it sticks: the radius drifts by less than 1 % a turn."""
    speed, friction = 3.0, 0.7  # [1/s]; needs 0.79 of the friction there is

    def turned(time: float) -> np.ndarray:
        c, s = np.cos(speed * time), np.sin(speed * time)
        return placed(rotation=np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]))

    scene = Soft(
        [block((0.6, standing(EDGE), 0.0), (0.2, 0.2, 0.2), friction=friction)],
        [floor(half=2.0, motion=FormulaMotion(turned), friction=friction)],
    )
    scene.push(np.cross([0.0, speed, 0.0], scene.nodes))
    scene.run(12)
    radius = np.hypot(*scene.centre[[0, 2]])
    frames = int(np.ceil(2.0 * np.pi / speed / FRAME))
    scene.run(frames)
    assert abs(np.hypot(*scene.centre[[0, 2]]) - radius) < 0.01 * radius
    angle = np.arctan2(-scene.centre[2], scene.centre[0])
    assert np.cos(angle - speed * scene.frames * FRAME) > np.cos(0.02)


# -- rest ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.25, pytest.param(0.5, marks=pytest.mark.slow), 1.0, 2.0])
def test_a_block_at_rest_neither_sinks_nor_hovers_nor_jitters(ratio):
    """Overlap <= 0.1 dx and gap <= 0.5 dx whatever dx/h; 1 mm/s."""
    scene = Soft([block((0.0, 0.105, 0.0), youngs_modulus=1e7)], [floor()], cell_size=ratio * CELL)
    scene.run(18)
    low = scene.skin[:, 1].min()
    assert -0.1 * ratio * CELL < low < 0.5 * ratio * CELL
    assert scene.speed < 1e-3
    # Held up by what it weighs.
    normal, pressure = (getattr(scene.obstacles.planes, name).numpy() for name in ("normal", "pressure"))
    held = scene.obstacles.planes.surface.numpy() >= 0
    weight = scene.mass.sum() * GRAVITY
    assert (normal[held, 1] * pressure[held]).sum() == pytest.approx(weight, rel=1e-2)


def test_the_thickness_of_a_surface_is_kept():
    scene = Soft([block((0.0, 0.15, 0.0), youngs_modulus=1e7)], [floor(thickness=0.03)])
    scene.run(18)
    assert scene.skin[:, 1].min() == pytest.approx(0.03 + REACH * edge_of(scene), rel=1e-2)


def test_a_body_in_a_corner_of_one_surface_keeps_out_of_all_its_walls():
    """One open trough with a floor and two walls, tipped: three planes at a point at once."""
    walls = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1], [1, 1, -1], [1, 1, 1], [-1, 1, 1]], float)
    triangles = np.array([[0, 2, 1], [0, 3, 2], [1, 2, 5], [1, 5, 4], [2, 3, 6], [2, 6, 5]], dtype=np.int32)
    trough = Surface("trough", walls, triangles, friction=0.0)
    scene = Soft([block((0.83, 0.12, 0.88), friction=0.0)], [trough])
    scene.push(np.array([3.0, -1.0, 2.0]))
    for _ in range(12):
        scene.run()
        x = scene.skin
        assert x[:, 1].min() > 0.0 and x[:, 0].max() < 1.0 and x[:, 2].max() < 1.0


# -- what hits hard ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("youngs_modulus", [1e4, pytest.param(1e5, marks=pytest.mark.slow), 1e7])
@pytest.mark.parametrize("kind", ["thin box", "sheet", "sheet seen from below"])
def test_a_thin_plate_stops_what_hits_it_at_ten_metres_a_second(kind, youngs_modulus):
    """Nothing passes; overlap <= 0.5 dx at the end of every substep."""
    if kind == "thin box":
        plate = solid_box("plate", (2.0, 0.1 * CELL, 2.0), (0.0, -0.05 * CELL, 0.0))
    else:
        plate = floor("plate", half=1.0)
        if kind != "sheet":
            plate = Surface("plate", plate.points, plate.triangles[:, ::-1].copy())
    scene = Soft([block((0.03, 0.13, 0.02), (0.2, 0.2, 0.2), youngs_modulus)], [plate], cell_size=CELL)
    scene.push(np.array([0.0, -10.0, 0.0]))
    for _ in range(2 * SUBSTEPS):
        scene.substep()
        assert scene.skin[:, 1].min() > -0.5 * CELL
    # The softest is turned inside out for a moment.
    scene.run(6)
    assert scene.skin[:, 1].min() > -0.5 * CELL and scene.centre[1] > 0.05


def test_a_piston_at_ten_metres_a_second_drives_a_block_before_it():
    """All of the block is ahead of it, and by the end as fast."""
    motion = FormulaMotion(lambda time: placed((10.0 * time, 0.0, 0.0)))
    piston = solid_box("piston", (0.2, 1.0, 1.0), (-0.3, 0.0, 0.0), motion=motion)
    scene = Soft([block()], [piston], gravity=0.0)
    for _ in range(24):
        scene.substep()
        face = -0.2 + 10.0 * scene.simulation.state.time
        assert scene.skin[:, 0].min() > face - 0.05 * CELL
    assert scene.velocity[0] > 9.9


def test_a_block_crushed_to_a_fifth_recovers_its_shape():
    """Two plates close on it and open again: every node is back to 1e-3 of the diagonal, up to a rigid motion."""
    half = 0.1

    def press(side: float) -> FormulaMotion:
        def place(time: float) -> np.ndarray:
            closed = 0.5 * (1.0 - np.cos(np.pi * np.clip(time / 0.5, 0.0, 2.0)))
            return placed((0.0, side * (1.05 - 0.85 * closed) * half, 0.0))

        return FormulaMotion(place)

    plates = [
        solid_box(
            f"plate {side:+.0f}", (1.0, 0.02, 1.0), (0.0, 0.01 * side, 0.0), motion=press(side), friction=0.5
        )
        for side in (-1.0, 1.0)
    ]
    soft = block((0.0, 0.0, 0.0), (0.2, 0.2, 0.2), 1e4, mass_damping=20.0)
    scene = Soft([soft], plates, gravity=0.0)
    rest = scene.nodes
    scene.run(12)
    x = scene.skin[:, 1]
    assert np.ptp(x) < 0.45 * half and x.max() < 0.25 * half and x.min() > -0.25 * half
    scene.run(36)
    assert off_shape(rest, scene.nodes) < 1e-3


def test_a_deforming_surface_that_rises_quickly_lifts_a_block():
    """A sheet that bulges at 3 m/s under the block: nothing passes."""
    points, triangles = grid(24, 2.0)
    points = points[:, [1, 2, 0]]

    def bulge(rest: np.ndarray, time: float) -> np.ndarray:
        height = 0.6 * min(time / 0.2, 1.0)
        return rest + np.outer(height * np.exp(-10.0 * (rest[:, 0] ** 2 + rest[:, 2] ** 2)), [0.0, 1.0, 0.0])

    sheet = Surface("sheet", points, triangles, motion=Played(bulge, points))
    scene = Soft([block((0.02, 0.11, 0.01))], [sheet], cell_size=CELL)
    for _ in range(2 * SUBSTEPS):
        scene.substep()
        placed_points = bulge(points, scene.simulation.state.time)
        height = placed_points[
            np.argmin(np.linalg.norm(points[:, None, ::2] - scene.skin[None, :, ::2], axis=2), 0), 1
        ]
        assert (scene.skin[:, 1] - height).min() > -0.5 * CELL


@pytest.mark.parametrize(("own", "floors"), [(0.0, 0.0), (0.5, 0.0), (1.0, 0.3), (0.2, 0.5)])
def test_a_stiff_block_rebounds_by_the_larger_restitution(own, floors):
    """Newton's law of impact, v' = -e v, where the block is too stiff to bounce by itself."""
    soft = block((0.0, 0.13, 0.0), (0.2, 0.2, 0.2), 1e8, restitution=own)
    scene = Soft([soft], [replace(floor(), restitution=floors)], gravity=0.0)
    scene.push(np.array([0.0, -2.0, 0.0]))
    scene.run(4)
    assert scene.velocity[1] == pytest.approx(2.0 * max(own, floors), abs=0.02 * 2.0)


# -- what contact leaves alone -------------------------------------------------------------------------------


def test_what_leaves_is_not_held_nor_helped():
    """A block that starts in contact and moves off goes exactly as it would without the floor."""
    ways = []
    for obstacles in ([floor()], [floor(half=10.0, collides=False)]):
        scene = Soft([block((0.0, standing(EDGE) + 1e-6, 0.0))], obstacles)
        scene.push(np.array([0.0, 1.0, 0.0]))
        scene.run(2)
        ways.append(scene.nodes)
    assert np.array_equal(*ways)


def test_what_starts_inside_a_solid_is_left_alone_until_it_has_come_out():
    """A block half inside a box stays where it is; drawn out it may not go in again."""
    solid = solid_box("solid", (1.0, 0.3, 1.0), (0.0, -0.15, 0.0))
    scene = Soft([block()], [solid], gravity=0.0)
    rest = scene.nodes
    scene.run()
    assert np.array_equal(scene.nodes, rest)
    scene.push(np.array([0.0, 2.0, 0.0]))
    scene.run(3)
    assert scene.skin[:, 1].min() > 0.0
    assert scene.velocity[1] == pytest.approx(2.0, rel=1e-3)
    scene.push(np.array([0.0, -2.0, 0.0]))
    scene.run(3)
    assert scene.skin[:, 1].min() > 0.0


def test_far_from_every_surface_nothing_is_launched():
    """As many launches in free flight as without any surface, and the same bits."""
    counts, ways = [], []
    for obstacles in ([], [floor(collides=True)]):
        scene = Soft([block((0.0, 5.0, 0.0))], obstacles)
        scene.run()
        counts.append(scene.run()["launches"]["tets"])
        ways.append(scene.nodes)
    assert counts[0] == counts[1] and np.array_equal(*ways)


# -- reproducible --------------------------------------------------------------------------------------------


def tumbling(threads: int = 1) -> Soft:
    rotation = turn_z(30.0)
    scene = Soft([block((0.0, 0.2, 0.0), rotation=rotation, youngs_modulus=1e5)], [floor()], threads=threads)
    scene.push(np.array([1.0, -1.0, 0.5]))
    return scene


def test_the_bits_do_not_depend_on_the_number_of_threads():
    ways = []
    for threads in (1, 2):
        scene = tumbling(threads)
        scene.run(6)
        ways.append(scene.nodes)
    assert np.array_equal(*ways)


def test_a_resumed_run_goes_on_bit_for_bit():
    scene = tumbling()
    scene.run(4)
    held = scene.simulation.state.to_numpy()
    scene.run(4)
    again = tumbling()
    again.simulation.state.restore(held)
    again.run(4)
    assert np.array_equal(scene.nodes, again.nodes)


def test_a_retracted_substep_leaves_no_trace():
    scene = tumbling()
    scene.run(4)
    state, parts = scene.simulation.state, scene.simulation.model.parts
    before = state.to_numpy()
    frame = Interval(state.time, state.time + FRAME)
    for part in parts.values():
        part.begin_frame(state, frame)
    substep = Interval(frame.start, frame.start + FRAME / SUBSTEPS)
    for part in parts.values():
        assert part.step(state, substep, False)
    for part in reversed(parts.values()):
        part.retract(state, substep)
    after = state.to_numpy()
    assert all(np.array_equal(before[name], after[name]) for name in before)


# -- forces --------------------------------------------------------------------------------------------------


def test_forces_and_stiffness_are_the_slopes_of_the_energy():
    """Central differences of the energy and of the forces, float64, where contacts stick, slip and open."""
    rotation = turn_z(3.0)
    scene = Soft([block((0.0, 0.102, 0.0), rotation=rotation)], [floor(friction=0.5)], precision="float64")
    random = np.random.default_rng(3)
    start = scene.nodes
    end = start + [2e-4, -5e-3, 1e-4] + 5e-4 * random.normal(size=start.shape)
    state, parts = scene.simulation.state, scene.simulation.model.parts
    substep = Interval(0.0, 1.0 / 192.0)
    parts["kinematics"].begin_frame(state, substep)
    parts["kinematics"].step(state, substep)
    held = [wp.array(x, dtype=wp.vec3d, device="cpu") for x in (start, end)]
    assert scene.obstacles.begin_substep(substep, *held)
    forces = scene.obstacles.bodies[0]
    assert forces.pushes(held[1], substep.length)
    # With pressures to bound friction.
    forces._hold(held[1])
    tets, count = scene.tets.layout.tets, len(start)

    def at(x: np.ndarray) -> tuple[float, np.ndarray]:
        position = wp.array(x, dtype=wp.vec3d, device="cpu")
        onto = wp.zeros(4 * len(tets), dtype=wp.vec3d, device="cpu")
        energy = forces.energy(position)
        forces.add_forces(position, onto)
        total = np.stack([np.bincount(tets.ravel(), f, count) for f in onto.numpy().T], axis=1)
        return energy, total

    x = end + 1e-4 * random.normal(size=end.shape)
    way = random.normal(size=end.shape)
    step = 1e-8
    _, force = at(x)
    blocks = wp.zeros(10 * len(tets), dtype=wp.mat33d, device="cpu")
    forces.add_stiffness(blocks)
    (energy1, force1), (energy2, force2) = at(x - step * way), at(x + step * way)
    assert (energy2 - energy1) / (2 * step) == pytest.approx(-(force * way).sum(), rel=1e-6)
    held_blocks = blocks.numpy().reshape(len(tets), 10, 3, 3)
    product = np.zeros_like(way)
    pairs = [(0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for k, (a, b) in enumerate(pairs):
        np.add.at(product, tets[:, a], np.einsum("tij,tj->ti", held_blocks[:, k], way[tets[:, b]]))
        if a != b:
            np.add.at(product, tets[:, b], np.einsum("tji,tj->ti", held_blocks[:, k], way[tets[:, a]]))
    difference = -(force2 - force1) / (2 * step)
    assert np.abs(product - difference).max() < 1e-6 * np.abs(difference).max()
