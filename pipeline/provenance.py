"""How a result was made: versions, configuration, seed, device; and the fingerprint that resume checks."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec

from plait.pipeline.config import Config

LIBRARIES = ("plait", "warp-lang", "usd-core", "numpy", "trimesh", "meshio", "pyvista")


@cache
def versions() -> dict[str, str]:
    """Version of the tool and of each library it stands on."""
    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def config_hash(config: Config) -> str:
    """Sixteen hex digits over every setting, in a fixed order."""
    return hashlib.sha256(msgspec.json.encode(config, order="deterministic")).hexdigest()[:16]


def describe(config: Config, device: str, threads: int) -> dict[str, str | int]:
    """What is written into the layer and the metrics. The solver draws no random numbers: its seed is 0."""
    return {
        **{f"version:{name}": text for name, text in versions().items()},
        "configuration": config_hash(config),
        "seed": 0,
        "device": device,
        "threads": threads,
    }


def fingerprint(config: Config, frames: str, layers: tuple[Path, ...], device: str, threads: int) -> str:
    """Of all that decides a run's bits: inputs by content, settings, versions, device, threads."""
    digest = hashlib.sha256()
    digest.update(repr((describe(config, device, threads), frames)).encode())
    for path in layers:
        digest.update(str(path).encode())
        with open(path, "rb") as handle:
            digest.update(hashlib.file_digest(handle, "sha256").digest())
    return digest.hexdigest()
