"""Nodes against moving surfaces, without a rod solve: what is found, guarded and counted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
import warp as wp

from plait.solver.contact.surfaces import SurfaceContact
from plait.solver.kinematics.stage import build
from plait.solver.launch import Launcher
from plait.solver.model import Interval, Model
from plait.solver.scene import RootBinding, Scene, Strands, Surface
from plait.solver.settings import Settings
from plait.solver.state import State

from .shapes import Played, ball, grid

STEP = 1.0 / 192.0
RADIUS = 1e-4


@dataclass
class Setup:
    """Strands of loose nodes, with nothing but contact acting on them."""

    contact: SurfaceContact
    kinematics: object
    state: State
    positions: np.ndarray  # (strand_count, node_count, 3), ghost and root first
    launcher: Launcher

    def sweep(self, displacement: np.ndarray, start: float = 0.0) -> np.ndarray:
        """One substep in which every free node tries to move so; where the guard lets them be."""
        self.substep(start)
        strands = len(self.positions)
        flags = wp.ones(strands, dtype=wp.int32, device="cpu")
        end = self.positions.copy()
        end[:, 2:] += displacement
        begin = wp.array(self.positions.reshape(-1, 3), dtype=wp.vec3d, device="cpu")
        held = wp.array(end.reshape(-1, 3), dtype=wp.vec3d, device="cpu")
        self.flagged = self.contact.examine(begin, held, flags)
        self.contact.guard(begin, held, flags)
        self.contact.end_substep()
        self.end = held
        self.positions = held.numpy().reshape(end.shape).copy()
        return self.positions[:, 2:]

    def substep(self, start: float) -> None:
        span = Interval(start, start + STEP)
        self.kinematics.begin_frame(self.state, span)
        self.contact.begin_frame()
        self.kinematics.step(self.state, span)
        self.contact.begin_substep(STEP)


@pytest.fixture(scope="module")
def launcher():
    launcher = Launcher("cpu", 2)
    yield launcher
    launcher.close()


def make(
    launcher: Launcher,
    surfaces: tuple[Surface, ...],
    nodes: np.ndarray,
    *,
    root=(0.0, 0.0, 3.0),
    grown_on=0,
    **kwargs,
) -> Setup:
    """nodes: (strand_count, free_node_count, 3). Roots stand apart from all surfaces unless told otherwise."""
    strand_count, count = nodes.shape[:2]
    roots = np.broadcast_to(np.asarray(root, dtype=float), (strand_count, 3))
    points = np.concatenate([roots[:, None], nodes], axis=1)
    carrier = Surface(
        "carrier",
        np.array([[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 1.0, 3.0]]),
        np.array([[0, 1, 2]]),
        collides=False,
    )
    strands = Strands(
        "strands",
        points.reshape(-1, 3),
        np.arange(strand_count + 1) * (count + 1),
        RootBinding(grown_on, np.zeros(strand_count, int), np.tile([1.0, 0.0, 0.0], (strand_count, 1))),
        np.full(strand_count * (count + 1), RADIUS),
        *(np.full(strand_count, value) for value in (1300.0, 1.0, 1.0, 1.0, 0.0, 0.3)),
    )
    model = Model(Scene((carrier, *surfaces), (strands,)), Settings(**kwargs), launcher, 0.0)
    state = State()
    kinematics = model.parts["kinematics"] = build(model, state)
    positions = np.concatenate([roots[:, None] + [0.0, 0.0, 0.1], points], axis=1)
    contact = SurfaceContact(
        model,
        state,
        first_node=np.arange(strand_count + 1) * (count + 2),
        position=wp.array(positions.reshape(-1, 3), dtype=wp.vec3d, device="cpu"),
        radius=np.full(strand_count * (count + 2), RADIUS),
        friction=np.full(strand_count, 0.3),
    )
    return Setup(contact, kinematics, state, positions, launcher)


def is_above(points: np.ndarray, triangles: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Whether each x lies above an open sheet that is a height field in z: plain plane arithmetic."""
    above = np.zeros(len(x), dtype=bool)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    for chunk in np.array_split(np.arange(len(x)), 40):
        p = x[chunk][:, None]

        def side(u, v, p=p):
            return (v[:, 0] - u[:, 0]) * (p[..., 1] - u[:, 1]) - (v[:, 1] - u[:, 1]) * (p[..., 0] - u[:, 0])

        inside = (side(a, b) >= 0.0) & (side(b, c) >= 0.0) & (side(c, a) >= 0.0)
        normal = np.cross(b - a, c - a)
        height = np.einsum("ntd,td->nt", p - a, normal) / np.linalg.norm(normal, axis=1)
        assert inside.any(axis=1).all()
        above[chunk] = height[np.arange(len(chunk)), inside.argmax(axis=1)] > 0.0
    return above


