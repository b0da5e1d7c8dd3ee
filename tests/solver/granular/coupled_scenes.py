"""Grains with rigid bodies, flesh and strands, for tests of what passes between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plait.solver.build import build
from plait.solver.scene import Granular, RigidBody, Scene, StaticMotion, Strands, Surface
from plait.solver.settings import Settings, StrandContactSettings

from ..contact.soft_scenes import solid_box
from ..rigid.rigid_scenes import of_mesh
from ..strands.rod_scenes import line, rod_scene
from .heaps import FRAME, granular, lattice

SUBSTEPS = 4
WEIGHTLESS = np.zeros(3)


@dataclass(frozen=True)
class Part:
    """Momentum [kg m/s], mass [kg] and kinetic energy [J] of one phase."""

    momentum: np.ndarray
    mass: float
    energy: float


class Coupled:
    """A running scene. What a phase has been given and has not taken up yet counts as its own."""

    def __init__(self, scene: Scene, substeps: int = SUBSTEPS, **settings: Any) -> None:
        alone = {"threads": 1, "strand_contact": StrandContactSettings(method="none")}
        self.simulation = build(scene, Settings(substeps=substeps, **(alone | settings)))
        self.parts = self.simulation.model.parts

    def run(self, frames: int = 1) -> dict[str, Any]:
        """Goes on for whole frames; the metrics of the last."""
        start = round(self.simulation.state.time / FRAME)
        for k in range(frames):
            metrics = self.simulation.advance_frame((start + k + 1) * FRAME)
        return metrics

    @property
    def grains(self) -> Part:
        matter = self.parts["granular"].matter
        held = matter.particles
        density = matter.materials.numpy()["density"][held.material.numpy()]
        mass = (density * held.volume.numpy()).astype(float)[: matter.count]
        return _part(mass, held.velocity.numpy()[: matter.count].astype(float))

    @property
    def rigid(self) -> Part:
        stage = self.parts["rigid"]
        mass = np.array([body.mass for body in stage.bodies])
        return _part(mass, stage.velocity.numpy() + stage.impulse.numpy() / mass[:, None])

    @property
    def flesh(self) -> Part:
        stage = self.parts["tets"]
        mass = stage.layout.mass
        return _part(mass, stage.velocity.numpy() + stage.external_impulse.numpy() / mass[:, None])

    @property
    def strands(self) -> Part:
        stage = self.parts["strands"]
        inverse_mass, impulse = stage.pushes.inverse_mass.numpy(), stage.pushes.impulse.numpy()
        return _part(stage.layout.mass, stage.velocity.numpy() + inverse_mass[:, None] * impulse)


def _part(mass: np.ndarray, velocity: np.ndarray) -> Part:
    energy = 0.5 * mass @ np.square(velocity).sum(axis=1)
    return Part(mass @ velocity, float(mass.sum()), float(energy))


def block(cells: tuple[int, int, int], corner, velocity=(0.0, 0.0, 0.0), **values: Any) -> Granular:
    """Sand that fills so many cells of CELL."""
    places = lattice(cells, corner)
    return granular(places, np.tile(velocity, (len(places), 1)), **({"youngs_modulus": 1e5} | values))


def rigid_box(
    size, centre, *, density: float = 1000.0, friction: float | None = None, index: int = 0, **body: Any
) -> tuple[Surface, RigidBody]:
    """A surface, and the body that carries it; both have `index` in the scene."""
    surface = solid_box("box", size, friction=friction)
    properties, place = of_mesh(surface.points, surface.triangles, density), np.eye(4)
    place[:3, 3] = centre
    motion = StaticMotion(place)
    told = RigidBody(
        "box", (index,), properties.mass, properties.center, properties.inertia, motion=motion, **body
    )
    return replace(surface, rigid=index, motion=motion), told


def mat_of_strands(centre, *, density: float, count: int = 10) -> tuple[Surface, Strands]:
    """Free strands side by side in two layers, 0.8 m long; the surface that they need."""
    shapes = [
        line(0.8, 16) + centre + [-0.4, 0.05 * layer, 0.06 * (row - 0.5 * count)]
        for row in range(count)
        for layer in range(2)
    ]
    scene = rod_scene(shapes, radius=0.01, density=density, young=1e6)
    return scene.surfaces[0], replace(scene.strands[0], free=np.ones(len(shapes), dtype=bool))
