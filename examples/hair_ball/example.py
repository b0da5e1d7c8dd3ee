"""A ball of hair is shaken and turned: with contact of strands it keeps its volume, and without it does not.

`python example.py [small|default|full]` runs it both ways, prints and checks what it comes to, and leaves
`out/hair_ball.usdc` with a picture.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Gf
from scipy.spatial import cKDTree

from plait.assets.small_scene import capsule, fans
from plait.assets.stages import add_camera, define_curves, define_mesh, make_smooth, new_stage
from plait.assets.strands import FRAMES_PER_SECOND, play
from plait.pipeline.benchmarks.scenes import Fibre, FormulaMotion, rods
from plait.pipeline.preview import render
from plait.solver.scene import Scene, Surface

RADIUS, LENGTH = 0.04, 0.1  # [m] of the ball, of the hair
SHAKEN = 1.5  # [s]
SWAY, LIFT, TURN = 0.06, 0.03, 0.6 * np.pi  # [m], [m], [rad] to either side
METHODS = {"implicit": "contact", "none": "no contact"}
CAMERA = "/camera"
BESIDE = 0.24  # [m] between the balls of the picture


@dataclass(frozen=True)
class Size:
    """hairs, radius [m] of a hair, segments: of a hair.  frames: simulated."""

    hairs: int
    radius: float
    segments: int
    frames: int


SIZES = {
    "small": Size(60, 1.2e-3, 10, 24),
    "default": Size(600, 1.2e-3, 16, 48),
    "full": Size(32000, 0.06e-3, 60, 60),
}


@dataclass(frozen=True)
class Result:
    """Of one method. points: (frame_count, hairs, node_count, 3) [m].
    missed: pairs of segments that passed through each other, over all substeps.
    strain, volume: the largest and the least of all frames; the latter as `kept` has it."""

    points: np.ndarray
    missed: int
    strain: float
    volume: float


def moved(time: float) -> np.ndarray:
    """(4, 4): where the ball is at `time` [s]: swayed, lifted and turned about y, each at its own pace."""
    part = np.clip(time / SHAKEN, 0.0, 1.0)
    strength = (4.0 * part * (1.0 - part)) ** 2
    turn = TURN * strength * np.sin(2.0 * np.pi * part)
    transform = np.eye(4)
    transform[0, [0, 2]], transform[2, [0, 2]] = (np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))
    transform[0, 3] = SWAY * strength * np.sin(2.0 * np.pi * 2.0 * part)
    transform[1, 3] = LIFT * strength * np.sin(2.0 * np.pi * 3.0 * part)
    return transform


def directions(count: int) -> np.ndarray:
    """(count, 3): evenly over the sphere, on a spiral (golden angle)."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    around = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(around), height, across * np.sin(around)], axis=1)


def ball() -> tuple[np.ndarray, np.ndarray]:
    points, faces = capsule(RADIUS, 2.0 * RADIUS, around=32, rings=23)
    return points - [0.0, RADIUS, 0.0], fans(faces)


def scene(size: Size) -> Scene:
    """Straight hair in all directions, that bends under its own weight, and the ball that it stands on."""
    fibre = Fibre(size.radius, density=1300.0, youngs_modulus=1e7, damping=15.0)
    motion = FormulaMotion(moved)
    along = np.linspace(RADIUS + 2.0 * size.radius, RADIUS + LENGTH, size.segments + 1)[:, None]
    roots, hair = rods(
        "hair", [along * d for d in directions(size.hairs)], fibre, motion=motion, rest_shape="authored"
    )
    soft = 0.005 * hair.bend_stiffness  # spun threads rather than solid hair
    hair = replace(hair, bend_stiffness=soft, twist_stiffness=soft)
    points, triangles = ball()
    return Scene((roots, Surface("ball", points, triangles, motion=motion)), (hair,))


def run(size: Size, method: str) -> Result:
    """method: of `StrandContactSettings`."""
    played = play(scene(size), method, size.frames)
    points = played.points["hair"]
    return Result(points, played.missed, played.strain, min(kept(one, size.radius) for one in points))


