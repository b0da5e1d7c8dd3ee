"""Free strands that meet others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.solver.build import build
from plait.solver.settings import Settings, StrandContactSettings, StrandSettings

from ..strands.rod_scenes import line, rod_scene


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_momentum_passes_from_one_to_the_other(precision):
    """Two free strands collide in flight: what one gets the other loses, to 1e-4 (float32: 1e-3)."""
    allowed = {"float64": 1e-4, "float32": 1e-3}[precision]
    shapes = [line(0.1, 20), line(0.1, 20, (0.0, 0.0, 1.0)) + np.array([0.04, 2e-3, -0.05])]
    scene = rod_scene(shapes, radius=200e-6, young=1e8, density=1000.0, gravity=(0.0, 0.0, 0.0))
    scene = replace(scene, strands=(replace(scene.strands[0], free=np.ones(2, bool)),))
    contact = StrandContactSettings(method="implicit")
    simulation = build(
        scene, Settings(threads=1, strands=StrandSettings(precision=precision), strand_contact=contact)
    )
    layout, velocity = simulation.model.parts["strands"].layout, simulation.state.arrays["strands/velocity"]
    start = np.zeros((layout.node_count, 3))
    start[layout.first_node[1] :, 1] = -0.3
    velocity.assign(start)
    for frame in range(3):
        simulation.advance_frame((frame + 1) / 24.0)
    momentum = layout.mass[:, None] * velocity.numpy()
    whole = layout.mass @ start
    assert momentum[: layout.first_node[1], 1].sum() < 0.1 * whole[1]
    assert np.linalg.norm(momentum.sum(axis=0) - whole) < allowed * np.linalg.norm(whole)
