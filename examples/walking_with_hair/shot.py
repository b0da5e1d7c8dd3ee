"""The shot: a mannequin with a full head of hair walks. Centimetres, Y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd

from plait.assets import generate, mannequin, wig

FIRST, SAMPLES_PER_FRAME = 1.0, 2
STEPS = 5
FROM = np.array([100.0, 18.0, 100.0])  # [cm] the camera from what it looks at
LOOK_AT = np.array([0.0, 155.0, 4.0])  # [cm] at first


def write(path: Path, frames: int, hair: wig.Wig) -> None:
    """frames: how long it lasts."""
    last = FIRST + frames
    codes = np.arange(FIRST, last + 1e-6, 1.0 / SAMPLES_PER_FRAME)
    plan = mannequin.straight_walk(STEPS)

    def author(stage: Usd.Stage) -> None:
        wig.author(stage, hair, codes, plan)
        wig.author_camera(stage, plan, codes, LOOK_AT, FROM)

    generate.write(path, author, frames=(FIRST, last))
