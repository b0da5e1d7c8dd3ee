"""Surfaces that bodies carry, as strands and grains see them: placed after the bodies have stepped."""

from __future__ import annotations

from typing import Any

from plait.solver.model import Interval, Model
from plait.solver.state import State


class CarriedStage:
    """Lets the kinematics stage follow the bodies, where strands grow on them or something may touch them."""

    name = "carried"

    def __init__(self, model: Model) -> None:
        self._kinematics = model.parts["kinematics"]
        self._kinematics.follow_bodies(model.start_time)

    def begin_frame(self, state: State, frame: Interval) -> None:
        """Nothing: the kinematics stage has placed the skins at the frame's start."""

    def step(self, state: State, substep: Interval, last_resort: bool) -> bool:
        self._kinematics.follow_bodies(substep.end)
        return True

    def retract(self, state: State, substep: Interval) -> None:
        """Nothing: the kinematics stage goes back with what it holds."""

    def end_frame(self, state: State, frame: Interval) -> dict[str, Any]:
        return {}


def build(model: Model, state: State) -> CarriedStage:
    return CarriedStage(model)
