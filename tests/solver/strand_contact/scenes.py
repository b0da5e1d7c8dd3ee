"""Scenes of strands that meet strands, by name in `CASES`: each a function that gives a `Case`. SI units, y up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plait.pipeline.benchmarks import strand_scenes
from plait.pipeline.benchmarks.scenes import HAIR, Fibre, FormulaMotion, rods, straight, translation
from plait.pipeline.benchmarks.strand_scenes import (
    GRAVITY,
    TUBE,
    TUBE_THICKNESS,
    bundle_places,
    set_velocity,
    tip_loads,
)
from plait.solver.build import build
from plait.solver.scene import Attachment, Motion, Scene, StaticMotion, Strands, Surface
from plait.solver.settings import Settings, StrandContactSettings
from plait.solver.step import Simulation

FRAMES_PER_SECOND = 24
# A cord to braid.
CORD = Fibre(radius=1e-3, density=1000.0, youngs_modulus=1e8, damping=5.0)
CORD_BENDING = 1e-6  # [N m2] of spun threads, far below a solid section's


@dataclass(frozen=True)
class Case:
    """A scene and how it is run.

    frames: of 1/24 s.  substeps: a frame, before any is halved.
    velocity: (point_count, 3) [m/s] at the start, all prims' points one after another; None: at rest.
    """

    scene: Scene
    frames: int
    substeps: int = 8
    velocity: np.ndarray | None = None

    def start(
        self, method: str = "implicit", *, substeps: int | None = None, threads: int = 1, **settings: Any
    ) -> Simulation:
        """A simulation of it at time 0.

        method: of `StrandContactSettings`.  substeps: None: its own.  settings: what else `Settings` takes.
        """
        contact = StrandContactSettings(method=method)
        count = substeps or self.substeps
        chosen = Settings(threads=threads, substeps=count, strand_contact=contact, **settings)
        simulation = build(self.scene, chosen)
        if self.velocity is not None:
            set_velocity(simulation, self.velocity)
        return simulation


def tubes(strands: int = 90, segments: int = 60) -> Case:
    """A bundle falls across another one."""
    return Case(strand_scenes.tubes(strands, segments), frames=100)


def mat(tiles: int = 1, segments: int = 30) -> Case:
    """A layer of strands falls 1 mm on another one drawn tight across it: soon a contact a segment.

    A tile is 60 strands of 30 cm each way, 5 mm apart; tiles lie in a row, those of the upper layer half a tile
    on, so that all strands hang together.
    """
    length, count = 0.3, 60
    spacing, above = length / count, 2.0 * TUBE.radius + TUBE_THICKNESS + 1e-3
    weight = TUBE.density * TUBE.area * length * GRAVITY
    random = np.random.default_rng(1)

    def layer(direction: np.ndarray, across: np.ndarray, start: np.ndarray) -> list[np.ndarray]:
        """No strand is quite straight across others, nor quite in its place."""
        aside = 0.1 * spacing * random.uniform(-1.0, 1.0, (count, 2, 1)) * across
        return [
            np.linspace(
                start + spacing * (k + 0.5) * across + aside[k, 0],
                start + spacing * (k + 0.5) * across + aside[k, 1] + length * direction,
                segments + 1,
            )
            for k in range(count)
        ]

    x, y, z = np.eye(3)
    lower = [shape for k in range(tiles) for shape in layer(z, x, length * k * x)]
    upper = [
        shape for k in range(tiles) for shape in layer(x, z, length * (k + 0.5 * (tiles > 1)) * x + above * y)
    ]
    pull = tip_loads(lower, 10.0 * weight * z)
    surface_a, a = rods("lower", lower, TUBE, rest_shape="authored", loads=pull, surface=0)
    surface_b, b = rods("upper", upper, TUBE, rest_shape="authored", surface=1)
    both = tuple(replace(s, thickness=TUBE_THICKNESS) for s in (a, b))
    return Case(Scene(surfaces=(surface_a, surface_b), strands=both), frames=4)


def sphere(rings: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a closed sphere that face out."""
    polar, turn = np.pi * np.arange(1, rings) / rings, np.pi * np.arange(2 * rings) / rings
    sine = np.sin(polar)[:, None]
    circles = np.stack(
        np.broadcast_arrays(sine * np.cos(turn), np.cos(polar)[:, None], -sine * np.sin(turn)), axis=-1
    )
    points = radius * np.vstack([circles.reshape(-1, 3), [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])
    index = np.arange((rings - 1) * 2 * rings).reshape(rings - 1, 2 * rings)
    after = np.roll(index, -1, axis=1)
    upper, lower, upper_after, lower_after = index[:-1], index[1:], after[:-1], after[1:]
    north, south = np.full(2 * rings, len(points) - 2), np.full(2 * rings, len(points) - 1)
    parts = [
        np.stack([upper, lower, upper_after], axis=-1),
        np.stack([upper_after, lower, lower_after], axis=-1),
        np.stack([north, index[0], after[0]], axis=-1),
        np.stack([south, after[-1], index[-1]], axis=-1),
    ]
    return points, np.concatenate([part.reshape(-1, 3) for part in parts]).astype(np.int32)


def smoothly(part: float) -> float:
    """From 0 to 1 with two derivatives zero at both ends."""
    p = min(max(part, 0.0), 1.0)
    return p**3 * (10.0 - 15.0 * p + 6.0 * p * p)


HEAD_RADIUS = 0.09


def head_transform(time: float) -> np.ndarray:
    """(4, 4): shaken sideways with a peak of 3 g at 4 Hz, and between 1 and 1.2 s turned 90 degrees about y."""
    speed = 8.0 * np.pi
    offset = 3.0 * GRAVITY / speed**2 / 4.0 * (1.0 - np.cos(speed * time)) ** 2
    turn = 0.5 * np.pi * smoothly((time - 1.0) / 0.2)
    moved = translation(np.array([offset, 0.0, 0.0]))
    moved[0, [0, 2]], moved[2, [0, 2]] = (np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))
    return moved


