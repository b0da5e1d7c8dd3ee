"""The sample's character: joints, a closed skin about them, and blended weights. Centimetres, Y up, facing +Z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.assets.implicit import (
    Distance,
    blend,
    carve,
    ellipsoid,
    neighbour_mean,
    polygonise,
    relax,
    rotation_z,
    round_cone,
    simplify,
)
from plait.assets.paint import split_along

TRIANGLES = 13000
INFLUENCES = 4
ARM_ANGLE = np.radians(36.0)  # of the arms from the vertical, as modelled


HEAD_MIDDLE = np.array([0.0, 165.2, -1.2])
HAIRLINE = np.array(  # azimuth [degrees], height [cm]
    [(0, 170.4), (30, 170.0), (48, 168.6), (62, 166.6), (80, 165.2),
     (100, 165.0), (122, 159.6), (150, 156.6), (180, 156.0)]
)  # fmt: skip
SCALP = (0.12, 0.06, 0.035)  # shadowed by hair that is too thin to be drawn
SKIN, LIPS = (0.55, 0.31, 0.22), (0.42, 0.17, 0.14)
SWEATER, TROUSERS, BOOTS = (0.08, 0.20, 0.24), (0.035, 0.04, 0.06), (0.13, 0.06, 0.03)


@dataclass(frozen=True)
class Joint:
    """One joint: its place in the modelled pose and its parent's index, -1 for the first."""

    name: str
    parent: int
    place: np.ndarray  # (3,) [cm]


@dataclass(frozen=True)
class Character:
    """The skin in its modelled pose.

    points (n, 3) [cm], triangles (m, 3), joint_indices and joint_weights (n, 4), colours (m, 3) linear RGB.
    """

    joints: tuple[Joint, ...]
    points: np.ndarray
    triangles: np.ndarray
    joint_indices: np.ndarray
    joint_weights: np.ndarray
    colours: np.ndarray


def skeleton() -> tuple[Joint, ...]:
    """22 joints in parent-first order; orientations are the world's."""
    trunk = [
        ("Hips", "", (0, 96, -0.5)),
        ("Spine", "Hips", (0, 105, -1.0)),
        ("Chest", "Spine", (0, 117, -1.5)),
        ("UpperChest", "Chest", (0, 129, -2.0)),
        ("Neck", "UpperChest", (0, 145, -2.0)),
        ("Head", "Neck", (0, 154, 0.0)),
    ]
    down_arm = np.array([np.sin(ARM_ANGLE), -np.cos(ARM_ANGLE), 0.0])
    shoulder = np.array([17.0, 139.5, -2.0])
    elbow = shoulder + 28.0 * down_arm
    wrist = elbow + 24.5 * (down_arm + np.array([0.0, 0.0, 0.12]))
    side = [
        ("Clavicle", "UpperChest", (3.0, 140.5, -1.0)),
        ("UpperArm", "Clavicle", shoulder),
        ("Forearm", "UpperArm", elbow),
        ("Hand", "Forearm", wrist),
        ("Thigh", "Hips", (9.0, 91.0, 0.0)),
        ("Shin", "Thigh", (9.6, 50.0, 1.2)),
        ("Foot", "Shin", (10.0, 8.5, -2.5)),
        ("Toe", "Foot", (10.8, 2.6, 10.0)),
    ]
    rows = list(trunk)
    for prefix, sign in (("Left", 1.0), ("Right", -1.0)):  # the character's own left is +X
        for name, parent, place in side:
            own_parent = parent if parent in ("UpperChest", "Hips") else prefix + parent
            rows.append((prefix + name, own_parent, np.asarray(place, float) * (sign, 1, 1)))
    index = {name: i for i, (name, _, _) in enumerate(rows)}
    return tuple(Joint(name, index.get(parent, -1), np.asarray(place, float)) for name, parent, place in rows)


def build() -> Character:
    """The whole character, the same every time."""
    joints = skeleton()
    points, triangles = skin()
    for border in (collar, cuff, waist, boots, lips, scalp):
        points, triangles = split_along(border, points, triangles)
    indices, weights = blended_weights(points, triangles, joints)
    return Character(joints, points, triangles, indices, weights, colours(points[triangles].mean(axis=1)))


