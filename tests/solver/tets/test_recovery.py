"""Bodies find back to their shape: from broken states, after a bend, after a jump of the skeleton."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.scene import Surface

from ..contact.soft_scenes import solid_box
from .lattices import box_body, box_lattice, keyed, placed
from .recoveries import FRAME, Bent, bunny, deviation, diagonal, limb, recover, simulate, smooth_step

KINDS = ("flat", "point", "scrambled", "mirrored")
PROMISE = 1e-6  # of the diagonal, the largest deviation
POP_SPEED = 2.0  # [m/s]
ELBOW = {"core": 0.55}
COARSE_ELBOW = {"core": 0.55, "across": 3}
KNEE = {"core": 0.7, "radii": (0.07, 0.045), "length": 0.7}


@pytest.mark.parametrize("kind", KINDS)
def test_a_bar_returns(kind):
    left, metrics = recover(*box_lattice((1.0, 0.3, 0.3), (4, 2, 2)), kind, seed=1)
    assert left < PROMISE
    assert metrics["inverted"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", KINDS)
def test_a_finer_bar_returns(kind, seed):
    assert recover(*box_lattice((1.0, 0.25, 0.25), (12, 3, 3)), kind, seed, touching=False)[0] < PROMISE


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", KINDS)
def test_a_bunny_returns(kind, seed):
    assert recover(*bunny(1500), kind, seed, touching=False)[0] < PROMISE


@pytest.mark.parametrize(
    "shape",
    [
        pytest.param(COARSE_ELBOW, id="coarse elbow"),
        pytest.param(ELBOW, id="elbow", marks=pytest.mark.slow),
        pytest.param(KNEE, id="knee", marks=pytest.mark.slow),
    ],
)
def test_a_joint_unbends(shape):
    """Bent to 120 degrees within half a second, and back: the flesh lies as before."""

    def angle(time: float) -> float:
        return np.radians(120.0) * smooth_step(2.0 * time) * (1.0 - smooth_step(2.0 * (time - 0.6)))

    body, skin = limb(Bent(angle), **shape)
    simulation = simulate(body, skin, substeps=4)
    stage = simulation.model.parts["tets"]
    furthest = 0.0
    for frame in range(96):
        simulation.advance_frame((frame + 1) * FRAME)
        left = np.linalg.norm(stage.nodes(0) - body.nodes, axis=1).max() / diagonal(body.nodes)
        furthest = max(furthest, left)
    simulation.close()
    assert furthest > 0.5  # it was bent
    assert left < PROMISE


@pytest.mark.parametrize(
    "degrees, shift, lasts",
    [
        pytest.param(90.0, 0.0, 0.0, id="step"),
        pytest.param(90.0, 1.0, FRAME, id="within a frame"),
        pytest.param(120.0, 1.0, 0.0, id="further", marks=pytest.mark.slow),
    ],
)
def test_a_jump_of_the_skeleton_takes_the_flesh_along(degrees, shift, lasts):
    """A joint turned and moved at once, or between one frame and the next: no node is faster than 2 m/s then."""
    jump = 2.0 * FRAME

    def part(time: float) -> float:
        return float(time > jump) if lasts == 0.0 else min(max((time - jump) / lasts, 0.0), 1.0)

    body, skin = limb(Bent(lambda t: np.radians(degrees) * part(t), lambda t: shift * part(t)), **COARSE_ELBOW)
    simulation = simulate(body, skin, substeps=8)
    stage, pops = simulation.model.parts["tets"], 0
    for frame in range(24):
        metrics = simulation.advance_frame((frame + 1) * FRAME)["tets"]
        pops += metrics["pops"]
        if frame >= 2:
            speed = np.linalg.norm(stage.node_velocities(0), axis=1)
            assert speed.max() < POP_SPEED  # false for what is not a number, too
    simulation.close()
    assert pops > 0


@pytest.mark.parametrize("cells", [2, pytest.param(5, marks=pytest.mark.slow)])
def test_a_crushed_box_returns(cells):
    """Pressed flat between two plates, to a tenth of its height and beyond what its tets bear, and let go."""
    size, half = 0.2, 0.1
    body, skin = box_body((size, size, size), cells, mass_damping=20.0, youngs_modulus=2e4)

    def plate(side: int) -> Surface:
        ways = [0.0, 0.0, 0.9 * half, 0.9 * half, -size, -size]
        motion = keyed([0.0, 0.05, 0.45, 0.55, 0.7, 10.0], [placed((0.0, -side * way, 0.0)) for way in ways])
        return solid_box(f"plate {side}", (1.0, size, 1.0), (0.0, side * (half + 0.5 * size), 0.0), motion=motion)

    simulation = simulate(body, skin, plate(1), plate(-1), substeps=8)
    stage, height = simulation.model.parts["tets"], size
    for frame in range(72):
        simulation.advance_frame((frame + 1) * FRAME)
        nodes = stage.nodes(0)
        height = min(height, np.ptp(nodes[:, 1]))
        left = deviation(nodes, body.nodes)
        if frame > 24 and left < 0.5 * PROMISE:
            break
    simulation.close()
    assert height < 0.25 * size
    assert left < PROMISE
