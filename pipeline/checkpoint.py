"""Checkpoints: a state, and the proof that it belongs to the run that wants to go on from it."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from plait.pipeline.errors import InputError, UsageError
from plait.pipeline.files import replacing
from plait.solver.state import State

_PREFIX = "state:"


def save(path: Path, state: State, fingerprint: str, legs_done: int) -> None:
    """Writes an uncompressed npz, atomically. `legs_done`: how much of the schedule the state has behind it."""
    held = {_PREFIX + name: array for name, array in state.to_numpy().items()}
    with replacing(path) as aside:
        with open(aside, "wb") as handle:
            np.savez(handle, fingerprint=np.array(fingerprint), legs_done=np.array(legs_done), **held)


def load(path: Path, state: State, fingerprint: str) -> int:
    """Restores `state` from `path`; returns how many legs of the schedule are done.

    Raises InputError for a file that is damaged, UsageError for one of another run: other settings, another
    version or device, or a shot that changed meanwhile could not end in the same bits.
    """
    try:
        with np.load(path, allow_pickle=False) as held:
            arrays = {name: held[name] for name in held.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(
            f"this checkpoint cannot be read ({error})", file=path, mend="run again with --overwrite"
        ) from error
    if str(arrays.get("fingerprint")) != fingerprint:
        raise UsageError(
            f"--resume: {path} is of a run with another shot, configuration, version or device; "
            "give the same ones, or start again with --overwrite"
        )
    state.restore(
        {name.removeprefix(_PREFIX): array for name, array in arrays.items() if name.startswith(_PREFIX)}
    )
    return int(arrays["legs_done"])
