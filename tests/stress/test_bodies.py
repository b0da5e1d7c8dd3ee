"""Strands and bodies that cannot be there: each scene ten times, each with what must hold said in words."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.benchmarks.scenes import FormulaMotion, translation
from plait.solver.build import build
from plait.solver.diagnostics import Refused
from plait.solver.scene import Motion, RootBinding, Scene, StaticMotion, Surface

from .harness import (
    DAMPED_HAIR,
    FRAME,
    GRAVITY,
    Play,
    curls,
    inner_radius,
    jumps,
    random_unit,
    scene_of,
    seeds,
    sphere,
)

STRANDS = 20
BALL = 0.08  # [m]
BELOW = np.array([0.0, -0.2, 0.0])  # [m] from the roots' midst
EXIT_SPEED = 0.5  # [m/s] `ContactSettings.exit_speed`


def ball(centre: np.ndarray, motion: Motion | None = None) -> Surface:
    points, triangles = sphere(BALL, centre)
    return Surface("/ball", points, triangles, motion=motion or StaticMotion())


def energy_allowed(length: float) -> float:
    """[J/kg] Of a strand led out and not thrown: the exit speed, a fall by its length, and what its rest curvature
    may hold, that of holding it out level: q^2 L^5 / 40 EI over its mass.
    """
    hair = DAMPED_HAIR
    line_weight = hair.density * hair.area * GRAVITY
    held = line_weight**2 * length**5 / (40.0 * hair.bend_stiffness)
    return 0.5 * EXIT_SPEED**2 + GRAVITY * length + held / (hair.density * hair.area * length)


def depth_inside(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(n,) [m] How deep points are inside the ball's facets, at least; negative outside."""
    surface, triangles = sphere(BALL, np.zeros(3))
    return inner_radius(surface, triangles, np.zeros(3)) - np.linalg.norm(points - centre, axis=1)


@seeds(quick=True)
def test_roots_inside_a_body(seed):
    """Hair grows from 0 to 3 cm under the surface of a ball that it is not bound to: it is led out and not thrown
    (no point is faster than the exit speed and a fall from twice its length), what was drawn outside is outside
    again in the end, and two seconds later all is at rest.
    """
    random = np.random.default_rng(seed)
    centre = np.zeros(3)
    shapes = [
        (BALL - random.uniform(0.0, 0.03)) * direction + np.linspace(0.0, 0.2, 26)[:, None] * direction
        for direction in (random_unit(random) for _ in range(STRANDS))
    ]
    play = Play(scene_of(shapes, bodies=(ball(centre),)))
    drawn_outside = depth_inside(np.concatenate(shapes), centre) < -1e-3

    def not_thrown(time: float) -> None:
        assert play.kinetic_energy().max() < energy_allowed(0.2)

    play.run(0.5, not_thrown)
    play.settle()
    assert depth_inside(play.points, centre)[drawn_outside].max() < DAMPED_HAIR.radius


@seeds()
def test_hair_drawn_through_a_body(seed):
    """Hair rooted outside hangs right through a ball: it is led out and not thrown, two seconds later all is at
    rest, and after the time its way out takes at the exit speed, and as long again, no point is inside.
    """
    random = np.random.default_rng(seed)
    shapes = curls(random, STRANDS)
    centre = np.array([0.0, -0.25, 0.0]) + random.uniform(-0.03, 0.03, 3)
    play = Play(scene_of(shapes, bodies=(ball(centre),)))

    def not_thrown(time: float) -> None:
        assert play.kinetic_energy().max() < energy_allowed(play.lengths.max())

    play.run(2.0 * BALL / EXIT_SPEED, not_thrown)
    assert depth_inside(play.points, centre).max() < DAMPED_HAIR.radius
    play.settle()


@seeds()
def test_body_that_jumps_through_hair(seed):
    """A ball jumps from one side of the hair to the other in one substep, three times, as an animator's cut does:
    nothing breaks or tears, no point stays inside it, and two seconds later all is at rest.
    """
    random = np.random.default_rng(seed)
    start = np.array([-0.4, -0.1, 0.0])
    places = [random.uniform(-0.3, 0.3, 3) + BELOW for _ in range(3)]
    places[-1] = np.array([0.4, -0.1, 0.0])
    times = np.array([4.5, 8.5, 12.5]) * FRAME
    motion = jumps(times, [translation(place - start) for place in places])
    play = Play(scene_of(curls(random, STRANDS), bodies=(ball(start, motion),)), int(random.choice([1, 2, 8])))
    play.run(14 * FRAME)
    play.settle()
    assert depth_inside(play.points, places[-1]).max() < DAMPED_HAIR.radius


