"""Strands solved in contact with moving bodies: nothing inside, Coulomb friction, gentle ways out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from plait.solver.build import build
from plait.solver.scene import Pose, RootBinding, Scene, Skinning, Strands, Surface
from plait.solver.settings import ContactSettings, Settings, StrandContactSettings, StrandSettings
from plait.solver.step import Simulation

from .shapes import Played, ball, grid

RADIUS = 40e-6
FRAME = 1.0 / 24.0


def hair(
    shapes: np.ndarray, roots: RootBinding, *, radius=RADIUS, young=4e9, friction=0.3, rest="sagfree"
) -> Strands:
    """Human hair through (strand_count, point_count, 3) shapes."""
    count, length = shapes.shape[:2]
    area, moment = np.pi * radius**2, 0.25 * np.pi * radius**4
    constants = (1300.0, young * area, young * moment, young * moment / 1.3, 0.0, friction)
    return Strands(
        "hair",
        shapes.reshape(-1, 3),
        np.arange(count + 1) * length,
        roots,
        np.full(count * length, radius),
        *(np.full(count, value) for value in constants),
        rest_shape=rest,
    )


def on_plate(roots: np.ndarray, height: float) -> tuple[Surface, RootBinding]:
    """A still triangle in y = height that carries roots in it and does not collide."""
    corners = np.array([[-2.0, height, -2.0], [2.0, height, -2.0], [0.0, height, 4.0]])
    weights = np.linalg.solve(
        np.vstack([corners[:, ::2].T, np.ones(3)]), np.vstack([roots[:, ::2].T, np.ones(len(roots))])
    )
    plate = Surface("plate", corners, np.array([[0, 2, 1]]), collides=False)
    return plate, RootBinding(0, np.zeros(len(roots), int), weights.T)


def on_faces(
    points: np.ndarray, triangles: np.ndarray, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray, RootBinding]:
    """Roots at the middle of chosen triangles: their places, the normals there, and the binding."""
    corners = points[triangles[chosen]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    binding = RootBinding(0, chosen, np.full((len(chosen), 3), 1.0 / 3.0))
    return corners.mean(axis=1), normals, binding


def depth_in_convex(points: np.ndarray, triangles: np.ndarray, x: np.ndarray) -> float:
    """[m] how deep the deepest x is inside a convex body: plane arithmetic."""
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    normals, origins = (normals / size)[size[:, 0] > 0.0], corners[size[:, 0] > 0.0, 0]
    heights = x @ normals.T - np.einsum("ti,ti->t", origins, normals)
    return float(-heights.max(axis=1).min())


def free_points(simulation: Simulation, strand_points: int) -> np.ndarray:
    """(n, 3) the first prim's points but the roots."""
    points = simulation.model.parts["strands"].points(0)
    return points.reshape(-1, strand_points, 3)[:, 1:].reshape(-1, 3)


def shaken(rest: np.ndarray, time: float) -> np.ndarray:
    """A head that is displaced by 5 cm at 4 Hz (3 g) and turns to and fro at up to 18 rad/s."""
    turn = 2.0 * np.sin(9.0 * time)
    c, s = np.cos(turn), np.sin(turn)
    moved = rest @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return moved + np.array([0.05 * np.sin(8.0 * np.pi * time), 0.03 * np.sin(10.4 * np.pi * time), 0.0])


def shaken_head(strands: int, friction: float = 0.3) -> tuple[Scene, np.ndarray, np.ndarray]:
    points, triangles = ball(24, 0.1)
    upper = np.flatnonzero(points[triangles].mean(axis=1)[:, 1] > 0.0)
    chosen = np.random.default_rng(0).choice(upper, strands, replace=False)
    roots, normals, binding = on_faces(points, triangles, chosen)
    shapes = roots[:, None] + normals[:, None] * np.linspace(0.0, 0.15, 20)[:, None]
    head = Surface("head", points, triangles, motion=Played(shaken, points))
    return Scene((head,), (hair(shapes, binding, friction=friction),)), points, triangles


