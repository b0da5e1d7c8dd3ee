"""Strands and elastic bodies: strands rest on skins and weigh on them, and grow where skins take them."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.build import build
from plait.solver.scene import RootBinding, Scene, Strands, Surface
from plait.solver.settings import Settings

from .lattices import box_body

GRAVITY, RADIUS = 9.81, 0.01
SMALL = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]])


def rope(points: np.ndarray, surface: int, radius: float, density: float = 300.0) -> Strands:
    one = np.ones(1)
    area = np.pi * radius**2
    return Strands(
        "rope",
        points,
        np.array([0, len(points)]),
        RootBinding(surface, np.array([0]), np.array([[1.0, 0.0, 0.0]])),
        np.full(len(points), radius),
        *(one * value for value in (density, 1e6 * area, 2e5 * area * radius**2 / 4, 1e3 * area * radius**2 / 2)),
        *(one * value for value in (5.0, 0.5)),
        rest_shape="authored",
    )


def rope_on_a_block(density: float) -> Scene:
    """A rope clamped beside a block that is held from below, along its top; 20 spans, one beside it."""
    body, skin = box_body((0.5, 0.2, 0.2), (5, 2, 2), youngs_modulus=5e4, density=500.0, mass_damping=4.0)
    body.pinned[body.nodes[:, 1] < -0.099] = True
    x = np.linspace(-0.27, 0.24, 21)
    points = np.stack([x, np.full_like(x, 0.1 + RADIUS), np.zeros_like(x)], axis=1)
    clamp = Surface("clamp", SMALL + points[0], np.array([[0, 1, 2]], np.int32), collides=False)
    return Scene((skin, clamp), (rope(points, 1, RADIUS, density),), bodies=(body,))


def test_a_rope_weighs_on_the_body_it_lies_on() -> None:
    """At rest the body carries the weight of the spans that touch it, and at most the clamp's span's besides.

    Momentum: what bodies are given over a time is the mean force times it, whichever substeps give it.
    """
    density = 300.0
    simulation = build(rope_on_a_block(density), Settings(threads=1))
    tets, strands = simulation.model.parts["tets"], simulation.model.parts["strands"]
    given = 0.0
    for step in range(384):
        metrics = simulation.advance_frame((step + 1) / 192, 1)
        if step >= 192:
            given -= tets.external_impulse.numpy()[:, 1].sum()
    touching = metrics["strands"]["contacts"]
    simulation.close()
    a_span = density * np.pi * RADIUS**2 * 0.51 / 20 * GRAVITY
    assert np.linalg.norm(strands.velocities(0), axis=1).max() < 1e-3
    # The tip's span is whole, the one towards the clamp shared.
    assert (touching - 0.5) * a_span < given < 20 * a_span, (given / a_span, touching)


def test_the_body_gives_way_under_the_rope() -> None:
    """Both ways: under a heavy rope the skin lies lower, by the order of p h / E, p over the block's width."""
    heights = []
    for density in (1.0, 3000.0):
        scene = rope_on_a_block(density)
        simulation = build(scene, Settings(threads=1))
        for frame in range(36):
            simulation.advance_frame((frame + 1) / 24)
        skin = scene.surfaces[0].points
        under = (skin[:, 1] > 0.099) & (np.abs(skin[:, 2]) < 0.06)
        heights.append(simulation.model.parts["tets"].points(0)[under, 1].mean())
        simulation.close()
    uniform = 3000.0 * np.pi * RADIUS**2 * GRAVITY / 0.2 * 0.2 / 5e4
    assert uniform < heights[0] - heights[1] < 10 * uniform


@pytest.mark.parametrize("young", [2e3, 2e5])
def test_hair_grows_where_the_skin_goes(young: float) -> None:
    """Roots lie on the deformed skin, whatever the body does: x_root = sum_b x_b over its triangle."""
    body, skin = box_body((0.2, 0.2, 0.2), 3, youngs_modulus=young)
    body.pinned[body.nodes[:, 1] < -0.099] = True
    weights = np.array([0.2, 0.5, 0.3])
    triangle = int(np.argmax(skin.points[skin.triangles].mean(axis=1)[:, 1]))
    root = weights @ skin.points[skin.triangles[triangle]]
    points = root + np.outer(np.linspace(0.0, 0.1, 6), [0.0, 1.0, 0.0])
    hair = rope(points, 0, 1e-3)
    binding = RootBinding(0, np.array([triangle]), weights[None])
    hair = Strands(**{**hair.__dict__, "roots": binding})
    simulation = build(Scene((skin,), (hair,), bodies=(body,)), Settings(threads=1))
    for frame in range(6):
        simulation.advance_frame((frame + 1) / 24)
        held = simulation.model.parts["tets"].points(0)
        expected = weights @ held[skin.triangles[triangle]]
        np.testing.assert_allclose(simulation.model.parts["strands"].points(0)[0], expected, atol=1e-9)
    assert np.abs(held - skin.points).max() > 1e-4 * (2e5 / young)
    simulation.close()
