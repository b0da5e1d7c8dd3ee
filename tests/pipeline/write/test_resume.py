"""Killed at any moment, what was finished opens; going on ends in the bytes of a run that was never stopped."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd

from plait.pipeline.cli import main
from plait.pipeline.errors import UsageError
from plait.pipeline.write import CacheWriter, cache_folder

MADE = {"version:plait": "0.1.0", "seed": 0, "device": "cpu"}
SAMPLES = [(frame - 0.25, frame) for frame in map(float, range(1, 12))]
CODES = [code for frame in SAMPLES for code in frame]
PRIMS = ("/World/hair", "/World/beard")


@pytest.fixture
def shot(fabricated, tmp_path):
    (tmp_path / "shots").mkdir()
    return fabricated.shot_of(fabricated.curve_source(tmp_path / "shots" / "shot.usda", prims=PRIMS), PRIMS)


def writer_of(out: Path, shot, *, samples=SAMPLES, chunk=4, made=MADE, resume=False) -> CacheWriter:
    return CacheWriter(out, shot, samples=samples, chunk=chunk, provenance=made, resume=resume).open()


def run(fabricated, writer: CacheWriter, shot, codes) -> None:
    for code in codes:
        writer.add(code, fabricated.results(shot, code))


def everything(out: Path, fabricated) -> dict[str, bytes]:
    return {"top": out.read_bytes(), **fabricated.contents(cache_folder(out))}


@pytest.fixture
def whole(fabricated, tmp_path, shot) -> dict[str, bytes]:
    """All bytes of a run that was never stopped."""
    (tmp_path / "whole").mkdir()
    with writer_of(tmp_path / "whole" / "out.usda", shot) as writer:
        run(fabricated, writer, shot, CODES)
    return everything(tmp_path / "whole" / "out.usda", fabricated)


@pytest.fixture
def out(tmp_path) -> Path:
    (tmp_path / "stopped").mkdir()
    return tmp_path / "stopped" / "out.usda"


@pytest.mark.parametrize("stop_after", range(len(CODES) + 1))
def test_flushed_anywhere_and_resumed_is_the_same(fabricated, shot, whole, out, stop_after):
    """Stopping early writes what there is; completing it leaves the same bytes in every file."""
    with writer_of(out, shot) as writer:
        run(fabricated, writer, shot, CODES[:stop_after])
    with writer_of(out, shot, resume=True) as writer:
        assert writer.frames_done == stop_after // 2
        run(fabricated, writer, shot, CODES[2 * writer.frames_done :])
        assert writer.frames_done == len(SAMPLES)
    assert everything(out, fabricated) == whole


@pytest.mark.parametrize("restart", [0, 3, 8, 9])
def test_samples_on_disk_are_passed_over(fabricated, shot, whole, out, restart):
    """A checkpoint may be older than the last chunk: the run then gives again what is written."""
    with writer_of(out, shot) as writer:
        run(fabricated, writer, shot, CODES[:10])
    with writer_of(out, shot, resume=True) as writer:
        run(fabricated, writer, shot, CODES[restart:])
    assert everything(out, fabricated) == whole


def test_dropped_without_closing(fabricated, shot, whole, out):
    """As SIGKILL leaves it: samples not in a chunk are gone, chunks are whole."""
    writer = writer_of(out, shot)
    run(fabricated, writer, shot, CODES[:19])
    del writer
    stage = Usd.Stage.Open(str(out))
    assert stage.GetPrimAtPath(PRIMS[0]).GetAttribute("points").GetTimeSamples() == CODES[:16]
    with writer_of(out, shot, resume=True) as writer:
        assert writer.frames_done == 8
        run(fabricated, writer, shot, CODES[16:])
    assert everything(out, fabricated) == whole


@pytest.mark.parametrize("damage", ["truncated", "missing", "empty", "another", "unlisted", "beyond"])
def test_damaged_files_are_written_again(fabricated, shot, whole, out, damage):
    """A chunk that is not whole, or a chunk whose listing was not reached, does not pass for finished."""
    with writer_of(out, shot) as writer:
        run(fabricated, writer, shot, CODES[:16])
    second = cache_folder(out) / "chunk.0002.usdc"
    expected = 4
    if damage == "truncated":
        second.write_bytes(second.read_bytes()[:-200])
    elif damage == "missing":
        second.unlink()
    elif damage == "empty":
        second.write_bytes(b"")
    elif damage == "another":
        shutil.copy(second.with_name("chunk.0001.usdc"), second)
    elif damage == "unlisted":
        listing = cache_folder(out) / "overrides.usda"
        listing.write_text("#usda 1.0\n(\n    timeCodesPerSecond = 24\n)\n")
        expected = 8
    else:
        shutil.copy(second, second.with_name("chunk.0009.usdc"))
        expected = 8
    (cache_folder(out) / ".chunk.0003.writing.usdc").write_bytes(b"half a file")
    with writer_of(out, shot, resume=True) as writer:
        assert writer.frames_done == expected
        run(fabricated, writer, shot, CODES[2 * expected :])
    assert everything(out, fabricated) == whole


def test_resuming_what_is_finished_changes_nothing(fabricated, shot, whole, out):
    for _ in range(2):
        with writer_of(out, shot, resume=True) as writer:
            run(fabricated, writer, shot, CODES)
    assert everything(out, fabricated) == whole


def test_resuming_nothing_starts_afresh(fabricated, shot, whole, out):
    """A farm's first attempt gives --resume too; so does one that was killed before the top layer was there."""
    cache_folder(out).mkdir()
    (cache_folder(out) / "overrides.usda").write_text("#usda 1.0\n")
    with writer_of(out, shot, resume=True) as writer:
        assert writer.frames_done == 0
        run(fabricated, writer, shot, CODES)
    assert everything(out, fabricated) == whole


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"samples": SAMPLES[:-1]}, "plan"),
        ({"chunk": 5}, "plan"),
        ({"made": {**MADE, "device": "cuda:0"}}, "device"),
        ({"made": {**MADE, "version:plait": "0.2.0"}}, "version"),
        ({"made": {**MADE, "more": 1}}, "more"),
    ],
)
def test_another_run_is_not_resumed(fabricated, shot, out, change, named):
    """It could not end in the same bits; the message names what differs, and nothing is touched."""
    with writer_of(out, shot) as writer:
        run(fabricated, writer, shot, CODES)
    before = everything(out, fabricated)
    with pytest.raises(UsageError, match=named):
        writer_of(out, shot, resume=True, **change)
    assert everything(out, fabricated) == before