def wave(rest: np.ndarray, time: float, rise: float) -> np.ndarray:
    """A sheet that waves, tilts at 2 rad/s and rises at a speed [m/s]."""
    z = 0.02 * np.sin(20.0 * rest[:, 0] + 30.0 * time) + 2.0 * time * rest[:, 1] + rise * time
    return np.column_stack([rest[:, :2], z])


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("from_below", [False, True])
def test_nothing_leaks_through_a_thin_wall(launcher: Launcher, moving: bool, from_below: bool) -> None:
    """20,000 nodes at 10 m/s against an open sheet without thickness, still or waving, tilting and rising."""
    rng = np.random.default_rng(0)
    count = 20_000
    points, triangles = grid(24, 1.6)
    nodes = np.zeros((count, 1, 3))
    nodes[:, 0, :2] = rng.uniform(-0.6, 0.6, (count, 2))
    side = -1.0 if from_below else 1.0
    function = partial(wave, rise=4.0 * side) if moving else lambda rest, time: rest
    nodes[:, 0, 2] = function(nodes[:, 0], 0.0)[:, 2] + side * rng.uniform(5e-3, 0.06, count)
    assert np.all(is_above(function(points, 0.0), triangles, nodes[:, 0]) != from_below)
    setup = make(launcher, (Surface("wall", points, triangles, motion=Played(function, points)),), nodes)
    direction = rng.normal(size=(count, 1, 3))
    direction[..., 2] = -side * np.abs(direction[..., 2])
    ways = 10.0 * STEP * direction / np.linalg.norm(direction, axis=2, keepdims=True)
    wall = function(points, STEP)
    crossing = is_above(wall, triangles, (nodes + ways)[:, 0]) == from_below
    assert crossing.sum() > count / 5
    end = setup.sweep(ways)[:, 0]
    assert np.all(is_above(wall, triangles, end) != from_below)
    # Nothing else is touched.
    np.testing.assert_array_equal(end[~crossing], (nodes + ways)[~crossing, 0])


def test_a_part_of_the_same_surface_sweeps_over_a_node(launcher: Launcher) -> None:
    """A second sheet of one mesh comes down over resting nodes: caught, whatever was nearest before."""
    points, triangles = grid(9, 1.0)
    both = np.vstack([points, np.add(points, [0.0, 0.0, 0.03])])
    pair = np.vstack([triangles, triangles[:, ::-1] + len(points)])

    def clap(rest: np.ndarray, time: float) -> np.ndarray:
        drop = np.where(np.arange(len(rest)) < len(points), 0.0, 4.8 * time)
        return rest - np.column_stack([np.zeros((len(rest), 2)), drop])

    nodes = np.random.default_rng(1).uniform(-0.4, 0.4, (500, 1, 3))
    nodes[..., 2] = np.linspace(2e-3, 0.012, 500)[:, None]
    setup = make(launcher, (Surface("clap", both, pair, motion=Played(clap, both)),), nodes)
    end = setup.sweep(np.zeros((500, 1, 3)))[:, 0, 2]
    assert 0.03 - 4.8 * STEP == pytest.approx(0.005)
    assert np.all(end > 0.0) and np.all(end < 0.005)


