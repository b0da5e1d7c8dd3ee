"""Scenes of strands that meet strands, by name in `CASES`: each a function that gives a `Case`. SI units, y up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from plait.pipeline.benchmarks.scenes import HAIR, Fibre, FormulaMotion, rods, straight, translation
from plait.solver.build import build
from plait.solver.scene import Attachment, Scene, StaticMotion, Strands, Surface
from plait.solver.settings import Settings
from plait.solver.step import Simulation

FRAMES_PER_SECOND = 24
GRAVITY = 9.81
# The strands of the tubes (Han 2019, figure 15, gives no material): thick hair, and the distance it keeps.
TUBE = Fibre(radius=0.3e-3, density=1300.0, youngs_modulus=1e8)
TUBE_THICKNESS = 0.4e-3
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

    def start(self, settings: Settings | None = None) -> Simulation:
        """A simulation of it at time 0."""
        simulation = build(self.scene, settings or Settings(threads=1, substeps=self.substeps))
        if self.velocity is not None:
            stage, array = simulation.model.parts["strands"], simulation.state.arrays["strands/velocity"]
            held = array.numpy()
            held[stage.layout.point_node] = self.velocity
            array.assign(held)
        return simulation


def bundle_places(count: int, spacing: float) -> np.ndarray:
    """(count, 2) [m]: the places nearest the origin of a hexagonal packing `spacing` apart."""
    reach = int(np.ceil(np.sqrt(count))) + 2
    row, column = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1), indexing="ij")
    places = spacing * np.stack([column + 0.5 * row, np.sqrt(0.75) * row], axis=-1).reshape(-1, 2)
    # Rounded, so that places equally far keep their order on every machine.
    order = np.lexsort((places[:, 1], places[:, 0], np.round(np.linalg.norm(places, axis=1) / spacing, 6)))
    return places[order[:count]]


def tip_loads(shapes: Sequence[np.ndarray], force: np.ndarray) -> np.ndarray:
    """(total points, 3) [N]: `force`, (3,) or (strand_count, 3), at the strands' last points."""
    counts = [len(shape) for shape in shapes]
    loads = np.zeros((sum(counts), 3))
    loads[np.cumsum(counts) - 1] = force
    return loads


def tubes(strands: int = 90, segments: int = 60) -> Case:
    """A bundle falls across another one (Han 2019, figure 15); half of the strands each.

    The lower bundle is clamped at one end and drawn tight at the other by a weight of ten times its own, as over a
    pulley; the upper one is clamped at one end, swings down onto it from 5 cm above, slides and hangs over it.
    """
    length, spacing = 0.3, 1.1 * (2.0 * TUBE.radius + TUBE_THICKNESS)
    lower_count = strands // 2
    weight = TUBE.density * TUBE.area * length * GRAVITY
    random = np.random.default_rng(1)
    # Hair is never quite parallel: ends are off by up to a third of the play between neighbours.
    uneven = 0.03 * spacing * random.uniform(-1.0, 1.0, (strands, 2, 2))
    ends = np.linspace(-0.5 * length, 0.5 * length, segments + 1)
    part = np.linspace(0.0, 1.0, segments + 1)[:, None]
    places = np.vstack([bundle_places(lower_count, spacing), bundle_places(strands - lower_count, spacing)])
    across = places[:, None] + (1.0 - part) * uneven[:, :1] + part * uneven[:, 1:]  # (strands, points, 2)
    lower = [np.column_stack([ends, one]) for one in across[:lower_count]]
    upper = [np.column_stack([one[:, 1], 0.05 + one[:, 0], ends]) for one in across[lower_count:]]
    pull = tip_loads(lower, np.array([10.0 * weight, 0.5 * weight, 0.0]))
    surface_a, a = rods("lower", lower, TUBE, rest_shape="authored", loads=pull, surface=0)
    surface_b, b = rods("upper", upper, TUBE, rest_shape="authored", surface=1)
    both = tuple(replace(s, thickness=TUBE_THICKNESS) for s in (a, b))
    return Case(Scene(surfaces=(surface_a, surface_b), strands=both), frames=100)


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


def crossing(pairs: int = 30, speed: tuple[float, float] = (5.0, 20.0), seed: int = 1) -> Case:
    """Pairs of strands, clamped at their roots, that swing at each other; no gravity.

    Where they meet they approach at `speed` [m/s], from the first to the last over the pairs, at 20 to 90 degrees.
    The velocity grows linearly from the root.
    """
    random = np.random.default_rng(seed)
    length, segments, apart = 0.3, 30, 0.02
    along = np.linspace(0.0, length, segments + 1)
    shapes, velocities = [], []
    for pair, approach in enumerate(np.linspace(*speed, pairs)):
        frame = np.linalg.qr(random.normal(size=(3, 3)))[0]
        angle = random.uniform(np.radians(20.0), np.radians(90.0))
        directions = frame[0], np.cos(angle) * frame[0] + np.sin(angle) * frame[1]
        middle = np.array([1.0 * pair, 0.0, 0.0])
        for direction, side in zip(directions, (1.0, -1.0), strict=True):
            meets = random.uniform(0.3, 0.8) * length
            shapes.append(middle + 0.5 * side * apart * frame[2] + (along - meets)[:, None] * direction)
            velocities.append(-0.5 * side * approach * (along / meets)[:, None] * frame[2])
    surface, strands = rods("pairs", shapes, TUBE, rest_shape="authored")
    strands = replace(strands, thickness=TUBE_THICKNESS)
    scene = Scene(surfaces=(surface,), strands=(strands,), gravity=np.zeros(3))
    return Case(scene, frames=4, velocity=np.concatenate(velocities))


