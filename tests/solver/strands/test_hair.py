"""Hair as productions treat it: shaken, teleported, drawn badly, saved and taken up again."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from plait.solver.diagnostics import Diverged, Refused
from plait.solver.scene import Pose, Scene
from plait.solver.settings import StrandSettings

from .rod_scenes import line, rod_scene, simulate

RATE = 24.0


@dataclass(frozen=True)
class Shaken:
    """Sideways shaking at 4 Hz for one second [m/s2], and a jump [m] within the frame from 0.5 s on."""

    acceleration: float = 10.0 * 9.81
    jump: float = 0.1
    animated: bool = True

    def pose(self, time: float) -> Pose:
        omega = 8.0 * np.pi
        swing = self.acceleration / omega**2 * np.sin(omega * min(time, 1.0)) * min(4.0 * time, 1.0)
        transform = np.eye(4)
        transform[0, 3] = swing + self.jump * np.clip((time - 0.5) * RATE, 0.0, 1.0)
        return Pose(transform[None])


def bundle(count: int, seed: int = 1, length: float = 0.25, segments: int = 50) -> list[np.ndarray]:
    """Straight and curly strands in all directions."""
    random = np.random.default_rng(seed)
    shapes = []
    for i in range(count):
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        shape = line(length, segments, direction)
        if i % 2:
            side = np.cross(direction, random.normal(size=3))
            side /= np.linalg.norm(side)
            angle = np.linspace(0.0, random.uniform(2.0, 20.0), segments + 1)[:, None]
            curl = (np.cos(angle) - 1.0) * side + np.sin(angle) * np.cross(direction, side)
            shape = shape + random.uniform(0.002, 0.01) * curl
        shapes.append(shape)
    return shapes


@pytest.mark.parametrize("substeps", [1, 2, 8])
def test_shaken_hair_neither_stretches_nor_fails_and_comes_to_rest(substeps: int) -> None:
    """Hair of 40 um and 4 GPa, shaken with 10 g and displaced by 0.1 m in a frame: stretch under 1 %, all solves
    converge, and 2 s after the shaking no point is faster than 1 mm/s.

    The damping, 10 / s, is the drag of air on a 40 um cylinder over its mass (Oseen, at 1 m/s about 11 / s).
    """
    simulation = simulate(rod_scene(bundle(16), motion=Shaken(), damping=10.0))
    strands = simulation.model.parts["strands"]
    for frame in range(72):
        metrics = simulation.advance_frame((frame + 1) / RATE, substeps)["strands"]
        assert metrics["strain_max"] < 0.01
        assert metrics["unconverged"] == 0
    assert np.linalg.norm(strands.velocities(0), axis=1).max() < 1e-3


def test_sagfree_groom_stays_as_drawn() -> None:
    """Gravity on, character still, 48 frames: no point moves more than 1e-4 of its strand's length.

    And not because nothing has touched it: kicked, it comes back.
    """
    scene = rod_scene(bundle(24), rest_shape="sagfree", damping=10.0)
    simulation = simulate(scene)
    strands = simulation.model.parts["strands"]
    drawn = strands.points(0)
    assert np.abs(drawn - scene.strands[0].points).max() < 1e-12
    for frame in range(48):
        simulation.advance_frame((frame + 1) / RATE)
        assert np.linalg.norm(strands.points(0) - drawn, axis=1).max() < 1e-4 * 0.25
    kick = simulation.state.arrays["strands/velocity"]
    kick.assign(np.tile([0.02, 0.01, -0.02], (len(kick), 1)))
    simulation.advance_frame(49 / RATE)
    assert np.linalg.norm(strands.points(0) - drawn, axis=1).max() > 1e-4 * 0.25
    for frame in range(49, 49 + 96):
        simulation.advance_frame((frame + 1) / RATE)
    assert np.linalg.norm(strands.points(0) - drawn, axis=1).max() < 1e-4 * 0.25


def test_strands_too_soft_to_stay_are_stiffened_and_said_so() -> None:
    """A column of 40 um hair, 0.25 m upright, weighs 16 times what Greenhill (1881) lets it carry."""
    up, down = line(0.25, 50, (0.0, 1.0, 0.0)), line(0.25, 50, (0.0, -1.0, 0.0))
    stage = simulate(rod_scene([up, down], rest_shape="sagfree")).model.parts["strands"]
    assert len(stage.warnings) == 1
    assert "hair: 1 of 2 strands" in stage.warnings[0]
    weight = 1300.0 * np.pi * 40e-6**2 * 9.81
    needed = weight * 0.25**3 / (7.8373 * 4e9 * np.pi * 40e-6**4 / 4.0)
    raised = stage.rods.bend.numpy()[10] / stage.rods.bend.numpy()[10 + 52]
    assert needed < raised < 1.6 * needed


def test_same_bits_with_one_and_two_threads() -> None:
    held = []
    for threads in (1, 2):
        simulation = simulate(rod_scene(bundle(40), motion=Shaken()), threads=threads)
        for frame in range(4):
            simulation.advance_frame((frame + 1) / RATE)
        held.append(simulation.state.to_numpy())
        simulation.close()
    for name, array in held[0].items():
        assert np.array_equal(array, held[1][name]), name


def test_saved_and_restored_run_continues_to_the_same_bits() -> None:
    scene = rod_scene(bundle(10), motion=Shaken(), rest_shape="sagfree")
    whole, first, second = (simulate(scene) for _ in range(3))
    for frame in range(6):
        whole.advance_frame((frame + 1) / RATE)
        if frame < 3:
            first.advance_frame((frame + 1) / RATE)
    second.state.restore(first.state.to_numpy())
    for frame in range(3, 6):
        second.advance_frame((frame + 1) / RATE)
    for name, array in whole.state.to_numpy().items():
        assert np.array_equal(array, second.state.to_numpy()[name]), name


def test_strands_do_not_know_of_one_another() -> None:
    """A strand alone and in a crowd, of other lengths, gives the same bits."""
    shapes = [line(0.1, 3), *bundle(5), line(0.3, 120, (0.0, 0.3, 1.0))]
    crowd, alone = simulate(rod_scene(shapes)), simulate(rod_scene([shapes[3]]))
    for frame in range(3):
        crowd.advance_frame((frame + 1) / RATE)
        alone.advance_frame((frame + 1) / RATE)
    begin = sum(len(shape) for shape in shapes[:3])
    points = crowd.model.parts["strands"].points(0)[begin : begin + len(shapes[3])]
    assert np.array_equal(points, alone.model.parts["strands"].points(0))


def awkward_shapes() -> dict[str, np.ndarray]:
    """What artists' tools leave behind."""
    base = line(0.1, 10)
    doubled = np.repeat(base, 2, axis=0)
    sliver = base.copy()
    sliver[5] = sliver[4] + [1e-6, 0.0, 0.0]
    folded = base.copy()
    folded[6:] = folded[5] - (folded[6:] - folded[5])
    nearly = folded.copy()
    nearly[6:, 1] += 1e-9
    zigzag = base.copy()
    zigzag[::2, 1] += 0.02
    return {
        "two points": base[:2],
        "every point twice": doubled,
        "a sliver": sliver,
        "folded back": folded,
        "nearly folded back": nearly,
        "zigzag": zigzag,
        "five hundred points": line(0.3, 499, (0.0, 1.0, 1.0)),
        "microscopic": 1e-5 * base,
        "twenty metres": 200.0 * base,
    }


