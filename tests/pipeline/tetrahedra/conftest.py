"""Skins whose inside is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh
import warp as wp
from pxr import Usd, UsdGeom


@dataclass(frozen=True)
class Shape:
    """volume: of the inside; None where the skin is open and none is known."""

    points: np.ndarray
    triangles: np.ndarray
    volume: float | None = None


def solid(mesh: trimesh.Trimesh) -> Shape:
    return Shape(np.array(mesh.vertices), np.array(mesh.faces), float(mesh.volume))


def both(first: Shape, second: Shape, volume: float) -> Shape:
    triangles = np.concatenate([first.triangles, second.triangles + len(first.points)])
    return Shape(np.concatenate([first.points, second.points]), triangles, volume)


def fork(gap: float) -> Shape:
    """Two prongs, 1.2 long, `gap` apart, on a bar: an extruded U, 0.4 thick."""
    half = 0.5 * gap
    outline = np.array(
        [[-0.5, 0], [0.5, 0], [0.5, 1.5], [half, 1.5], [half, 0.3], [-half, 0.3], [-half, 1.5], [-0.5, 1.5]]
    )
    cap = np.array([[0, 1, 4], [1, 2, 3], [1, 3, 4], [0, 4, 5], [0, 5, 7], [5, 6, 7]])
    count = len(outline)
    points = np.concatenate([np.column_stack([outline, np.full(count, z)]) for z in (0.0, 0.4)])
    a = np.arange(count)
    b = (a + 1) % count
    walls = np.concatenate([np.stack([a, b, b + count], axis=1), np.stack([a, b + count, a + count], axis=1)])
    return Shape(points, np.concatenate([cap[:, ::-1], cap + count, walls]), 0.4 * (1.5 - 1.2 * gap))


def make_shapes() -> dict[str, Shape]:
    ball = solid(trimesh.creation.icosphere(3))
    moved = Shape(ball.points + np.array([1.2, 0.0, 0.0]), ball.triangles)
    # Two unit balls 1.2 apart share a lens of height 2 h, h = 1 - 0.6; less by the part that the facets are.
    lens = 2.0 * np.pi * 0.4**2 * (3.0 - 0.4) / 3.0 * (ball.volume / (4.0 / 3.0 * np.pi))
    below = ball.triangles[ball.points[ball.triangles].mean(axis=1)[:, 2] < 0.3]
    side = np.linspace(0.0, 1.0, 11)
    sheet = trimesh.creation.box((1.0, 1.0, 0.002))
    flat = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    corner = np.arange(121).reshape(11, 11)
    a, b, c, d = (corner[i : i + 10, j : j + 10].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return {
        "cube": solid(trimesh.creation.box((1.0, 2.0, 1.5))),
        "ball": ball,
        "inside out": Shape(ball.points, ball.triangles[:, ::-1], ball.volume),
        "overlapping": both(ball, moved, 2.0 * ball.volume - lens),
        "inside out beside": both(ball, Shape(moved.points, moved.triangles[:, ::-1]), 2.0 * ball.volume - lens),
        "hollow": both(ball, Shape(0.5 * ball.points, ball.triangles[:, ::-1]), 0.875 * ball.volume),
        "hollow inside out": both(
            Shape(ball.points, ball.triangles[:, ::-1]),
            Shape(0.5 * ball.points, ball.triangles),
            0.875 * ball.volume,
        ),
        "nested": both(ball, Shape(0.5 * ball.points, ball.triangles), ball.volume),
        "bowl": Shape(ball.points, below),
        "plate": solid(sheet),
        "sheet": Shape(
            np.column_stack([flat, np.zeros(121)]), np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
        ),
        "fork": fork(0.02),
        "bunny": bunny(),
    }


def bunny() -> Shape:
    """Warp's; open where it stands."""
    stage = Usd.Stage.Open(str(Path(wp.__file__).parent / "examples" / "assets" / "bunny.usd"))
    mesh = next(UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    return Shape(
        np.array(mesh.GetPointsAttr().Get(), dtype=float),
        np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3),
    )


@pytest.fixture(scope="session")
def shapes() -> dict[str, Shape]:
    return make_shapes()


@pytest.fixture(scope="session")
def make_fork():
    return fork
