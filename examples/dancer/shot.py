"""The shot: a mannequin with long hair spins round once on a foot, and stops. Centimetres, Y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from plait.assets import mannequin, wig
from plait.assets.walk import Choreography, Swing

FIRST = 1.0
SPIN = (0.25, 1.05)  # [s] from the first frame
LEFT_FOOT_STANDS: tuple[Swing, ...] = ()
FROM = np.array([75.0, 40.0, 230.0])  # [cm] the camera from what it looks at
LOOK_AT = np.array([4.0, 150.0, 0.0])  # [cm]


def choreography() -> Choreography:
    """On the left foot, the right one round it to where it was."""
    ball = next(joint.place for joint in mannequin.skeleton() if joint.name == "RightToe")
    round_it = Swing(SPIN[0] + 0.02, SPIN[1] + 0.02, float(ball[0]), float(ball[2]), 9.0)
    return Choreography({"Left": LEFT_FOOT_STANDS, "Right": (round_it,)}, SPIN, staff=False)


def write(path: Path, frames: int, hair: wig.Wig) -> None:
    """frames: how long it lasts."""
    wig.write(path, hair, choreography(), (FIRST, FIRST + frames), LOOK_AT, FROM)
