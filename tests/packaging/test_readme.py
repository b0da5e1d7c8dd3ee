"""The README names every verb, flag, setting and parameter there is, with its default, and its pictures exist."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import msgspec
import pytest

from plait.pipeline import cli
from plait.pipeline.config import Config
from plait.pipeline.read import parameter_table

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()


def verbs() -> dict[str, argparse.ArgumentParser]:
    actions = cli._parser()._actions
    return next(action.choices for action in actions if isinstance(action, argparse._SubParsersAction))


def settings(kind: type, prefix: str = "") -> list[tuple[str, object]]:
    """Dotted key and default of every setting."""
    found = []
    for field in msgspec.structs.fields(kind):
        default = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
        if isinstance(default, msgspec.Struct):
            found += settings(type(default), f"{prefix}{field.name}.")
        else:
            found.append((prefix + field.name, default))
    return found


@pytest.mark.parametrize("verb", verbs())
def test_every_verb_and_flag_is_documented(verb):
    assert f"plait {verb}" in README
    for action in verbs()[verb]._actions:
        for flag in action.option_strings:
            if flag.startswith("--") and flag != "--help":
                assert f"`{flag}" in README, f"{verb} {flag}"


@pytest.mark.parametrize(("key", "default"), settings(Config), ids=lambda value: str(value))
def test_every_setting_has_a_row_with_its_default(key, default):
    row = re.search(rf"^\| `{re.escape(key)}` \|.*$", README, re.MULTILINE)
    assert row, key
    if isinstance(default, int | float | str):
        assert str(default) in row[0] or f"{default:g}" in row[0], f"{key}: default {default}"


def test_the_parameter_table_is_the_one_reading_uses():
    assert parameter_table.as_markdown().strip() in README


def test_pictures_and_files_named_exist():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target