def test_a_fast_solid_takes_along_what_it_meets(launcher: Launcher) -> None:
    """A ball that flies and spins at 10 m/s, 20 rad/s: 0 nodes deeper than their radius after every substep."""
    points, triangles = ball(16, 0.1)

    def fly(rest: np.ndarray, time: float) -> np.ndarray:
        c, s = np.cos(20.0 * time), np.sin(20.0 * time)
        return rest @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + np.array([10.0 * time, 0.0, 0.0])

    rng = np.random.default_rng(2)
    nodes = rng.uniform(-0.15, 0.15, (3000, 1, 3)) + np.array([0.3, 0.0, 0.0])
    setup = make(launcher, (Surface("ball", points, triangles, motion=Played(fly, points)),), nodes)
    for k in range(8):
        setup.sweep(np.zeros((3000, 1, 3)), k * STEP)
        assert setup.contact.penetrating(setup.end) == (0, 0.0)
    centre = np.array([80.0 * STEP, 0.0, 0.0])
    assert np.linalg.norm(setup.positions[:, 2] - centre, axis=1).min() > 0.1 * np.cos(np.pi / 16) ** 2 - RADIUS


def test_what_starts_inside_is_led_out_at_the_exit_speed(launcher: Launcher) -> None:
    """A node inside a solid gains exit_speed * dt of height a substep, no more, and no less under the guard."""
    points, triangles = ball(24, 0.1)
    nodes = np.array([[[0.0, 0.0, 0.095]], [[0.097, 0.0, 0.0]], [[0.0, -0.06, 0.0]]])
    setup = make(launcher, (Surface("ball", points, triangles),), nodes)
    gain = 0.5 * STEP
    height = np.linalg.norm(nodes[:, 0], axis=1) - 0.1
    for k in range(30):
        end = setup.sweep(np.zeros((3, 1, 3)), k * STEP)[:, 0]
        new = np.linalg.norm(end, axis=1) - 0.1
        # A facet lies up to (1 - cos(pi/24)) of the radius under the sphere.
        assert np.all(new - height < 1.02 * gain)
        assert np.all((new - height > 0.98 * gain) | (new > -1e-3))
        height = new
    assert setup.contact.penetrating(setup.end) == (0, 0.0)


def test_a_node_between_two_bodies_stays_out_of_both(launcher: Launcher) -> None:
    """Pressed into a wedge of 40 degrees between two solids, a node ends in neither, with a plane of each."""
    points, triangles = ball(32, 0.1)
    apart = np.array([0.104, 0.0, 0.0])
    bodies = (Surface("left", points - apart, triangles), Surface("right", points + apart, triangles))
    nodes = np.zeros((40, 1, 3))
    nodes[:, 0, 2] = np.linspace(0.05, 0.09, 40)
    nodes[:, 0, 0] = np.linspace(-1e-3, 1e-3, 40)
    setup = make(launcher, bodies, nodes)
    setup.sweep(np.array([0.0, 0.0, -0.03]))
    assert setup.contact.penetrating(setup.end) == (0, 0.0)


def drawn_on_a_ball(launcher: Launcher, heights: list[float], root_height: float) -> Setup:
    """One strand along a meridian of the ball it grows on, its nodes at these heights."""
    points, triangles = ball(64, 0.1)
    angles = 0.6 + 0.02 * np.arange(len(heights) + 1)
    radii = 0.1 + np.array([root_height, *heights])
    way = np.stack([np.sin(angles) * np.cos(0.3), np.sin(angles) * np.sin(0.3), np.cos(angles)], axis=1)
    x = way * radii[:, None]
    return make(launcher, (Surface("skin", points, triangles),), x[None, 1:], root=x[0], grown_on=1)


