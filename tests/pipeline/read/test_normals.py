"""Authored normals are read by their interpolation, each with the segment that carries it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from plait.pipeline.config import Config
from plait.pipeline.read import read_shot

# Two curves of four points, one along y, one along x.
CURVES = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 10
    timeCodesPerSecond = 24
)
def BasisCurves "hair"
{{
    uniform token type = "{type}"
    uniform token basis = "{basis}"
    int[] curveVertexCounts = [4, 4]
    point3f[] points = [(0,0,0), (0,1,0), (0,2,0), (0,3,0), (5,0,0), (6,0,0), (7,0,0), (8,0,0)]
    float[] widths = [0.001] ( interpolation = "constant" )
    {normals}
}}
"""


def normals_read(folder: Path, normals: str, type: str = "linear", basis: str = "bezier"):
    """(normals, warnings about them) of a shot with these attributes."""
    (folder / "shot.usda").write_text(CURVES.format(normals=normals, type=type, basis=basis))
    shot = read_shot(folder / "shot.usda", Config())
    return shot.curves[0].normals, [line for line in shot.warnings if "normals" in line]


def values(count: int) -> str:
    return "[" + ", ".join("(0, 0, 2)" for _ in range(count)) + "]"


@pytest.mark.parametrize(
    ("type", "basis", "interpolation", "segments"),
    [
        ("linear", "bezier", "vertex", [0, 1, 2, 2, 4, 5, 6, 6]),
        ("linear", "bezier", "varying", [0, 1, 2, 2, 4, 5, 6, 6]),
        ("cubic", "bspline", "vertex", [0, 1, 2, 2, 4, 5, 6, 6]),
        ("cubic", "bezier", "varying", [0, 2, 4, 6]),
        ("cubic", "bspline", "varying", [1, 2, 5, 6]),
        ("linear", "bezier", "uniform", [2, 6]),
    ],
)
def test_each_interpolation(tmp_path, type, basis, interpolation, segments):
    """A tip's normal goes with the last segment; a whole curve's with its middle."""
    text = f'normal3f[] normals = {values(len(segments))} ( interpolation = "{interpolation}" )'
    normals, warnings = normals_read(tmp_path, text, type, basis)
    assert list(normals.segments) == segments and not warnings
    np.testing.assert_allclose(normals.values, np.tile([0, 0, 1.0], (len(segments), 1)), atol=1e-12)


def test_primvars_come_first_and_are_flattened(tmp_path):
    text = """
    normal3f[] normals = [(1, 0, 0)] ( interpolation = "constant" )
    normal3f[] primvars:normals = [(0, 0, 1), (0, 1, 0)] ( interpolation = "uniform" )
    int[] primvars:normals:indices = [1, 0]
    """
    normals, _ = normals_read(tmp_path, text)
    np.testing.assert_allclose(normals.values, [[0, 1, 0], [0, 0, 1]], atol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        'normal3f[] normals = [(0, 0, 1)] ( interpolation = "constant" )',
        'normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0, 1)] ( interpolation = "vertex" )',
        'normal3f[] normals = [(0, 0, 1), (0, 0, 0)] ( interpolation = "uniform" )',
    ],
)
def test_what_cannot_turn_with_the_hair_is_left_out_and_said(tmp_path, text):
    """One for several curves, a count that does not fit, no direction: a warning, and no normals in the result."""
    normals, warnings = normals_read(tmp_path, text)
    assert normals is None and len(warnings) == 1 and "the result has none" in warnings[0]


def test_none_authored_none_read(tmp_path):
    assert normals_read(tmp_path, "") == (None, [])