def head(strands: int = 2000, segments: int = 30) -> Case:
    """Hair of 15 cm on the upper half of a ball, combed down in layers, shaken and turned (`head_transform`).

    Every strand lies in the meridian's plane of its root; its height over the ball grows with the way from its
    root, so that those that come from above lie over those that start below.
    """
    length, rise, away = 0.15, 0.06, 1e-3
    golden = np.pi * (3.0 - np.sqrt(5.0))
    height = 1.0 - (np.arange(strands) + 0.5) / strands  # cos of the polar angle, to the equator
    shapes = [_combed(np.arccos(h), golden * i, segments, length, rise, away) for i, h in enumerate(height)]
    motion = FormulaMotion(head_transform)
    roots, hair = rods("hair", shapes, HAIR, motion=motion, surface=0)
    points, triangles = sphere(20, HEAD_RADIUS)
    ball = Surface("head", points, triangles, motion=motion)
    return Case(Scene(surfaces=(roots, ball), strands=(replace(hair, thickness=0.2e-3),)), frames=48)


def _combed(polar: float, azimuth: float, segments: int, length: float, rise: float, away: float) -> np.ndarray:
    """(segments + 1, 3) [m]: down a meridian and from the equator on straight down; see `head`."""
    out, up = np.empty(segments + 1), np.empty(segments + 1)
    below = 0.0
    for i, s in enumerate(np.linspace(0.0, length, segments + 1)):
        lifted = HEAD_RADIUS + away + rise * s
        if polar < 0.5 * np.pi:
            out[i], up[i] = lifted * np.sin(polar), lifted * np.cos(polar)
            polar += length / segments / lifted
        else:
            out[i], up[i] = lifted, -below
            below += length / segments
    return np.stack([out * np.cos(azimuth), up, out * np.sin(azimuth)], axis=1)


def crossing(pairs: int = 30, speed: tuple[float, float] = (5.0, 20.0)) -> Case:
    """Pairs of strands that swing at each other."""
    scene, velocity = strand_scenes.crossing(pairs, speed)
    return Case(scene, frames=4, velocity=velocity)


def capstan(friction: float = 0.3, angle: float = np.pi, post: str = "strand") -> Case:
    """A strand wound about a fixed post, slowly pulled at its root."""
    return Case(strand_scenes.capstan(friction, angle, post), frames=24, substeps=16)


