"""A mannequin with a full head of hair walks: a USD shot in, a USD cache out, hair that lies upon hair.

`python example.py [small|default|full]` writes the shot, simulates it, checks it and draws it, all in `out/`.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np

from plait.assets import wig
from plait.pipeline import config, driver
from plait.pipeline.preview import render

HERE = Path(__file__).parent
SHOT = runpy.run_path(str(HERE / "shot.py"))

SIZES = {  # frames simulated, hair
    "small": (16, wig.Wig(60, 10, 0.4)),
    "default": (60, wig.Wig(400, 16, 0.2)),
    "full": (72, wig.Wig(20000, 50, 0.05)),
}


def run(folder: Path, frames: int, hair: wig.Wig) -> Path:
    """Writes the shot into `folder` and simulates it; returns the cache. `plait sim` does just the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    shot, cache = folder / "walking_shot.usda", folder / "walking.usda"
    SHOT["write"](shot, frames, hair)
    driver.simulate(shot, cache, config.load(HERE / "sim.toml", []), overwrite=True)
    return cache


def check(worn: wig.Worn) -> None:
    """What must be seen, beside what `wig.check` asks for; AssertionError if it is not."""
    # Hair swings as it is walked with: heads bob and sway by centimetres.
    swing = np.ptp(worn.tips.mean(axis=1), axis=0)
    print(f"tips swing by {swing[0]:.1f}, {swing[1]:.1f} and {swing[2]:.1f} cm across, up and along")
    assert swing.max() > 1.0


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, checks, draws."""
    frames, hair = SIZES[size]
    cache = run(folder, frames, hair)
    check(wig.check(cache))
    if draw:
        render(cache, folder / "walking.jpg", frames=str(min(frames, 36)), size="640x640", camera=str(wig.CAMERA))


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