def test_hair_on_a_shaken_head_stays_out_of_it() -> None:
    """0 nodes deeper than their radius at every frame, by plane arithmetic and by the stage's own count."""
    scene, points, triangles = shaken_head(80)
    alone = StrandContactSettings(method="none")  # it is about bodies
    simulation = build(scene, Settings(threads=2, strand_contact=alone))
    touched = 0
    for frame in range(18):
        metrics = simulation.advance_frame((frame + 1) * FRAME, 8)["strands"]
        x = free_points(simulation, 20)
        assert depth_in_convex(shaken(points, (frame + 1) * FRAME), triangles, x) < RADIUS
        assert metrics["penetrating"] == 0 and metrics["strain_max"] < 0.01
        touched += metrics["contacts"]
    assert touched > 50
    simulation.close()


def test_an_arm_swings_through_strands_at_ten_metres_a_second() -> None:
    """Swept 5 cm a substep through a curtain of hair: 0 nodes deeper than their radius, then at rest again."""
    rest, triangles = ball(16, 0.1)
    rest = rest * np.array([0.4, 0.4, 3.0])

    def swing(points: np.ndarray, time: float) -> np.ndarray:
        angle = 20.0 * (min(time, 0.2) - 0.1)
        c, s = np.cos(angle), np.sin(angle)
        moved = points - [0.0, 0.5, 0.0]
        return moved @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [0.0, 0.5, 0.0]

    rng = np.random.default_rng(0)
    roots = np.column_stack([rng.uniform(-0.1, 0.1, 40), np.full(40, 0.15), rng.uniform(-0.2, 0.2, 40)])
    plate, binding = on_plate(roots, 0.15)
    shapes = roots[:, None] - np.array([0.0, 1.0, 0.0]) * np.linspace(0.0, 0.3, 31)[:, None]
    arm = Surface("arm", rest, triangles, motion=Played(swing, rest))
    simulation = build(Scene((plate, arm), (hair(shapes, binding),)), Settings(threads=2))
    touched = 0
    for frame in range(10):
        metrics = simulation.advance_frame((frame + 1) * FRAME, 8)["strands"]
        x = free_points(simulation, 31)
        assert np.isfinite(x).all()
        assert depth_in_convex(swing(rest, (frame + 1) * FRAME), triangles, x) < RADIUS
        assert metrics["penetrating"] == 0
        touched += metrics["contacts"]
    assert touched > 0 and metrics["strain_max"] < 0.01
    simulation.close()


@dataclass(frozen=True)
class Bending:
    """Two joints of a cylinder along z: the upper one bends to and fro by 1.6 rad, both sway."""

    animated: bool = True

    def pose(self, time: float) -> Pose:
        lower, upper = np.eye(4), np.eye(4)
        angle = 1.6 * np.sin(6.0 * time)
        c, s = np.cos(angle), np.sin(angle)
        lower[0, 3] = 0.1 * np.sin(9.0 * time)
        upper[:3, :3] = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
        upper[:3, 3] = [0.0, 0.0, 0.3] - upper[:3, :3] @ [0.0, 0.0, 0.3]
        return Pose(np.stack([lower, lower @ upper]))


def limb() -> tuple[np.ndarray, np.ndarray, Skinning]:
    """A closed cylinder 0.6 m long, 5 cm in radius, blended between two joints about its middle."""
    rings, around = 30, 20
    turn = 2.0 * np.pi * np.arange(around) / around
    ring = np.column_stack([0.05 * np.cos(turn), 0.05 * np.sin(turn)])
    points = [[x, y, z] for z in np.linspace(0.0, 0.6, rings) for x, y in ring] + [[0, 0, 0], [0, 0, 0.6]]
    triangles = []
    for j in range(around):
        k, top = (j + 1) % around, (rings - 1) * around
        triangles += [[len(points) - 2, k, j], [len(points) - 1, top + j, top + k]]
        for i in range(0, top, around):
            triangles += [[i + j, i + k, i + j + around], [i + k, i + k + around, i + j + around]]
    points, triangles = np.array(points, dtype=float), np.array(triangles)
    weight = np.clip((points[:, 2] - 0.2) / 0.2, 0.0, 1.0)
    joints = np.tile([0, 1], (len(points), 1)).astype(np.int32)
    return points, triangles, Skinning(joints, np.column_stack([1.0 - weight, weight]))


