"""What a user, a log or a farm sees of a run while it goes on."""

from __future__ import annotations

import json
import sys
import time
from typing import Any, Protocol, TextIO


class Progress(Protocol):
    """Told what is being done. `frame` counts from 1; pre-roll frames count too."""

    def phase(self, text: str) -> None: ...
    def frame(self, done: int, total: int, label: str) -> None: ...
    def log(self, event: str, **fields: Any) -> None: ...
    def close(self) -> None: ...


class Quiet:
    """Logs only: one line an event on stderr, as text or as JSON."""

    def __init__(self, log_format: str = "text", stream: TextIO | None = None) -> None:
        self.log_format, self.stream = log_format, stream or sys.stderr

    def phase(self, text: str) -> None:
        pass

    def frame(self, done: int, total: int, label: str) -> None:
        pass

    def log(self, event: str, **fields: Any) -> None:
        if self.log_format == "json":
            line = json.dumps({"time": round(time.time(), 3), "event": event, **fields})
        else:
            line = " ".join([f"plait: {event}", *(f"{key}={value}" for key, value in fields.items())])
        print(line, file=self.stream, flush=True)

    def close(self) -> None:
        pass


class OpenJobDescription(Quiet):
    """Progress as Open Job Description runners read it from stdout."""

    def phase(self, text: str) -> None:
        print(f"openjd_status: {text}", flush=True)

    def frame(self, done: int, total: int, label: str) -> None:
        print(f"openjd_progress: {100.0 * done / total:.1f}", flush=True)
        print(f"openjd_status: {label}", flush=True)


class Plain(Quiet):
    """For a log file: a line when the phase changes, then one every few seconds."""

    SECONDS_BETWEEN_LINES = 5.0

    def __init__(self, log_format: str = "text", stream: TextIO | None = None) -> None:
        super().__init__(log_format, stream)
        self.phase_started()

    def phase_started(self) -> None:
        """The first frame of a phase holds the compilation: time left is judged by those after it."""
        self.first: tuple[int, float] | None = None
        self.printed = time.monotonic()

    def phase(self, text: str) -> None:
        self.log(text)
        self.phase_started()

    def frame(self, done: int, total: int, label: str) -> None:
        now = time.monotonic()
        if self.first is None:
            self.first = (done, now)
            self.log(label, done=f"{done}/{total}")
            return
        if done < total and now - self.printed < self.SECONDS_BETWEEN_LINES:
            return
        self.printed = now
        left = (now - self.first[1]) / (done - self.first[0]) * (total - done)
        self.log(label, done=f"{done}/{total}", left=f"{left:.0f}s")


class Rich(Quiet):
    """A bar on a terminal: what is being done, frames, time left."""

    def __init__(self, log_format: str = "text") -> None:
        super().__init__(log_format)
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            SpinnerColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
        from rich.progress import Progress as Bar

        self.bar = Bar(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
        )
        self.task = self.bar.add_task("starting", total=None)
        self.counting = False
        self.bar.start()

    def phase(self, text: str) -> None:
        self.counting = False
        self.bar.update(self.task, description=text, total=None, completed=0)

    def frame(self, done: int, total: int, label: str) -> None:
        if not self.counting:  # after the first frame, which holds the compilation
            self.bar.reset(self.task)
            self.counting = True
        self.bar.update(self.task, description=label, total=total, completed=done)

    def log(self, event: str, **fields: Any) -> None:
        if self.log_format == "json":
            super().log(event, **fields)
        else:
            text = " ".join([event, *(f"{key}={value}" for key, value in fields.items())])
            self.bar.console.print(f"plait: {text}", markup=False, highlight=False)

    def close(self) -> None:
        self.bar.stop()


def make(kind: str, log_format: str) -> Progress:
    """kind: 'rich' (lines instead of a bar where stderr is no terminal), 'openjd' or 'none'."""
    if kind == "openjd":
        return OpenJobDescription(log_format)
    if kind == "none":
        return Quiet(log_format)
    return Rich(log_format) if sys.stderr.isatty() else Plain(log_format)
