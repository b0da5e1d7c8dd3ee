"""A curtain of ropes that a ball on a pendulum swings through and back: a scene by hand, without USD or files.

`python example.py` runs it, checks it, and leaves `out/ropes_and_ball.usdc` and a picture of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from pxr import Gf, UsdGeom

from plait.assets.stages import define_curves, new_stage
from plait.pipeline.preview import render_still
from plait.solver.build import build
from plait.solver.scene import KeyedMotion, RootBinding, Scene, Strands, Surface

FRAMES_PER_SECOND = 24
SWING, REST = 1.6, 5.0  # [s] one swing there and back, then nothing
ROPES, NODES, LENGTH, RADIUS = 24, 25, 1.2, 0.008  # [m]
BAR = 1.4  # [m] its height
BALL, ARM, PIVOT = 0.2, 1.4, np.array([0.03, 1.95, 0.0])  # [m] radius, length of its pendulum, where that hangs
ANGLE = np.radians(40.0)


@dataclass(frozen=True)
class Result:
    """points: (frame_count, ROPES, NODES, 3) [m].  centres: (frame_count, 3) [m], of the ball.
    strain: (frame_count,) the largest of any segment."""

    points: np.ndarray
    centres: np.ndarray
    strain: np.ndarray


def ball_centre(time: float) -> np.ndarray:
    """(3,) [m]: down through the ropes, up behind them, and back."""
    angle = ANGLE * np.cos(2.0 * np.pi * min(time, SWING) / SWING)
    return PIVOT + ARM * np.array([0.0, -np.cos(angle), np.sin(angle)])


def scene() -> Scene:
    """Ropes that hang from a bar, and the ball."""
    x = np.linspace(-0.7, 0.7, ROPES)
    corners = np.array([[-1.0, BAR, 0.0], [0.0, BAR, 1.0], [1.0, BAR, 0.0]])
    bar = Surface("bar", corners, np.array([[0, 1, 2]], np.int32), collides=False)
    along = (x + 1.0) / 2.0  # from the bar's first corner to its last
    points = np.zeros((ROPES, NODES, 3))
    points[..., 0] = x[:, None]
    points[..., 1] = BAR - np.linspace(0.0, LENGTH, NODES)

    sphere = trimesh.creation.icosphere(subdivisions=3, radius=BALL)
    times = np.linspace(0.0, SWING, 97)
    transforms = np.tile(np.eye(4), (len(times), 1, 1, 1))
    transforms[:, 0, :3, 3] = [ball_centre(time) for time in times]
    ball = Surface("ball", sphere.vertices, sphere.faces.astype(np.int32), KeyedMotion(times, transforms))

    ropes = Strands(
        "ropes",
        points.reshape(-1, 3),
        np.arange(0, ROPES * NODES + 1, NODES, dtype=np.int32),
        RootBinding(0, np.zeros(ROPES, np.int32), np.stack([1.0 - along, np.zeros(ROPES), along], axis=1)),
        radius=np.full(ROPES * NODES, RADIUS),
        density=np.full(ROPES, 900.0),  # kg/m3
        stretch_stiffness=np.full(ROPES, 2e4),  # N
        bend_stiffness=np.full(ROPES, 2e-3),  # N m2: limp
        twist_stiffness=np.full(ROPES, 2e-3),
        damping=np.full(ROPES, 4.0),  # 1/s
        friction=np.full(ROPES, 0.3),
        rest_shape="authored",
    )
    return Scene(surfaces=(bar, ball), strands=(ropes,))


def run() -> Result:
    """Some seconds of it."""
    simulation = build(scene())
    stage = simulation.model.parts["strands"]
    points, centres, strain = [stage.points(0)], [ball_centre(0.0)], [0.0]
    for frame in range(1, round((SWING + REST) * FRAMES_PER_SECOND) + 1):
        time = frame / FRAMES_PER_SECOND
        metrics = simulation.advance_frame(time)
        points.append(stage.points(0))
        centres.append(ball_centre(time))
        strain.append(metrics["strands"]["strain_max"])
    simulation.close()
    shape = (len(points), ROPES, NODES, 3)
    return Result(np.array(points).reshape(shape), np.array(centres), np.array(strain))


def write(result: Result, path: Path) -> None:
    """All frames as a USD stage, for `plait preview` or any USD application."""
    stage = new_stage(path, (0, len(result.points) - 1), FRAMES_PER_SECOND)
    define_curves(stage, "/ropes", result.points, 2.0 * RADIUS, (0.45, 0.29, 0.13))
    ball = UsdGeom.Sphere.Define(stage, "/ball")
    ball.CreateRadiusAttr(BALL)
    ball.CreateDisplayColorAttr([(0.5, 0.06, 0.04)])
    place = ball.AddTranslateOp()
    for frame, centre in enumerate(result.centres):
        place.Set(Gf.Vec3d(*centre.tolist()), frame)
    bar = UsdGeom.Cylinder.Define(stage, "/bar")
    bar.CreateAxisAttr("X")
    bar.CreateRadiusAttr(0.012)
    bar.CreateHeightAttr(1.5)
    bar.CreateDisplayColorAttr([(0.25, 0.25, 0.27)])
    bar.AddTranslateOp().Set(Gf.Vec3d(0.0, BAR, 0.0))
    stage.Save()


def check(result: Result) -> None:
    """What must be seen; AssertionError if it is not."""
    # The ball pushes ropes aside: they are far from where they hung while it is among them ...
    swung = np.abs(result.points[..., 2]).max(axis=(1, 2))
    assert swung.max() > 2.0 * BALL
    # ... and no rope's middle line is ever inside it. Flat triangles between points on a sphere of radius R lie
    # at R - edge^2 / (6 R) or further out; the longest edge of this one is 0.165 R.
    distance = np.linalg.norm(result.points - result.centres[:, None, None], axis=-1)
    assert distance.min() > BALL * (1.0 - 0.165**2 / 6.0)
    # Ropes do not stretch: the heaviest load is some times a rope's weight of 2 N, on EA = 2e4 N.
    assert result.strain.max() < 0.01
    # In the end they hang as before: at 4 /s the swing has died down by exp(-2 * 5 s) since the ball left.
    assert np.abs(result.points[-1] - result.points[0]).max() < 1e-3 * LENGTH


def main(folder: Path, draw: bool = True) -> None:
    """Runs, checks, writes, draws."""
    folder.mkdir(parents=True, exist_ok=True)
    result = run()
    check(result)
    path = folder / "ropes_and_ball.usdc"
    write(result, path)
    if draw:
        render_still(path, path.with_suffix(".jpg"), frame=20, size=(640, 480))


if __name__ == "__main__":
    main(Path("out"))
