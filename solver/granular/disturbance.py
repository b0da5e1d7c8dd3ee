"""Where what is not grains moves, so that no grain sleeps there."""

from __future__ import annotations

import numpy as np

from plait.solver.kinematics.colliders import Collider
from plait.solver.model import Interval, Model


def moving_boxes(model: Model, substep: Interval) -> list[np.ndarray]:
    """(2, 3) [m] bounds, over the substep last stepped, of surfaces that move or may and of strands.

    A surface that the animation holds still takes any weight, and grains may sleep on it; bodies do not.
    """
    kinematics = model.parts["kinematics"]
    followed = {collider.index for collider in kinematics.followed}
    boxes = [_strands(model, substep)] if "strands" in model.parts else []
    for collider in kinematics.colliders.items if kinematics.colliders is not None else ():
        if collider.index in followed or _placed(collider, substep):
            ends = np.stack([points[collider.points].numpy() for points in kinematics.colliders.points])
            if collider.carried or not np.array_equal(*ends):
                boxes.append(_bounds(ends.reshape(-1, 3), collider.surface.thickness))
    return boxes


def _placed(collider: Collider, substep: Interval) -> bool:
    """Whether an animated surface has been brought to both ends, as those near the grains are."""
    return collider.moves and {substep.start, substep.end} <= set(collider.placed)


def _strands(model: Model, substep: Interval) -> np.ndarray:
    stage = model.parts["strands"]
    position, velocity = stage.position.numpy(), stage.velocity.numpy()
    return _bounds(np.concatenate([position, position - substep.length * velocity]), 0.0)


def _bounds(points: np.ndarray, margin: float) -> np.ndarray:
    return np.stack([points.min(axis=0) - margin, points.max(axis=0) + margin])
