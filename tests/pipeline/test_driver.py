"""The frame loop, through the command line: what is written, refused, stopped and taken up again."""

from __future__ import annotations

import itertools
import json
import random
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from plait import assets
from plait.pipeline.cli import main
from plait.pipeline.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_FAILED, EXIT_STOPPED, EXIT_USAGE
from plait.solver.diagnostics import Diverged
from plait.solver.step import Simulation

SMALL = Path(assets.__file__).parent / "small" / "shot.usda"
ARGUMENTS = ["--progress", "openjd", "--chunk", "4", "--preroll", "2", "--substeps", "2", "-f", "1:12"]


def sim(output: Path, *more: str) -> int:
    return main(["sim", str(SMALL), "-o", str(output), *ARGUMENTS, *more])


def results(path: Path) -> dict[tuple[str, float], bytes]:
    """Bits of every simulated value: points and velocities of every curve, on every frame."""
    stage = Usd.Stage.Open(str(path))
    found = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.BasisCurves):
            for name in ("points", "velocities", "extent"):
                attribute = prim.GetAttribute(name)
                for code in attribute.GetTimeSamples():
                    found[f"{prim.GetPath()}.{name}", code] = np.asarray(attribute.Get(code)).tobytes()
    return found


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A run that was never stopped."""
    output = tmp_path_factory.mktemp("finished") / "small.usda"
    assert sim(output) == EXIT_DONE
    return output


def test_a_shot_in_a_cache_out(finished):
    """Every frame asked for holds finite points that move; metrics hold an entry a simulated frame."""
    stage = Usd.Stage.Open(str(finished))
    curves = next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.BasisCurves))
    points = [np.asarray(curves.GetAttribute("points").Get(code)) for code in range(1, 13)]
    assert np.isfinite(points).all()
    assert all((a != b).any() for a, b in itertools.pairwise(points))
    metrics = json.loads(finished.with_suffix(".metrics.json").read_text())
    assert len(metrics["frames"]) == 2 + 11  # the pre-roll ends on the first frame
    for frame in metrics["frames"]:
        assert frame["substeps"] == 2
        assert {"kinematics", "strands"} <= frame["seconds"].keys() & frame["launches"].keys()
    assert {"version:plait", "configuration", "seed", "device", "peak_memory_bytes"} <= metrics["run"].keys()


def test_an_earlier_result_is_not_replaced_unasked(finished, capsys):
    before = finished.stat().st_mtime_ns
    assert sim(finished) == EXIT_USAGE
    assert "--overwrite" in capsys.readouterr().err
    assert finished.stat().st_mtime_ns == before


def test_overwrite_gives_the_same_bits(finished, tmp_path):
    """Same input, device and thread count: same bits."""
    output = tmp_path / "small.usda"
    assert sim(output) == EXIT_DONE
    assert sim(output, "--overwrite") == EXIT_DONE
    assert results(output) == results(finished)


def test_the_source_is_never_written_to(capsys):
    before = SMALL.read_bytes()
    assert main(["sim", str(SMALL), "-o", str(SMALL), "--overwrite", *ARGUMENTS]) == EXIT_BAD_INPUT
    assert SMALL.read_bytes() == before


def start(output: Path, *more: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "plait.pipeline.cli", "sim", str(SMALL), "-o", str(output), *ARGUMENTS, *more]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def send_after(process: subprocess.Popen, lines: int, number: int) -> None:
    """Sends the signal once the process has told so many lines of progress."""
    for _ in range(lines):
        if not process.stdout.readline():
            break
    process.send_signal(number)


def kill_and_resume(output: Path, finished: Path, seed: int) -> None:
    """SIGKILL at a random line of progress; what is on disk opens and is right; resume ends in the same bits."""
    process = start(output)
    send_after(process, random.Random(seed).randint(1, 32), signal.SIGKILL)
    process.communicate()
    expected = results(finished)
    if output.exists():
        assert results(output).items() <= expected.items()
    assert sim(output, "--resume") == EXIT_DONE
    assert results(output) == expected


@pytest.mark.parametrize("seed", range(2))
def test_killed_and_resumed_ends_in_the_same_bits(finished, tmp_path, seed):
    kill_and_resume(tmp_path / "small.usda", finished, seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 12))
def test_killed_and_resumed_ten_more_times(finished, tmp_path, seed):
    kill_and_resume(tmp_path / "small.usda", finished, seed)


def test_sigterm_keeps_the_frames_so_far_and_exits_143(finished, tmp_path):
    output = tmp_path / "small.usda"
    process = start(output)
    send_after(process, 16, signal.SIGTERM)
    process.communicate()
    assert process.returncode == EXIT_STOPPED
    expected = results(finished)
    assert 0 < len(results(output)) < len(expected)
    assert results(output).items() <= expected.items()
    assert sim(output, "--resume") == EXIT_DONE
    assert results(output) == expected


def test_resume_of_another_run_is_refused(finished, tmp_path, capsys):
    """Another configuration cannot end in the same bits, so it is refused."""
    output = tmp_path / "small.usda"
    assert sim(output) == EXIT_DONE
    assert sim(output, "--resume", "--set", "solver.strands.tolerance=0.01") == EXIT_USAGE
    assert results(output) == results(finished)


def test_a_shot_that_changed_meanwhile_is_not_resumed(tmp_path, capsys):
    """A result half of one shot and half of another would be neither."""
    shot = tmp_path / "shot.usda"
    shot.write_text(SMALL.read_text())
    command = ["sim", str(shot), "-o", str(tmp_path / "small.usda"), *ARGUMENTS]
    assert main(command) == EXIT_DONE
    shot.write_text(SMALL.read_text() + "\n# touched\n")
    assert main([*command, "--resume"]) == EXIT_USAGE
    assert "--overwrite" in capsys.readouterr().err


def test_what_diverges_stops_the_run_and_keeps_the_frames_before(finished, tmp_path, capsys, monkeypatch):
    """NaN never reaches a file: exit 3, one line with what, where and when, frames before it kept."""
    advance = Simulation.advance_frame

    def diverge(self, end, substeps=None):
        figures = advance(self, end, substeps)
        if end * 24.0 > 6.5:
            raise Diverged("position", "/World/hair strand 3", end)
        return figures

    monkeypatch.setattr(Simulation, "advance_frame", diverge)
    output = tmp_path / "small.usda"
    assert sim(output) == EXIT_FAILED
    (line,) = capsys.readouterr().err.splitlines()
    assert "/World/hair strand 3" in line and "frame 7" in line
    held, expected = results(output), results(finished)
    assert held.items() <= expected.items()
    assert {code for _, code in held} == {1, 2, 3, 4, 5, 6}


@pytest.mark.parametrize(
    "arguments",
    [
        ["-f", "5:1"],
        ["-f", "x"],
        ["--preroll", "-1"],
        ["--substeps", "0"],
        ["--chunk", "0"],
        ["--threads", "-2"],
        ["--device", "tpu"],
        ["--device", "cuda:7"],
        ["--set", "nonsense=1"],
        ["--set", "parameters.damping=-1"],
        ["--set", "parameters.dampings=1"],
        ["-c", "none.toml"],
    ],
)
def test_bad_usage_is_one_line_and_writes_nothing(tmp_path, capsys, arguments):
    output = tmp_path / "out" / "small.usda"
    code = main(["sim", str(SMALL), "-o", str(output), "--progress", "none", *arguments])
    assert code in (EXIT_USAGE, EXIT_BAD_INPUT)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("plait: ")
    assert not output.parent.exists()
