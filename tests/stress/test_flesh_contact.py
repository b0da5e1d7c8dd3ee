"""Elastic blocks dropped, thrown and crushed: each scene ten times, each with what must hold said in words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from plait.assets.jelly import off_shape
from plait.pipeline.benchmarks.scenes import FormulaMotion
from plait.solver.build import build
from plait.solver.scene import Scene, Surface, TetBody

from ..solver.contact.soft_scenes import floor, solid_box
from ..solver.tets.lattices import box_body, box_lattice, placed, turn
from .harness import FRAME, GRAVITY, inner_radius, random_unit, seeds, sphere

CELL = 0.1  # [m] of a block's lattice, and of the contact grid
OVERLAP = 0.5  # of a cell


def random_block(
    random: np.random.Generator, index: int, centre: np.ndarray, **body: Any
) -> tuple[TetBody, Surface]:
    """A box of 1 to 3 cells a side, of any orientation; as hard as rubber or as soft as jelly."""
    cells = random.integers(1, 4, 3)
    return box_body(
        tuple(CELL * cells),
        tuple(cells),
        index=index,
        surface=index,
        name=f"block {index}",
        youngs_modulus=10.0 ** random.uniform(4.3, 6.5),
        poissons_ratio=random.uniform(0.1, 0.45),
        density=10.0 ** random.uniform(2.5, 3.3),
        friction=random.uniform(0.0, 1.0),
        transform=placed(centre, turn(random_unit(random), random.uniform(0.0, np.pi))),
        **body,
    )


class Play:
    """Plays a scene of blocks, the first surfaces; after each frame all is finite, and energy has not risen.

    driven: whether the animation does work on the blocks.
    """

    def __init__(
        self,
        blocks: list[tuple[TetBody, Surface]],
        obstacles: list[Surface],
        *,
        driven: bool = False,
        gravity: float = GRAVITY,
    ) -> None:
        surfaces = (*(skin for _, skin in blocks), *obstacles)
        down = np.array([0.0, -gravity, 0.0])
        self.simulation = build(Scene(surfaces, bodies=tuple(body for body, _ in blocks), gravity=down))
        self.tets = self.simulation.model.parts["tets"]
        self.driven = driven
        self.energy, self.scale = np.inf, 0.0

    def throw(self, velocities: list[np.ndarray]) -> None:
        layout = self.tets.layout
        velocity = np.repeat(velocities, np.diff(layout.first_node), axis=0)
        self.tets.external_impulse.assign(layout.mass[:, None] * velocity)

    def run(self, seconds: float, each: Callable[[np.ndarray], None] = lambda skin: None) -> None:
        """`each` is given the (particle_count, 3) points of all skins after every frame."""
        start = round(self.simulation.state.time / FRAME)
        for frame in range(start + 1, start + 1 + round(seconds / FRAME)):
            metrics = self.simulation.advance_frame(frame * FRAME)["tets"]
            parts = [metrics[f"{kind}_energy"] for kind in ("kinetic", "elastic", "potential")]
            assert np.isfinite(parts).all()
            if not self.driven:
                self.scale = self.scale or abs(sum(parts))
                assert sum(parts) <= self.energy + 0.01 * self.scale, f"frame {frame}"
                self.energy = min(self.energy, sum(parts))
            each(self.skin)

    @property
    def skin(self) -> np.ndarray:
        particles = self.tets._contact.particles
        return particles.evaluate_positions(self.tets.position).numpy()


def floor_and_ball(
    middle: np.ndarray, friction: float | None = None
) -> tuple[list[Surface], Callable[[np.ndarray], None]]:
    """A floor, a fixed ball of 0.15 m, and a check that skins go into neither."""
    points, triangles = sphere(0.15, middle)
    inner = inner_radius(points, triangles, middle)

    def check(skin: np.ndarray) -> None:
        assert skin[:, 1].min() > -OVERLAP * CELL
        assert np.linalg.norm(skin - middle, axis=1).min() > inner - OVERLAP * CELL

    return [floor(friction=friction), Surface("ball", points, triangles, friction=0.3)], check


@seeds()
def test_a_block_dropped_aslant(seed):
    """One block falls on a ball and a floor at up to 6 m/s: it goes into neither, and energy never rises."""
    random = np.random.default_rng(seed)
    obstacles, check = floor_and_ball(np.array([0.1, 0.2, 0.0]), 0.5)
    play = Play([random_block(random, 0, np.array([random.uniform(-0.2, 0.2), 0.7, 0.0]))], obstacles)
    play.throw([random.uniform(0.0, 5.0) * np.array([0.2, -1.0, 0.1])])
    play.run(1.0, check)


@seeds(quick=True)
def test_blocks_dropped_on_each_other(seed):
    """Three blocks fall on a floor and on each other, past a ball fixed above it: none goes into floor or ball,
    and energy never rises by 1 % of what there was.
    """
    random = np.random.default_rng(seed)
    centres = [[random.uniform(-0.1, 0.1), 0.35 + 0.4 * k, random.uniform(-0.1, 0.1)] for k in range(3)]
    obstacles, check = floor_and_ball(np.array([0.35, 0.2, 0.0]))
    play = Play([random_block(random, k, np.array(centre)) for k, centre in enumerate(centres)], obstacles)
    play.run(1.0, check)


@seeds(quick=True)
def test_blocks_thrown_about_a_room(seed):
    """Two blocks at 5 to 10 m/s in a closed room of thin sheets, two metres a side, with a thin post in it: they
    stay in the room, and energy never rises.
    """
    random = np.random.default_rng(seed)
    room = solid_box("room", (2.0, 2.0, 2.0), friction=random.uniform(0.0, 0.6))
    room = Surface("room", room.points, room.triangles[:, ::-1].copy(), friction=room.friction)
    post = solid_box("post", (0.02, 2.0, 0.02), (0.0, 0.0, 0.0))
    blocks = [random_block(random, k, np.array([x, 0.0, 0.0])) for k, x in enumerate((-0.5, 0.5))]
    play = Play(blocks, [room, post])
    play.throw([random.uniform(5.0, 10.0) * random_unit(random) for _ in range(2)])

    def check(skin: np.ndarray) -> None:
        assert np.abs(skin).max() < 1.0 + OVERLAP * CELL

    play.run(1.0, check)


@seeds(quick=True)
def test_a_block_crushed_between_plates_recovers(seed):
    """Plates close on a block to a quarter of its height or less, aslant, within a third of a second, and open
    again: nothing passes them, and two seconds later every node is back to 1 % of the diagonal in the shape that
    the block had.
    """
    random = np.random.default_rng(seed)
    cells = random.integers(2, 4, 3)
    size = CELL * cells
    soft = box_body(
        tuple(size),
        tuple(cells),
        youngs_modulus=10.0 ** random.uniform(4.0, 5.5),
        poissons_ratio=random.uniform(0.1, 0.4),
        friction=random.uniform(0.0, 1.0),
        mass_damping=10.0,
    )
    tilt = turn(random_unit(random), random.uniform(0.0, 0.1))
    open_gap, closed_gap = 1.4 * size[1], random.uniform(0.1, 0.25) * size[1]

    def press(side: float) -> FormulaMotion:
        def place(time: float) -> np.ndarray:
            shut = 0.5 * (1.0 - np.cos(np.pi * np.clip(time / 0.33, 0.0, 2.0)))
            gap = open_gap + shut * (closed_gap - open_gap)
            return placed(tilt @ [0.0, 0.5 * side * gap, 0.0], tilt)

        return FormulaMotion(place)

    plates = [
        solid_box(f"plate {side:+.0f}", (2.0, 0.02, 2.0), (0.0, 0.01 * side, 0.0), motion=press(side))
        for side in (-1.0, 1.0)
    ]
    play = Play([soft], plates, driven=True, gravity=0.0)
    rest = play.tets.nodes(0).copy()

    def between(skin: np.ndarray) -> None:
        time = play.simulation.state.time
        gap = plates[1].motion.pose(time).joint_transforms[0][:3, 3] @ tilt[:, 1]
        assert np.abs(skin @ tilt[:, 1]).max() < gap + OVERLAP * CELL

    play.run(1.0, between)
    play.run(1.5)
    assert off_shape(rest, play.tets.nodes(0)) < 0.01


@seeds()
def test_a_block_drawn_through_a_gap_too_narrow_for_it(seed):
    """Bone drags a soft block through a slot narrower than it, at 1 to 3 m/s: bone goes where it must, the flesh
    follows, nothing is left behind or blown up, and no skin goes into the jaws but next to the bone.
    """
    random = np.random.default_rng(seed)
    cells, speed = np.array([4, 4, 3]), random.uniform(1.0, 3.0)
    size = CELL * cells
    opening = random.uniform(0.5, 0.8) * size[1]
    motion = FormulaMotion(lambda time: placed((speed * time, 0.0, 0.0)))
    nodes, _ = box_lattice(tuple(size), tuple(cells))
    bone = np.linalg.norm(nodes[:, :2], axis=1) < 0.6 * CELL
    soft = box_body(
        tuple(size),
        tuple(cells),
        youngs_modulus=10.0 ** random.uniform(4.3, 5.5),
        friction=random.uniform(0.0, 0.5),
        pinned=bone,
        motion=motion,
        mass_damping=10.0,
    )
    jaws = [
        solid_box(f"jaw {side:+.0f}", (0.1, 1.0, 2.0), (0.6, side * (0.5 * opening + 0.5), 0.0))
        for side in (-1.0, 1.0)
    ]
    play = Play([soft], jaws, driven=True, gravity=0.0)

    def check(skin: np.ndarray) -> None:
        inside = (np.abs(skin[:, 0] - 0.6) < 0.05) & (np.abs(skin[:, 1]) > 0.5 * opening)
        depth = np.minimum(0.05 - np.abs(skin[:, 0] - 0.6), np.abs(skin[:, 1]) - 0.5 * opening)
        assert not inside.any() or depth[inside].max() < OVERLAP * CELL
        assert np.abs(skin[:, 0] - speed * play.simulation.state.time).max() < 4.0 * size[0]

    play.run(np.ceil(2.4 / speed / FRAME) * FRAME, check)
    assert np.abs(play.skin[:, 0] - speed * play.simulation.state.time).max() < size[0]