def skin() -> tuple[np.ndarray, np.ndarray]:
    """A watertight mesh of `body_distance`, finer on the head."""
    points, triangles = polygonise(body_distance, (-70, -1, -20), (70, 178, 24), 0.72)
    points, triangles = simplify(magnify_head(points), triangles, TRIANGLES)
    points = magnify_head(points, undo=True)
    return relax(body_distance, points, triangles, 4), triangles


def magnify_head(points: np.ndarray, undo: bool = False) -> np.ndarray:
    """Swells a ball about the face, so that simplification, which goes by size, keeps more of it."""
    centre, radius, factor = np.array([0.0, 161.0, 2.0]), 12.0, 2.2
    offset = points - centre
    far = np.linalg.norm(offset, axis=1)
    if undo:
        wanted = np.where(far < factor * radius, far / factor, far - (factor - 1.0) * radius)
    else:
        wanted = np.where(far < radius, far * factor, far + (factor - 1.0) * radius)
    return centre + offset * (wanted / np.maximum(far, 1e-9))[:, None]


def body_distance(points: np.ndarray) -> np.ndarray:
    """Signed distance to the whole skin; the body is its own mirror image but for the right hand's fist."""
    mirrored = np.column_stack([np.abs(points[:, 0]), points[:, 1:]])
    trunk = torso(mirrored)
    limbs = blend(arm(mirrored), hand(points, mirrored), 1.6)
    result = blend(trunk, limbs, 4.0)
    result = blend(result, leg(mirrored), 5.0)
    result = blend(result, neck(mirrored), 4.5)
    return blend(result, head(mirrored), 2.5)


def torso(p: np.ndarray) -> np.ndarray:
    d = ellipsoid(p, (0, 96, -0.5), (15.6, 11.5, 10.6))
    d = blend(d, ellipsoid(p, (7.4, 91.5, -4.6), (8.2, 9.0, 8.0)), 5.0)
    d = blend(d, ellipsoid(p, (0, 108, 0.2), (12.0, 13.0, 8.8)), 8.0)
    d = blend(d, ellipsoid(p, (0, 122, 0.0), (13.6, 14.0, 9.8)), 8.0)
    d = blend(d, ellipsoid(p, (0, 133, -1.4), (15.0, 10.0, 8.8)), 6.0)
    d = blend(d, ellipsoid(p, (6.6, 125.0, 6.4), (6.2, 6.0, 5.0)), 4.0)
    d = blend(d, round_cone(p, (4.0, 140.0, -1.6), (16.0, 139.0, -2.0), 4.2, 5.0), 5.0)
    return blend(d, round_cone(p, (2.0, 148.0, -2.8), (13.0, 141.5, -2.4), 3.4, 3.2), 5.0)


def neck(p: np.ndarray) -> np.ndarray:
    return round_cone(p, (0, 140, -2.4), (0, 156, -0.4), 5.6, 5.0)


def head(p: np.ndarray) -> np.ndarray:
    d = ellipsoid(p, HEAD_MIDDLE, (7.5, 9.4, 9.6))
    d = blend(d, ellipsoid(p, (0, 160.4, 2.4), (6.2, 8.4, 6.9)), 3.0)
    d = blend(d, round_cone(p, (4.2, 156.8, 1.6), (0.8, 153.8, 6.9), 2.2, 1.9), 2.4)
    d = blend(d, ellipsoid(p, (3.7, 159.2, 5.6), (2.6, 2.4, 2.8)), 2.4)
    d = blend(d, round_cone(p, (1.2, 164.6, 8.0), (4.6, 164.4, 6.2), 0.9, 0.8), 1.6)
    d = carve(d, ellipsoid(p, (3.1, 162.3, 9.6), (1.9, 1.3, 1.9)), 1.2)
    d = blend(d, round_cone(p, (0, 163.4, 8.6), (0, 159.3, 10.7), 0.75, 0.95), 1.2)
    d = blend(d, ellipsoid(p, (1.0, 158.9, 9.6), (0.8, 0.65, 0.9)), 0.7)
    d = blend(d, ellipsoid(p, (0, 156.75, 8.85), (2.0, 0.55, 0.9)), 0.5)
    d = blend(d, ellipsoid(p, (0, 155.75, 8.75), (1.7, 0.6, 0.85)), 0.5)
    return blend(d, ear(p), 0.8)


def ear(p: np.ndarray) -> np.ndarray:
    return ellipsoid(p, (7.6, 161.2, -0.6), (0.9, 3.0, 1.9), rotation_z(np.radians(-12.0)))


