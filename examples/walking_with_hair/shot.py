"""The shot: a mannequin with a full head of hair walks. Centimetres, Y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from plait.assets import mannequin, wig

FIRST = 1.0
STEPS = 5
FROM = np.array([100.0, 18.0, 100.0])  # [cm] the camera from what it looks at
LOOK_AT = np.array([0.0, 155.0, 4.0])  # [cm] at first


def write(path: Path, frames: int, hair: wig.Wig) -> None:
    """frames: how long it lasts."""
    wig.write(path, hair, mannequin.straight_walk(STEPS), (FIRST, FIRST + frames), LOOK_AT, FROM)
