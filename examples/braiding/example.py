"""Three bundles of hair are braided by their ends, and unbraided again: all come free.

`python example.py [small|default|full]` runs it, prints and checks it, and leaves `out/braiding.usdc` with a
picture.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from plait.assets.stages import define_curves, new_stage
from plait.assets.strands import FRAMES_PER_SECOND, play
from plait.pipeline.benchmarks.scenes import Fibre, FormulaMotion, rods, translation
from plait.pipeline.benchmarks.strand_scenes import bundle_places
from plait.pipeline.preview import render_still
from plait.solver.scene import Attachment, Scene, Surface

LENGTH = 0.3  # [m] of the hair
PERIODS = 2  # of the braid
HOLD, AFTER = 0.25, 0.5  # [s] that the ends are held when it is made, and when it is not any more
WIDTH, DEPTH = 0.04, 0.025  # [m] of the paths that the ends are led on
RISE = 0.02  # [m] by which the ends come up meanwhile: a braid takes of its length
PULL = 10.0  # [N/m] with which a bundle's ends are drawn to where they are led
TOPS = 0.25  # how near each other the tops are, against the ends
COLOURS = ((0.40, 0.10, 0.03), (0.55, 0.33, 0.10), (0.16, 0.09, 0.05))  # linear RGB
BESIDE = 0.11  # [m] between the braids of the picture


@dataclass(frozen=True)
class Size:
    """hairs: of each of the three bundles.  radius: [m] of a hair.  segments: of a hair.
    make: [s] in which the braid is made; unmaking it takes as long."""

    hairs: int
    radius: float
    segments: int
    make: float

    @property
    def seconds(self) -> float:
        return 2.0 * self.make + HOLD + AFTER

    @property
    def frames(self) -> int:
        return round(self.seconds * FRAMES_PER_SECOND)

    @property
    def made(self) -> int:
        """The frame at which the braid is held."""
        return round((self.make + 0.5 * HOLD) * FRAMES_PER_SECOND)


SIZES = {
    "small": Size(1, 1e-3, 40, 1.5),
    "default": Size(7, 1e-3, 80, 2.0),
    "full": Size(620, 1.2e-4, 200, 2.0),
}


@dataclass(frozen=True)
class Result:
    """points: (frame_count, 3, hairs, node_count, 3) [m].
    missed: pairs of segments that passed through each other, over all substeps.  strain: the largest of all."""

    points: np.ndarray
    missed: int
    strain: float


def led(size: Size, time: float) -> np.ndarray:
    """(3, 3) [m] where the middles of the bundles' ends are at `time` [s], beside where they hang.

    Seen from above each goes round a figure of eight, a third of a turn behind the one before.
    """
    part = np.clip(min(time, size.seconds - AFTER - time) / size.make, 0.0, 1.0)
    part = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    phase = 2.0 * np.pi * (PERIODS * part + np.arange(3) / 3.0)
    return np.stack([WIDTH * np.sin(phase), np.full(3, RISE * part), DEPTH * np.sin(2.0 * phase)], axis=1)


def scene(size: Size) -> Scene:
    """The bundles hang straight, their tops clamped; a clamp of its own draws the ends of each along."""
    # Spun threads rather than solid hair: they bend a hundred times as easily.
    fibre = Fibre(size.radius, density=1000.0, youngs_modulus=1e8, damping=5.0)
    around = bundle_places(size.hairs, 1.2 * 2.0 * size.radius)
    around = np.stack([around[:, 0], np.zeros(size.hairs), around[:, 1]], axis=1)
    along = np.linspace(0.0, 1.0, size.segments + 1)[:, None]
    shapes, clamps = [], []
    for k, end in enumerate(led(size, 0.0)):
        top, tip = end * [TOPS, 0.0, TOPS], end - [0.0, LENGTH, 0.0]
        shapes += [(1.0 - along) * top + along * tip + one for one in around]
        clamps.append(_clamp(f"end{k}", tip, lambda time, k=k, end=end: translation(led(size, time)[k] - end)))
    tops, hair = rods("hair", shapes, fibre, rest_shape="authored")
    soft = 0.01 * hair.bend_stiffness
    hair = replace(hair, bend_stiffness=soft, twist_stiffness=soft)
    tips = hair.offsets[1:].reshape(3, -1) - 1
    held = [_held(f"end{k}", own, k + 1) for k, own in enumerate(tips)]
    return Scene((tops, *clamps), (hair,), attachments=tuple(held))


def _clamp(name: str, place: np.ndarray, transform: Callable[[float], np.ndarray]) -> Surface:
    """A triangle about `place` that does not collide."""
    corners = place + 1e-3 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.0, 0.9], [-0.5, 0.0, -0.9]])
    return Surface(name, corners, np.array([[0, 1, 2]], np.int32), FormulaMotion(transform), collides=False)


def _held(name: str, points: np.ndarray, surface: int) -> Attachment:
    """Points of the hair, drawn to how they stand from the triangle of a clamp."""
    count = len(points)
    middle = np.full((count, 3), 1.0 / 3.0)
    return Attachment(name, 0, points, surface, np.zeros(count, np.int32), middle, stiffness=PULL / count)


def run(size: Size) -> Result:
    played = play(scene(size), "implicit", size.frames)
    points = played.points["hair"]
    return Result(points.reshape(len(points), 3, size.hairs, -1, 3), played.missed, played.strain)


def braid(paths: np.ndarray) -> tuple[int, tuple[int, ...]]:
    """What braid three paths (3, n, 2), across and in depth, make from the first of their n places to the last.

    Two are the same braid, which can be moved into each other without passing through, just if this is: the sum
    of their crossings' signs, and their image in SL(2, Z), whose kernel has sums that are multiples of 12.
    """
    found = []
    for i, j in combinations(range(3), 2):
        gap = paths[i] - paths[j]
        for k in np.flatnonzero(gap[:-1, 0] * gap[1:, 0] < 0.0):
            part = gap[k, 0] / (gap[k, 0] - gap[k + 1, 0])
            third = paths[3 - i - j, k, 0] < (1.0 - part) * paths[i, k, 0] + part * paths[i, k + 1, 0]
            front = (1.0 - part) * gap[k, 1] + part * gap[k + 1, 1]
            found.append((k + part, int(third), int(np.sign(front * gap[k, 0]))))
    total, image = 0, np.eye(2, dtype=int)
    for _, second, sign in sorted(found):
        total += sign
        image = image @ ([[1, 0], [-sign, 1]] if second else [[1, sign], [0, 1]])
    return total, tuple(image.ravel().tolist())


def braid_of(points: np.ndarray) -> tuple[int, tuple[int, ...]]:
    """Of the bundles' middles, (3, hairs, node_count, 3), from the top down; all go down."""
    middles = points.mean(axis=1)
    down = np.linspace(0.0, -middles[:, -1, 1].max(), 2000)
    paths = [[np.interp(down, -one[:, 1], one[:, axis]) for axis in (0, 2)] for one in middles]
    return braid(np.array(paths).swapaxes(1, 2))