def test_fur_on_a_bending_limb_stays_out_of_it() -> None:
    """A groom lying along a skinned limb whose creases close on it: 0 nodes deeper than their radius."""
    points, triangles, skinning = limb()
    height = points[triangles].mean(axis=1)[:, 2]
    sides = np.flatnonzero((height > 0.05) & (height < 0.55))
    chosen = np.random.default_rng(1).choice(sides, 120, replace=False)
    roots, normals, binding = on_faces(points, triangles, chosen)
    way = 0.6 * normals + np.array([0.0, 0.0, -0.8])
    shapes = roots[:, None] + way[:, None] * np.linspace(0.0, 0.06, 15)[:, None]
    skin = Surface("skin", points, triangles, motion=Bending(), skinning=skinning)
    scene = Scene((skin,), (hair(shapes, binding),), gravity=np.array([0.0, 0.0, -9.81]))
    simulation = build(scene, Settings(threads=2))
    touched = 0
    for frame in range(24):
        metrics = simulation.advance_frame((frame + 1) * FRAME, 8)["strands"]
        assert metrics["penetrating"] == 0 and metrics["strain_max"] < 0.01
        touched += metrics["contacts"]
    assert touched > 20
    simulation.close()


def test_strands_in_a_closing_crease_stay_out_of_both_bodies() -> None:
    """Two balls close to 1 mm about hanging strands: 0 nodes deeper than their radius in either."""
    points, triangles = ball(24, 0.1)

    def place(side: float):
        return lambda rest, time: rest + np.array([side * max(0.115 - 0.3 * time, 0.1005), 0.0, 0.0])

    rng = np.random.default_rng(0)
    roots = np.column_stack([rng.uniform(-0.012, 0.012, 40), np.full(40, 0.15), rng.uniform(-0.05, 0.05, 40)])
    plate, binding = on_plate(roots, 0.15)
    shapes = roots[:, None] - np.array([0.0, 1.0, 0.0]) * np.linspace(0.0, 0.3, 31)[:, None]
    bodies = [
        Surface(name, points, triangles, motion=Played(place(side), points))
        for name, side in (("left", -1.0), ("right", 1.0))
    ]
    simulation = build(Scene((plate, *bodies), (hair(shapes, binding),)), Settings(threads=2))
    touched = 0
    for frame in range(10):
        metrics = simulation.advance_frame((frame + 1) * FRAME, 8)["strands"]
        touched += metrics["contacts"]
        x = free_points(simulation, 31)
        for side in (-1.0, 1.0):
            assert depth_in_convex(place(side)(points, (frame + 1) * FRAME), triangles, x) < RADIUS
        assert metrics["penetrating"] == 0 and metrics["strain_max"] < 0.01
    assert touched > 20
    simulation.close()


@pytest.mark.parametrize("slope", [0.2, 0.45, 0.55, 0.8])
def test_a_strand_on_an_incline_sticks_and_slides_as_coulomb_says(slope: float) -> None:
    """Limp, lying across the slope, mu = 0.5: at its tip v = max(0, g (sin - mu cos)) t.

    Backward Euler gives v exactly under constant force. Sticking is a spring that yields by a hundredth of the
    radius a substep, which bounds both the creep and what sliding is late by.
    """
    mu, radius, substep = 0.5, 1e-3, 0.005
    points, triangles = grid(3, 20.0)
    angle = np.arctan(slope)
    gravity = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    carrier = Surface(
        "carrier",
        np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        np.array([[0, 1, 2]]),
        collides=False,
    )
    shape = np.column_stack([np.zeros(21), np.linspace(0.0, 1.0, 21), np.full(21, radius)])
    strand = hair(
        shape[None],
        RootBinding(0, np.zeros(1, int), np.array([[1.0, 0.0, 0.0]])),
        radius=radius,
        young=1e4,
        friction=mu,
        rest="authored",
    )
    settings = Settings(threads=1, strands=StrandSettings(tolerance=1e-6))
    simulation = build(Scene((carrier, Surface("slope", points, triangles)), (strand,), gravity=gravity), settings)
    simulation.advance_frame(0.1, 20)
    velocity = simulation.model.parts["strands"].velocities(0)[-1]
    expected = max(0.0, 9.81 * (np.sin(angle) - mu * np.cos(angle))) * 0.1
    assert velocity[0] == pytest.approx(expected, abs=0.01 * radius / substep)
    assert abs(velocity[2]) < 1e-9
    simulation.close()


