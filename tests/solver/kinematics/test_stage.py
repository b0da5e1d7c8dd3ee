"""Roots, reach and moving surfaces of the kinematics stage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import warp as wp

from plait.solver.diagnostics import Refused
from plait.solver.kinematics.reach import SurfaceBounds
from plait.solver.kinematics.stage import KinematicsStage, build
from plait.solver.launch import Launcher
from plait.solver.model import Interval, Model
from plait.solver.scene import BlendShapes, Pose, RootBinding, Scene, Skinning, StaticMotion, Strands, Surface
from plait.solver.settings import Settings
from plait.solver.state import State

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])


def rotation_about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def transform(rotation: np.ndarray | None = None, translation=(0.0, 0.0, 0.0)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) if rotation is None else rotation
    matrix[:3, 3] = translation
    return matrix


@dataclass(frozen=True)
class Spin:
    """Turns about z at one radian a second and rises at one metre a second; exact at every time."""

    animated: bool = True

    def pose(self, time: float) -> Pose:
        return Pose(transform(rotation_about_z(time), (0.0, 0.0, time))[None])


@dataclass(frozen=True)
class Played:
    """A point cache given by a function of time."""

    points: object
    animated: bool = True

    def pose(self, time: float) -> Pose:
        return Pose(np.eye(4)[None], points=self.points(time))


def strands_on(surface: int, root=(0.25, 0.5, 0.1), length=1.0, triangle=0, count=1) -> Strands:
    """Strands of two points along z, bound to a triangle's place (1/4, 1/2, 1/4)."""
    points = np.tile(np.add(root, [[0.0, 0.0, 0.0], [0.0, 0.0, length]]), (count, 1))
    ones = np.ones(count)
    return Strands(
        "hair",
        points,
        np.arange(count + 1) * 2,
        RootBinding(surface, np.full(count, triangle), np.tile([0.5, 0.25, 0.25], (count, 1))),
        np.full(2 * count, 1e-3),
        *(ones * value for value in (1300.0, 1.0, 1.0, 1.0, 0.0, 0.3)),
    )


def make_stage(*surfaces: Surface, strands: Strands | None = None) -> tuple[KinematicsStage, State]:
    scene = Scene(surfaces, (strands or strands_on(0),))
    state = State()
    model = Model(scene, Settings(threads=2), Launcher("cpu", 2), 0.0)
    return build(model, state), state


def test_roots_follow_a_rigid_motion_exactly() -> None:
    """A rigid motion carries root and frame: x' = R x + t, rotation R, also off the surface and between frames."""
    stage, state = make_stage(Surface("skin", TRIANGLE, np.array([[0, 1, 2]]), motion=Spin(), collides=False))
    np.testing.assert_allclose(stage.root_position.numpy()[0], [0.25, 0.5, 0.1], atol=1e-15)
    np.testing.assert_allclose(stage.root_rotation.numpy()[0], np.eye(3), atol=1e-15)
    stage.begin_frame(state, Interval(0.0, 0.5))
    stage.step(state, Interval(0.0, 0.3))
    expected = rotation_about_z(0.3)
    np.testing.assert_allclose(stage.root_rotation.numpy()[0], expected, atol=1e-15)
    np.testing.assert_allclose(
        stage.root_position.numpy()[0], expected @ [0.25, 0.5, 0.1] + [0, 0, 0.3], atol=1e-15
    )


def test_root_rotation_is_the_polar_one_of_a_deformed_triangle() -> None:
    """The rotation nearest to the deformation, normal to normal: against an SVD of the full gradient."""
    rng = np.random.default_rng(1)
    rest, posed = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    skin = Surface("skin", rest, np.array([[0, 1, 2]]), motion=Played(lambda time: posed), collides=False)
    root = np.array([0.5, 0.25, 0.25]) @ rest
    stage, _ = make_stage(skin, strands=strands_on(0, root=root))

    def edges_and_normal(corners: np.ndarray) -> np.ndarray:
        edges = corners[1:] - corners[0]
        normal = np.cross(*edges)
        return np.column_stack([*edges, normal / np.linalg.norm(normal)])

    u, _, vt = np.linalg.svd(edges_and_normal(posed) @ np.linalg.inv(edges_and_normal(rest)))
    np.testing.assert_allclose(stage.root_rotation.numpy()[0], u @ vt, atol=1e-12)
    np.testing.assert_allclose(stage.root_position.numpy()[0], np.array([0.5, 0.25, 0.25]) @ posed, atol=1e-14)


