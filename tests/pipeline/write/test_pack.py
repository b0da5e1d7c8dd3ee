"""A packed result says the same as the chunks it was made of, from one file."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from pxr import Sdf, Usd

from plait.pipeline.errors import InputError, UsageError
from plait.pipeline.layers import open_stage
from plait.pipeline.pack import pack
from plait.pipeline.validate import skinned_prims, validate
from plait.pipeline.write import cache_folder

REAL = "Autodesk_arnold-usd/testsuite/test_1814/data/test.usda"


@pytest.fixture
def out(fabricated, tmp_path):
    (tmp_path / "shots").mkdir()
    shot = fabricated.shot_of(fabricated.curve_source(tmp_path / "shots" / "shot.usda"))
    return fabricated.write(tmp_path / "result" / "out.usda", shot, fabricated.frames(1, 8))


def same(fabricated, first, second, prim="/World/hair", codes=(-3.0, 1.0, 2.5, 3.0, 3.75, 8.0, 40.0)):
    """Whether both stages give the same bits at and between samples, chunk edges included."""
    stages = open_stage(first), open_stage(second)
    for name in ("points", "velocities", "extent", "widths", "curveVertexCounts"):
        times = [stage.GetPrimAtPath(prim).GetAttribute(name).GetTimeSamples() for stage in stages]
        assert times[0] == times[1]
        for code in codes:
            assert np.array_equal(*(fabricated.values(stage, prim, name, code) for stage in stages)), (name, code)
    return True


@pytest.mark.parametrize("flatten", [False, True])
@pytest.mark.parametrize("suffix", [".usdc", ".usda"])
def test_packed_is_the_same_from_one_file(fabricated, tmp_path, out, flatten, suffix):
    packed = tmp_path / "elsewhere" / f"one{suffix}"
    packed.parent.mkdir()
    pack(out, packed, flatten=flatten)
    assert same(fabricated, out, packed)
    assert validate(packed, tmp_path / "shots" / "shot.usda") == []
    shown = Sdf.Layer.FindOrOpen(str(packed))
    assert shown.subLayerPaths == ([] if flatten else ["../shots/shot.usda"])
    for key in ("metersPerUnit", "upAxis", "startTimeCode", "endTimeCode", "defaultPrim", "timeCodesPerSecond"):
        assert shown.pseudoRoot.GetInfo(key) == Sdf.Layer.FindOrOpen(str(out)).pseudoRoot.GetInfo(key), key
    assert shown.customLayerData["plait"]["device"] == "cpu"


def test_needs_no_chunks(fabricated, tmp_path, out):
    packed, flat = tmp_path / "one.usdc", tmp_path / "flat.usdc"
    pack(out, packed)
    pack(out, flat, flatten=True)
    expected = fabricated.values(open_stage(out), "/World/hair", "points", 3.0)
    shutil.rmtree(cache_folder(out))
    assert np.array_equal(fabricated.values(open_stage(packed), "/World/hair", "points", 3.0), expected)
    shutil.rmtree(tmp_path / "shots")
    assert np.array_equal(fabricated.values(Usd.Stage.Open(str(flat)), "/World/hair", "points", 3.0), expected)


def test_a_skinned_shot_is_not_skinned_twice_once_packed(fabricated, shared, tmp_path):
    """The fur of a real shot: what switches skinning off is packed too, in both forms."""
    fur = "/world/geo/curves_fur"
    shot = fabricated.shot_of(shared / "samples" / REAL, [fur], skinned=[fur])
    out = fabricated.write(tmp_path / "out.usda", shot, fabricated.frames(1020, 1027), width=0.2)
    for name, flatten in (("one.usdc", False), ("flat.usdc", True)):
        pack(out, tmp_path / name, flatten=flatten)
        assert same(fabricated, out, tmp_path / name, fur, (1020.0, 1022.5, 1025.0, 1100.0))
        assert fur not in skinned_prims(open_stage(tmp_path / name))
        assert validate(tmp_path / name, shot.info.path) == []


def test_a_result_without_chunks_packs(fabricated, tmp_path):
    """Stopped before the first chunk, or with nothing to simulate: the source shows."""
    source = fabricated.curve_source(tmp_path / "shot.usda")
    out = fabricated.write(tmp_path / "out.usda", fabricated.shot_of(source), [])
    pack(out, tmp_path / "one.usdc")
    assert same(fabricated, source, tmp_path / "one.usdc")


def test_what_is_refused(fabricated, tmp_path, out):
    shot = tmp_path / "shots" / "shot.usda"
    with pytest.raises(InputError, match="not a result"):
        pack(shot, tmp_path / "one.usdc")
    with pytest.raises(InputError, match="cannot be opened"):
        pack(tmp_path / "nowhere.usda", tmp_path / "one.usdc")
    before = fabricated.contents(cache_folder(out)), shot.read_bytes(), out.read_bytes()
    for target in (out, shot, cache_folder(out) / "chunk.0001.usdc", cache_folder(out) / "one.usdc"):
        with pytest.raises(UsageError, match="part of what"):
            pack(out, target, overwrite=True)
    with pytest.raises(UsageError, match="ends in"):
        pack(out, tmp_path / "one.abc")
    assert (fabricated.contents(cache_folder(out)), shot.read_bytes(), out.read_bytes()) == before


def test_overwrites_only_when_told(tmp_path, out):
    one = tmp_path / "one.usdc"
    one.write_text("something of the user's")
    with pytest.raises(UsageError, match="exists"):
        pack(out, one)
    assert one.read_text() == "something of the user's"
    pack(out, one, overwrite=True)
    assert open_stage(one).GetPrimAtPath("/World/hair")