def check(size: Size, result: Result) -> None:
    """What must be seen; AssertionError if it is not."""
    times = np.linspace(0.0, size.make, 2000)
    made = braid(np.array([led(size, time) for time in times])[:, :, [0, 2]].swapaxes(0, 1))
    none = braid_of(result.points[0])
    # The hair is braided as its ends were led round each other, and not at all once they have been led back.
    assert none == (0, (1, 0, 0, 1)) != made
    assert braid_of(result.points[size.made]) == made
    assert braid_of(result.points[-1]) == none
    assert result.missed == 0
    assert result.strain < 0.03


def write(size: Size, result: Result, path: Path) -> None:
    """All frames as a USD stage; beside them, how it hung at first, and how it was when it was made."""
    stage = new_stage(path, (0, len(result.points) - 1), FRAMES_PER_SECOND)
    shown = {"before": result.points[:1], "made": result.points[size.made : size.made + 1], "hair": result.points}
    for place, (name, points) in enumerate(shown.items()):
        for k, colour in enumerate(COLOURS):
            moved = points[:, k] + [BESIDE * place, 0.0, 0.0]
            define_curves(stage, f"/{name}{k}", moved, 2.0 * size.radius, colour)
    stage.Save()


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, prints, checks, writes, draws."""
    folder.mkdir(parents=True, exist_ok=True)
    chosen = SIZES[size]
    result = run(chosen)
    for name, frame in {"before": 0, "made": chosen.made, "after": -1}.items():
        print(f"{name}: {braid_of(result.points[frame])}")
    print(f"passed through: {result.missed}; largest strain {100.0 * result.strain:.2g} %")
    path = folder / "braiding.usdc"
    write(chosen, result, path)
    check(chosen, result)
    if draw:
        render_still(path, path.with_suffix(".jpg"), frame=len(result.points) - 1, size=(720, 640))


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