@pytest.mark.parametrize("lost", ["chunk.0001.usdc", "chunk.0002.usdc"])
def test_the_command_makes_lost_chunks_anew(fabricated, tmp_path, lost):
    """A checkpoint that is ahead of the chunks is no place to go on from: all bits come back."""
    path, out = fabricated.curve_source(tmp_path / "shot.usda"), tmp_path / "out.usda"
    command = [
        "sim",
        str(path),
        "-o",
        str(out),
        "-f",
        "1:5",
        "--chunk",
        "2",
        "--preroll",
        "1",
        "--progress",
        "none",
    ]
    assert main(command) == 0
    expected = {path.name: path.read_bytes() for path in cache_folder(out).glob("chunk.*")}
    assert len(expected) == 3
    (cache_folder(out) / lost).unlink()
    assert main([*command, "--resume"]) == 0
    assert {path.name: path.read_bytes() for path in cache_folder(out).glob("chunk.*")} == expected


ENDLESS = """
import runpy, sys
from pathlib import Path
made = runpy.run_path(sys.argv[1])
shot = made["shot_of"](Path(sys.argv[2]))
samples = made["frames"](1, 240)
with made["CacheWriter"](Path(sys.argv[3]), shot, samples=samples, chunk=2, provenance={}, resume=True) as writer:
    print("begun", flush=True)
    for (code,) in samples[writer.frames_done:]:
        writer.add(code, made["results"](shot, code))
        print(writer.frames_done, flush=True)
"""


def test_killed_at_random_moments(fabricated, tmp_path):
    """SIGKILL during writing, five times over one run, each at a random number of lines or amid the set-up.

    After each kill all frames that the process had said are done open with the right values, and all that open are
    whole; the last attempt, left alone, ends in the bytes of a run that was never killed.
    """
    chance = random.Random(20240229)
    path = fabricated.curve_source(tmp_path / "shot.usda", strands=300, per_strand=20)
    shot, out = fabricated.shot_of(path), tmp_path / "out.usda"
    command = [sys.executable, "-c", ENDLESS, str(Path(__file__).with_name("conftest.py")), str(path), str(out)]
    for _ in range(5):
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            lines = [process.stdout.readline().strip() for _ in range(chance.randrange(1, 40))]
            process.kill()
        said = max((int(line) for line in lines if line.isdigit()), default=0)
        shown = check_finished(fabricated, out, shot)
        assert shown >= said
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert check_finished(fabricated, out, shot) == 240
    (tmp_path / "whole").mkdir()
    fresh = [*command[:-1], str(tmp_path / "whole" / "out.usda")]
    subprocess.run(fresh, check=True, stdout=subprocess.DEVNULL)
    assert fabricated.contents(cache_folder(out)) == fabricated.contents(tmp_path / "whole" / "out.cache")


def check_finished(fabricated, out: Path, shot) -> int:
    """How many frames the result shows, all of them right."""
    stage = Usd.Stage.Open(str(out))
    attribute = stage.GetPrimAtPath("/World/hair").GetAttribute("points")
    codes = attribute.GetTimeSamples()
    assert codes == [float(code) for code in range(1, len(codes) + 1)]
    for code in codes:
        assert np.array_equal(np.array(attribute.Get(code)), fabricated.results(shot, code)[0].points)
    for layer in stage.GetUsedLayers(includeClipLayers=True):
        assert not layer.dirty
    del stage, attribute
    assert not [
        layer for layer in Sdf.Layer.GetLoadedLayers() if layer.realPath.startswith(str(out.parent / "out"))
    ]
    return len(codes)
