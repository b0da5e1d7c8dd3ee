"""The command line: bad input and bad usage end with the right code, one line, and nothing written."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from plait.pipeline.cli import main
from plait.pipeline.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_USAGE


def _load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / "read" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault(name, module)
    spec.loader.exec_module(module)
    return module


malformed, malformed_flesh = _load("malformed"), _load("malformed_flesh")


def arguments(case, folder: Path) -> list[str]:
    """The command line that a malformed case stands for."""
    result = ["sim", str(case.write(folder)), "--progress", "none", "-o", str(folder / "out" / "result.usda")]
    if case.frames is not None:
        result += ["-f", f"{case.frames[0]}:{case.frames[1]}"]
    tables = [("parameters", case.config.get("parameters", {}))]
    tables += [(f'prim."{path}"', values) for path, values in case.config.get("prim", {}).items()]
    for table, values in tables:
        for key, value in values.items():
            result += ["--set", f"{table}.{key}={json.dumps(value)}"]
    return result


@pytest.mark.parametrize("case", (*malformed.CASES, *malformed_flesh.CASES), ids=lambda case: case.name)
def test_malformed_input_is_refused_by_name_and_nothing_written(case, tmp_path, capfd):
    """Exit 2 or 5; one line on stderr that names file, prim and attribute; no output folder."""
    code = main(arguments(case, tmp_path))
    assert code == (EXIT_USAGE if case.usage else EXIT_BAD_INPUT)
    printed = capfd.readouterr()
    (line,) = printed.err.splitlines()
    assert case.attribute in line and (case.prim or "") in line
    assert not (tmp_path / "out").exists()
    assert printed.out == ""


@pytest.mark.parametrize("valid", [malformed.VALID, malformed_flesh.VALID], ids=["hair", "flesh"])
def test_the_valid_shots_they_are_made_from_simulate(valid, tmp_path):
    case = malformed.Malformed("valid", (), valid=valid)
    assert main([*arguments(case, tmp_path), "--preroll", "1"]) == EXIT_DONE
    assert (tmp_path / "out" / "result.usda").is_file()


@pytest.mark.parametrize("verb", ["inspect", "pack", "preview", "compare"])
def test_every_verb_names_a_missing_file(verb, tmp_path, capfd):
    gone = str(tmp_path / "gone.usda")
    more = {
        "pack": ["-o", str(tmp_path / "o.usdc")],
        "preview": ["-o", str(tmp_path / "o.png")],
        "compare": [gone],
    }
    assert main([verb, gone, *more.get(verb, [])]) == EXIT_BAD_INPUT
    (line,) = capfd.readouterr().err.splitlines()
    assert "gone.usda" in line


@pytest.mark.parametrize(
    "wrong",
    [
        [],
        ["nonsense"],
        ["sim"],
        ["sim", "a.usd"],
        ["farm", "slurm", "a", "-o", "b"],
        ["sim", "a", "--substeps", "x"],
    ],
)
def test_wrong_command_lines_exit_2_with_one_line(wrong, capfd):
    with pytest.raises(SystemExit) as stop:
        main(wrong)
    assert stop.value.code == EXIT_USAGE
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("plait: ")