def test_a_groom_is_asked_for_no_more_than_it_was_drawn_with(launcher: Launcher) -> None:
    """Nodes drawn nearer than their radius break no plane and stay where they are."""
    setup = drawn_on_a_ball(launcher, [3e-4, 1.5e-4, 3e-4, 4e-4], 2e-4)
    before = setup.positions.copy()
    for k in range(3):
        setup.sweep(np.zeros((1, 4, 3)), k * STEP)
        assert setup.flagged == 0
    np.testing.assert_array_equal(setup.positions, before)


def test_a_buried_stem_is_left_alone_and_the_rest_led_out(launcher: Launcher) -> None:
    """Nodes inside within twice the root's depth of arc have no contact; those further along come out."""
    depth = 3e-3
    setup = drawn_on_a_ball(launcher, [-depth] * 8, -depth)
    before = setup.positions.copy()
    for k in range(12):
        setup.sweep(np.zeros((1, 8, 3)), k * STEP)
    moved = np.linalg.norm(setup.positions - before, axis=2)[0, 2:]
    # Nodes lie 1.94 mm apart; twice the depth of the facets' surface is just over three of them.
    assert np.all(moved[:2] == 0.0) and np.all(moved[3:] > 2e-3)
    assert setup.contact.penetrating(setup.end)[0] == 0


