"""Scenes made by hand: rods on triangles of their own, moved by a formula."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from plait.solver.scene import Motion, Pose, RestShape, RootBinding, StaticMotion, Strands, Surface

# Corners of the triangle under a root, about it [root radii]: any place will do, this one has no symmetry.
_CORNERS = np.array([[0.9, 0.1], [-0.5, 0.8], [-0.4, -0.9]])
_PATCH = 1e-3  # [m] its size


@dataclass(frozen=True)
class Fibre:
    """A round, homogeneous, isotropic rod.

    radius [m], density [kg/m3], youngs_modulus [Pa], poissons_ratio, damping [1/s].
    """

    radius: float
    density: float
    youngs_modulus: float
    poissons_ratio: float = 0.3
    damping: float = 0.0

    @property
    def area(self) -> float:
        return np.pi * self.radius**2

    @property
    def stretch_stiffness(self) -> float:
        """EA [N]."""
        return self.youngs_modulus * self.area

    @property
    def bend_stiffness(self) -> float:
        """EI [N m2], I = pi r^4 / 4."""
        return self.youngs_modulus * np.pi * self.radius**4 / 4.0

    @property
    def twist_stiffness(self) -> float:
        """GJ [N m2], J = 2 I and G = E / (2 (1 + nu))."""
        return self.bend_stiffness / (1.0 + self.poissons_ratio)


# Scalp hair, of the stiffness and weight that keratin has.
HAIR = Fibre(radius=40e-6, density=1300.0, youngs_modulus=4e9)


@dataclass(frozen=True)
class FormulaMotion:
    """A rigid surface moved by a formula, smooth in time as keys are not.

    transform: time [s] -> (4, 4), rest to world.
    """

    transform: Callable[[float], np.ndarray]
    animated: bool = True

    def pose(self, time: float) -> Pose:
        return Pose(self.transform(time)[None])


def translation(offset: np.ndarray) -> np.ndarray:
    """(4, 4): moves by `offset` (3,) [m]."""
    moved = np.eye(4)
    moved[:3, 3] = offset
    return moved


def shaking(acceleration: float, frequency: float, axis: int = 0) -> FormulaMotion:
    """To and fro along `axis`: peak acceleration [m/s2], frequency [1/s]; from rest, smoothly.

    x = a/4 (1 - cos w t)^2, whose first three derivatives vanish at t = 0 and whose acceleration peaks at a w^2.
    """
    speed = 2.0 * np.pi * frequency
    amplitude = acceleration / speed**2

    def at(time: float) -> np.ndarray:
        offset = np.zeros(3)
        offset[axis] = amplitude / 4.0 * (1.0 - np.cos(speed * time)) ** 2
        return translation(offset)

    return FormulaMotion(at)


def rods(
    name: str,
    shapes: Sequence[np.ndarray],
    fibre: Fibre | Sequence[Fibre],
    *,
    motion: Motion | None = None,
    rest_shape: RestShape = "sagfree",
    friction: float = 0.3,
    loads: np.ndarray | None = None,
    surface: int = 0,
) -> tuple[Surface, Strands]:
    """Rods clamped at their first points, each on a triangle of its own that `motion` carries.

    shapes: (point_count, 3) [m] each, root first.  fibre: one for all, or one a rod.
    loads: (total points, 3) [N], dead.
    surface: the place in `Scene.surfaces` that the returned surface, which does not collide, will have.
    """
    fibres = [fibre] * len(shapes) if isinstance(fibre, Fibre) else list(fibre)
    offsets = np.concatenate([[0], np.cumsum([len(shape) for shape in shapes])]).astype(np.int32)
    ground = Surface(
        f"{name}_roots",
        np.concatenate([_patch(shape) for shape in shapes]),
        np.arange(3 * len(shapes), dtype=np.int32).reshape(-1, 3),
        motion=motion or StaticMotion(),
        collides=False,
    )
    count = len(shapes)
    strands = Strands(
        name,
        points=np.concatenate(shapes).astype(np.float64),
        offsets=offsets,
        roots=RootBinding(surface, np.arange(count, dtype=np.int32), np.full((count, 3), 1.0 / 3.0)),
        radius=np.repeat([one.radius for one in fibres], np.diff(offsets)),
        density=np.array([one.density for one in fibres]),
        stretch_stiffness=np.array([one.stretch_stiffness for one in fibres]),
        bend_stiffness=np.array([one.bend_stiffness for one in fibres]),
        twist_stiffness=np.array([one.twist_stiffness for one in fibres]),
        damping=np.array([one.damping for one in fibres]),
        friction=np.full(count, friction),
        rest_shape=rest_shape,
        loads=loads,
    )
    return ground, strands


def _patch(shape: np.ndarray) -> np.ndarray:
    """(3, 3) corners of a triangle about the root, across the first segment."""
    direction = shape[1] - shape[0]
    length = np.linalg.norm(direction)
    direction = direction / length if length > 0.0 else np.array([0.0, 1.0, 0.0])
    across = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    across /= np.linalg.norm(across)
    return shape[0] + _PATCH * _CORNERS @ np.stack([across, np.cross(direction, across)])


def straight(segments: int, length: float, direction: Sequence[float], root: Sequence[float] = (0, 0, 0)):
    """(segments + 1, 3) [m]: from `root` along `direction`."""
    unit = np.asarray(direction, float) / np.linalg.norm(direction)
    return np.asarray(root, float) + np.linspace(0.0, length, segments + 1)[:, None] * unit


def arc(segments: int, radius: float, angle: float) -> np.ndarray:
    """(segments + 1, 3) [m]: from the origin along +x, bending towards +y through `angle` [rad]."""
    turned = np.linspace(0.0, angle, segments + 1)
    return radius * np.stack([np.sin(turned), 1.0 - np.cos(turned), np.zeros_like(turned)], axis=1)
