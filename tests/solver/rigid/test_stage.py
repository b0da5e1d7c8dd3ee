"""The stage of rigid bodies among others: state, skipping, surfaces that others see."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from plait.solver.build import FEATURES, build
from plait.solver.diagnostics import Refused
from plait.solver.model import Interval
from plait.solver.scene import Pose, RootBinding, Scene, Strands, Surface
from plait.solver.settings import Settings

from ..contact.soft_scenes import floor
from .rigid_scenes import FRAME, SUBSTEPS, Rigid, box, pose, rotation_about, shaped


def tumbling() -> Rigid:
    props = [box(centre=(0.05 * k, 0.15 + 0.22 * k, 0.0), angular_velocity=[1.0, 0.5, 2.0]) for k in range(3)]
    return Rigid([*props, shaped("sphere", 0.1, (0.4, 0.3, 0.0), velocity=[-1.0, 0.0, 0.0])], [floor()])


def test_a_saved_state_goes_on_with_the_same_bits():
    scene = tumbling()
    scene.run(0.5)
    held = scene.simulation.state.to_numpy()
    scene.run(0.25)
    other = tumbling()
    other.simulation.state.restore(held)
    other.run(0.25)
    assert np.array_equal(scene.position, other.position)
    assert np.array_equal(scene.stage.orientation.numpy(), other.stage.orientation.numpy())


def test_a_retracted_step_leaves_no_trace():
    scene, other = tumbling(), tumbling()
    scene.run(0.5)
    other.run(0.5)
    substep = Interval(scene.time, scene.time + FRAME / 8)
    kinematics = scene.simulation.model.parts["kinematics"]
    for stage in (kinematics, scene.stage):
        stage.begin_frame(scene.simulation.state, substep)
        stage.step(scene.simulation.state, substep, False)
    for stage in (scene.stage, kinematics):
        stage.retract(scene.simulation.state, substep)
    scene.run(0.25)
    other.run(0.25)
    assert np.array_equal(scene.position, other.position)


def test_without_rigid_bodies_nothing_of_them_is_imported():
    code = (
        "import sys, numpy as np\n"
        "from plait.solver.build import FEATURES, build\n"
        "from plait.solver.scene import Scene\n"
        "build(Scene())\n"
        "assert not [name for name in sys.modules if name.startswith('plait.solver.rigid')]\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert not any(needed(Scene()) for _, _, needed in FEATURES)


@pytest.mark.parametrize("change", [2.0 * np.eye(3), np.diag([1.0, 1.0, -1.0])])
def test_a_pose_that_scales_or_mirrors_is_refused(change):
    prop = box()
    prop.motion.transform[:3, :3] = change
    with pytest.raises(Refused, match="body 0"):
        Rigid([prop])


def test_a_body_without_mass_is_refused():
    prop = box(density=0.0)
    with pytest.raises(Refused, match="mass"):
        Rigid([prop])


def test_launches_do_not_grow_with_bodies():
    """A few recorded launches a substep, however many bodies there are."""
    counts = []
    for number in (1, 6):
        scene = Rigid([box(centre=(0.0, 0.1 + 0.2 * k, 0.0)) for k in range(number)], [floor()])
        scene.run(FRAME)
        before = scene.simulation.model.launcher.launches["rigid"]
        scene.substep()
        counts.append(scene.simulation.model.launcher.launches["rigid"] - before)
    assert counts[0] == counts[1] <= 8


def one_strand(points: np.ndarray, roots: RootBinding, transform: np.ndarray, radius: float) -> Strands:
    count = len(points)
    values = (1300.0, 20.0, 8e-9 * (radius / 4e-5) ** 4, 6e-9 * (radius / 4e-5) ** 4, 10.0, 0.3)
    return Strands(
        "hair",
        points,
        np.array([0, count]),
        roots,
        np.full(count, radius),
        *(np.array([value]) for value in values),
        rest_transform=transform,
    )


def test_strands_grow_on_rigid_bodies():
    """Hair on a falling, turning box: its root goes exactly with it."""
    prop = box(centre=(0.0, 2.0, 0.0), angular_velocity=[0.0, 0.0, 3.0])
    root = np.array([-0.05, 0.1, 0.02])
    points = root + np.linspace(0.0, 0.15, 12)[:, None] * [0.0, 1.0, 0.0]
    triangle = next(
        t
        for t, corners in enumerate(prop.surface.points[prop.surface.triangles])
        if np.allclose(corners[:, 1], 0.1) and _weights(corners, root).min() >= 0.0
    )
    weights = _weights(prop.surface.points[prop.surface.triangles[triangle]], root)
    roots = RootBinding(0, np.array([triangle]), weights[None])
    held = Rigid([prop]).scene
    hair = one_strand(points, roots, prop.motion.transform, 4e-5)
    simulation = build(replace(held, strands=(hair,)), Settings(threads=1))
    for k in range(6):
        simulation.advance_frame((k + 1) * FRAME)
    pose = simulation.model.parts["rigid"].pose(0)
    kinematics = simulation.model.parts["kinematics"]
    assert kinematics.root_position.numpy()[0] == pytest.approx(pose[:3, :3] @ root + pose[:3, 3], abs=1e-12)
    assert kinematics.root_rotation.numpy()[0] == pytest.approx(pose[:3, :3], abs=1e-9)


def test_a_strand_that_is_hit_by_a_body_pushes_back():
    """A light ball thrown at a thick bristle in weightlessness: the bristle gives way, the ball loses speed."""
    corners = np.array([[-0.01, 0.0, -0.01], [0.01, 0.0, -0.01], [0.0, 0.0, 0.02]])
    skin = Surface("skin", corners, np.array([[0, 2, 1]]), collides=False)
    points = np.linspace(0.0, 0.3, 16)[:, None] * [0.0, 1.0, 0.0]
    roots = RootBinding(1, np.array([0]), np.full((1, 3), 1.0 / 3.0))
    bristle = one_strand(points, roots, np.eye(4), 1e-3)
    ball = shaped("sphere", 0.05, (-0.1, 0.25, 0.0), velocity=[0.5, 0.0, 0.0], density=10.0)
    scene = Rigid([ball], [skin], gravity=(0.0, 0.0, 0.0))
    simulation = build(replace(scene.scene, strands=(bristle,)), Settings(threads=1))
    rigid, strands = simulation.model.parts["rigid"], simulation.state.arrays["strands/position"]
    start = strands.numpy()[-1].copy()
    for k in range(8):
        simulation.advance_frame((k + 1) * FRAME)
    assert strands.numpy()[-1][0] > start[0] + 0.01
    assert -0.5 < rigid.velocity.numpy()[0, 0] < 0.45


def _weights(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    u, v, w = corners[1] - corners[0], corners[2] - corners[0], point - corners[0]
    b, c = np.linalg.lstsq(np.stack([u, v], axis=1), w, rcond=None)[0]
    return np.array([1.0 - b - c, b, c])


def test_a_surface_is_carried_to_where_its_body_is():
    scene = Rigid([box(centre=(1.0, 2.0, 3.0), angular_velocity=[0.5, 0.1, 0.2])])
    scene.run(0.5)
    count = len(scene.scene.surfaces[0].points)
    points, query = wp.zeros(count, dtype=wp.vec3d), wp.zeros(count, dtype=wp.vec3f)
    scene.stage.place_surface(0, points, query)
    assert points.numpy() == pytest.approx(scene.points(0), abs=1e-12)
    assert query.numpy() == pytest.approx(scene.points(0), abs=1e-6)


class _Rising:
    """Up at 2 m/s while it turns about y at 3 rad/s."""

    animated = True

    def pose(self, time: float) -> Pose:
        return Pose(pose((0.0, 2.0 * time, 0.0), rotation_about((0.0, 1.0, 0.0), 3.0 * time)).transform[None])


def test_a_body_is_held_until_it_is_released():
    """Until then it is where its motion has it, whatever pushes it; then it flies with the velocity it has."""
    release = 2.0 * FRAME
    prop = box(velocity=np.array([1.0, 0.0, 0.0]))
    prop.motion = _Rising()
    rigid = Rigid([prop], rigid_start=release)
    for _ in range(2):
        rigid.stage.push(np.array([0]), np.zeros((1, 3)), np.array([[5.0, 5.0, 5.0]]))
        rigid.run(FRAME)
        np.testing.assert_allclose(rigid.position[0], [0.0, 2.0 * rigid.time, 0.0], atol=1e-12)
        expected = rotation_about((0.0, 1.0, 0.0), 3.0 * rigid.time)
        np.testing.assert_allclose(rigid.rotation[0], expected, atol=1e-12)
    np.testing.assert_allclose(rigid.velocity[0], [1.0, 0.0, 0.0])
    kept = rigid.simulation.state.to_numpy()
    rigid.run(FRAME)
    # A first-order step of gravity over a frame of n substeps falls by g h^2 n (n + 1) / 2.
    h = FRAME / SUBSTEPS
    fallen = 9.81 * h**2 * SUBSTEPS * (SUBSTEPS + 1) / 2
    np.testing.assert_allclose(rigid.position[0], [FRAME, 2.0 * release - fallen, 0.0], atol=1e-12)
    after = rigid.simulation.state.to_numpy()
    rigid.simulation.state.restore(kept)
    rigid.run(FRAME)
    for name, value in rigid.simulation.state.to_numpy().items():
        np.testing.assert_array_equal(value, after[name])
