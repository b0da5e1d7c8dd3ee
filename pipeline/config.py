"""The command's configuration: defaults, then a TOML file, then `--set key=value`. Unknown keys are errors."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Annotated, Any

import msgspec

from plait.pipeline.errors import InputError, UsageError
from plait.solver.settings import Settings

# The value of a parameter; three numbers of a vector.
ParameterValue = float | str | bool | tuple[float, float, float]


class OutputSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[output]: what is written.

    chunk: frames a value-clip file holds.  shutter: offsets in frames of extra samples about each frame, for
    motion blur, e.g. [-0.25, 0.25]; empty for none.
    """

    chunk: Annotated[int, msgspec.Meta(ge=1)] = 20
    shutter: tuple[Annotated[float, msgspec.Meta(gt=-1.0, lt=1.0)], ...] = ()


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All of a run's configuration.

    preroll: frames simulated before the first that is written.
    parameters: values that win over everything authored, by the name they have on a prim without its prefix
        (`damping`, `youngsModulus`, `density`, ...), for all prims of a role that knows them.
    prim: the same for prims whose path matches a glob: {"/World/hair*": {"damping": 2.0}}.
    """

    preroll: Annotated[int, msgspec.Meta(ge=0)] = 24
    solver: Settings = Settings()
    output: OutputSettings = OutputSettings()
    parameters: dict[str, ParameterValue] = {}
    prim: dict[str, dict[str, ParameterValue]] = {}


def load(path: Path | None, assignments: list[str], flags: dict[str, Any] | None = None) -> Config:
    """Defaults, then the file, then `key=value` assignments (dotted keys, TOML values), then flags.

    Raises InputError for a file that cannot be read, UsageError for an assignment that cannot be right.
    """
    tree: dict[str, Any] = {}
    if path is not None:
        try:
            tree = tomllib.loads(path.read_text())
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise InputError(str(error), file=path) from error
        _convert(tree, str(path), InputError)
    for assignment in assignments:
        _merge(tree, _parse(assignment), assignment)
    for key, value in (flags or {}).items():
        group, _, leaf = key.rpartition(".")
        _merge(tree, {group: {leaf: value}} if group else {leaf: value}, key)
    return _convert(tree, "command line", UsageError)


def _parse(assignment: str) -> dict[str, Any]:
    """`key=value` as a tree: a TOML key, dotted and quoted as there, and a TOML value or a bare word."""
    key, separator, text = assignment.partition("=")
    if separator and key.strip():
        for value in (text, json.dumps(text)):
            try:
                return tomllib.loads(f"{key} = {value}")
            except tomllib.TOMLDecodeError:
                continue
    raise UsageError(f"--set {assignment}: write key=value, e.g. solver.substeps=8")


def _merge(tree: dict[str, Any], more: dict[str, Any], source: str) -> None:
    for key, value in more.items():
        if isinstance(value, dict) and isinstance(tree.get(key, {}), dict):
            _merge(tree.setdefault(key, {}), value, source)
        elif isinstance(value, dict):
            raise UsageError(f"--set {source}: {key} is a value, not a table")
        else:
            tree[key] = value


def _convert(tree: dict[str, Any], source: str, error_type: type) -> Config:
    try:
        return msgspec.convert(tree, Config)
    except msgspec.ValidationError as error:
        message = f"{source}: {error}"
        if error_type is InputError:
            raise InputError(str(error), file=source) from error
        raise UsageError(message) from error