@seeds()
def test_body_shot_through_hair(seed):
    """A ball crosses the hair at 50 m/s, 2 m in one frame of 1 to 8 substeps: nothing breaks or tears, no point is
    in it at the end of any frame, and two seconds later all is at rest.
    """
    random = np.random.default_rng(seed)
    aim = random.uniform(-0.05, 0.05, 3) + 0.5 * BELOW
    way = random_unit(random)

    def at(time: float) -> np.ndarray:
        return 48.0 * (np.clip(time, 2 * FRAME, 3 * FRAME) - 2.5 * FRAME) * way

    motion = FormulaMotion(lambda time: translation(at(time)))
    play = Play(scene_of(curls(random, STRANDS), bodies=(ball(aim, motion),)), int(random.choice([1, 2, 8])))

    def outside(time: float) -> None:
        assert depth_inside(play.points, aim + at(time)).max() < DAMPED_HAIR.radius

    play.run(6 * FRAME, outside)
    play.settle()


@seeds(quick=True)
def test_hair_caught_between_overlapping_bodies(seed):
    """Two balls slide into each other through the hair, as a hat does over a head, and shake there: hair in both
    has nowhere to go. Nothing breaks; no segment is stretched by more than a tenth (`TORN`) and what its weight
    and the shaking, up to 10 g, ask for, 1 % at most; the frames are not cut into shorter steps for good.
    """
    random = np.random.default_rng(seed)
    ways = [random_unit(random), random_unit(random)]

    def at(way: np.ndarray, time: float) -> np.ndarray:
        closing = 0.15 * max(0.0, 1.0 - time / (8 * FRAME))
        return translation((closing + 0.01 * np.sin(12.0 * np.pi * time)) * way)

    bodies = tuple(ball(BELOW + 0.03 * way, FormulaMotion(lambda time, way=way: at(way, time))) for way in ways)
    play = Play(scene_of(curls(random, STRANDS), bodies=bodies), reach=1.11)
    substeps = []
    play.run(8 * FRAME)
    for frame in range(9, 33):
        metrics = play.simulation.advance_frame(frame * FRAME, 8)
        play.check()
        assert metrics["strands"]["strain_max"] < 0.11
        substeps.append(metrics["substeps"])
    assert np.median(substeps) <= 2 * 8


@seeds()
def test_degenerate_triangles(seed):
    """A ball among whose triangles are ones of no area (repeated corners, corners in line), ones given twice and
    points of no triangle, pushed into hair: as with a clean one, nothing breaks or tears, no point is inside at
    the end, and two seconds later all is at rest.
    """
    random = np.random.default_rng(seed)
    start, end = np.array([-0.45, -0.25, 0.0]), np.array([0.0, -0.25, 0.0])
    points, triangles = sphere(BALL, start)
    bad = triangles[random.integers(len(triangles), size=30)].copy()
    bad[:10, 2] = bad[:10, 1]  # a repeated corner
    edges = bad[10:20, :2]
    middle = len(points) + np.arange(10)
    points = np.concatenate([points, points[edges].mean(axis=1), random.normal(size=(5, 3))])
    bad[10:20] = np.column_stack(
        [edges[:, 0], middle, edges[:, 1]]
    )  # corners in line; the last ten are given twice
    spoiled = np.concatenate([triangles, bad]).astype(np.int32)
    motion = FormulaMotion(lambda time: translation((end - start) * min(1.0, time)))
    body = Surface("/ball", points, spoiled, motion=motion)
    play = Play(scene_of(curls(random, STRANDS), bodies=(body,)))
    play.run(1.0)
    play.settle()
    assert depth_inside(play.points, end).max() < DAMPED_HAIR.radius


def bound_to(scene: Scene, triangle: int) -> Scene:
    hair = scene.strands[0]
    binding = hair.roots
    triangles = binding.triangle.copy()
    triangles[7] = triangle
    bound = RootBinding(binding.surface, triangles, binding.barycentric)
    return Scene(scene.surfaces, (type(hair)(**{**vars(hair), "roots": bound}),))


def test_roots_that_cannot_be_carried_are_refused_by_name():
    """A root on a triangle that does not exist, or that has no area at rest, is refused with prim and strand."""
    random = np.random.default_rng(0)
    scene = scene_of(curls(random, STRANDS))
    for triangle in (-1, STRANDS):
        with pytest.raises(Refused, match=rf"/hair: strand 7 .*triangle {triangle}"):
            build(bound_to(scene, triangle))
    ground = scene.surfaces[0]
    points = ground.points.copy()
    points[3 * 7 + 2] = points[3 * 7]
    flat = Surface(ground.name, points, ground.triangles, collides=False)
    with pytest.raises(Refused, match=r"/hair: strand 7 .*no area"):
        build(Scene((flat,), scene.strands))


@seeds()
def test_root_triangle_that_collapses(seed):
    """The triangles under the roots shrink to nothing within half a second and open again: nothing breaks or
    tears, and two seconds later all is at rest.
    """
    random = np.random.default_rng(seed)
    shapes = curls(random, STRANDS)

    def squeezed(time: float) -> np.ndarray:
        moved = np.eye(4)
        moved[:3, :3] *= 1.0 - np.sin(2.0 * np.pi * min(time, 0.5)) ** 2
        return moved

    centred = [shape - shape[0] for shape in shapes]
    play = Play(scene_of(centred, motion=FormulaMotion(squeezed)))
    play.run(0.5)
    play.settle()
