"""What the character carries: a wooden staff in the right fist."""

from __future__ import annotations

import numpy as np

from plait.assets.character import ARM_ANGLE, Joint
from plait.assets.implicit import rotation_z

STAFF_COLOUR = (0.23, 0.13, 0.06)
SIDES = 12
# [cm] along the staff from the fist, and radius there: a tapered shaft with a knob at its upper end.
PROFILE = np.array(
    [(-84, 0.0), (-84, 0.9), (-40, 1.15), (48, 1.3),
     (50, 1.9), (52, 2.7), (54, 3.0), (56, 2.7), (58, 1.6), (58.6, 0.0)]
)  # fmt: skip


def staff(joints: tuple[Joint, ...]) -> tuple[np.ndarray, np.ndarray]:
    """A closed mesh as the fist of the modelled pose holds it: points (n, 3) [cm], triangles (m, 3).

    It lies along Z, which a forearm raised to the front turns upright.
    """
    wrist = next(joint.place for joint in joints if joint.name == "RightHand")
    grip = wrist - 6.0 * rotation_z(-ARM_ANGLE)[:, 1] + (2.2, 0.0, 0.0)
    angles = np.arange(SIDES) * 2.0 * np.pi / SIDES
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    rings = PROFILE[1:-1]
    points = [np.array([[0.0, 0.0, PROFILE[0, 0]]])]
    points += [np.column_stack([radius * circle, np.full(SIDES, z)]) for z, radius in rings]
    points.append(np.array([[0.0, 0.0, PROFILE[-1, 0]]]))
    here, after = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    last = 1 + SIDES * len(rings)
    triangles = [np.column_stack([np.zeros(SIDES, int), 1 + after, 1 + here])]
    for ring in range(len(rings) - 1):
        low, high = 1 + SIDES * ring, 1 + SIDES * (ring + 1)
        triangles += [
            np.column_stack([low + here, low + after, high + after]),
            np.column_stack([low + here, high + after, high + here]),
        ]
    top = last - SIDES
    triangles.append(np.column_stack([top + here, top + after, np.full(SIDES, last)]))
    return np.concatenate(points) + grip, np.concatenate(triangles)
