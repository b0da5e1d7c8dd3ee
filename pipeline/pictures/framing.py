"""Where a picture is taken from: a camera of the stage, or one that holds all that moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pxr import UsdGeom

from plait.pipeline.errors import UsageError
from plait.pipeline.pictures.drawables import Drawable, Shell
from plait.pipeline.read.source import PREDICATE, Source

VIEW_ANGLE = 30.0  # degrees, across the smaller side
MARGIN = 1.08
FLAT = 0.02  # a surface this thin against its size may be a ground
WIDE = 1.5  # and is one if it is this much larger than all the rest


@dataclass(frozen=True)
class View:
    """position, target, up: (3,) [m] in the world.  angle: vertical, degrees.  height: [m] for a parallel
    projection, else None.  near, far: [m], or None for what fits."""

    position: np.ndarray
    target: np.ndarray
    up: np.ndarray
    angle: float = VIEW_ANGLE
    height: float | None = None
    clip: tuple[float, float] | None = None

    @property
    def axes(self) -> np.ndarray:
        """(3, 3) rows right, up, towards the eye."""
        back = _unit(self.position - self.target)
        right = _unit(np.cross(self.up, back))
        return np.array([right, np.cross(back, right), back])

    def pixel_size(self, points: np.ndarray, pixels_high: int) -> float:
        """[m] that a pixel spans at the middle of `points`."""
        if self.height is not None:
            return self.height / pixels_high
        depth = abs(float((self.position - points.mean(axis=0)) @ self.axes[2]))
        return 2.0 * depth * math.tan(math.radians(self.angle) / 2.0) / pixels_high


def grounds(drawables: Sequence[Drawable], code: float) -> list[Shell]:
    """Surfaces so flat and large that what stands on them, not they, decides the framing."""
    boxes = [_box(d.points(code)) for d in drawables]
    flat = [isinstance(d, Shell) and _thinness(box) < FLAT for d, box in zip(drawables, boxes, strict=True)]
    rest = [box for box, is_flat in zip(boxes, flat, strict=True) if not is_flat and box is not None]
    if not rest:
        return []
    size = float(np.ptp(np.concatenate(rest), axis=0).max())
    return [
        d
        for d, box, is_flat in zip(drawables, boxes, flat, strict=True)
        if is_flat and float(np.ptp(box, axis=0).max()) > WIDE * size
    ]


def level(shells: Sequence[Shell], up_axis: str) -> Shell | None:
    """The first of these that lies level and still."""
    for shell in shells:
        if not shell.animated and np.argmin(np.ptp(shell.points(shell.source.start), axis=0)) == "XYZ".index(
            up_axis
        ):
            return shell
    return None


def around(points: np.ndarray, up_axis: str, aspect: float) -> View:
    """A view from the front, a little from the side and above, that just holds (n, 3) points."""
    up = np.array([0.0, 0.0, 1.0]) if up_axis == "Z" else np.array([0.0, 1.0, 0.0])
    front = np.array([0.0, -1.0, 0.0]) if up_axis == "Z" else np.array([0.0, 0.0, 1.0])
    back = _unit(front + 0.45 * np.cross(up, front) + 0.22 * up)
    vertical = math.radians(VIEW_ANGLE)
    if aspect < 1.0:
        vertical = 2.0 * math.atan(math.tan(vertical / 2.0) / aspect)
    high, wide = math.tan(vertical / 2.0) / MARGIN, math.tan(vertical / 2.0) * aspect / MARGIN
    axes = View(back, np.zeros(3), up).axes
    x, y, depth = (points @ axes.T).T
    # A point at depth d below an eye at e is inside the frame if |x - e_x| <= wide (e_d - d), and so for y: the
    # closest eye for which that can hold, and for that one the place from which what is seen lies centred.
    size = float(np.ptp(points, axis=0).max()) or 1.0
    distance = max(_closest(x, depth, wide), _closest(y, depth, high), float(depth.max()) + 0.05 * size)
    nearness = 1.0 / (distance - depth)
    place = [_centred(x * nearness, nearness), _centred(y * nearness, nearness)]
    eye, target = np.array([*place, distance]), np.array([*place, float(depth.mean())])
    return View(eye @ axes, target @ axes, up, math.degrees(vertical))


def _closest(side: np.ndarray, depth: np.ndarray, slope: float) -> float:
    """How far along its direction an eye must be to see all of it in a wedge of that slope."""
    return 0.5 * (float(np.max(slope * depth + side)) + float(np.max(slope * depth - side))) / slope


def _centred(angle: np.ndarray, change: np.ndarray) -> float:
    """The step e of an eye, from 0, at which the largest and smallest of `angle - e change` are opposite.

    Bisection: their sum falls with e.
    """
    low, high = float(np.min(angle / change)), float(np.max(angle / change))
    for _ in range(50):
        middle = 0.5 * (low + high)
        seen = angle - middle * change
        low, high = (middle, high) if seen.max() + seen.min() > 0.0 else (low, middle)
    return 0.5 * (low + high)


def through(source: Source, path: str, code: float, aspect: float) -> View:
    """The view of a camera prim, its width kept. Raises UsageError when there is no such camera."""
    prim = source.stage.GetPrimAtPath(path) if path.startswith("/") else None
    if not prim or not prim.IsA(UsdGeom.Camera):
        cameras = [str(p.GetPath()) for p in source.stage.Traverse(PREDICATE) if p.IsA(UsdGeom.Camera)]
        raise UsageError(f"--camera {path}: no such camera; the stage has {', '.join(cameras) or 'none'}")
    camera = UsdGeom.Camera(prim).GetCamera(code)
    meters = source.units.meters_per_unit
    matrix = source.local_to_world(prim, code)
    rotation = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-30)
    position = meters * matrix[:3, 3]
    near, far = camera.clippingRange.min * meters, camera.clippingRange.max * meters
    # Apertures are in tenths of a stage unit, as focal lengths are.
    half_width = 0.5 * camera.horizontalAperture
    height = None
    if camera.projection == camera.Orthographic:
        height = 0.2 * half_width / aspect * meters
    angle = 2.0 * math.atan(half_width / aspect / max(camera.focalLength, 1e-6))
    target = position - rotation[:, 2] * max(near, 1e-3 * far)
    return View(position, target, rotation[:, 1], math.degrees(angle), height, (near, far))


def _box(points: np.ndarray) -> np.ndarray | None:
    return np.array([points.min(axis=0), points.max(axis=0)]) if len(points) else None


def _thinness(box: np.ndarray | None) -> float:
    sides = np.ptp(box, axis=0) if box is not None else np.ones(3)
    return float(sides.min() / max(sides.max(), 1e-30))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