def kept(points: np.ndarray, radius: float) -> float:
    """Which part of its own volume the hair (hairs, node_count, 3) takes up, beside itself: 1 where none overlaps.

    On level planes: the area that discs about the hairs cover, over the sum of theirs. Where hairs keep off each
    other, theirs do not overlap, however they lean.
    """
    around = 2.399963 * np.arange(64)
    disc = (
        radius * np.sqrt((np.arange(64) + 0.5) / 64)[:, None] * np.stack([np.cos(around), np.sin(around)], axis=1)
    )
    shares = []
    for level in np.linspace(*np.quantile(points[..., 1], (0.02, 0.98)), 40):
        height = points[..., 1] - level
        hair, edge = np.nonzero(height[:, :-1] * height[:, 1:] < 0.0)
        part = (height[hair, edge] / (height[hair, edge] - height[hair, edge + 1]))[:, None]
        places = (1.0 - part) * points[hair, edge][:, [0, 2]] + part * points[hair, edge + 1][:, [0, 2]]
        samples = (places[:, None] + disc).reshape(-1, 2)
        shares.append(1.0 / cKDTree(places).query_ball_point(samples, radius, return_length=True))
    return float(np.concatenate(shares).mean())


def in_the_way(size: Size) -> float:
    """How many hairs grow where another lies that lies down on the ball.

    Hairs a thickness apart are clear of each other: it takes a strip two thicknesses wide, and as long as it is.
    """
    return size.hairs * 4.0 * size.radius * LENGTH / (4.0 * np.pi * RADIUS**2)


def check(size: Size, results: dict[str, Result]) -> None:
    """What must be seen; AssertionError if it is not."""
    with_contact, without = results["implicit"], results["none"]
    # Without contact hairs go through those that are in their way. Of two hairs one is in the other's.
    assert without.missed > 0.5 * size.hairs * in_the_way(size)
    assert with_contact.missed == 0
    # Hairs in contact may be a tenth nearer than they are thick, where two discs lose 2 % each to each other.
    assert with_contact.volume > 0.98 and with_contact.volume > without.volume
    assert with_contact.strain < 0.03
    for frame, points in enumerate(with_contact.points):
        local = points - moved(frame / FRAMES_PER_SECOND)[:3, 3]
        # Facets lie within the sphere by up to R (1 - cos(pi / 32)), .5 %.
        assert np.linalg.norm(local, axis=-1).min() > 0.99 * RADIUS


def write(size: Size, results: dict[str, Result], path: Path) -> None:
    """All frames as a USD stage: how it was at first, and the methods side by side."""
    stage = new_stage(path, (0, size.frames), FRAMES_PER_SECOND)
    add_camera(stage, CAMERA, (BESIDE, 0.36, 1.95), down=10.5)
    shown = {"start": results["implicit"].points[:1]} | {name: result.points for name, result in results.items()}
    for place, (name, frames) in enumerate(shown.items()):
        offset = np.array([BESIDE * place, 0.0, 0.0])
        mesh = define_mesh(stage, f"/{name}_ball", *ball(), (0.30, 0.12, 0.09))
        transform = mesh.AddTransformOp()
        for frame in range(len(frames)):
            at = moved(frame / FRAMES_PER_SECOND)
            at[:3, 3] += offset
            transform.Set(Gf.Matrix4d(at.T.tolist()), frame)
        make_smooth(define_curves(stage, f"/{name}_hair", frames + offset, 2.0 * size.radius, colours(size.hairs)))
    stage.Save()


def colours(count: int) -> np.ndarray:
    """(count, 3) linear RGB: by where each hair grows, light above and dark below, no two quite alike."""
    part = 0.5 + 0.5 * directions(count)[:, 1:2]
    mixed = part * [0.75, 0.42, 0.12] + (1.0 - part) * [0.20, 0.05, 0.06]
    return mixed * np.random.default_rng(1).uniform(0.5, 1.2, part.shape)


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, prints, checks, writes, draws."""
    folder.mkdir(parents=True, exist_ok=True)
    chosen, results = SIZES[size], {}
    for method, name in METHODS.items():
        results[method] = found = run(chosen, method)
        strain = f"largest strain {100.0 * found.strain:.2g} %"
        print(f"{name}: {found.missed} passed through, {100.0 * found.volume:.3g} % of the volume kept, {strain}")
    path = folder / "hair_ball.usdc"
    write(chosen, results, path)
    check(chosen, results)
    if draw:
        render(path, path.with_suffix(".jpg"), frames=str(chosen.frames), size="960x380", camera=CAMERA)


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
