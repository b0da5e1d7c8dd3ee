"""`plait farm openjd`: a template that Open Job Description's own checker takes."""

from __future__ import annotations

import json
import shutil
import subprocess

import pytest

from plait.pipeline.cli import main
from plait.pipeline.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_USAGE


@pytest.fixture
def shots(tmp_path):
    paths = [tmp_path / name for name in ("a.usda", "b.usda")]
    for path in paths:
        path.write_text("#usda 1.0\n")
    return paths


def test_a_task_a_shot_that_resumes(tmp_path, shots):
    """Simulation is sequential in frames, so a task is a shot; a retried task goes on from its checkpoint."""
    job = tmp_path / "jobs" / "job.yaml"
    assert main(["farm", "openjd", *map(str, shots), "-o", str(job), "--results", str(tmp_path)]) == EXIT_DONE
    (step,) = json.loads(job.read_text())["steps"]
    parameters = {p["name"]: p["range"] for p in step["parameterSpace"]["taskParameterDefinitions"]}
    assert parameters == {"Shot": [str(path) for path in shots], "Result": ["a.usda", "b.usda"]}
    assert "--resume" in step["script"]["actions"]["onRun"]["args"]


@pytest.mark.skipif(shutil.which("openjd") is None, reason="openjd-cli is an optional dependency")
@pytest.mark.parametrize("verb", ["check", "summary"])
def test_the_engine_takes_the_template(tmp_path, shots, verb):
    job = tmp_path / "job.yaml"
    main(["farm", "openjd", *map(str, shots), "-o", str(job)])
    assert subprocess.run(["openjd", verb, str(job)], capture_output=True, check=False).returncode == 0


def test_missing_shots_and_shared_names_are_refused(tmp_path, shots, capsys):
    job = tmp_path / "job.yaml"
    assert main(["farm", "openjd", str(tmp_path / "none.usda"), "-o", str(job)]) == EXIT_BAD_INPUT
    assert main(["farm", "openjd", str(shots[0]), str(shots[0]), "-o", str(job)]) == EXIT_USAGE
    assert not job.exists()
    assert len(capsys.readouterr().err.splitlines()) == 2
