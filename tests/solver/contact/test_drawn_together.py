"""Skins that lie within one another as drawn: they belong together there, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.build import build
from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.drawn_together import drawn_together
from plait.solver.launch import Launcher
from plait.solver.scene import Scene
from plait.solver.settings import Settings
from plait.solver.tets.layout import build_layout

from ..tets.lattices import box_body, placed

CELL = 0.05


def two_boxes(apart: float, *, gravity: float = 0.0) -> Scene:
    """A cube of .2 m and a bar of 1 m along x, their ends `apart` [m]: negative where one lies in the other."""
    cube, cube_skin = box_body((0.2, 0.2, 0.2), 4, index=0, surface=0)
    bar, bar_skin = box_body(
        (1.0, 0.1, 0.1), (20, 2, 2), index=1, surface=1, transform=placed((0.6 + apart, 0.0, 0.0))
    )
    return Scene((cube_skin, bar_skin), bodies=(cube, bar), gravity=np.array([0.0, -gravity, 0.0]))


def together(scene: Scene) -> tuple[CollisionParticles, np.ndarray, np.ndarray, np.ndarray]:
    launcher = Launcher("cpu", 1)
    particles = CollisionParticles(scene, build_layout(scene), CELL, launcher)
    shift = np.array([body.motion.transform[:3, 3] for body in scene.bodies])
    start = particles.rest + shift[particles.body]
    return particles, start, *drawn_together(particles, start, 3 * CELL, launcher)


def test_only_what_lies_within_belongs_together() -> None:
    """The bar's end, .08 m deep in the cube, and what is within three cells of it; no other particle."""
    particles, start, offsets, bodies = together(two_boxes(-0.08))
    chosen = np.diff(offsets) > 0
    np.testing.assert_array_equal(bodies, 1 - particles.body[chosen])
    inside = (particles.body == 1) & (start[:, 0] < 0.1 - 0.1 * CELL)
    assert chosen[inside].all() and inside.any()
    distance = np.array([np.linalg.norm(start[inside] - x, axis=1).min() for x in start])
    np.testing.assert_array_equal(chosen[distance < 2.9 * CELL], True)
    np.testing.assert_array_equal(chosen[distance > 3.5 * CELL], False)
    assert (~chosen).any()


@pytest.mark.parametrize("apart", [0.0, 1e-4, 0.02])
def test_what_only_touches_is_contact(apart: float) -> None:
    _, _, offsets, bodies = together(two_boxes(apart))
    assert not len(bodies) and not offsets.any()


def test_bodies_drawn_within_one_another_rest_so() -> None:
    """Without gravity nothing moves by a bit: there is no impulse to part them."""
    scene = two_boxes(-0.08)
    simulation = build(scene, Settings(threads=1))
    tets = simulation.model.parts["tets"]
    before = tets.position.numpy().copy()
    for frame in range(3):
        metrics = simulation.advance_frame((frame + 1) / 24)
        assert metrics["tets"]["skin_overlap"] == 0.0
    np.testing.assert_array_equal(tets.position.numpy(), before)
    simulation.close()
