"""Mass properties against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.rigid.mass_properties import of_mesh, of_shape
from plait.solver.scene import Shape

from ..contact.shapes import ball
from ..contact.soft_scenes import solid_box
from .rigid_scenes import rotation_about


def test_a_box_of_triangles_has_the_inertia_of_a_box_wherever_it_is():
    """m (b^2 + c^2) / 12 along its edges, exact for a polyhedron."""
    size, centre = np.array([0.3, 0.5, 0.7]), np.array([10.0, -20.0, 5.0])
    turn = rotation_about(np.array([1.0, 2.0, 3.0]), 0.7)
    surface = solid_box("box", tuple(size))
    found = of_mesh(surface.points @ turn.T + centre, surface.triangles, 1000.0)
    mass = 1000.0 * size.prod()
    assert found.mass == pytest.approx(mass, rel=1e-12)
    assert found.center == pytest.approx(centre, rel=1e-12)
    expected = turn @ np.diag(mass / 12.0 * (np.sum(size**2) - size**2)) @ turn.T
    assert found.inertia == pytest.approx(expected, rel=1e-10, abs=1e-12 * mass)


def test_a_surface_that_encloses_nothing_has_no_mass():
    with pytest.raises(ValueError, match="no volume"):
        of_mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), 1.0)


def lathe(radius: np.ndarray, height: np.ndarray, around: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed surface of revolution about z, through (radius, height), which begins and ends on the axis."""
    turn = 2.0 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rings = [
        np.concatenate([r * circle, np.full((around, 1), z)], axis=1) for r, z in zip(radius, height, strict=True)
    ]
    first = np.arange(around)
    following = (first + 1) % around
    triangles = []
    for k in range(len(radius) - 1):
        a, b = k * around, (k + 1) * around
        triangles.append(np.stack([a + first, a + following, b + following], axis=1))
        triangles.append(np.stack([a + first, b + following, b + first], axis=1))
    return np.concatenate(rings), np.concatenate(triangles)


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "cone", "box"])
def test_shapes_have_the_mass_properties_of_their_fine_meshes(kind):
    """Of n segments around, meshes are short by terms of order (2 pi / n)^2 / 6, here 3e-5."""
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation_about(np.array([0.3, 1.0, 0.2]), 0.8), [0.1, 0.2, 0.3]
    shape = Shape(kind, np.array([0.2, 0.35, 0.15]), frame)
    r, h = 0.2, 0.35
    arc = np.linspace(0.0, np.pi / 2.0, 200)
    outlines = {
        "sphere": (r * np.sin(np.linspace(0.0, np.pi, 400)), -r * np.cos(np.linspace(0.0, np.pi, 400))),
        "capsule": (
            np.concatenate([r * np.sin(arc), r * np.cos(arc)]),
            np.concatenate([-h - r * np.cos(arc), h + r * np.sin(arc)]),
        ),
        "cylinder": (np.array([0.0, r, r, 0.0]), np.array([-h, -h, h, h])),
        "cone": (np.array([0.0, r, 0.0]), np.array([-h, -h, h])),
    }
    if kind == "box":
        surface = solid_box("box", tuple(2.0 * shape.size))
        points, triangles = surface.points, surface.triangles
    else:
        points, triangles = lathe(*outlines[kind], 400)
    mesh = of_mesh(points @ frame[:3, :3].T + frame[:3, 3], triangles, 700.0)
    found = of_shape(shape, 700.0)
    assert found.mass == pytest.approx(mesh.mass, rel=3e-4)
    assert found.center == pytest.approx(mesh.center, abs=1e-5)
    assert found.inertia == pytest.approx(mesh.inertia, rel=1e-3, abs=1e-4 * np.trace(mesh.inertia))


def test_a_ball_of_triangles_comes_near_a_ball():
    points, triangles = ball(24, 0.5)
    found, exact = of_mesh(points, triangles, 1.0), of_shape(Shape("sphere", np.full(3, 0.5)), 1.0)
    assert found.mass == pytest.approx(exact.mass, rel=0.02)
    assert np.diag(found.inertia) == pytest.approx(np.diag(exact.inertia), rel=0.03)