def arm(p: np.ndarray) -> np.ndarray:
    places = {joint.name: joint.place for joint in skeleton()}
    shoulder, elbow, wrist = places["LeftUpperArm"], places["LeftForearm"], places["LeftHand"]
    d = round_cone(p, shoulder, elbow, 4.9, 3.7)
    d = blend(d, round_cone(p, elbow, wrist, 3.6, 2.4), 2.0)
    belly = elbow + 0.28 * (wrist - elbow)
    return blend(d, ellipsoid(p, belly, (3.6, 7.0, 3.9), rotation_z(ARM_ANGLE)), 3.0)


def hand(p: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """An open left hand, a closed right one."""
    wrist = next(joint.place for joint in skeleton() if joint.name == "LeftHand")
    axes = rotation_z(ARM_ANGLE)
    down = -axes[:, 1]
    palm = ellipsoid(mirrored, wrist + 5.0 * down + (0, 0, 0.6), (1.7, 5.2, 4.0), axes)
    fingers = ellipsoid(mirrored, wrist + 11.5 * down + (0, 0, 1.0), (1.35, 6.4, 3.3), rotation_z(ARM_ANGLE - 0.2))
    thumb = round_cone(mirrored, wrist + 3.0 * down + (0, 0, 3.0), wrist + 8.0 * down + (-1.6, 0, 5.6), 1.3, 0.95)
    opened = blend(blend(palm, fingers, 2.0), thumb, 1.2)
    fist = ellipsoid(mirrored, wrist + 5.6 * down + (-1.2, 0, 0.8), (3.6, 4.4, 4.3), axes)
    knuckles = round_cone(
        mirrored, wrist + 4.0 * down + (-3.4, 0, 4.0), wrist + 7.8 * down + (-3.8, 0, 2.6), 1.3, 1.2
    )
    closed = blend(fist, knuckles, 1.2)
    return np.where(p[:, 0] > 0.0, opened, closed)


def leg(p: np.ndarray) -> np.ndarray:
    d = round_cone(p, (8.6, 90, 0), (9.6, 52, 1.2), 8.3, 5.4)
    d = blend(d, round_cone(p, (9.6, 50, 1.2), (10.0, 10, -2.2), 5.0, 3.3), 3.0)
    d = blend(d, ellipsoid(p, (9.9, 37, -1.4), (4.6, 11.5, 5.0)), 4.0)
    foot = round_cone(p, (10.0, 4.0, -5.0), (10.9, 2.9, 10.5), 3.9, 3.3)
    foot = blend(foot, round_cone(p, (10.0, 9.0, -2.2), (10.6, 4.0, 7.0), 3.6, 3.2), 3.0)
    foot = blend(foot, ellipsoid(p, (10.9, 2.3, 13.0), (4.3, 2.2, 4.6)), 2.5)
    sole = 0.0 - p[:, 1]
    return blend(d, -blend(-foot, -sole, 0.8), 2.0)


def joint_volumes(joints: tuple[Joint, ...]) -> list[Distance]:
    """For each joint, the distance to the part of the body that it moves."""
    places = {joint.name: joint.place for joint in joints}

    def cone(start, end, start_radius, end_radius):
        return lambda p: round_cone(p, start, end, start_radius, end_radius)

    ahead = np.array([0.0, 0.0, 1.0])
    volumes: dict[str, Distance] = {
        "Hips": lambda p: ellipsoid(p, (0, 94, -1), (16.0, 10.0, 12.0)),
        "Spine": lambda p: ellipsoid(p, (0, 109, 0), (13.0, 8.0, 10.0)),
        "Chest": lambda p: ellipsoid(p, (0, 122, 1), (14.5, 9.0, 11.0)),
        "UpperChest": lambda p: ellipsoid(p, (0, 134.5, -1), (14.5, 8.5, 10.0)),
        "Neck": cone((0, 143, -2.4), (0, 151, -1.0), 6.0, 5.4),
        "Head": lambda p: np.minimum(
            ellipsoid(p, (0, 164.5, 0.5), (9.0, 11.0, 11.5)), round_cone(p, (0, 156, 5), (0, 156, 6), 5.0, 5.0)
        ),
    }
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        flip = np.array([sign, 1.0, 1.0])
        shoulder, elbow, wrist = (places[side + name] for name in ("UpperArm", "Forearm", "Hand"))
        hip, knee, ankle, ball = (places[side + name] for name in ("Thigh", "Shin", "Foot", "Toe"))
        tip = wrist + 18.0 * (wrist - elbow) / np.linalg.norm(wrist - elbow)
        volumes |= {
            side + "Clavicle": cone(np.array([5, 141, -2]) * flip, np.array([13, 140, -2]) * flip, 5.0, 5.6),
            side + "UpperArm": cone(shoulder + np.array([1.5 * sign, -1.5, 0.0]), elbow, 5.2, 4.0),
            side + "Forearm": cone(elbow, wrist, 4.0, 2.7),
            side + "Hand": cone(wrist, tip, 2.7, 3.0),
            side + "Thigh": cone(hip - (0, 3, 0), knee, 8.6, 5.5),
            side + "Shin": cone(knee, ankle, 5.5, 3.8),
            side + "Foot": cone(ankle - (0, 2.5, 1), ball - (0, 0, 2), 4.2, 3.8),
            side + "Toe": cone(ball + 1.0 * ahead, ball + 7.0 * ahead, 3.8, 2.6),
        }
    return [volumes[joint.name] for joint in joints]


def blended_weights(
    points: np.ndarray, triangles: np.ndarray, joints: tuple[Joint, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Four influences a point: a soft nearest volume, smoothed over the skin."""
    distances = np.column_stack([volume(points) for volume in joint_volumes(joints)])
    sharpness = 2.0  # [cm] over which one joint hands over to the next, before smoothing
    weights = np.exp(-(distances - distances.min(axis=1, keepdims=True)) / sharpness)
    weights /= weights.sum(axis=1, keepdims=True)
    for _ in range(6):
        weights = 0.5 * (weights + neighbour_mean(weights, triangles))
    order = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
    kept = np.take_along_axis(weights, order, axis=1)
    kept[kept < 0.004] = 0.0
    return order.astype(np.int32), kept / kept.sum(axis=1, keepdims=True)


def collar(p: np.ndarray) -> np.ndarray:
    """Negative below a neckline lower in front."""
    return p[:, 1] - 138.5 - np.hypot(p[:, 0], p[:, 2] + 2.0) + 0.4 * (p[:, 2] + 2.0)


def cuff(p: np.ndarray) -> np.ndarray:
    """Negative above the wrists."""
    joints = {joint.name: joint.place for joint in skeleton()}
    wrist, elbow = joints["LeftHand"], joints["LeftForearm"]
    mirrored = np.column_stack([np.abs(p[:, 0]), p[:, 1:]])
    along = (mirrored - wrist) @ (wrist - elbow) / np.linalg.norm(wrist - elbow)
    return np.where(mirrored[:, 0] > 22.0, along + 0.5, -20.0)


def waist(p: np.ndarray) -> np.ndarray:
    """Negative below; the hands do not count."""
    return np.where(np.abs(p[:, 0]) > 22.0, 20.0, p[:, 1] - 96.0)


def boots(p: np.ndarray) -> np.ndarray:
    return p[:, 1] - 17.0


def lips(p: np.ndarray) -> np.ndarray:
    return np.where(p[:, 2] > 7.0, np.hypot(p[:, 0] / 2.0, (p[:, 1] - 156.2) / 0.95) - 1.0, 1.0)


def azimuth(points: np.ndarray) -> np.ndarray:
    """Degrees around the head: 0 in front, 180 behind, the same on both sides."""
    offset = points - HEAD_MIDDLE
    return np.degrees(np.arctan2(np.abs(offset[:, 0]), offset[:, 2]))


def scalp(p: np.ndarray) -> np.ndarray:
    """Negative where hair grows: above the hairline, not on the ears."""
    mirrored = np.column_stack([np.abs(p[:, 0]), p[:, 1:]])
    return np.maximum(np.interp(azimuth(p), *HAIRLINE.T) - p[:, 1], 0.5 - ear(mirrored))


def colours(p: np.ndarray) -> np.ndarray:
    """(n, 3) linear RGB: clothes are painted on."""
    result = np.tile(SKIN, (len(p), 1))
    result[(collar(p) < 0.0) & (cuff(p) < 0.0)] = SWEATER
    result[waist(p) < 0.0] = TROUSERS
    result[boots(p) < 0.0] = BOOTS
    result[lips(p) < 0.0] = LIPS
    result[scalp(p) < 0.0] = SCALP
    return result