def box(size: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed cube of this half side, facing out."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def test_a_node_that_swings_about_an_edge_is_kept_on_the_side_it_came_from(launcher: Launcher) -> None:
    """From 1.4 radii above one face to a quarter radius before the next: the first one was touched first."""
    corners, triangles = box(0.1)
    nodes = np.array([[[0.1 - 0.5 * RADIUS, 0.02, 0.1 + 1.4 * RADIUS]]])
    setup = make(launcher, (Surface("box", corners, triangles),), nodes)
    setup.sweep(np.array([0.75 * RADIUS, 0.0, -1.9 * RADIUS]))
    normals = setup.contact.planes.normal.numpy()
    assert normals[np.flatnonzero(np.any(normals, axis=1))[0], 2] > 0.9


def test_a_root_that_the_animation_puts_inside_a_body_holds_its_stem(launcher: Launcher) -> None:
    """Nodes within twice the root's depth along the strand have no contact with that body, others come out."""
    points, triangles = ball(24, 0.1)

    def swallow(rest: np.ndarray, time: float) -> np.ndarray:
        return rest + np.array([0.0, 0.0, min(24.0 * time, 0.12) - 0.12])

    # The root ends 1 cm under the ball's top; a node every 9 mm beside it, the first four inside.
    nodes = np.array([[[0.009 * k, 0.0, 0.09] for k in range(1, 7)]])
    body = Surface("ball", points, triangles, motion=Played(swallow, points))
    setup = make(launcher, (body,), nodes, root=(0.0, 0.0, 0.09))
    before = setup.positions.copy()
    setup.sweep(np.zeros((1, 6, 3)))
    np.testing.assert_array_equal(setup.positions[0, 2:4], before[0, 2:4])
    assert np.all(np.linalg.norm(setup.positions[0, 4:], axis=1) > 0.1 * np.cos(np.pi / 24) ** 2)
    assert np.all(setup.positions[0, 4:6] != before[0, 4:6], axis=1).any()
    assert setup.contact.penetrating(setup.end)[0] == 0


def test_enclosures_have_no_inside(launcher: Launcher) -> None:
    """A room drawn as a closed box facing out holds everything: nothing is pushed through its walls."""
    points, triangles = ball(12, 5.0)
    nodes = np.random.default_rng(3).uniform(-1.0, 1.0, (50, 1, 3))
    setup = make(launcher, (Surface("room", points, triangles),), nodes, root=(0.0, 0.0, 0.5))
    before = setup.positions.copy()
    setup.sweep(np.zeros((50, 1, 3)))
    np.testing.assert_array_equal(setup.positions, before)
    assert setup.contact.penetrating(setup.end) == (0, 0.0)


def test_penetration_is_counted_as_geometry_says(launcher: Launcher) -> None:
    """Against the exact distance to a box: nodes deeper than their radius, and the deepest."""
    corners, triangles = box(0.1)
    nodes = np.random.default_rng(4).uniform(-0.12, 0.12, (300, 6, 3))
    setup = make(launcher, (Surface("box", corners, triangles),), nodes)
    x = wp.array(setup.positions.reshape(-1, 3), dtype=wp.vec3d, device="cpu")
    depth = (0.1 - np.abs(nodes)).min(axis=2)
    count, deepest = setup.contact.penetrating(x)
    assert count == (depth > RADIUS).sum()
    assert deepest == pytest.approx(depth.max(), abs=1e-12)


def test_planes_carry_friction_and_the_place_where_a_node_would_stick(launcher: Launcher) -> None:
    """The anchor is the start carried rigidly by the surface; friction is the surface's, or else the strand's."""
    points, triangles = grid(3, 1.0)

    def turn(rest: np.ndarray, time: float) -> np.ndarray:
        c, s = np.cos(3.0 * time), np.sin(3.0 * time)
        return rest @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    nodes = np.array([[[0.2, 0.1, RADIUS]]])
    for friction, expected in ((None, 0.3), (0.7, 0.7)):
        sheet = Surface("sheet", points, triangles, motion=Played(turn, points), friction=friction)
        setup = make(launcher, (sheet,), nodes)
        setup.sweep(np.array([0.0, 0.0, -1e-3]))
        slot = np.flatnonzero(setup.contact.planes.normal.numpy()[:, 2])[0]
        np.testing.assert_allclose(setup.contact.planes.normal.numpy()[slot], [0.0, 0.0, 1.0], atol=1e-12)
        assert setup.contact.planes.offset.numpy()[slot] == pytest.approx(RADIUS, abs=1e-12)
        assert setup.contact.planes.friction.numpy()[slot] == expected
        np.testing.assert_allclose(setup.contact.planes.anchor.numpy()[slot], turn(nodes[0], STEP)[0], atol=1e-12)


def test_surfaces_out_of_reach_launch_nothing(launcher: Launcher) -> None:
    """No kernel runs for contact while no surface can be touched."""
    points, triangles = ball(8, 0.1)
    nodes = np.zeros((5, 1, 3)) + np.array([0.0, 0.0, 2.9])
    setup = make(launcher, (Surface("far", np.add(points, [0.0, 0.0, -5.0]), triangles),), nodes)
    with launcher.stage("contact"):
        setup.substep(0.0)
        before = launcher.launches["contact"]
        setup.contact.begin_frame()
        setup.contact.begin_substep(STEP)
        x = wp.array(setup.positions.reshape(-1, 3), dtype=wp.vec3d, device="cpu")
        flags = wp.ones(5, dtype=wp.int32, device="cpu")
        assert setup.contact.examine(x, x, flags) == 0 and not flags.numpy().any()
        setup.contact.guard(x, x, flags)
        setup.contact.end_substep()
        setup.contact.end_frame(x)
    assert launcher.launches["contact"] == before and not setup.contact.active


def test_triangles_that_collapse_in_motion_break_nothing(launcher: Launcher) -> None:
    """A sheet with a row of triangles squeezed to lines still stops what falls on it, with finite planes."""
    points, triangles = grid(12, 1.0)

    def squeeze(rest: np.ndarray, time: float) -> np.ndarray:
        x = np.where(np.abs(rest[:, 0]) < 0.1, 0.0, rest[:, 0]) if time > 0.0 else rest[:, 0]
        return np.column_stack([x, rest[:, 1:]])

    nodes = np.random.default_rng(5).uniform(-0.2, 0.2, (2000, 1, 3))
    nodes[..., 2] = 0.01
    setup = make(launcher, (Surface("sheet", points, triangles, motion=Played(squeeze, points)),), nodes)
    for k in range(3):
        end = setup.sweep(np.array([0.0, 0.0, -0.03 if k == 0 else 0.0]), k * STEP)
        assert np.isfinite(setup.contact.planes.offset.numpy()).all()
        assert np.all(end[..., 2] > 0.0)