@pytest.mark.parametrize("name", awkward_shapes())
@pytest.mark.parametrize("rest_shape", ["authored", "sagfree"])
def test_awkward_strands_stay_finite(name: str, rest_shape: str) -> None:
    """Badly drawn strands move like any other: solved, no longer than drawn by 1 %, counts unchanged."""
    shape = awkward_shapes()[name]
    scene = rod_scene([shape, line(0.1, 10)], rest_shape=rest_shape, motion=Shaken(), damping=5.0)
    simulation = simulate(scene)
    for frame in range(18):
        metrics = simulation.advance_frame((frame + 1) / RATE)["strands"]
        assert metrics["strain_max"] < 0.01
        assert metrics["unconverged"] == 0
    points = simulation.model.parts["strands"].points(0)
    assert points.shape == scene.strands[0].points.shape
    assert np.isfinite(points).all()


def test_stiffness_a_million_apart_in_one_scene() -> None:
    """All solves converge, and what is shaken comes to rest."""
    scene = rod_scene(bundle(6), motion=Shaken(), damping=5.0)
    factors = np.array([1e-3, 1e3, 1.0, 1e-3, 1e3, 1.0])
    strands = scene.strands[0]
    strands = replace(
        strands,
        bend_stiffness=factors * strands.bend_stiffness,
        twist_stiffness=factors[::-1] * strands.twist_stiffness,
    )
    simulation = simulate(replace(scene, strands=(strands,)))
    for frame in range(72):
        metrics = simulation.advance_frame((frame + 1) / RATE)["strands"]
        assert metrics["unconverged"] == 0
    assert np.linalg.norm(simulation.model.parts["strands"].velocities(0), axis=1).max() < 0.1


