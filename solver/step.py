"""The loop over stages."""

from __future__ import annotations

from typing import Any

from plait.solver.model import Interval, Model
from plait.solver.state import State


class Simulation:
    """A model, its state and the loop that advances it; see `plait.solver.build.build`."""

    def __init__(self, model: Model, state: State) -> None:
        self.model, self.state = model, state

    def advance_frame(self, end: float, substeps: int | None = None) -> dict[str, Any]:
        """Steps from the state's time to `end` [s] in equal substeps that end exactly on it.

        Returns the frame's metrics: one entry a stage, beside 'launches' and 'seconds' by stage. Raises
        `Diverged`, with the state as it was found, when something is not finite.
        """
        launcher = self.model.launcher
        frame = Interval(self.state.time, end)
        count = substeps or self.model.settings.substeps
        launches, seconds = launcher.launches.copy(), launcher.seconds.copy()
        stages = self.model.parts.items()
        for name, stage in stages:
            with launcher.stage(name):
                stage.begin_frame(self.state, frame)
        for i in range(count):
            substep = Interval(
                frame.start + frame.length * i / count,
                end if i + 1 == count else frame.start + frame.length * (i + 1) / count,
            )
            for name, stage in stages:
                with launcher.stage(name):
                    stage.step(self.state, substep)
            self.state.time = substep.end
        metrics: dict[str, Any] = {"substeps": count}
        for name, stage in stages:
            with launcher.stage(name):
                metrics[name] = stage.end_frame(self.state, frame)
        metrics["launches"] = dict(launcher.launches - launches)
        metrics["seconds"] = {name: launcher.seconds[name] - seconds[name] for name in self.model.parts}
        return metrics

    def close(self) -> None:
        self.model.launcher.close()
