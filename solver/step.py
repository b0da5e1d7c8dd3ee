"""The loop over stages."""

from __future__ import annotations

from typing import Any

from plait.solver.model import Interval, Model
from plait.solver.state import State

# A substep that a stage cannot take as it is, is halved at most so often.
MAX_HALVINGS = 4


class Simulation:
    """A model, its state and the loop that advances it; see `plait.solver.build.build`."""

    def __init__(self, model: Model, state: State) -> None:
        self.model, self.state = model, state

    def advance_frame(self, end: float, substeps: int | None = None) -> dict[str, Any]:
        """Steps from the state's time to `end` [s] in equal substeps that end exactly on it, cut where need be.

        Returns the frame's metrics: one entry a stage, beside 'launches' and 'seconds' by stage. Raises
        `Diverged` when something is not finite; the state is then of no further use.
        """
        launcher = self.model.launcher
        frame = Interval(self.state.time, end)
        count = substeps or self.model.settings.substeps
        launches, seconds = launcher.launches.copy(), launcher.seconds.copy()
        stages = self.model.parts.items()
        for name, stage in stages:
            with launcher.stage(name):
                stage.begin_frame(self.state, frame)
        taken = 0
        for i in range(count):
            start = frame.start + frame.length * i / count
            substep = Interval(start, end if i + 1 == count else frame.start + frame.length * (i + 1) / count)
            taken += self._advance(substep, MAX_HALVINGS)
        metrics: dict[str, Any] = {"substeps": taken}
        for name, stage in stages:
            with launcher.stage(name):
                metrics[name] = stage.end_frame(self.state, frame)
        metrics["launches"] = dict(launcher.launches - launches)
        metrics["seconds"] = {name: launcher.seconds[name] - seconds[name] for name in self.model.parts}
        return metrics

    def _advance(self, substep: Interval, halvings: int) -> int:
        """Steps every stage, in halves where one asks for shorter steps; returns the number of steps taken."""
        stages, launcher = self.model.parts.items(), self.model.launcher
        tried = []
        for name, stage in stages:
            tried.append(stage)
            with launcher.stage(name):
                if not stage.step(self.state, substep, halvings == 0):
                    break
        else:
            self.state.time = substep.end
            return 1
        for stage in reversed(tried):
            stage.retract(self.state, substep)
        middle = 0.5 * (substep.start + substep.end)
        halves = (Interval(substep.start, middle), Interval(middle, substep.end))
        return sum(self._advance(half, halvings - 1) for half in halves)

    def close(self) -> None:
        self.model.launcher.close()
