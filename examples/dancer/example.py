"""A dancer's long hair flies out as she spins, wraps round her as she stops, and comes down again.

`python example.py [small|default|full]` writes the shot, simulates it, checks it and draws it, all in `out/`.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np

from plait.assets import wig
from plait.assets.generate import RATE
from plait.pipeline import config, driver
from plait.pipeline.preview import render

HERE = Path(__file__).parent
SHOT = runpy.run_path(str(HERE / "shot.py"))

LENGTH = (26.0, 10.0)  # [cm] of the lowest strands, and what the highest have more
SIZES = {  # frames simulated, hair
    "small": (32, wig.Wig(60, 12, 0.4, LENGTH)),
    "default": (60, wig.Wig(400, 18, 0.2, LENGTH)),
    "full": (72, wig.Wig(10000, 49, 0.07, LENGTH)),
}


def run(folder: Path, frames: int, hair: wig.Wig) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "dancer_shot.usda", folder / "dancer.usda"
    SHOT["write"](shot, frames, hair)
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


def check(worn: wig.Worn) -> None:
    """What must be seen, beside what `wig.check` asks for; AssertionError if it is not."""
    flare = np.linalg.norm(worn.tips[..., [0, 2]], axis=-1).mean(axis=1)
    print(f"tips from the axis: {flare[0]:.1f} cm at first, {flare.max():.1f} at most, {flare[-1]:.1f} in the end")
    # It flies out by its spin, and comes down.
    assert flare.max() > 1.8 * flare[0]
    assert flare[-1] < 1.3 * flare[0]
    # And wraps: it goes on round the head when that has stopped.
    around = worn.tips[..., 2] + 1j * worn.tips[..., 0]
    stopped = round(SHOT["SPIN"][1] * RATE)
    turned = np.angle(around[stopped + 1 :] / around[stopped:-1]).mean(axis=1)
    wrapped = np.degrees(np.cumsum(turned).max())
    print(f"it goes on by {wrapped:.0f} degrees")
    assert wrapped > 30.0


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, checks, draws."""
    frames, hair = SIZES[size]
    cache = run(folder, frames, hair)
    check(wig.check(cache))
    if draw:
        render(cache, folder / "dancer.jpg", frames=str(min(frames, 22)), size="720x560", camera=str(wig.CAMERA))


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
