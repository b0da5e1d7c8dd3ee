"""Curves of every type: what is simulated for them, at what thickness, and the way back to the drawn points."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.read.strands import DEFAULT_THICKNESS

CURVES = """
def BasisCurves "Hair"
{{
    uniform token type = "{type}"
    uniform token basis = "{basis}"
    uniform token wrap = "{wrap}"
    int[] curveVertexCounts = {counts}
    point3f[] points = {points}
    {widths}
    {more}
}}
"""
STRAIGHT = "[(0, 0, 0), (0, 1, 0), (0, 2, 0), (0, 3, 0), (0, 4, 0), (0, 5, 0), (0, 6, 0)]"


def _curves(**given: str) -> str:
    base = {
        "type": "linear",
        "basis": "bezier",
        "wrap": "nonperiodic",
        "counts": "[7]",
        "points": STRAIGHT,
        "widths": 'float[] widths = [0.0001] (interpolation = "constant")',
        "more": "",
    }
    return CURVES.format(**(base | given))


def _back(shot) -> np.ndarray:
    """The drawn points, from the simulated ones where they were drawn."""
    output = shot.curves[0]
    strands = shot.scene.strands[output.strands]
    to_world = strands.rest_transform
    world = strands.points @ to_world[:3, :3].T + to_world[:3, 3]
    to_local = output.world_to_local(shot.info.start / shot.info.time_codes_per_second)
    return output.drawn(world @ to_local[:3, :3].T + to_local[:3, 3])


@pytest.mark.parametrize("wrap", ["nonperiodic", "pinned"])
@pytest.mark.parametrize("basis", ["bezier", "bspline", "catmullRom"])
@pytest.mark.parametrize("type", ["linear", "cubic"])
def test_every_basis_comes_back_as_drawn(type: str, basis: str, wrap: str, read) -> None:
    """The control points themselves are simulated, in every basis: counts and order never change."""
    shot = read(_curves(type=type, basis=basis, wrap=wrap), meters=0.01)
    drawn = np.column_stack([np.zeros(7), np.arange(7.0), np.zeros(7)])
    np.testing.assert_allclose(_back(shot), drawn, atol=1e-12)


def test_a_bezier_hair_bends_without_kinks(read) -> None:
    """Its simulated points bent to an arc, the curve drawn from them is smooth where its segments meet.

    A cubic through four points of an arc of angle t has an end tangent wrong by O(t^3): two such meet at less than
    t^3; along the control polygon a third of the bending, 2 t / 3, would be kinks at the joints.
    """
    points = "[(0, 0, 0), (0, 1, 0), (0, 2, 0), (0, 3, 0), (0, 4, 0), (0, 5, 0), (0, 6, 0)]"
    shot = read(_curves(type="cubic", basis="bezier", points=points))
    output, segment_angle = shot.curves[0], 0.3
    along = np.arange(7.0) * segment_angle / 3.0
    radius = 3.0 / segment_angle
    arc = radius * np.column_stack([1.0 - np.cos(along), np.sin(along), np.zeros(7)])
    control = output.drawn(arc)
    into, out = control[3] - control[2], control[4] - control[3]
    kink = np.arccos(into @ out / np.linalg.norm(into) / np.linalg.norm(out))
    assert kink < segment_angle**3
    np.testing.assert_allclose(control[::3], arc[::3], atol=1e-12)


def test_bezier_handles_come_back_as_drawn(read) -> None:
    points = "[(0, 0, 0), (3, 1, 0), (-2, 2, 1), (0, 3, 0), (0, 3, 0), (1, 5, -2), (0, 6, 0)]"
    shot = read(_curves(type="cubic", basis="bezier", points=points))
    expected = [(0, 0, 0), (3, 1, 0), (-2, 2, 1), (0, 3, 0), (0, 3, 0), (1, 5, -2), (0, 6, 0)]
    np.testing.assert_allclose(_back(shot), expected, atol=1e-12)


def test_transform_units_and_origin_there_and_back(read) -> None:
    """A scaled, turned, far away prim in centimetres: metres in the scene, and back as drawn."""
    more = """double3 xformOp:translate = (100000, 20000, -300000)
    double xformOp:rotateX = 40
    float3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX", "xformOp:scale"]"""
    shot = read(_curves(more=more), meters=0.01)
    strands = shot.scene.strands[0]
    lengths = np.linalg.norm(np.diff(strands.points, axis=0), axis=1)
    np.testing.assert_allclose(lengths, 0.02, rtol=1e-9)
    np.testing.assert_allclose(strands.radius, 0.5 * 0.0001 * 2 * 0.01, rtol=1e-6)
    world = strands.points @ strands.rest_transform[:3, :3].T + strands.rest_transform[:3, 3]
    assert np.abs(world).max() < 1.0, "scene coordinates are near zero"
    np.testing.assert_allclose(shot.scene.origin, [1000, 200, -3000], atol=0.5)
    np.testing.assert_allclose(_back(shot)[:, 1], np.arange(7.0), atol=1e-7)


def test_repeated_ends_are_one_point(read) -> None:
    points = "[(0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 1, 0), (0, 2, 0), (0, 2, 0), (0, 2, 0)]"
    shot = read(_curves(type="cubic", basis="bspline", points=points))
    assert len(shot.scene.strands[0].points) == 3
    assert shot.curves[0].point_map.tolist() == [0, 0, 0, 1, 2, 2, 2]
    np.testing.assert_allclose(_back(shot)[:, 1], [0, 0, 0, 1, 2, 2, 2], atol=1e-12)