def spoiled(name: str, value: float, row: int = 1) -> Scene:
    scene = rod_scene([line(0.1, 5), line(0.1, 5)])
    values = np.array(getattr(scene.strands[0], name))
    values[row] = value
    return replace(scene, strands=(replace(scene.strands[0], **{name: values}),))


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (spoiled("density", -1.0), ("hair", "strand 1", "density")),
        (spoiled("bend_stiffness", 0.0), ("hair", "strand 1", "bend_stiffness")),
        (spoiled("stretch_stiffness", np.nan), ("hair", "strand 1", "stretch_stiffness")),
        (spoiled("radius", 0.0, row=7), ("hair", "strand 1", "radius")),
        (spoiled("points", np.inf, row=3), ("hair", "strand 0", "points")),
        (spoiled("damping", -2.0), ("hair", "strand 1", "damping")),
        (rod_scene([line(0.1, 5), line(0.1, 5)[:1]]), ("hair", "strand 1", "two or more")),
        (rod_scene([line(0.1, 5), np.zeros((4, 3))]), ("hair", "strand 1", "coincide")),
    ],
)
def test_what_cannot_be_a_rod_is_refused_by_name(scene: Scene, words: tuple[str, ...]) -> None:
    with pytest.raises(Refused) as refusal:
        simulate(scene)
    for word in words:
        assert word in str(refusal.value)


def test_state_that_is_not_finite_is_reported_with_its_strand() -> None:
    simulation = simulate(rod_scene([line(0.1, 5), line(0.1, 5), line(0.1, 5)]))
    velocity = simulation.state.arrays["strands/velocity"]
    spoil = velocity.numpy()
    spoil[9] = np.nan
    velocity.assign(spoil)
    with pytest.raises(Diverged) as error:
        simulation.advance_frame(1.0 / RATE)
    assert error.value.where == "hair strand 1"


def test_production_tolerance_keeps_the_tips() -> None:
    """Shaken with 1 g, the default tolerance moves tips of hair of 0.25 m by 0.2 mm rms at most."""
    tips = []
    for tolerance in (StrandSettings().tolerance, 1e-8):
        simulation = simulate(
            rod_scene(bundle(30), motion=Shaken(9.81, 0.0), damping=2.0),
            strands=StrandSettings(tolerance=tolerance),
        )
        for frame in range(12):
            simulation.advance_frame((frame + 1) / RATE)
        tips.append(simulation.model.parts["strands"].points(0).reshape(30, -1, 3)[:, -1])
    assert np.sqrt(((tips[0] - tips[1]) ** 2).sum(axis=1).mean()) < 2e-4


def test_float32_follows_float64_with_bounded_stretch() -> None:
    """The GPU's arithmetic, on the CPU: 2 mm rms at the tips of hair of 0.25 m after a second of shaking with 1 g.

    Its EA is softened, so that rounding does not drown the weight; the strain stays under 1 %.
    """
    tips = []
    for precision in ("float64", "float32"):
        simulation = simulate(
            rod_scene(bundle(30), motion=Shaken(9.81, 0.0), damping=2.0),
            strands=StrandSettings(precision=precision, tolerance=3e-3),
        )
        for frame in range(24):
            metrics = simulation.advance_frame((frame + 1) / RATE)["strands"]
            assert metrics["strain_max"] < 0.01
            assert metrics["unconverged"] == 0
        tips.append(simulation.model.parts["strands"].points(0).reshape(30, -1, 3)[:, -1])
    assert np.sqrt(((tips[0] - tips[1]) ** 2).sum(axis=1).mean()) < 2e-3
