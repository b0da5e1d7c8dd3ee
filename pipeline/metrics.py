"""OUT.metrics.json: what each frame cost and how well it went."""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from typing import Any

from plait.pipeline.files import replacing


class Metrics:
    """Collects a run's figures; `save` writes them whole.

    The file holds `run` (versions, configuration, seed, device, peak memory, totals) and `frames`, a list with one
    entry a simulated frame: time code, seconds and launches by stage, and what each stage reports.
    """

    def __init__(self, path: Path, run: dict[str, Any]) -> None:
        self.path, self.run = path, run
        self.frames: list[dict[str, Any]] = []

    def resume(self, legs_done: int) -> None:
        """Takes up the entries of the first `legs_done` legs from an earlier attempt's file, if it is there."""
        try:
            held = json.loads(self.path.read_text())
        except (OSError, ValueError):
            return
        self.frames = [entry for entry in held.get("frames", []) if entry.get("leg", legs_done) < legs_done]

    def add(self, leg: int, code: float, seconds: float, figures: dict[str, Any]) -> None:
        self.frames.append({"leg": leg, "code": code, "wall_seconds": round(seconds, 6), **figures})

    def save(self) -> None:
        """Writes the file atomically; NaN and infinity become null, which JSON can hold."""
        content = {"run": self.run | {"peak_memory_bytes": _peak_memory()}, "frames": self.frames}
        with replacing(self.path) as aside:
            aside.write_text(json.dumps(_plain(content), indent=1) + "\n")


def _peak_memory() -> int:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(held) for key, held in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(held) for held in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value
