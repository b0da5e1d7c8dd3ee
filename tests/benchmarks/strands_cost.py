"""What a substep of strands costs: microseconds per segment on one and two threads, and its growth with size.

    python tests/benchmarks/strands_cost.py [--strands 10000] [--segments 50] [--growth]

Wavy hair of 40 um radius, 4 GPa and 0.25 m, roots shaken sideways with 1 g at 2 Hz, dt = 1/192 s, production
tolerance. Each figure is the best and the median of several frames, after two frames of warming up.
"""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import dataclass

import numpy as np

from plait.solver.build import build
from plait.solver.scene import Pose, RootBinding, Scene, Strands, Surface
from plait.solver.settings import Settings, StrandContactSettings, StrandSettings
from plait.solver.step import Simulation

SUBSTEPS = 8
FRAME = 1.0 / 24.0
ACCELERATION = 9.81
FREQUENCY = 2.0


@dataclass(frozen=True)
class Shaken:
    """Sideways to and fro, starting from rest."""

    animated: bool = True

    def pose(self, time: float) -> Pose:
        omega = 2.0 * np.pi * FREQUENCY
        transform = np.eye(4)
        transform[0, 3] = ACCELERATION / omega**2 * (1.0 - np.cos(omega * time))
        return Pose(transform[None])


def wavy_hair(strand_count: int, segments: int, seed: int = 1) -> Scene:
    """Strands in random directions, gently curled, each on a triangle of its own."""
    random = np.random.default_rng(seed)
    length, radius, young = 0.25, 40e-6, 4e9
    direction = random.normal(size=(strand_count, 3))
    direction[:, 1] = -np.abs(direction[:, 1])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    side = np.cross(direction, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(direction, side)
    along = np.linspace(0.0, length, segments + 1)
    phase = 4.0 * np.pi * along / length
    points = (
        random.uniform(-0.1, 0.1, (strand_count, 1, 3))
        + along[:, None] * direction[:, None]
        + 0.005 * ((np.cos(phase) - 1.0)[:, None] * side[:, None] + np.sin(phase)[:, None] * other[:, None])
    )
    roots = points[:, :1] + 0.01 * np.array([[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 2.0]])
    scalp = Surface(
        "scalp",
        roots.reshape(-1, 3),
        np.arange(3 * strand_count, dtype=np.int32).reshape(-1, 3),
        motion=Shaken(),
        collides=False,
    )
    area, second_moment = np.pi * radius**2, np.pi * radius**4 / 4.0
    hair = Strands(
        "hair",
        points.reshape(-1, 3),
        np.arange(strand_count + 1, dtype=np.int32) * (segments + 1),
        RootBinding(0, np.arange(strand_count, dtype=np.int32), np.full((strand_count, 3), 1.0 / 3.0)),
        np.full(strand_count * (segments + 1), radius),
        *(
            np.full(strand_count, value)
            for value in (1300.0, young * area, young * second_moment, young / 1.3 * second_moment, 1.0, 0.3)
        ),
        rest_shape="authored",
    )
    return Scene(surfaces=(scalp,), strands=(hair,))


def start(scene: Scene, threads: int, strands: StrandSettings | None = None) -> Simulation:
    """Of rods for themselves: contact would look for others."""
    alone = StrandContactSettings(method="none")
    return build(scene, Settings(threads=threads, strands=strands or StrandSettings(), strand_contact=alone))


def cost(simulation: Simulation, segments: int, frames: int) -> tuple[float, float, float, float]:
    """Microseconds per segment and substep (best, median, best in processor time), and mean Newton iterations."""
    seconds, processor, iterations = [], [], []
    for frame in range(frames + 2):
        started = time.process_time()
        metrics = simulation.advance_frame((frame + 1) * FRAME, SUBSTEPS)
        processor.append(time.process_time() - started)
        seconds.append(metrics["seconds"]["strands"])
        iterations.append(metrics["strands"]["iterations_mean"])
    scale = 1e6 / (segments * SUBSTEPS)
    each = [scale * s for s in seconds[2:]]
    return min(each), statistics.median(each), scale * min(processor[2:]), statistics.mean(iterations[2:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--strands", type=int, default=10000)
    parser.add_argument("--segments", type=int, default=50)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--threads", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--precision", default="auto")
    parser.add_argument("--tolerance", type=float, default=StrandSettings().tolerance)
    parser.add_argument("--growth", action="store_true", help="1e3 to 1e6 segments on one thread")
    options = parser.parse_args()
    settings = StrandSettings(precision=options.precision, tolerance=options.tolerance)
    counts = [20, 200, 2000, 20000] if options.growth else [options.strands]
    seen = []
    for strand_count in counts:
        scene = wavy_hair(strand_count, options.segments)
        total = strand_count * options.segments
        for threads in [1] if options.growth else options.threads:
            simulation = start(scene, threads, settings)
            best, median, processor, iterations = cost(simulation, total, options.frames)
            simulation.close()
            print(
                f"{total:8d} segments, {threads} thread(s): best {best:.3f}, median {median:.3f} us per segment "
                f"and substep (processor time with roots {processor:.3f}), {iterations:.2f} iterations",
                flush=True,
            )
            seen.append(processor * total)
    if options.growth:
        exponent = np.polyfit(np.log(counts), np.log(seen), 1)[0]
        print(f"growth exponent {exponent:.3f}")


if __name__ == "__main__":
    main()
