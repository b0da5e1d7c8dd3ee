"""A mannequin of any build: a closed skin over the sample character's skeleton, that walks straight ahead.

Centimetres, Y up, facing +Z. `author` puts one into a stage, as flesh that the simulation fills with tets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

from plait.assets import generate, walk
from plait.assets.character import Joint, blended_weights, skeleton
from plait.assets.implicit import blend, ellipsoid, polygonise, relax, round_cone, simplify
from plait.assets.walk import Choreography, Swing

CELL = 1.3  # [cm] of the grid that the skin is cut on
FOOTPRINT_X = 8.0  # [cm] of the ball of the foot from the line walked along


@dataclass(frozen=True)
class Build:
    """fat: -1 thin, 0 average, 1 heavy, and anything between.  colour: linear RGB."""

    name: str
    fat: float
    colour: tuple[float, float, float]


THIN = Build("Thin", -1.0, (0.62, 0.42, 0.20))
AVERAGE = Build("Average", 0.0, (0.50, 0.24, 0.17))
HEAVY = Build("Heavy", 1.0, (0.20, 0.32, 0.44))


@dataclass(frozen=True)
class Mannequin:
    """points (n, 3) [cm], triangles (m, 3), joint_indices and joint_weights (n, 4)."""

    joints: tuple[Joint, ...]
    points: np.ndarray
    triangles: np.ndarray
    joint_indices: np.ndarray
    joint_weights: np.ndarray


def make(build: Build, triangles: int = 4000) -> Mannequin:
    """The same every time; about so many triangles."""
    joints = skeleton()

    def distance(points: np.ndarray) -> np.ndarray:
        return body_distance(points, build.fat)

    points, faces = polygonise(distance, (-72, -2, -26), (72, 178, 32), CELL)
    points, faces = simplify(points, faces, triangles)
    points = relax(distance, points, faces, 4)
    return Mannequin(joints, points, faces, *blended_weights(points, faces, joints))


def straight_walk(
    steps: int, stride: float = 66.0, period: float = 0.52, fat: float = 0.0, first: str = "Right"
) -> Choreography:
    """From standing, `steps` steps of `stride` [cm], one every `period` [s], the last to where the other foot is.

    first: the foot that goes first. Heavier people hold their arms further out.
    """
    swings: dict[str, list[Swing]] = {"Left": [], "Right": []}
    other = "Left" if first == "Right" else "Right"
    ball = next(joint.place[2] for joint in skeleton() if joint.name == "LeftToe")
    for step in range(steps):
        side = first if step % 2 == 0 else other
        start = 0.39 + step * period
        ahead = min(step + 1, steps - 1) * stride
        x = FOOTPRINT_X if side == "Left" else -FOOTPRINT_X
        swings[side].append(Swing(start, start + 0.9 * period, x, ball + ahead, 5.0))
    arms_out = np.radians(13.0 + 9.0 * max(fat, 0.0))
    return Choreography({side: tuple(own) for side, own in swings.items()}, walk.NEVER, arms_out, staff=False)


def author(
    stage: Usd.Stage, path: Sdf.Path, build: Build, codes: np.ndarray, choreography: Choreography, x: float = 0.0
) -> UsdGeom.Mesh:
    """A SkelRoot at `path`, `x` [cm] aside, that walks from the first of the time `codes`; returns its skin.

    The skin has the role of flesh; its stiffness and the like are the caller's.
    """
    body = make(build)
    root = UsdSkel.Root.Define(stage, path)
    if x:
        root.AddTranslateOp().Set(Gf.Vec3d(x, 0.0, 0.0))
    generate.author_skeleton(stage, body.joints, path)
    generate.author_clip(stage, path, body.joints, codes, choreography)
    skin = generate.define_mesh(stage, path.AppendChild("Skin"), body.points, body.triangles)
    skin.CreateDisplayColorAttr([Gf.Vec3f(*build.colour)])
    generate.bind(skin.GetPrim(), body.joint_indices, body.joint_weights)
    skin.GetPrim().CreateAttribute("plait:role", Sdf.ValueTypeNames.Token, custom=True).Set("flesh")
    return skin


def body_distance(points: np.ndarray, fat: float) -> np.ndarray:
    """(n,) signed distance [cm] to the skin, which is its own mirror image."""
    p = np.column_stack([np.abs(points[:, 0]), points[:, 1:]])
    d = blend(torso(p, fat), arm(p, fat), 4.0)
    d = blend(d, leg(p, fat), 5.0)
    d = blend(d, round_cone(p, (0, 138, -2.4), (0, 157, -0.4), 5.6 + 0.9 * fat, 5.0 + 0.6 * fat), 4.5)
    return blend(d, head(p, fat), 2.5)


def torso(p: np.ndarray, fat: float) -> np.ndarray:
    d = ellipsoid(p, (0, 96, -0.5), np.array([15.6, 11.5, 10.6]) + fat * np.array([2.6, 0.5, 1.8]))
    d = blend(d, ellipsoid(p, (7.4, 91.5, -4.6), np.array([8.2, 9.0, 8.0]) + fat * np.array([1.6, 1.2, 2.0])), 5.0)
    d = blend(d, ellipsoid(p, (0, 108, 0.2), np.array([12.0, 13.0, 8.8]) + fat * np.array([3.6, 1.0, 2.6])), 8.0)
    d = blend(d, ellipsoid(p, (0, 103, 4.0 + 3.0 * fat), 8.4 + fat * np.array([4.6, 2.6, 4.4])), 6.0)
    d = blend(d, ellipsoid(p, (0, 122, 0.0), np.array([13.6, 14.0, 9.8]) + fat * np.array([1.4, 0.0, 1.4])), 8.0)
    d = blend(d, ellipsoid(p, (0, 133, -1.4), np.array([15.0, 10.0, 8.8]) + fat * np.array([0.8, 0.0, 0.6])), 6.0)
    d = blend(d, ellipsoid(p, (6.8, 124.5, 6.2), np.array([6.4, 6.0, 5.0]) + fat * np.array([1.2, 1.2, 2.2])), 4.0)
    d = blend(d, round_cone(p, (4.0, 140.0, -1.6), (16.0, 139.0, -2.0), 4.2, 5.0 + 0.6 * fat), 5.0)
    return blend(d, round_cone(p, (2.0, 148.0, -2.8), (13.0, 141.5, -2.4), 3.4, 3.2), 5.0)


def head(p: np.ndarray, fat: float) -> np.ndarray:
    d = ellipsoid(p, (0.0, 165.2, -1.2), (7.5, 9.4, 9.6))
    d = blend(d, ellipsoid(p, (0, 160.4, 2.4), (6.2 + 0.7 * fat, 8.4, 6.9)), 3.0)
    d = blend(d, round_cone(p, (4.2, 156.8, 1.6), (0.8, 153.8, 6.9), 2.2 + 0.6 * fat, 1.9 + 0.6 * fat), 2.4)
    return blend(d, round_cone(p, (0, 163.4, 8.0), (0, 159.3, 9.8), 0.9, 1.3), 2.0)


def arm(p: np.ndarray, fat: float) -> np.ndarray:
    places = {joint.name: joint.place for joint in skeleton()}
    shoulder, elbow, wrist = places["LeftUpperArm"], places["LeftForearm"], places["LeftHand"]
    down = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    d = round_cone(p, shoulder, elbow, 5.1 + 0.7 * fat, 4.0 + 0.6 * fat)
    d = blend(d, round_cone(p, elbow, wrist, 4.0 + 0.5 * fat, 2.9 + 0.2 * fat), 2.0)
    d = blend(d, round_cone(p, wrist, wrist + 13.0 * down, 2.9, 2.7), 2.0)
    return blend(d, round_cone(p, wrist + 3.0 * down, wrist + np.array([-0.5, -6.0, 4.8]), 1.9, 1.7), 1.5)


def leg(p: np.ndarray, fat: float) -> np.ndarray:
    d = round_cone(p, (8.8 + 1.2 * fat, 88, 0), (9.6 + 0.8 * fat, 52, 1.2), 8.3 + 1.1 * fat, 5.6 + 0.8 * fat)
    d = blend(
        d, round_cone(p, (9.6 + 0.8 * fat, 50, 1.2), (10.0, 10, -2.2), 5.2 + 0.7 * fat, 3.8 + 0.3 * fat), 3.0
    )
    d = blend(d, ellipsoid(p, (9.9, 37, -1.4), np.array([4.7, 11.5, 5.2]) + 0.8 * fat), 4.0)
    foot = round_cone(p, (10.0, 4.2, -5.0), (10.9, 3.2, 10.5), 4.1, 3.6)
    foot = blend(foot, round_cone(p, (10.0, 9.0, -2.2), (10.6, 4.0, 7.0), 3.8, 3.4), 3.0)
    return blend(d, blend_above(foot, p[:, 1], 0.8), 2.0)


def blend_above(d: np.ndarray, height: np.ndarray, width: float) -> np.ndarray:
    """What of `d` is above the ground, its edge rounded."""
    return -blend(-d, height, width)
