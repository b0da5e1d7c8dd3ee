"""The frame loop: read, build, step, write; checkpoints, metrics, signals. Small on purpose."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from plait.pipeline import checkpoint, provenance
from plait.pipeline.config import Config
from plait.pipeline.errors import EXIT_DONE, EXIT_STOPPED, InputError, PlaitError, UsageError
from plait.pipeline.frames import FrameRange, parse, sample_codes, schedule
from plait.pipeline.metrics import Metrics
from plait.pipeline.outputs import Outputs
from plait.pipeline.progress import Progress, Quiet
from plait.pipeline.read import read_shot
from plait.pipeline.shot import Shot
from plait.pipeline.stopping import StopRequest
from plait.pipeline.write import CHECKPOINT, CacheWriter
from plait.solver.build import build
from plait.solver.diagnostics import Diverged, NoSuchDevice, Refused
from plait.solver.step import Simulation


def simulate(
    shot_path: Path,
    output: Path,
    config: Config,
    *,
    frames: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    skip_unsupported: bool = False,
    progress: Progress | None = None,
) -> int:
    """Simulates a shot into a cache; returns EXIT_DONE, or EXIT_STOPPED when a signal asked to stop.

    output: the top layer; its cache and metrics come beside it.  frames: as `plait.pipeline.frames.parse` reads
    them; None for the shot's own.  resume: go on from the last checkpoint, if there is one, to the same bits as a
    run that was never stopped.

    Raises UsageError and InputError before anything is written; PlaitError when the simulation fails, with the
    frames before it kept.
    """
    progress = progress or Quiet()
    wanted = parse(frames) if frames else None
    progress.phase(f"reading {shot_path.name}")
    shot = read_shot(shot_path, config, wanted and (wanted.start, wanted.end))
    for warning in shot.warnings:
        progress.log("warning", text=warning)
    _refuse_unsupported(shot, skip_unsupported)
    wanted = wanted or FrameRange(shot.info.start, shot.info.end)
    with StopRequest() as stop:
        run = _Run(shot, output, config, wanted, progress, resume=resume, overwrite=overwrite)
        return run.run(stop)


def _refuse_unsupported(shot: Shot, skip: bool) -> None:
    for prim in shot.prims:
        if not prim.supported and not skip:
            raise InputError(
                f"the role '{prim.role}' ({prim.recognised}) cannot be simulated: {prim.reason}",
                file=shot.info.path,
                prim=prim.path,
                mend="--skip-unsupported leaves such prims as they are",
            )


class _Run:
    """One run of one shot: the schedule, and what each leg of it leaves behind."""

    def __init__(
        self,
        shot: Shot,
        output: Path,
        config: Config,
        frames: FrameRange,
        progress: Progress,
        *,
        resume: bool,
        overwrite: bool,
    ) -> None:
        self.shot, self.output, self.config, self.progress = shot, output, config, progress
        self.resuming = resume
        self.begin, self.legs = schedule(frames, config.preroll, config.solver.substeps, config.output.shutter)
        self._tell_of_late_begin(frames)
        self.fingerprint = provenance.fingerprint(config, repr(frames), shot.layers)
        made = {**provenance.describe(config), "run": self.fingerprint}
        self.writer = CacheWriter(
            output,
            shot,
            samples=sample_codes(self.legs),
            chunk=config.output.chunk,
            provenance=made,
            inputs=shot.layers,
            overwrite=overwrite,
            resume=resume,
        )
        self.checkpoint_path = self.writer.folder / CHECKPOINT
        self.metrics = Metrics(output.with_suffix(".metrics.json"), {"shot": str(shot.info.path), **made})

    def run(self, stop: StopRequest) -> int:
        """Everything from an empty or half-filled folder to the finished cache."""
        scene = self.shot.scene
        if not (scene.strands or scene.bodies or scene.rigid_bodies or scene.granular):
            self.writer.open()
            name = self.shot.info.path.name
            self.progress.log(f"nothing to simulate in {name}; {self.output} shows it as it is")
            return EXIT_DONE
        simulation = self._build()
        self.metrics.run["threads"] = simulation.model.launcher.threads
        parts = simulation.model.parts
        for part in parts.values():
            for warning in getattr(part, "warnings", ()):
                self.progress.log("warning", text=warning)
        try:
            self.outputs = self._outputs(parts)
            with self.writer:
                return self._loop(simulation, self._resume(simulation), stop)
        finally:
            simulation.close()

    def _tell_of_late_begin(self, frames: FrameRange) -> None:
        """What falls from the shot's first frame on is elsewhere where the run begins later."""
        scene, late = self.shot.scene, self.begin - self.shot.info.start
        if late > 0.0 and (scene.rigid_bodies or scene.granular):
            self.progress.log(
                "warning",
                text=f"rigid bodies and grains start at frame {self.begin:g}, after the first of the shot, "
                f"{self.shot.info.start:g}: frame {frames.start:g} is that of a run of the whole shot with "
                f"--preroll {self.config.preroll + math.ceil(late)} or more",
            )

    def _build(self) -> Simulation:
        self.progress.phase("compiling")
        try:
            return build(self.shot.scene, self.config.solver, self._seconds(self.begin))
        except Refused as error:
            raise self._refused(error) from error
        except NoSuchDevice as error:
            raise UsageError(str(error)) from error

    def _outputs(self, parts: Mapping[str, Any]) -> Outputs:
        try:
            return Outputs(self.shot, parts)
        except Refused as error:
            raise self._refused(error) from error

    def _refused(self, error: Refused) -> InputError:
        return InputError(str(error), file=self.shot.info.path)

    def _resume(self, simulation: Simulation) -> int:
        if not self.resuming or not self.checkpoint_path.exists():
            return 0
        fresh = simulation.state.to_numpy()
        done = checkpoint.load(self.checkpoint_path, simulation.state, self.fingerprint)
        if sum(leg.last_of_frame for leg in self.legs[:done]) > self.writer.frames_done:
            simulation.state.restore(fresh)
            self.progress.log("chunks before the checkpoint are missing; simulating from the first frame")
            return 0
        self.metrics.resume(done)
        self.progress.log("resuming", after=self._label(done - 1))
        return done

    def _loop(self, simulation: Simulation, done: int, stop: StopRequest) -> int:
        try:
            return self._legs(simulation, done, stop)
        finally:
            self.metrics.save()

    def _legs(self, simulation: Simulation, done: int, stop: StopRequest) -> int:
        for index in range(done, len(self.legs)):
            leg = self.legs[index]
            self._advance(simulation, index)
            self.progress.frame(index + 1, len(self.legs), self._label(index))
            finished = self.writer.frames_done
            if leg.frame is not None:
                self.writer.add(leg.code, self.outputs.frames(simulation.state.time))
            stopping = bool(stop) and index + 1 < len(self.legs)
            if stopping:
                self.writer.flush()
            if stopping or self.writer.frames_done > finished:
                checkpoint.save(self.checkpoint_path, simulation.state, self.fingerprint, index + 1)
                self.metrics.save()
            if stopping:
                self.progress.log("stopped by a signal; --resume goes on", after=self._label(index))
                return EXIT_STOPPED
        self.progress.log("wrote", path=str(self.output), frames=self.writer.frames_done)
        return EXIT_DONE

    def _advance(self, simulation: Simulation, index: int) -> None:
        leg = self.legs[index]
        if leg.substeps == 0:
            return
        started = time.perf_counter()
        try:
            figures = simulation.advance_frame(self._seconds(leg.code), leg.substeps)
        except Diverged as error:
            raise PlaitError(
                f"{self.shot.info.path}: {error} (frame {leg.code:g}); the frames before it are kept; "
                f"try {' or '.join(['more substeps', *self._softer()])}"
            ) from error
        self.metrics.add(index, leg.code, time.perf_counter() - started, figures)

    def _softer(self) -> list[str]:
        """What else may help against divergence."""
        kinds = {"stiffer or thicker strands": self.shot.scene.strands, "softer flesh": self.shot.scene.bodies}
        kinds["softer grains"] = self.shot.scene.granular
        return [advice for advice, held in kinds.items() if held]

    def _seconds(self, code: float) -> float:
        return code / self.shot.info.time_codes_per_second

    def _label(self, index: int) -> str:
        leg = self.legs[index]
        return f"frame {leg.code:g}" if leg.frame is not None else f"pre-roll {leg.code:g}"
