"""Two caches, made by hand so that every distance is known."""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from plait.pipeline.cli import main
from plait.pipeline.compare import DEFAULT_TOLERANCE, compare, show, strand_lengths
from plait.pipeline.errors import InputError, UsageError
from plait.pipeline.plot import line_plot
from plait.pipeline.report import write_report

# float32 points of magnitude 3, differences of two of them.
ROUNDING = 4 * 3 * float(np.finfo(np.float32).eps)
HAIR = np.array([[0, 0, 0], [0, 1, 0], [0, 2, 0], [1, 0, 0], [1, 3, 0]], np.float32)


def cache(path, move=None, *, codes=(1, 2, 3, 4), meters=1.0, counts=(3, 2), prims=("/hair",), rate=24, axis="Y"):
    """A cache of two strands, 2 m and 3 m long; `move(points, code)` changes them at a code."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, meters)
    UsdGeom.SetStageUpAxis(stage, axis)
    stage.SetTimeCodesPerSecond(rate)
    for name in prims:
        curves = UsdGeom.BasisCurves.Define(stage, name)
        curves.CreateCurveVertexCountsAttr(list(counts))
        for code in codes:
            points = (HAIR / meters)[: sum(counts)].copy()
            curves.CreatePointsAttr().Set(points if move is None else move(points, code), code)
    stage.Save()
    return path


def moved(by, point=4, since=3):
    """One point displaced by `by`, from frame `since`."""

    def move(points, code):
        if code >= since:
            points[point] += np.array(by, np.float32)
        return points

    return move


def test_equal_caches_are_the_same(tmp_path):
    result = compare(cache(tmp_path / "a.usda"), cache(tmp_path / "b.usda"), tolerance=0.0)
    assert result.ok
    (hair,) = result.prims
    assert (hair.points, list(hair.codes), hair.largest.max(), hair.length_change.max()) == (
        5,
        [1, 2, 3, 4],
        0.0,
        0.0,
    )


def test_distances_frame_and_point(tmp_path):
    """A point moved by 3-4-0 centimetres is 5 cm away; the mean is a fifth of it."""
    reference = cache(tmp_path / "a.usda")
    result = compare(reference, cache(tmp_path / "b.usda", moved((0.03, 0.04, 0.0))), tolerance=0.049)
    (hair,) = result.prims
    assert not result.ok
    np.testing.assert_allclose(hair.largest, [0, 0, 0.05, 0.05], atol=ROUNDING)
    np.testing.assert_allclose(hair.mean, [0, 0, 0.01, 0.01], atol=ROUNDING)
    assert (hair.codes[hair.worst], hair.worst_point[hair.worst], hair.first_beyond) == (3.0, 4, 3.0)
    assert compare(reference, tmp_path / "b.usda", tolerance=0.051).ok


def test_length_change(tmp_path):
    """The 3 m strand grown by 0.3 m is 10 % longer; the sign is kept when it shrinks."""
    reference = cache(tmp_path / "a.usda")
    longer = compare(reference, cache(tmp_path / "b.usda", moved((0, 0.3, 0), since=2)))
    np.testing.assert_allclose(longer.prims[0].length_change, [0, 0.1, 0.1, 0.1], atol=ROUNDING)
    shorter = compare(reference, cache(tmp_path / "c.usda", moved((0, -0.5, 0), point=2, since=4)))
    np.testing.assert_allclose(shorter.prims[0].length_change, [0, 0, 0, -0.25], atol=ROUNDING)


def test_strand_lengths_of_uneven_curves():
    """A curve ends where its count says, a curve of one point or none has no length."""
    points = np.array([[0, 0, 0], [3, 4, 0], [9, 9, 9], [0, 0, 0], [0, 0, 1], [0, 1, 1]], float)
    np.testing.assert_array_equal(strand_lengths(points, (2, 1, 0, 3, 0)), [5, 0, 0, 2, 0])


def test_units_are_converted(tmp_path):
    """The same hair in centimetres; distances are metres in both directions."""
    a, b = cache(tmp_path / "a.usda"), cache(tmp_path / "b.usda", moved((2, 0, 0)), meters=0.01)
    assert compare(a, b).prims[0].largest[3] == pytest.approx(0.02, abs=ROUNDING)
    assert compare(b, a).prims[0].largest[3] == pytest.approx(0.02, abs=ROUNDING)


def test_distances_are_in_world_space(tmp_path):
    """A transform above the prim, animated, with scale."""
    for name, height in (("a", 5.0), ("b", 7.0)):
        stage = Usd.Stage.Open(str(cache(tmp_path / f"{name}.usda", prims=("/set/hair",))))
        prim = UsdGeom.Xform.Define(stage, "/set")
        prim.AddTranslateOp().Set(Gf.Vec3d(0, 0, 0), 1)
        prim.GetOrderedXformOps()[0].Set(Gf.Vec3d(0, height, 0), 3)
        prim.AddScaleOp().Set(Gf.Vec3f(2))
        stage.Save()
    result = compare(tmp_path / "a.usda", tmp_path / "b.usda")
    np.testing.assert_allclose(result.prims[0].largest, [0, 1, 2, 2], atol=10 * ROUNDING)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"prims": ("/hair", "/beard")}, "missing in the reference"),
        ({"prims": ()}, "missing in the new"),
        ({"counts": (3, 1)}, "4 points, not 5"),
        ({"counts": (2, 3)}, "other numbers of points"),
        ({"codes": (1, 2, 3)}, "sample times differ: 4 samples, 1 to 4, in the reference, 3 samples, 1 to 3"),
        ({"codes": (1, 2, 3, 4, 5)}, "sample times differ"),
        ({"codes": (1, 1.5, 2, 3, 4)}, "sample times differ"),
        ({"codes": (7, 8)}, "sample times differ"),
        ({"move": moved((math.nan, 0, 0))}, "points of the new are not finite, from frame 3"),
        ({"move": moved((math.inf, 0, 0))}, "points of the new are not finite, from frame 3"),
        ({"rate": 30}, "time codes per second"),
        ({"axis": "Z"}, "up axis"),
    ],
)
def test_what_is_different_at_any_tolerance(tmp_path, change, words):
    result = compare(cache(tmp_path / "a.usda"), cache(tmp_path / "b.usda", **change), tolerance=1e30)
    assert not result.ok
    assert words in "\n".join(result.lines())
    json.dumps(result.to_dict(), allow_nan=False)


def test_nan_in_both_is_not_the_same(tmp_path):
    wrong = moved((math.nan, 0, 0))
    assert not compare(cache(tmp_path / "a.usda", wrong), cache(tmp_path / "b.usda", wrong)).ok


def test_meshes_and_prims_at_rest_are_compared_too(tmp_path):
    """A mesh without samples is compared once; it has no strands to change length."""
    for name, height in (("a", 1.0), ("b", 1.25)):
        stage = Usd.Stage.CreateNew(str(tmp_path / f"{name}.usda"))
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        mesh = UsdGeom.Mesh.Define(stage, "/skin")
        mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, height, 0)])
        stage.Save()
    (skin,) = compare(tmp_path / "a.usda", tmp_path / "b.usda").prims
    assert (skin.type_name, skin.largest[0], skin.worst_point[0], skin.length_change) == ("Mesh", 0.25, 2, None)


@pytest.mark.parametrize("tolerance", [-1.0, math.nan])
def test_tolerances_that_cannot_be_right(tmp_path, tolerance):
    with pytest.raises(UsageError, match="tolerance"):
        compare(cache(tmp_path / "a.usda"), cache(tmp_path / "b.usda"), tolerance)


def test_a_missing_file_is_bad_input(tmp_path):
    with pytest.raises(InputError, match="nowhere"):
        compare(cache(tmp_path / "a.usda"), tmp_path / "nowhere.usda")


def test_the_command_prints_and_judges(tmp_path, capsys):
    """Text and JSON say the same; the default tolerance is the documented 0.1 mm."""
    reference = cache(tmp_path / "a.usda")
    near = cache(tmp_path / "b.usda", moved((0.9 * DEFAULT_TOLERANCE, 0, 0)))
    far = cache(tmp_path / "c.usda", moved((1.1 * DEFAULT_TOLERANCE, 0, 0)))
    assert show(reference, near) is True
    assert show(reference, far) is False
    printed = capsys.readouterr().out
    assert "same: 1 of 1" in printed and "different: 0 of 1" in printed and "from frame 3" in printed
    assert show(reference, far, as_json=True) is False
    held = json.loads(capsys.readouterr().out)
    assert held["same"] is False and held["tolerance"] == 1e-4
    (hair,) = held["prims"]
    assert (hair["first_beyond"], hair["largest_frame"], hair["largest_point"]) == (3.0, 3.0, 4)
    assert hair["largest"] == pytest.approx(1.1e-4, abs=ROUNDING)


def test_exit_codes_of_the_command(tmp_path, capfd):
    """0 the same, 4 different, 2 a tolerance that cannot be, 5 a file that is none; errors are one line."""
    same, other = cache(tmp_path / "a.usda"), cache(tmp_path / "b.usda", moved((1, 0, 0)))
    (tmp_path / "broken.usda").write_text("not USD")
    (tmp_path / "partial.usda").write_text("#usda 1.0\n(\n subLayers = [@./gone.usda@, @./a.usda@]\n)\n")
    (tmp_path / "empty.usda").write_text("#usda 1.0\n")
    arguments = (
        ([same, same], 0),
        ([same, other], 4),
        ([same, other, "--tolerance", "1.5"], 0),
        ([same, other, "--tolerance", "-1"], 2),
        ([same, tmp_path / "nowhere.usda"], 5),
        ([tmp_path / "broken.usda", same], 5),
        ([same, tmp_path / "partial.usda"], 5),
        ([tmp_path / "empty.usda", tmp_path / "empty.usda"], 4),
    )
    for given, expected in arguments:
        assert main(["compare", *map(str, given)]) == expected, given
        assert capfd.readouterr().err.count("\n") == (expected in (2, 5))


def test_the_page_is_one_file_with_plots(tmp_path):
    """Nothing to load from elsewhere; plots are well-formed; every prim has a row."""
    reference = cache(tmp_path / "a.usda", prims=("/hair", "/beard"))
    result = compare(reference, cache(tmp_path / "b.usda", moved((0.02, 0, 0)), prims=("/hair",)))
    page = write_report(result, tmp_path / "deep" / "report")
    text = page.read_text(encoding="utf-8")
    assert [entry.name for entry in page.parent.iterdir()] == ["index.html"]
    assert not re.search(r"(src|href)='(?!data:)", text)
    plots = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(plots) == 2
    for plot in plots:
        ElementTree.fromstring(plot)
    assert (
        "/hair" in text and "/beard" in text and "missing in the new" in text and "<h1 class='different'>" in text
    )


def test_a_page_of_nothing_to_compare(tmp_path):
    """No common prim, no plot, no picture, still a page."""
    result = compare(cache(tmp_path / "a.usda"), cache(tmp_path / "b.usda", prims=()))
    assert "missing in the new" in write_report(result, tmp_path / "report").read_text(encoding="utf-8")


def test_a_folder_that_cannot_be_written_is_usage(tmp_path):
    (tmp_path / "file").write_text("")
    result = compare(cache(tmp_path / "a.usda"), cache(tmp_path / "b.usda"))
    with pytest.raises(UsageError, match="--report"):
        write_report(result, tmp_path / "file" / "report")


def test_plot_places_values_on_its_axes():
    """On a logarithmic axis equal ratios are equal distances, and zero lies on the lower edge."""
    svg = line_plot(
        np.array([1.0, 2, 3, 4]), {"a": np.array([0.0, 1e-6, 1e-4, 1e-2])}, "distance", logarithmic=True
    )
    (points,) = re.findall(r"<polyline points='([^']*)'", svg)
    heights = [float(pair.split(",")[1]) for pair in points.split()]
    assert heights[1] - heights[2] == pytest.approx(heights[2] - heights[3], abs=0.11)
    assert 240 > heights[0] > heights[1]
