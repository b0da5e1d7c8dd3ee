"""What cannot be right is refused in one line that names file, prim and attribute, and says nothing else."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from plait.pipeline.config import Config
from plait.pipeline.errors import InputError, UsageError
from plait.pipeline.read import read_shot

_SPEC = importlib.util.spec_from_file_location("malformed", Path(__file__).with_name("malformed.py"))
malformed = importlib.util.module_from_spec(_SPEC)
sys.modules["malformed"] = malformed
_SPEC.loader.exec_module(malformed)


def test_the_shot_that_is_spoilt_is_valid(tmp_path: Path) -> None:
    path = malformed.Malformed("valid", ()).write(tmp_path)
    shot = read_shot(path, Config())
    assert shot.warnings == ()
    assert [strands.name for strands in shot.scene.strands] == ["/Hair"]
    assert {surface.name for surface in shot.scene.surfaces} == {"/Body/Skin", "/Ball"}


def test_there_are_forty() -> None:
    assert len({case.name for case in malformed.CASES}) == len(malformed.CASES) >= 40


@pytest.mark.parametrize("case", malformed.CASES, ids=lambda case: case.name)
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
