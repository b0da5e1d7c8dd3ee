"""What is kept between runs: found again, rebuilt when damaged, never half written."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from plait.pipeline import flesh
from plait.pipeline.tetrahedra import cache


@pytest.fixture
def made(monkeypatch, tmp_path):
    """Counts how often arrays are made anew, with a cache of its own."""
    monkeypatch.setenv("PLAIT_CACHE", str(tmp_path / "cache"))
    calls = []

    def make() -> dict[str, np.ndarray]:
        calls.append(1)
        return {"values": np.arange(1000.0), "other": np.zeros((0, 3))}

    return tmp_path / "cache", calls, make


def test_made_once(made):
    folder, calls, make = made
    inputs = {"points": np.ones(3), "edge": 0.1}
    first = cache.kept("thing", 1, inputs, make)
    again = cache.kept("thing", 1, inputs, make)
    assert len(calls) == 1 and len(list(folder.iterdir())) == 1
    assert all(np.array_equal(first[name], again[name]) for name in first) and again["other"].shape == (0, 3)


@pytest.mark.parametrize(
    "other",
    [
        {"points": np.ones(4), "edge": 0.1},
        {"points": np.ones(3, dtype=np.float32), "edge": 0.1},
        {"points": np.ones((1, 3)), "edge": 0.1},
        {"points": np.ones(3), "edge": 0.2},
        {"points": np.ones(3), "edge": None},
    ],
)
def test_other_inputs_are_another_thing(other, made):
    _, calls, make = made
    cache.kept("thing", 1, {"points": np.ones(3), "edge": 0.1}, make)
    cache.kept("thing", 1, other, make)
    assert len(calls) == 2


def test_other_versions_are_another_thing(made):
    _, calls, make = made
    for version in (1, 2):
        cache.kept("thing", version, {}, make)
    assert len(calls) == 2


@pytest.mark.parametrize("place", [0, 200, 4000, -200])
def test_a_damaged_file_is_made_again(place, made):
    folder, calls, make = made
    cache.kept("thing", 1, {}, make)
    (path,) = folder.iterdir()
    data = bytearray(path.read_bytes())
    data[place] ^= 0xFF
    path.write_bytes(data)
    again = cache.kept("thing", 1, {}, make)
    assert np.array_equal(again["values"], np.arange(1000.0))
    path.write_bytes(path.read_bytes()[:500])
    cache.kept("thing", 1, {}, make)
    assert len(calls) >= 2
    seen = len(calls)
    cache.kept("thing", 1, {}, make)
    assert len(calls) == seen


def test_off_and_not_writable(made, monkeypatch, tmp_path):
    _, calls, make = made
    monkeypatch.setenv("PLAIT_CACHE", "off")
    for _ in range(2):
        cache.kept("thing", 1, {}, make)
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("PLAIT_CACHE", str(tmp_path / "file"))
    cache.kept("thing", 1, {}, make)
    assert len(calls) == 3


def test_where_it_is_kept(monkeypatch, tmp_path):
    monkeypatch.delenv("PLAIT_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.folder() == tmp_path / "plait"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache.folder() == tmp_path / "home" / ".cache" / "plait"


def test_several_writers_at_once(made):
    folder, _, make = made
    with ThreadPoolExecutor(8) as threads:
        results = list(threads.map(lambda _: cache.kept("thing", 1, {}, make), range(32)))
    assert all(np.array_equal(result["values"], np.arange(1000.0)) for result in results)
    assert [path.name.startswith("thing-") for path in folder.iterdir()] == [True]


def test_a_lattice_comes_back_as_it_was(made, shapes):
    folder, _, _ = made
    shape = shapes["ball"]
    first = flesh.fill(shape.points, shape.triangles, edge=0.4)
    again = flesh.fill(shape.points, shape.triangles, edge=0.4)
    assert len(list(folder.iterdir())) == 1
    for name, value in vars(first).items():
        assert np.array_equal(value, getattr(again, name)) and value.dtype == getattr(again, name).dtype
