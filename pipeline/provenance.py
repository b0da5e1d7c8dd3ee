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
    """Sixteen hex digits over every setting that can change a result, in a fixed order.

    The number of threads is none: strands are solved one by one, whoever does it.
    """
    solver = msgspec.structs.replace(config.solver, threads=0)
    encoded = msgspec.json.encode(msgspec.structs.replace(config, solver=solver), order="deterministic")
    return hashlib.sha256(encoded).hexdigest()[:16]


def describe(config: Config) -> dict[str, str | int]:
    """What is written into the layer and the metrics. What is random, where grains lie, has seeds on its prims."""
    return {
        **{f"version:{name}": text for name, text in versions().items()},
        "configuration": config_hash(config),
        "seed": 0,
        "device": config.solver.device,
    }


def fingerprint(config: Config, frames: str, layers: tuple[Path, ...]) -> str:
    """Of all that decides a run's bits: inputs by content, settings, frames, versions, device."""
    digest = hashlib.sha256(repr((describe(config), frames)).encode())
    for path in layers:
        digest.update(path.name.encode())
        with open(path, "rb") as handle:
            digest.update(hashlib.file_digest(handle, "sha256").digest())
    return digest.hexdigest()