def test_curves_without_length_keep_their_points(read) -> None:
    """No point, one point, and three times the same: they stay in the output and follow their roots."""
    points = "[(0, 0, 0), (0, 1, 0), (7, 0, 0), (9, 3, 0), (9, 3, 0), (9, 3, 0), (5, 0, 0), (5, 2, 0)]"
    shot = read(_curves(counts="[2, 1, 0, 3, 2]", points=points))
    strands = shot.scene.strands[0]
    assert strands.strand_count == 4 and np.all(np.diff(strands.offsets) == 2)
    expected = [(0, 0, 0), (0, 1, 0), (7, 0, 0), (9, 3, 0), (9, 3, 0), (9, 3, 0), (5, 0, 0), (5, 2, 0)]
    np.testing.assert_allclose(_back(shot), expected, atol=1e-12)
    assert any("have no length" in warning for warning in shot.warnings)


def test_a_prim_without_any_length_is_skipped(read) -> None:
    shot = read(_curves(counts="[1, 1]", points="[(0, 0, 0), (1, 0, 0)]", widths=""))
    assert shot.scene.strands == () and shot.curves == ()
    assert shot.prims[0].role == "skipped" and shot.prims[0].reason == "no curve has a length"


def test_closed_loops_are_skipped_by_name(read) -> None:
    shot = read(_curves(wrap="periodic"))
    assert shot.scene.strands == ()
    assert "periodic" in shot.prims[0].reason and shot.prims[0].supported


def test_closed_loops_asked_for_are_refused(read) -> None:
    prim = read(_curves(wrap="periodic", more='token plait:role = "strands"')).prims[0]
    assert (prim.role, prim.supported) == ("strands", False)


@pytest.mark.parametrize("kind", ["NurbsCurves", "HermiteCurves"])
def test_other_curves_are_skipped_by_name(kind: str, read) -> None:
    text = _curves().replace("BasisCurves", kind).replace('uniform token type = "linear"', "")
    text = text.replace('uniform token basis = "bezier"', "").replace('uniform token wrap = "nonperiodic"', "")
    assert kind in read(text).prims[0].reason


def test_topology_that_changes_is_skipped_by_name(read) -> None:
    text = _curves(points=STRAIGHT, counts="[7]").replace(
        "int[] curveVertexCounts = [7]", "int[] curveVertexCounts.timeSamples = { 1: [7], 4: [3, 4] }"
    )
    prim = read(text).prims[0]
    assert prim.role == "skipped" and "time code 4" in prim.reason


@pytest.mark.parametrize(
    ("type", "basis", "interpolation", "widths", "expected"),
    [
        ("linear", "bezier", "constant", [2], [2] * 7),
        ("linear", "bezier", "vertex", [1, 2, 3, 4, 5, 6, 7], [1, 2, 3, 4, 5, 6, 7]),
        ("linear", "bezier", "varying", [1, 2, 3, 4, 5, 6, 7], [1, 2, 3, 4, 5, 6, 7]),
        ("linear", "bezier", "uniform", [3], [3] * 7),
        # A bezier's varying values sit where its segments meet: at points 0, 3 and 6.
        ("cubic", "bezier", "varying", [1, 4, 10], [1, 2, 3, 4, 6, 8, 10]),
        # A b-spline's four segments are ruled by points 1 to 5 at their ends.
        ("cubic", "bspline", "varying", [1, 2, 3, 4, 5], [1, 1, 2, 3, 4, 5, 5]),
        ("cubic", "catmullRom", "varying", [1, 2, 3, 4, 5], [1, 1, 2, 3, 4, 5, 5]),
    ],
)
def test_widths_are_diameters(type, basis, interpolation, widths, expected, read) -> None:
    values = f'float[] widths = {[w * 1e-5 for w in widths]} (interpolation = "{interpolation}")'
    shot = read(_curves(type=type, basis=basis, widths=values))
    np.testing.assert_allclose(shot.scene.strands[0].radius, 0.5e-5 * np.array(expected), rtol=1e-6)
    np.testing.assert_allclose(shot.curves[0].widths, 1e-5 * np.array(expected), rtol=1e-6)


def test_primvar_widths_come_first(read) -> None:
    shot = read(_curves(more='float[] primvars:widths = [0.0003] (interpolation = "constant")'))
    np.testing.assert_allclose(shot.scene.strands[0].radius, 0.00015, rtol=1e-6)


def test_without_widths_a_hair_and_a_warning(read) -> None:
    shot = read(_curves(widths=""), meters=0.01)
    np.testing.assert_allclose(shot.scene.strands[0].radius, 0.5 * DEFAULT_THICKNESS)
    assert any("widths" in warning and "8e-05 m" in warning for warning in shot.warnings)


def test_tips_that_taper_to_nothing_keep_a_mass(read) -> None:
    values = 'float[] widths = [0.0002, 0.0002, 0.0002, 0.0001, 0.0001, 0.0001, 0] (interpolation = "vertex")'
    shot = read(_curves(widths=values))
    assert shot.scene.strands[0].radius.min() > 0.0
    assert shot.curves[0].widths[-1] == 0.0, "as drawn, for the extent"


def test_widths_that_fit_no_interpolation_but_one(read) -> None:
    """A single value is meant for all, whatever interpolation a writer left at its default."""
    shot = read(_curves(widths="float[] widths = [0.0002]"))
    np.testing.assert_allclose(shot.scene.strands[0].radius, 0.0001, rtol=1e-6)
    assert any("taken as constant" in warning for warning in shot.warnings)
