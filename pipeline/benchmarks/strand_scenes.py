"""Scenes of strands that meet strands: tubes, crossing pairs, a capstan. SI units, y up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from plait.pipeline.benchmarks.scenes import Fibre, FormulaMotion, rods, straight, translation
from plait.solver.scene import Scene, Surface
from plait.solver.step import Simulation

GRAVITY = 9.81
# The strands of the tubes (Han 2019, figure 15, gives no material): thick hair, and the distance it keeps.
TUBE = Fibre(radius=0.3e-3, density=1300.0, youngs_modulus=1e8)
TUBE_THICKNESS = 0.4e-3


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


def set_velocity(simulation: Simulation, velocity: np.ndarray) -> None:
    """Lets strands start with (point_count, 3) [m/s], all prims' points one after another."""
    array = simulation.state.arrays["strands/velocity"]
    held = array.numpy()
    held[simulation.model.parts["strands"].layout.point_node] = velocity
    array.assign(held)


def tubes(strands: int, segments: int) -> Scene:
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
    return Scene(surfaces=(surface_a, surface_b), strands=both)


def crossing(pairs: int, speed: tuple[float, float], seed: int = 1) -> tuple[Scene, np.ndarray]:
    """Pairs of strands, clamped at their roots, that swing at each other, without gravity; (point_count, 3) [m/s].

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
    return scene, np.concatenate(velocities)


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


def capstan(friction: float, angle: float, post: str = "strand") -> Scene:
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
        return Scene(surfaces=(ground, cylinder), strands=(strand,), gravity=np.zeros(3))
    stiff = Fibre(radius=POST_RADIUS, density=5000.0, youngs_modulus=1e12)
    fixed = straight(3, 0.06, (0, 0, 1), (0, 0, -0.03))
    post_ground, thick = rods("post", [fixed], stiff, rest_shape="authored", friction=friction, surface=1)
    return Scene(surfaces=(ground, post_ground), strands=(strand, thick), gravity=np.zeros(3))


def _cylinder(facets: int, radius: float, length: float, friction: float) -> Surface:
    """About z, open at its ends, facing out."""
    turn = 2.0 * np.pi * np.arange(facets) / facets
    circle = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = np.vstack([np.c_[circle, np.full(facets, z)] for z in (-0.5 * length, 0.5 * length)])
    here = np.arange(facets)
    after = (here + 1) % facets
    triangles = np.vstack([np.c_[here, after, here + facets], np.c_[after, after + facets, here + facets]])
    return Surface("post", points, triangles.astype(np.int32), friction=friction)