POST_RADIUS = 10e-3
CAPSTAN_LOAD = 0.02  # [N] T1
CAPSTAN_SPEED = 0.02  # [m/s] of the pull


def wound(angle: float, distance: float, spacing: float, tail: float, segment: float) -> np.ndarray:
    """(n, 3) [m]: a straight tail, a helix about z through `angle` [rad], a straight tail; 0 at its middle.

    distance: of the middles of the helix's edges from z.  spacing: [m] it advances along z in a turn.
    """
    steps = int(np.ceil(angle * distance / segment))
    turned = np.linspace(-0.5, 0.5, steps + 1) * angle
    radius = distance / np.cos(0.5 * angle / steps)
    climb = spacing / (2.0 * np.pi)
    helix = np.stack([radius * np.cos(turned), radius * np.sin(turned), climb * turned], axis=1)
    tails = []
    for end in (turned[0], turned[-1]):
        tangent = np.array([-distance * np.sin(end), distance * np.cos(end), climb])
        tails.append(tangent / np.linalg.norm(tangent))
    ways = segment * np.arange(1, int(tail / segment) + 1)[:, None]
    return np.vstack([helix[0] - ways[::-1] * tails[0], helix, helix[-1] + ways * tails[1]])


def capstan(friction: float = 0.3, angle: float = np.pi, post: str = "strand") -> Case:
    """A strand wound about a fixed post by `angle` [rad], loaded with T1 at its tip and slowly pulled at its root.

    Sliding, the tensions' ratio is exp(friction * angle). post: 'strand', one that is 33 times as thick, or
    'surface', a cylinder of 128 facets. The strand hardly resists bending (EI / R^2 is T1 / 2000) and stretches by
    half a percent under T2. No gravity.
    """
    fibre = Fibre(radius=0.3e-3, density=1300.0, youngs_modulus=4e9, damping=50.0)
    # The cylinder's facets lie inside its circle; the strand touches their edges.
    shape = wound(angle, POST_RADIUS + fibre.radius, 5.0 * fibre.radius, 0.03, 0.75e-3)
    ends = [(shape[i] - shape[j]) / np.linalg.norm(shape[i] - shape[j]) for i, j in ((0, 1), (-1, -2))]
    pull = FormulaMotion(lambda time: translation(CAPSTAN_SPEED * time * ends[0]))
    loads = tip_loads([shape], CAPSTAN_LOAD * ends[1])
    ground, strand = rods(
        "rope", [shape], fibre, motion=pull, rest_shape="authored", friction=friction, loads=loads, surface=0
    )
    soft = np.array([5e-4 * CAPSTAN_LOAD * POST_RADIUS**2])
    stretch = np.array([200.0 * CAPSTAN_LOAD * np.exp(friction * angle)])
    strand = replace(strand, stretch_stiffness=stretch, bend_stiffness=soft, twist_stiffness=soft)
    if post == "surface":
        cylinder = _cylinder(128, POST_RADIUS, 0.06, friction)
        scene = Scene(surfaces=(ground, cylinder), strands=(strand,), gravity=np.zeros(3))
    else:
        stiff = Fibre(radius=POST_RADIUS, density=5000.0, youngs_modulus=1e12)
        fixed = straight(3, 0.06, (0, 0, 1), (0, 0, -0.03))
        post_ground, thick = rods("post", [fixed], stiff, rest_shape="authored", friction=friction, surface=1)
        scene = Scene(surfaces=(ground, post_ground), strands=(strand, thick), gravity=np.zeros(3))
    return Case(scene, frames=24, substeps=16)


def _cylinder(facets: int, radius: float, length: float, friction: float) -> Surface:
    """About z, open at its ends, facing out."""
    turn = 2.0 * np.pi * np.arange(facets) / facets
    circle = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = np.vstack([np.c_[circle, np.full(facets, z)] for z in (-0.5 * length, 0.5 * length)])
    here = np.arange(facets)
    after = (here + 1) % facets
    triangles = np.vstack([np.c_[here, after, here + facets], np.c_[after, after + facets, here + facets]])
    return Surface("post", points, triangles.astype(np.int32), friction=friction)


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
        surfaces.append(_clamp(f"end{k}", shape[-1], motion))
        attachments.append(hold(strands, 0, (k + 1) * (segments + 1) - 1, k + 1))
    scene = Scene(tuple(surfaces), (strands,), np.zeros(3), attachments=tuple(attachments))
    seconds = 2.0 * plaiting.make + plaiting.hold + 0.5
    return Case(scene, frames=round(seconds * FRAMES_PER_SECOND))


def _clamp(name: str, place: np.ndarray, motion: FormulaMotion | StaticMotion) -> Surface:
    """A triangle about `place` that does not collide."""
    corners = place + 1e-3 * np.array([[1.0, 0.1, 0.0], [-0.5, -0.2, 0.9], [-0.5, 0.1, -0.9]])
    return Surface(name, corners, np.array([[0, 1, 2]], np.int32), motion=motion, collides=False)


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
    case.__name__: case for case in (tubes, head, crossing, capstan, incline, braid, unbraid, landing, alone)
}
