"""Jobs for render farms. A simulation is sequential in frames, so a task is a whole shot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from plait.pipeline.errors import InputError, UsageError
from plait.pipeline.files import replacing


def write_job(shots: list[Path], output: Path, results: Path) -> None:
    """Writes an Open Job Description template (2023-09) with a task a shot.

    The tasks resume what an earlier attempt of theirs left. The file is JSON, which every YAML reader reads.
    Raises InputError for a shot that is not there, UsageError for two shots whose results would have one name.
    """
    for shot in shots:
        if not shot.is_file():
            raise InputError("no such shot", file=shot, mend="give paths as the farm's machines see them")
    names = [shot.stem for shot in shots]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UsageError(f"farm: several shots are called {', '.join(twice)}; their results would share a file")
    output.parent.mkdir(parents=True, exist_ok=True)
    with replacing(output) as aside:
        aside.write_text(json.dumps(_template(shots, results), indent=2) + "\n")


def _template(shots: list[Path], results: Path) -> dict[str, Any]:
    arguments = ["sim", "{{Task.Param.Shot}}", "-o", "{{Param.Results}}/{{Task.Param.Result}}"]
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "name": "plait",
        "parameterDefinitions": [
            # A string, for the default of a PATH would be joined to the template's folder.
            {"name": "Results", "type": "STRING", "default": str(results.absolute())}
        ],
        "steps": [
            {
                "name": "Simulate",
                "parameterSpace": {
                    "taskParameterDefinitions": [
                        {"name": "Shot", "type": "PATH", "range": [str(shot.absolute()) for shot in shots]},
                        {"name": "Result", "type": "STRING", "range": [f"{shot.stem}.usda" for shot in shots]},
                    ],
                    "combination": "(Shot, Result)",
                },
                "script": {
                    "actions": {
                        "onRun": {
                            "command": "plait",
                            "args": [*arguments, "--resume", "--progress", "openjd"],
                            "cancelation": {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": 120},
                        }
                    }
                },
            }
        ],
    }
