"""A braid of three cords that is pulled tight by weights: no cord passes through another, and it stays a braid.

`python example.py [small|default|full]` runs it, prints and checks it, and leaves `out/braid.usdc` with a picture.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from plait.assets.stages import define_curves, new_stage
from plait.pipeline.preview import render_still
from plait.solver.build import build
from plait.solver.scene import RootBinding, Scene, Strands, Surface
from plait.solver.settings import Settings, StrandContactSettings

FRAMES_PER_SECOND = 24
RADIUS = 1e-3  # [m] of a cord
PULL = 0.3  # [N] a cord
BESIDE = 0.04  # [m] how far beside it the loose braid is drawn
COLOURS = ((0.40, 0.10, 0.03), (0.55, 0.33, 0.10), (0.16, 0.09, 0.05))  # linear RGB


@dataclass(frozen=True)
class Size:
    """periods: of the braid, 45 mm each.  segments: a cord.  frames: simulated."""

    periods: int
    segments: int
    frames: int


SIZES = {"small": Size(2, 40, 8), "default": Size(4, 80, 50), "full": Size(20, 500, 100)}


@dataclass(frozen=True)
class Result:
    """points: (frame_count, 3, node_count, 3) [m].  strain: the largest of all frames."""

    points: np.ndarray
    strain: float


def braided(size: Size) -> np.ndarray:
    """(3, node_count, 3) [m]: loose, so that cords pass at 1.4 of their thickness; down from y = 0.

    Across the braid each goes as sin(phase), in depth as sin(2 phase), a third of a turn apart.
    """
    along = np.linspace(0.0, 1.0, size.segments + 1)
    phase = 2.0 * np.pi * (size.periods * along + np.arange(3)[:, None] / 3.0 + 0.125)
    depth = 1.4 * 2.0 * RADIUS / np.sqrt(3.0)
    down = np.broadcast_to(-0.045 * size.periods * along, phase.shape)
    return np.stack([4.0 * RADIUS * np.sin(phase), down, depth * np.sin(2.0 * phase)], axis=-1)


def pulls(points: np.ndarray) -> np.ndarray:
    """(3, 3): unit directions 30 degrees from down, 120 degrees from each other round it, as the tips stand."""
    tips = points[:, -1, [0, 2]]
    angle = np.arctan2(*(tips - tips.mean(axis=0)).T[::-1])
    turn = 2.0 * np.pi / 3.0 * np.argsort(np.argsort(angle))
    turn += np.angle(np.exp(1j * (angle - turn)).sum())
    return np.stack([0.5 * np.cos(turn), np.full(3, -np.sqrt(0.75)), 0.5 * np.sin(turn)], axis=1)


def scene(size: Size) -> Scene:
    """The cords, clamped at their tops; a weight over a pulley at each tip."""
    points = braided(size)
    count = points.shape[1]
    corners = points[:, :1] + 1e-3 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.0, -0.9], [-0.5, 0.0, 0.9]])
    top = Surface("top", corners.reshape(-1, 3), np.arange(9, dtype=np.int32).reshape(3, 3), collides=False)
    loads = np.zeros((3, count, 3))
    loads[:, -1] = PULL * pulls(points)
    cords = Strands(
        "cords",
        points.reshape(-1, 3),
        count * np.arange(4, dtype=np.int32),
        RootBinding(0, np.arange(3, dtype=np.int32), np.full((3, 3), 1.0 / 3.0)),
        radius=np.full(3 * count, RADIUS),
        density=np.full(3, 1000.0),  # kg/m3
        stretch_stiffness=np.full(3, 300.0),  # N
        bend_stiffness=np.full(3, 1e-6),  # N m2: spun threads, not a solid section
        twist_stiffness=np.full(3, 1e-6),
        damping=np.full(3, 5.0),  # 1/s
        friction=np.full(3, 0.3),
        rest_shape="authored",
        loads=loads.reshape(-1, 3),
    )
    return Scene(surfaces=(top,), strands=(cords,))


def run(size: Size) -> Result:
    contact = StrandContactSettings(method="implicit")
    simulation = build(scene(size), Settings(strand_contact=contact))
    stage = simulation.model.parts["strands"]
    points, strain = [stage.points(0)], 0.0
    for frame in range(1, size.frames + 1):
        metrics = simulation.advance_frame(frame / FRAMES_PER_SECOND)
        points.append(stage.points(0))
        strain = max(strain, metrics["strands"]["strain_max"])
    simulation.close()
    return Result(np.array(points).reshape(len(points), 3, -1, 3), strain)


def crossings(points: np.ndarray) -> list[tuple[int, int, bool]]:
    """Which two cords, (3, node_count, 3), cross as seen from the front, from the top down; is the first in front?

    In a braid all go down.
    """
    levels = np.unique(points[..., 1])[::-1]
    x, z = (np.array([np.interp(levels, cord[::-1, 1], cord[::-1, axis]) for cord in points]) for axis in (0, 2))
    found = []
    for i, j in combinations(range(3), 2):
        gap = x[i] - x[j]
        for k in np.flatnonzero(gap[:-1] * gap[1:] < 0.0):
            part = gap[k] / (gap[k] - gap[k + 1])
            front = (1.0 - part) * (z[i] - z[j])[k] + part * (z[i] - z[j])[k + 1]
            found.append((levels[k], i, j, bool(front > 0.0)))
    return [(i, j, front) for _, i, j, front in sorted(found, reverse=True)]


def nearest(points: np.ndarray) -> float:
    """[m] the least distance of two cords, (3, node_count, 3), sampled four times a segment."""
    parts = np.linspace(0.0, 1.0, 4, endpoint=False)[:, None, None]
    dense = [((1.0 - parts) * cord[:-1] + parts * cord[1:]).reshape(-1, 3) for cord in points]
    return min(
        float(np.linalg.norm(dense[i][:, None] - dense[j], axis=-1).min()) for i, j in combinations(range(3), 2)
    )


def check(result: Result) -> None:
    """What must be seen; AssertionError if it is not."""
    before, after = crossings(result.points[0]), crossings(result.points[-1])
    # The same cords cross in the same order, the same ones in front: a braid. Only the last crossing may come or
    # go, as tips are drawn apart.
    assert before[:-1] == after[: len(before) - 1]
    assert abs(len(after) - len(before)) <= 1
    # Pulled tight: cords lie on each other, and none is in another by more than a tenth of its thickness.
    assert 0.9 * 2.0 * RADIUS < nearest(result.points[-1]) < 1.05 * 2.0 * RADIUS
    assert nearest(result.points[0]) > 1.3 * 2.0 * RADIUS
    # .3 N on EA = 300 N are .1 %; .1 more for friction over the crossings, and the jerk as the weights are let go.
    assert result.strain < 0.02


def write(result: Result, path: Path) -> None:
    """All frames as a USD stage."""
    stage = new_stage(path, (0, len(result.points) - 1), FRAMES_PER_SECOND)
    loose = result.points[:1] - [BESIDE, 0.0, 0.0]
    define_curves(stage, "/loose", loose, 2.0 * RADIUS, COLOURS)
    define_curves(stage, "/braid", result.points, 2.0 * RADIUS, COLOURS)
    stage.Save()


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, prints, checks, writes, draws."""
    folder.mkdir(parents=True, exist_ok=True)
    result = run(SIZES[size])
    print(
        f"nearest cords: {1e3 * nearest(result.points[0]):.2f} mm at first, {1e3 * nearest(result.points[-1]):.2f}"
    )
    print(f"crossings: {len(crossings(result.points[0]))} at first, {len(crossings(result.points[-1]))}")
    print(f"largest strain: {100.0 * result.strain:.2f} %")
    check(result)
    path = folder / "braid.usdc"
    write(result, path)
    if draw:
        render_still(path, path.with_suffix(".jpg"), frame=len(result.points) - 1, size=(560, 720))


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