def incline(angle: float = np.radians(20.0), friction: float = 0.3) -> Case:
    """A short free strand across two fixed rails that fall by `angle` [rad] along +x.

    It sticks where tan(angle) < friction; else it slides with g (sin(angle) - friction cos(angle)).
    """
    rail = Fibre(radius=3e-3, density=1000.0, youngs_modulus=1e12)
    short = Fibre(radius=0.5e-3, density=2000.0, youngs_modulus=1e9)
    down = np.array([np.cos(angle), -np.sin(angle), 0.0])
    normal = np.array([np.sin(angle), np.cos(angle), 0.0])
    rails = [straight(30, 0.3, down, (0.0, 0.0, z)) for z in (-0.015, 0.015)]
    lying = straight(10, 0.05, (0, 0, 1), 0.055 * down + (rail.radius + short.radius) * normal - [0, 0, 0.025])
    surface_a, a = rods("rails", rails, rail, friction=friction, surface=0)
    surface_b, b = rods("short", [lying], short, rest_shape="authored", friction=friction, surface=1)
    return Case(Scene(surfaces=(surface_a, surface_b), strands=(a, replace(b, free=np.ones(1, bool)))), frames=12)


def braid_curve(phase: np.ndarray, width: float, depth: float) -> np.ndarray:
    """(n, 2): across and in depth of one strand of a braid of three, whose phases are a third of a turn apart."""
    return np.stack([width * np.sin(phase), depth * np.sin(2.0 * phase)], axis=1)


def braided(periods: int, length: float, segments: int, width: float, depth: float) -> list[np.ndarray]:
    """Three strands, (segments + 1, 3) [m] each, down from y = 0."""
    along = np.linspace(0.0, 1.0, segments + 1)
    shapes = []
    for k in range(3):
        # A quarter of a crossing on from the middle, no strand is behind another at the ends.
        across = braid_curve(2.0 * np.pi * (periods * along + k / 3.0 + 0.125), width, depth)
        shapes.append(np.stack([across[:, 0], -length * along, across[:, 1]], axis=1))
    return shapes


def braid_pull(strands: np.ndarray) -> np.ndarray:
    """(3, 3): unit directions 30 degrees from down, 120 degrees from each other round it, as the tips stand."""
    tips = strands[:, -1, [0, 2]]
    angle = np.arctan2(*(tips - tips.mean(axis=0)).T[::-1])
    turn = 2.0 * np.pi / 3.0 * np.argsort(np.argsort(angle))
    turn += np.angle(np.exp(1j * (angle - turn)).sum())
    return np.stack([0.5 * np.cos(turn), np.full(3, -np.sqrt(0.75)), 0.5 * np.sin(turn)], axis=1)


def braid(tightness: float = 1.0, periods: int = 6, segments: int = 120) -> Case:
    """A braid of three, clamped at its top, each strand pulled down and outwards at its tip by a weight.

    tightness: of the pull, .3 N a strand at 1. It starts loose: strands pass at 1.4 contact distances.
    """
    distance, length = 2.0 * CORD.radius, 0.27
    # Where two cross, they are 2 sin(60 degrees) times the depth apart.
    shapes = braided(periods, length, segments, 2.0 * distance, 1.4 * distance / np.sqrt(3.0))
    loads = tip_loads(shapes, 0.3 * tightness * braid_pull(np.array(shapes)))
    surface, strands = rods("braid", shapes, CORD, rest_shape="authored", loads=loads)
    soft = np.full(3, CORD_BENDING)
    strands = replace(strands, bend_stiffness=soft, twist_stiffness=soft)
    return Case(Scene(surfaces=(surface,), strands=(strands,), gravity=np.zeros(3)), frames=100)


@dataclass(frozen=True)
class Plaiting:
    """Where the ends of strands are while a braid is made, held and undone again.

    make, hold: [s]; undoing takes as long as making.  periods: of the braid.
    width, depth: [m] of the ends' paths.  rise: [m] by which the ends come up meanwhile.
    """

    periods: int = 2
    make: float = 2.0
    hold: float = 0.5
    width: float = 0.04
    depth: float = 0.025
    rise: float = 0.05

    def part(self, time: float) -> float:
        """Of the braid that is made at `time` [s], 0 to 1."""
        back = 2.0 * self.make + self.hold - time
        return smoothly(min(time, back) / self.make)

    def end(self, strand: int, time: float) -> np.ndarray:
        """(3,) [m] where a strand's end is, beside y at the start."""
        part = self.part(time)
        phase = 2.0 * np.pi * (self.periods * part + strand / 3.0 + 0.125)
        across = braid_curve(np.array([phase]), self.width, self.depth)[0]
        return np.array([across[0], self.rise * part, across[1]])


