"""What cannot be right is refused in one line that names file, prim and attribute, and says nothing else."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from plait.pipeline.config import Config
from plait.pipeline.errors import InputError, UsageError
from plait.pipeline.read import read_shot


def _load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


malformed, malformed_flesh, malformed_grains = map(_load, ("malformed", "malformed_flesh", "malformed_grains"))
CASES = (*malformed.CASES, *malformed_flesh.CASES, *malformed_grains.CASES)


def test_the_shot_that_is_spoilt_is_valid(tmp_path: Path) -> None:
    path = malformed.Malformed("valid", ()).write(tmp_path)
    shot = read_shot(path, Config())
    assert shot.warnings == ()
    assert [strands.name for strands in shot.scene.strands] == ["/Hair"]
    assert {surface.name for surface in shot.scene.surfaces} == {"/Body/Skin", "/Ball"}


def test_the_shot_of_flesh_that_is_spoilt_is_valid(tmp_path: Path) -> None:
    path = malformed.Malformed("valid", (), valid=malformed_flesh.VALID).write(tmp_path)
    shot = read_shot(path, Config())
    assert shot.warnings == ()
    assert [body.name for body in shot.scene.bodies] == ["/Body/Arm", "/Body/Belly"]


def test_the_shot_of_grains_that_is_spoilt_is_valid(tmp_path: Path) -> None:
    path = malformed.Malformed("valid", (), valid=malformed_grains.VALID).write(tmp_path)
    shot = read_shot(path, Config())
    assert shot.warnings == ()
    assert [granular.name for granular in shot.scene.granular] == ["/World/Pile", "/World/Tap", "/World/Drift"]


def test_each_has_its_name() -> None:
    assert len({case.name for case in CASES}) == len(CASES) >= 100


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_refused_in_one_line(case, tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    path = case.write(tmp_path)
    with pytest.raises(UsageError if case.usage else InputError) as refusal:
        read_shot(path, case.configuration(), case.frames)
    line = str(refusal.value)
    assert "\n" not in line
    if not case.usage:
        assert line.startswith(str(path))
        assert ";" in line, "says what would mend it"
    if case.prim:
        assert f"<{case.prim}>" in line
    assert case.attribute in line
    printed = capfd.readouterr()
    assert printed.out == "" and printed.err == "", "USD's own messages are kept back"


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_shot(tmp_path / "gone.usda", Config())