def test_roots_are_float64_far_from_the_origin() -> None:
    """A skinned root a kilometre away keeps 1e-12 m, where float32 keeps 6e-5 m."""
    far = np.array([1000.0, 0.0, 0.0])
    skinning = Skinning(np.zeros((3, 1), np.int32), np.ones((3, 1)))
    skin = Surface(
        "skin", TRIANGLE, np.array([[0, 1, 2]]), StaticMotion(transform(translation=far)), skinning, collides=False
    )
    stage, _ = make_stage(skin)
    np.testing.assert_allclose(stage.root_position.numpy()[0], np.add(far, [0.25, 0.5, 0.1]), atol=5e-13)


def test_a_collapsed_triangle_keeps_its_last_rotation() -> None:
    """The documented rule, through a checkpoint as well."""
    turned = TRIANGLE @ rotation_about_z(0.4).T
    line = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    motion = Played(lambda time: TRIANGLE if time < 0.5 else turned if time < 1.5 else line)
    skin = Surface("skin", TRIANGLE, np.array([[0, 1, 2]]), motion=motion, collides=False)
    stage, state = make_stage(skin)
    stage.step(state, Interval(0.0, 1.0))
    resumed, resumed_state = make_stage(skin)
    resumed_state.restore(state.to_numpy())
    for each in (stage, resumed):
        each.place_roots(2.0)
        np.testing.assert_allclose(each.root_rotation.numpy()[0], rotation_about_z(0.4), atol=1e-15)


def test_a_root_triangle_without_area_at_rest_is_refused_by_name() -> None:
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    with pytest.raises(Refused, match=r"hair: strand 0 grows on triangle 0 of skin, which has no area at rest"):
        make_stage(Surface("skin", flat, np.array([[0, 1, 2]])))
    with pytest.raises(Refused, match=r"hair: strand 0 is bound to triangle 7 of skin"):
        make_stage(Surface("skin", TRIANGLE, np.array([[0, 1, 2]])), strands=strands_on(0, triangle=7))


def two_joint_surface(rng: np.random.Generator, method: str) -> Surface:
    points = rng.uniform(-1.0, 1.0, (300, 3)) * [3.0, 1.0, 1.0]
    weight = np.clip(points[:, 0] / 3.0 + 0.5, 0.0, 1.0)
    skinning = Skinning(np.tile([0, 1], (300, 1)), np.column_stack([1.0 - weight, weight]), method)
    shapes = BlendShapes(np.array([0, 300]), np.arange(300), rng.normal(size=(300, 3)))
    return Surface("s", points, np.array([[0, 1, 2]]), skinning=skinning, blend_shapes=shapes)


@pytest.mark.parametrize("method", ["linear", "dual-quaternion"])
@pytest.mark.parametrize("scaled", [False, True])
def test_bounds_hold_every_skinned_point(method: str, scaled: bool) -> None:
    """The box computed without skinning holds the skinned points, for any joints and blend weights."""
    from plait.solver.kinematics.deformer import Deformer

    rng = np.random.default_rng(2)
    surface = two_joint_surface(rng, method)
    bounds, deformer = SurfaceBounds(surface), Deformer(surface, Launcher("cpu", 1))
    points = wp.zeros(300, dtype=wp.vec3d, device="cpu")
    for _ in range(40):
        transforms = np.tile(np.eye(4), (2, 1, 1))
        rotations = np.linalg.qr(rng.normal(size=(2, 3, 3)))[0]
        transforms[:, :3, :3] = rotations * np.sign(np.linalg.det(rotations))[:, None, None]
        if scaled:
            transforms[:, :3, :3] *= rng.uniform(0.3, 2.0, (2, 1, 3))
        transforms[:, :3, 3] = rng.normal(size=(2, 3))
        pose = Pose(transforms, rng.normal(size=1))
        deformer.place(pose, points, wp.zeros(0, dtype=wp.vec3f, device="cpu"))
        lower, upper = bounds.at(pose)
        assert np.all(points.numpy() >= lower - 1e-12) and np.all(points.numpy() <= upper + 1e-12)