def unbraid(plaiting: Plaiting = Plaiting(), segments: int = 80) -> Case:
    """Three strands whose ends are led round each other and back (Han 2019, figure 12); the tops are clamped."""
    length = 0.3
    ends = [plaiting.end(k, 0.0) for k in range(3)]
    tops = [end * (0.25, 1.0, 0.25) for end in ends]
    shapes = [
        np.linspace(top, end - [0.0, length, 0.0], segments + 1) for end, top in zip(ends, tops, strict=True)
    ]
    surface, strands = rods("strands", shapes, CORD, rest_shape="authored")
    soft = np.full(3, CORD_BENDING)
    strands = replace(strands, bend_stiffness=soft, twist_stiffness=soft)
    surfaces, attachments = [surface], []
    for k, shape in enumerate(shapes):
        motion = FormulaMotion(lambda time, k=k: translation(plaiting.end(k, time) - plaiting.end(k, 0.0)))
        surfaces.append(clamp(f"end{k}", shape[-1], motion))
        attachments.append(hold(strands, 0, (k + 1) * (segments + 1) - 1, k + 1))
    scene = Scene(tuple(surfaces), (strands,), np.zeros(3), attachments=tuple(attachments))
    seconds = 2.0 * plaiting.make + plaiting.hold + 0.5
    return Case(scene, frames=round(seconds * FRAMES_PER_SECOND))


def clamp(name: str, place: np.ndarray, motion: Motion | None = None) -> Surface:
    """A triangle about `place` that does not collide."""
    corners = place + 1e-3 * np.array([[1.0, 0.1, 0.0], [-0.5, -0.2, 0.9], [-0.5, 0.1, -0.9]])
    return Surface(name, corners, np.array([[0, 1, 2]], np.int32), motion=motion or StaticMotion(), collides=False)


def hold(strands: Strands, prim: int, point: int, surface: int) -> Attachment:
    """Point `point` of prim `prim`, held exactly at the first triangle of a surface."""
    middle = np.full((1, 3), 1.0 / 3.0)
    return Attachment(f"{strands.name} {point}", prim, np.array([point]), surface, np.zeros(1, np.int32), middle)


def landing(strands: int = 37, segments: int = 30, ground: str = "trough") -> Case:
    """A bundle clamped at one end 1 cm over the ground falls on it from level and comes to rest.

    ground: 'trough', of two planes at 45 degrees, which holds the bundle together; 'floor', on which it slumps, as
    round logs do.
    """
    length, spacing = 0.3, 1.05 * (2.0 * TUBE.radius + TUBE_THICKNESS)
    places = bundle_places(strands, spacing)
    shapes = [straight(segments, length, (1, 0, 0), (0.0, 0.015 + y, z)) for y, z in places]
    surface, bundle = rods("bundle", shapes, replace(TUBE, damping=2.0), rest_shape="authored")
    side = 0.1 if ground == "trough" else 0.0
    profile = np.array([[side, -0.1], [0.0, 0.0], [side, 0.1]])
    corners = np.vstack([np.column_stack([np.full(3, x), profile]) for x in (-0.1, 0.4)])
    triangles = np.array([[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4]], np.int32)
    below = Surface("ground", corners, triangles, friction=0.5)
    bundle = replace(bundle, thickness=TUBE_THICKNESS)
    return Case(Scene(surfaces=(surface, below), strands=(bundle,)), frames=72)


def alone(strands: int = 16, segments: int = 30) -> Case:
    """Strands a metre apart that swing and never meet."""
    shapes = [straight(segments, 0.3, (1, 0, 0), (0.0, 0.0, 1.0 * i)) for i in range(strands)]
    surface, far = rods("far", shapes, TUBE, rest_shape="authored")
    return Case(Scene(surfaces=(surface,), strands=(replace(far, thickness=TUBE_THICKNESS),)), frames=12)


CASES: dict[str, Callable[..., Case]] = {
    case.__name__: case for case in (tubes, mat, head, crossing, capstan, incline, braid, unbraid, landing, alone)
}
