"""Small scenes of rods for the tests."""

from __future__ import annotations

import numpy as np

from plait.solver.build import build
from plait.solver.scene import Motion, RootBinding, Scene, StaticMotion, Strands, Surface
from plait.solver.settings import Settings, StrandContactSettings
from plait.solver.step import Simulation


def rod_scene(
    shapes: list[np.ndarray],
    *,
    radius: float = 40e-6,
    density: float = 1300.0,
    young: float = 4e9,
    bend: float | None = None,
    twist: float | None = None,
    stretch: float | None = None,
    damping: float = 0.0,
    rest_shape: str = "authored",
    motion: Motion | None = None,
    gravity: tuple[float, float, float] = (0.0, -9.81, 0.0),
    loads: np.ndarray | None = None,
    surfaces: tuple[Surface, ...] = (),
    friction: float = 0.3,
) -> Scene:
    """Strands of circular section through `shapes`, each on a triangle of its own that `motion` moves."""
    count = len(shapes)
    points = np.concatenate(shapes)
    corner = np.array([[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 2.0]])
    roots = np.concatenate([shape[0] + 0.01 * corner for shape in shapes])
    scalp = Surface(
        "scalp",
        roots,
        np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
        motion=motion or StaticMotion(),
        collides=False,
    )
    area, second_moment = np.pi * radius**2, np.pi * radius**4 / 4.0

    def each(value: float) -> np.ndarray:
        return np.full(count, value)

    return Scene(
        surfaces=(scalp, *surfaces),
        strands=(
            Strands(
                "hair",
                points,
                np.concatenate([[0], np.cumsum([len(shape) for shape in shapes])]).astype(np.int32),
                RootBinding(0, np.arange(count, dtype=np.int32), np.full((count, 3), 1.0 / 3.0)),
                np.full(len(points), radius),
                each(density),
                each(young * area if stretch is None else stretch),
                each(young * second_moment if bend is None else bend),
                each(young / 2.6 * 2.0 * second_moment if twist is None else twist),
                each(damping),
                each(friction),
                rest_shape=rest_shape,
                loads=loads,
            ),
        ),
        gravity=np.array(gravity),
    )


def line(length: float, segments: int, direction: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> np.ndarray:
    """(segments + 1, 3) points of a straight strand from zero."""
    unit = np.array(direction) / np.linalg.norm(direction)
    return np.linspace(0.0, length, segments + 1)[:, None] * unit


def simulate(scene: Scene, **settings: object) -> Simulation:
    """`build` on one CPU thread, strands for themselves, unless told otherwise."""
    alone = {"threads": 1, "strand_contact": StrandContactSettings(method="none")}
    return build(scene, Settings(**(alone | settings)))
