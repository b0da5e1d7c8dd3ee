"""Grooms, shocks and what every stress scene must come through."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from plait.pipeline.benchmarks.scenes import HAIR, Fibre, FormulaMotion, rods
from plait.solver.build import build
from plait.solver.scene import Motion, RestShape, Scene, Surface
from plait.solver.settings import Settings, StrandContactSettings
from plait.solver.step import Simulation

FRAME = 1.0 / 24.0
GRAVITY = 9.81
# Coarse enough to be at rest as drawn: finer hair of these lengths, held up by its own rest curvature, leaves that
# equilibrium for a lower one by itself.  Amplitudes fall by e in a quarter of a second.
DAMPED_HAIR = replace(HAIR, radius=100e-6, damping=8.0)
LIMP_HAIR = replace(DAMPED_HAIR, radius=40e-6)
SETTLING = 2.0  # [s] after the last disturbance


def seeds(*, quick: bool = False, count: int = 10) -> pytest.MarkDecorator:
    """So many seeds, slow; with `quick`, the first also in the default run."""
    marked = [pytest.param(seed, marks=() if quick and seed == 0 else pytest.mark.slow) for seed in range(count)]
    return pytest.mark.parametrize("seed", marked)


def curls(random: np.random.Generator, count: int, points: int | Sequence[int] = 26) -> list[np.ndarray]:
    """Hair of 0.1 to 0.3 m that hangs from within 5 cm of the origin, spread and curled at random."""
    counts = np.broadcast_to(points, count)
    return [_curl(random, int(n)) for n in counts]


def _curl(random: np.random.Generator, count: int) -> np.ndarray:
    direction = random.normal(size=3)
    direction[1] = -abs(direction[1]) - 1.0
    direction /= np.linalg.norm(direction)
    side = np.cross(direction, random.normal(size=3))
    side /= np.linalg.norm(side)
    other = np.cross(direction, side)
    along = np.linspace(0.0, 1.0, count)[:, None]
    length, turns, width = random.uniform(0.1, 0.3), random.uniform(0.0, 3.0), random.uniform(0.0, 0.008)
    phase = 2.0 * np.pi * turns * along
    wave = width * ((np.cos(phase) - 1.0) * side + np.sin(phase) * other)
    return random.uniform(-0.05, 0.05, 3) + length * along * direction + wave


def random_unit(random: np.random.Generator) -> np.ndarray:
    held = random.normal(size=3)
    return held / np.linalg.norm(held)


def scene_of(
    shapes: list[np.ndarray],
    fibre: Fibre | Sequence[Fibre] = DAMPED_HAIR,
    *,
    motion: Motion | None = None,
    bodies: tuple[Surface, ...] = (),
    rest_shape: RestShape = "sagfree",
) -> Scene:
    """Hair `/hair` on triangles of its own, and bodies it may meet."""
    ground, hair = rods("/hair", shapes, fibre, motion=motion, rest_shape=rest_shape)
    return Scene((ground, *bodies), (hair,))


@dataclass
class Play:
    """Plays a scene, each strand for itself; after each frame everything is finite and within reach of its root.

    reach: no point may be further from its root than this many times its strand's arc length.
    """

    scene: Scene
    substeps: int = 8
    reach: float = 1.01

    def __post_init__(self) -> None:
        alone = StrandContactSettings(method="none")
        self.simulation: Simulation = build(self.scene, Settings(strand_contact=alone))
        hair = self.scene.strands[0]
        self.offsets = hair.offsets
        gaps = np.linalg.norm(np.diff(hair.points, axis=0, prepend=hair.points[:1]), axis=1)
        gaps[self.offsets[:-1]] = 0.0
        self.lengths = np.add.reduceat(gaps, self.offsets[:-1])
        # Each point's share of its strand's length, and so of its mass.
        after = np.append(gaps[1:], 0.0)
        self.weights = 0.5 * (gaps + after) / np.repeat(self.lengths, np.diff(self.offsets))
        self.strand = np.repeat(np.arange(hair.strand_count), np.diff(self.offsets))

    @property
    def points(self) -> np.ndarray:
        return self.simulation.model.parts["strands"].points(0)

    @property
    def speeds(self) -> np.ndarray:
        return np.linalg.norm(self.simulation.model.parts["strands"].velocities(0), axis=1)

    def run(self, seconds: float, each: Callable[[float], None] = lambda time: None) -> None:
        """Goes on for `seconds`, to the next whole frame; `each` is called after every frame."""
        start = round(self.simulation.state.time / FRAME)
        for frame in range(start + 1, start + 1 + int(np.ceil(seconds / FRAME - 1e-9))):
            self.simulation.advance_frame(frame * FRAME, self.substeps)
            self.check()
            each(frame * FRAME)

    def check(self) -> None:
        points = self.points
        assert np.isfinite(points).all() and np.isfinite(self.speeds).all()
        roots = points[self.offsets[:-1]]
        apart = np.linalg.norm(points - roots[self.strand], axis=1) / self.lengths[self.strand]
        worst = int(np.argmax(apart))
        assert apart[worst] < self.reach, f"strand {self.strand[worst]} reaches {apart[worst]:.3f} of its length"

    def kinetic_energy(self) -> np.ndarray:
        """(strand_count,) [J/kg] of each strand."""
        return np.add.reduceat(self.weights * self.speeds**2, self.offsets[:-1]) / 2.0

    def settle(self, seconds: float = SETTLING) -> None:
        """Goes on undisturbed for `seconds`; then no strand has more kinetic energy than a fall of 1e-4 of its
        length would give it: 2 cm/s for 0.25 m.
        """
        self.run(seconds)
        fall = self.kinetic_energy() / (GRAVITY * self.lengths)
        worst = int(np.argmax(fall))
        assert fall[worst] < 1e-4, f"strand {worst} has the energy of a fall of {fall[worst]:.2g} of its length"


def placed(rotation: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(4, 4) of a rotation and a translation [m]."""
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = rotation, offset
    return moved


