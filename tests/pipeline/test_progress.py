"""What a run tells while it goes on."""

from __future__ import annotations

import io
import json

from plait.pipeline.progress import OpenJobDescription, Plain, Quiet


def test_lines_tell_phase_frame_and_time_left():
    stream = io.StringIO()
    shown = Plain(stream=stream)
    shown.phase("reading shot.usda")
    for done in (1, 2, 3):
        shown.frame(done, 3, f"frame {done}")
    lines = stream.getvalue().splitlines()
    assert lines[0] == "plait: reading shot.usda"
    assert lines[1] == "plait: frame 1 done=1/3"
    assert lines[-1].startswith("plait: frame 3 done=3/3 left=0s")


def test_json_log_lines_parse():
    stream = io.StringIO()
    Quiet("json", stream).log("wrote", path="a b", frames=3)
    line = json.loads(stream.getvalue())
    assert (line["event"], line["path"], line["frames"]) == ("wrote", "a b", 3)


def test_farms_read_percent_and_status(capsys):
    """Open Job Description runners take `openjd_progress` and `openjd_status` from stdout."""
    shown = OpenJobDescription()
    shown.phase("compiling")
    shown.frame(1, 4, "frame 7")
    assert capsys.readouterr().out.splitlines() == [
        "openjd_status: compiling",
        "openjd_progress: 25.0",
        "openjd_status: frame 7",
    ]