def test_hair_drawn_inside_is_led_out_and_not_thrown() -> None:
    """A groom that dips 8 mm into the head comes out in the time that exit_speed needs, a strand's whip apart.

    Put out in one substep it would leave at 1.5 m/s; led out at 0.1 m/s no node reaches a third of that.
    """
    points, triangles = ball(32, 0.1)
    chosen = np.random.default_rng(2).choice(len(triangles), 30, replace=False)
    roots, normals, binding = on_faces(points, triangles, chosen)
    across = np.cross(normals, [0.3, 0.2, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    part = np.linspace(0.0, 1.0, 20)[:, None]
    radii = np.linalg.norm(roots, axis=1)[:, None, None] - 0.008 * np.sin(np.pi * part)
    shapes = radii * (np.cos(part) * normals[:, None] + np.sin(part) * across[:, None])
    shapes[:, 0] = roots
    speed, depth = 0.1, 0.008
    alone = StrandContactSettings(method="none")  # they are drawn through each other
    settings = Settings(threads=2, contact=ContactSettings(exit_speed=speed), strand_contact=alone)
    scene = Scene((Surface("head", points, triangles),), (hair(shapes, binding),), gravity=np.zeros(3))
    simulation = build(scene, settings)
    strands = simulation.model.parts["strands"]
    needed = int(np.ceil(depth / (speed * FRAME)))
    for frame in range(needed + 6):
        metrics = simulation.advance_frame((frame + 1) * FRAME, 8)["strands"]
        points, velocities = (values(0) for values in (strands.points, strands.velocities))
        climb = np.einsum("ni,ni->n", velocities, points) / np.linalg.norm(points, axis=1)
        assert climb.max() < depth / (FRAME / 8) / 3.0
        assert (metrics["penetrating"] == 0) == (frame >= needed - 1) and metrics["strain_max"] < 0.01
    simulation.close()


@pytest.mark.parametrize("lift", [0.2, 0.9])
def test_a_groom_drawn_on_the_skin_does_not_move(lift: float) -> None:
    """Sag-free strands whose nodes lie nearer to the skin than their radius: 1e-4 of the length, all frames."""
    points, triangles = ball(48, 0.1)
    chosen = np.random.default_rng(3).choice(len(triangles), 30, replace=False)
    roots, normals, binding = on_faces(points, triangles, chosen)
    across = np.cross(normals, [0.3, 0.2, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.linspace(0.0, 0.6, 12)[:, None]
    way = np.cos(angle) * normals[:, None] + np.sin(angle) * across[:, None]
    # The sphere about the facets: touching it at the corners only.
    radii = np.where(angle > 0.0, 0.1 + lift * RADIUS, np.linalg.norm(roots, axis=1)[:, None, None])
    simulation = build(
        Scene((Surface("head", points, triangles),), (hair(way * radii, binding),)), Settings(threads=2)
    )
    drawn = free_points(simulation, 12)
    for frame in range(12):
        simulation.advance_frame((frame + 1) * FRAME, 8)
        assert np.linalg.norm(free_points(simulation, 12) - drawn, axis=1).max() < 1e-4 * 0.06
    simulation.close()


def test_contact_resumes_and_splits_bit_for_bit() -> None:
    """Half a run saved and taken up by a new simulation, and one thread instead of two, end in the same bits."""
    scene, _, _ = shaken_head(40)
    whole = build(scene, Settings(threads=2))
    held = None
    for frame in range(8):
        if frame == 4:
            held = whole.state.to_numpy()
        whole.advance_frame((frame + 1) * FRAME, 4)
    resumed = build(scene, Settings(threads=1))
    resumed.state.restore(held)
    for frame in range(4, 8):
        metrics = resumed.advance_frame((frame + 1) * FRAME, 4)
    assert metrics["strands"]["contacts"] > 0
    for name, array in whole.state.arrays.items():
        np.testing.assert_array_equal(array.numpy(), resumed.state.arrays[name].numpy(), err_msg=name)
    whole.close()
    resumed.close()


def test_a_scene_without_colliders_in_reach_launches_no_contact() -> None:
    """The same number of launches as a scene without that collider."""
    scene, points, triangles = shaken_head(5)
    head = Surface("head", points, triangles, motion=scene.surfaces[0].motion, collides=False)
    far = Surface("far", points + np.array([0.0, 10.0, 0.0]), triangles)
    launches = []
    for surfaces in ((head,), (head, far)):
        simulation = build(Scene(surfaces, scene.strands), Settings(threads=1))
        metrics = simulation.advance_frame(FRAME, 8)
        launches.append(metrics["launches"]["strands"])
        simulation.close()
    assert launches[0] == launches[1]
    assert metrics["kinematics"]["skipped"] == ["far"]