def jumps(times: Sequence[float], transforms: Sequence[np.ndarray]) -> FormulaMotion:
    """Rests, and is elsewhere from one instant to the next: transforms[k] (4, 4) after times[k] [s]."""
    held = [np.eye(4), *transforms]
    return FormulaMotion(lambda time: held[int(np.searchsorted(times, time, side="left"))])


def sphere(radius: float, centre: np.ndarray, rings: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and triangles (m, 3) of a closed ball, facing out."""
    polar = np.pi * np.arange(1, rings) / rings
    around = np.pi * np.arange(2 * rings) / rings
    ring = np.stack(np.broadcast_arrays(np.cos(around), 0.0, np.sin(around)), axis=1)
    body = np.sin(polar)[:, None, None] * ring + np.cos(polar)[:, None, None] * np.array([0.0, 1.0, 0.0])
    points = np.concatenate([body.reshape(-1, 3), [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])
    size, top, bottom = 2 * rings, (rings - 1) * 2 * rings, (rings - 1) * 2 * rings + 1
    triangles = []
    for k in range(size):
        after = (k + 1) % size
        triangles += [[top, after, k], [bottom, bottom - 1 - size + k, bottom - 1 - size + after]]
        for row in range(rings - 2):
            a, b = row * size + k, row * size + after
            triangles += [[a, b, a + size], [b, b + size, a + size]]
    return centre + radius * points, np.array(triangles, dtype=np.int32)


def inner_radius(points: np.ndarray, triangles: np.ndarray, centre: np.ndarray) -> float:
    """[m] Of the largest ball about `centre` within a convex surface: its facets lie inside the sphere."""
    a, b, c = (points[triangles[:, k]] - centre for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    kept = area > 0.0
    return float(np.min(np.einsum("ni,ni->n", a[kept], normal[kept] / area[kept, None])))
