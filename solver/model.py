"""What is constant during a run: the scene, the settings, and the launcher that works on them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

from plait.solver.launch import Launcher
from plait.solver.scene import Scene
from plait.solver.settings import Settings
from plait.solver.state import State


@dataclass(frozen=True)
class Interval:
    """A span of shot time [s], a substep or a frame."""

    start: float
    end: float

    @property
    def length(self) -> float:
        return self.end - self.start


class Stage(Protocol):
    """One feature's part of a substep. Built only when the scene needs it."""

    name: str

    def begin_frame(self, state: State, frame: Interval) -> None:
        """Decides what this frame can skip; called before the frame's substeps."""

    def step(self, state: State, substep: Interval, last_resort: bool) -> bool:
        """Moves its part of `state` from substep.start to substep.end, in place; whether the step stands.

        False asks for shorter steps, and leaves `state` so that `retract` can undo it; never with `last_resort`.
        """

    def retract(self, state: State, substep: Interval) -> None:
        """Undoes a `step` that does not stand, its own or that of a stage after it."""

    def end_frame(self, state: State, frame: Interval) -> dict[str, Any]:
        """Checks what it made (raises `Diverged`) and returns this frame's metrics."""


@dataclass
class Model:
    """Shared by the stages. `parts` lets a later stage find an earlier one, of whatever class, by name."""

    scene: Scene
    settings: Settings
    launcher: Launcher
    start_time: float
    parts: dict[str, Any] = field(default_factory=dict)
