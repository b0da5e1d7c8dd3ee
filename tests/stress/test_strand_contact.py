"""Strands against strands as no groomer means it: each scene ten times, each with what must hold said in words.

What must hold in all: the run ends, all is finite, no strand passes through another, and energy, which nothing
adds to, never rises by more than a hundredth of what the strands would gain by falling their own length. Strain
stays below 10 %, as strands that cross at 20 m/s are allowed, and where roots are shaken below the 3 % of hair on
a shaken head.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from plait.pipeline.benchmarks.scenes import Fibre, rods, shaking, straight
from plait.solver.build import build
from plait.solver.scene import Motion, Scene, Surface
from plait.solver.settings import Settings, StrandContactSettings

from ..solver.contact.soft_scenes import floor
from ..solver.strand_contact.referee import Referee
from .harness import FRAME, GRAVITY, curls, random_unit, seeds

CORD = Fibre(radius=0.3e-3, density=1300.0, youngs_modulus=1e8, damping=2.0)
THICKNESS = 0.4e-3
DISTANCE = 2.0 * CORD.radius + THICKNESS
THROWN, SHAKEN = 0.1, 0.03  # strain
ENERGIES = ("kinetic_energy", "elastic_energy", "potential_energy")


class Play:
    """Plays strands that meet, rooted or free; after every frame it checks what must hold in all scenes.

    strain: no edge may have more.  within: pairs of strands (i, j), i < j, that start within each other: only
        those may be there afterwards, and count as missed.
    """

    def __init__(
        self,
        shapes: Sequence[np.ndarray],
        fibre: Fibre | Sequence[Fibre] = CORD,
        *,
        strain: float = THROWN,
        motion: Motion | None = None,
        free: bool = False,
        ground: Surface | None = None,
        within: frozenset[tuple[int, int]] = frozenset(),
    ) -> None:
        roots, hair = rods("/hair", shapes, fibre, motion=motion, rest_shape="authored")
        hair = replace(hair, thickness=THICKNESS, free=np.full(len(shapes), free))
        scene = Scene((roots,) if ground is None else (roots, ground), (hair,))
        self.simulation = build(
            scene, Settings(threads=1, strand_contact=StrandContactSettings(method="implicit"))
        )
        self.stage = self.simulation.model.parts["strands"]
        self._judge = Referee(self.simulation, ignored=within)
        self._strain, self._driven, self._all_apart = strain, motion is not None, not within
        length = np.array([np.linalg.norm(np.diff(shape, axis=0), axis=1).sum() for shape in shapes])
        mass = np.add.reduceat(self.stage.layout.mass, self.stage.layout.first_node[:-1])
        self._scale, self._energy = float(GRAVITY * mass @ length), np.inf
        self.contacts = 0

    def run(self, frames: int, substeps: int = 8) -> None:
        for frame in range(1, frames + 1):
            found = self.simulation.advance_frame(frame * FRAME, substeps)["strands"]
            assert np.isfinite(self.stage.points(0)).all()
            assert self._judge.missed == 0, f"frame {frame}: edges {sorted(self._judge.pairs)}"
            assert not self._all_apart or found["missed"] == 0, f"frame {frame}"
            assert self._judge.largest_strain < self._strain, f"frame {frame}: {self._judge.largest_strain:.3f}"
            energy = sum(found[name] for name in ENERGIES)
            if not self._driven:
                assert energy <= self._energy + 0.01 * self._scale, f"frame {frame}"
                self._energy = min(self._energy, energy)
            self.contacts = max(self.contacts, found["strand_contacts"])
        assert self.contacts > 0


def sideways(random: np.random.Generator, count: int, points: int, apart: float) -> list[np.ndarray]:
    """Strands of 20 cm that start level, in two layers `apart` that cross at random."""
    shapes = []
    for k in range(count):
        turn = random.uniform(0.0, 0.5) + 0.5 * np.pi * (k % 2)
        along = np.array([np.cos(turn), 0.0, np.sin(turn)])
        across = np.array([-along[2], 0.0, along[0]])
        root = -0.1 * along + random.uniform(-0.03, 0.03) * across + [0.0, (k % 2) * 0.02 + k // 2 * apart, 0.0]
        shapes.append(straight(points - 1, 0.2, along, root))
    return shapes


@seeds(quick=True)
def test_tangled_strands_fall_on_each_other(seed):
    """Twelve curls at random, stress-free as drawn, fall over each other and swing."""
    random = np.random.default_rng(seed)
    Play(curls(random, 12, points=20)).run(12)


@seeds()
def test_strands_drawn_touching(seed):
    """Level strands drawn side by side exactly at their distance, in layers that cross exactly at it."""
    random = np.random.default_rng(seed)
    shapes = [
        straight(15, 0.2, (1, 0, 0), (-0.05 * random.uniform(), DISTANCE * (k // 4), DISTANCE * (k % 4)))
        for k in range(8)
    ]
    shapes += [straight(15, 0.2, (0, 0, 1), (0.02 + DISTANCE * k, 2.0 * DISTANCE, -0.1)) for k in range(4)]
    Play(shapes).run(8)


@seeds()
def test_strands_drawn_exactly_on_each_other(seed):
    """Curls drawn twice, and some that have a common root: whatever becomes of those pairs, which are within each
    other from the start, the others do not pass through them, and nothing is torn.
    """
    random = np.random.default_rng(seed)
    shapes = curls(random, 8, points=16)
    shapes = [*shapes, *(shape.copy() for shape in shapes[:2])]
    shapes += [shapes[2][:1] + straight(15, 0.2, random_unit(random)) for _ in range(2)]
    Play(shapes, within=frozenset({(0, 8), (1, 9), (2, 10), (2, 11), (10, 11)})).run(12)


@seeds(quick=True)
def test_strands_drawn_nearer_than_their_distance(seed):
    """Parallel strands at a tenth to nine tenths of their distance fall side by side; none is thrown out."""
    random = np.random.default_rng(seed)
    places = np.cumsum(DISTANCE * random.uniform(0.1, 0.9, 8))
    shapes = [straight(15, 0.2, (1.0, -0.2, 0.0), (0.0, 0.0, z)) for z in places]
    Play(shapes).run(8)


@seeds(quick=True)
def test_a_shake_of_three_g(seed):
    """Curls shaken with 3 g at 3 to 6 Hz along any axis."""
    random = np.random.default_rng(seed)
    motion = shaking(3.0 * GRAVITY, random.uniform(3.0, 6.0), axis=seed % 3)
    Play(curls(random, 12, points=20), strain=SHAKEN, motion=motion).run(12)


@seeds()
def test_strands_drawn_in_opposite_directions(seed):
    """Every second strand is clamped where its neighbours have their tips."""
    random = np.random.default_rng(seed)
    shapes = sideways(random, 12, 16, 3.0 * DISTANCE)
    Play([shape[::-1].copy() if k // 2 % 2 else shape for k, shape in enumerate(shapes)]).run(12)


@seeds(quick=True)
def test_radii_a_hundred_apart(seed):
    """Strands of 30 um to 3 mm fall across each other: no thin one slips through, no thick one is stopped dead."""
    random = np.random.default_rng(seed)
    shapes = sideways(random, 10, 16, 8e-3)
    radii = 30e-6 * 100.0 ** random.permutation(np.linspace(0.0, 1.0, len(shapes)))
    Play(shapes, [replace(CORD, radius=radius, youngs_modulus=4e9 * (40e-6 / radius)) for radius in radii]).run(12)


@seeds(quick=True)
def test_free_short_strands_in_a_heap(seed):
    """Cuttings of 2 to 4 cm, of 2 to 6 points, fall in any direction on a floor and on each other."""
    random = np.random.default_rng(seed)
    shapes = []
    for k in range(20):
        root = np.array([random.uniform(-0.01, 0.01), 0.01 + 0.004 * k, random.uniform(-0.01, 0.01)])
        direction = random_unit(random) * [1.0, 0.05, 1.0]
        shapes.append(straight(int(random.integers(1, 6)), random.uniform(0.02, 0.04), direction, root))
    Play(shapes, free=True, ground=floor()).run(12)


@seeds(quick=True)
def test_one_substep_a_frame(seed):
    """Two crossing layers fall a centimetre and more in every one of their steps of 1/24 s."""
    random = np.random.default_rng(seed)
    Play(sideways(random, 12, 16, 3.0 * DISTANCE)).run(12, substeps=1)
