"""Arrays that take long to make, kept by what they were made from.

In `$PLAIT_CACHE` (`off`: nothing is kept), else `$XDG_CACHE_HOME/plait`, else `~/.cache/plait`. A file is written
aside and renamed, so that several runs at once never see half a one; one that does not match its own digest is
made again."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

Arrays = dict[str, np.ndarray]


def folder() -> Path | None:
    """Where arrays are kept; None where they are not to be."""
    chosen = os.environ.get("PLAIT_CACHE", "")
    if chosen.lower() == "off":
        return None
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "plait"


def kept(kind: str, version: int, inputs: Mapping[str, object], make: Callable[[], Arrays]) -> Arrays:
    """What `make` gives, from the cache if it was made before of equal inputs by the same version of `kind`.

    inputs: arrays, numbers and strings that decide the result.
    """
    where = folder()
    if where is None:
        return make()
    path = where / f"{kind}-{_digest({'version': version, **inputs})[:40]}.npz"
    found = _read(path)
    if found is None:
        found = make()
        _write(path, found)
    return found


def _digest(values: Mapping[str, object]) -> str:
    digest = hashlib.sha256()
    for name in sorted(values):
        value = values[name]
        digest.update(f"{name}:{type(value).__name__}:".encode())
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype.str}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        else:
            digest.update(repr(value).encode())
    return digest.hexdigest()


def _read(path: Path) -> Arrays | None:
    """The arrays of a file that is whole; None for one that is missing or damaged."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except Exception:  # whatever a damaged archive raises: it is made again
        return None
    digest = arrays.pop("digest", None)
    return arrays if digest is not None and str(digest) == _digest(arrays) else None


def _write(path: Path, arrays: Arrays) -> None:
    """A cache that cannot be written is none: the arrays are there all the same."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, aside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=".npz")
    except OSError:
        return
    try:
        with os.fdopen(handle, "wb") as stream:
            np.savez(stream, digest=np.array(_digest(arrays)), **arrays)
        os.replace(aside, path)
    except OSError:
        Path(aside).unlink(missing_ok=True)