def test_negative_weights_leave_a_surface_without_bounds() -> None:
    """Outside convex combinations nothing can be promised, so such a surface is always in reach."""
    surface = two_joint_surface(np.random.default_rng(3), "linear")
    surface.skinning.joint_weights[5] = [1.5, -0.5]
    assert np.all(np.isinf(SurfaceBounds(surface).at(Pose(np.tile(np.eye(4), (2, 1, 1)), np.zeros(1)))))


@dataclass(frozen=True)
class FlyPast:
    """Passes the origin along x at half time only, at `speed` [m/s]."""

    speed: float
    animated: bool = True

    def pose(self, time: float) -> Pose:
        return Pose(transform(translation=(self.speed * (time - 0.5), 0.0, 0.0))[None])


def test_only_colliders_in_reach_are_skinned() -> None:
    """A collider that no strand can touch in the frame is neither placed nor launched for; one passing by is."""
    skin = Surface("skin", TRIANGLE, np.array([[0, 1, 2]]), motion=Spin(), collides=False)
    far = Surface("far", np.add(TRIANGLE, [50.0, 0.0, 0.0]), np.array([[0, 1, 2]]), motion=Spin())
    bullet = Surface("bullet", TRIANGLE, np.array([[0, 1, 2]]), motion=FlyPast(200.0))
    stage, state = make_stage(skin, far, bullet)
    frame = Interval(0.0, 1.0)
    stage.begin_frame(state, frame)
    stage.step(state, frame)
    metrics = stage.end_frame(state, frame)
    assert metrics["surfaces"] == 2 and metrics["in_reach"] == 1 and metrics["skipped"] == ["far"]
    # Three points at build of the tree, at the frame's start (the same pose: once), and at its end.
    assert metrics["skinned_points"] == 6
    assert not stage.colliders.items[0].meshes


def test_both_ends_of_a_substep_and_a_late_arrival() -> None:
    """Buffers hold the poses of the substep's own start and end, also for a surface that was skipped before."""
    skin = Surface("skin", TRIANGLE, np.array([[0, 1, 2]]), collides=False)
    passing = Surface("passing", TRIANGLE, np.array([[0, 1, 2]]), motion=FlyPast(40.0))
    still = Surface("still", TRIANGLE, np.array([[0, 1, 2]]))
    stage, state = make_stage(skin, passing, still)
    for frame, near in ((Interval(0.0, 0.1), ["still"]), (Interval(0.45, 0.55), ["passing", "still"])):
        stage.begin_frame(state, frame)
        assert [collider.surface.name for collider in stage.in_reach] == near
        middle = 0.5 * (frame.start + frame.end)
        for substep in (Interval(frame.start, middle), Interval(middle, frame.end)):
            stage.step(state, substep)
            for collider in stage.in_reach:
                for buffer, time in ((stage.start, substep.start), (stage.end, substep.end)):
                    x = 40.0 * (time - 0.5) if collider.surface.name == "passing" else 0.0
                    points = stage.colliders.points[buffer][collider.points].numpy()
                    np.testing.assert_allclose(points, np.add(TRIANGLE, [x, 0.0, 0.0]), atol=1e-12)
                    rounded = collider.meshes[buffer].points.numpy()
                    np.testing.assert_array_equal(rounded, points.astype(np.float32))


def test_triangles_without_area_take_no_part() -> None:
    """Repeated corners and needles on a line are left out of the search tree; the rest keeps its place."""
    points = np.vstack([TRIANGLE, [[2.0, 0.0, 0.0]]])
    triangles = np.array([[0, 0, 1], [0, 1, 3], [0, 1, 2]])
    skin = Surface("skin", TRIANGLE, np.array([[0, 1, 2]]), collides=False)
    stage, _ = make_stage(skin, Surface("s", points, triangles))
    collider = stage.colliders.items[0]
    assert collider.triangle_count == 1
    np.testing.assert_array_equal(stage.colliders.triangles.numpy(), [[0, 1, 2]])


def test_closed_surfaces_are_told_from_open_ones() -> None:
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    corners = np.vstack([np.zeros(3), np.eye(3)])
    skin = Surface("skin", TRIANGLE, np.array([[0, 1, 2]]), collides=False)
    turned = tetrahedron.copy()
    turned[0] = turned[0, ::-1]
    found = [
        make_stage(skin, Surface("s", corners, triangles))[0].colliders.items[0].closed
        for triangles in (tetrahedron, tetrahedron[:3], turned)
    ]
    assert found == [True, False, False]
