"""Shots of sand and snow that cannot be right, as `malformed.py` has them of hair."""

from __future__ import annotations

from typing import Any

from malformed import Malformed

VALID = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 2
    timeCodesPerSecond = 24
    kilogramsPerUnit = 1
)

def Xform "World"
{
    def Mesh "Pile"
    {
        token plait:role = "sand"
        float plait:spacing = 2.5
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]
        point3f[] points = [
            (0, 0, 0), (10, 0, 0), (0, 10, 0), (10, 10, 0), (0, 0, 10), (10, 0, 10), (0, 10, 10), (10, 10, 10)]
    }

    def Cube "Tap"
    {
        token plait:role = "sand"
        float plait:spacing = 2.5
        double size = 10
        float plait:rate = 90
        float3 plait:velocity = (0, -100, 0)
        bool plait:emit.timeSamples = { 1: 1, 2: 0 }
    }

    def Points "Drift"
    {
        token plait:role = "snow"
        float plait:spacing = 2.5
        point3f[] points = [(50, 0, 0), (50, 2, 0)]
        vector3f[] velocities = [(0, 0, 0), (0, 1, 0)]
        float[] widths = [1, 1]
        int64[] ids = [7, 3]
        rel material:binding:physics = </World/Powder>
    }

    def Material "Powder"
    {
        float physics:density = 0.0004
        float plait:hardening = 5
    }
}
"""

PILE, TAP, DRIFT, POWDER = "/World/Pile", "/World/Tap", "/World/Drift", "/World/Powder"
_SIZE = "double size = 10"
_POINTS = "[(50, 0, 0), (50, 2, 0)]"
_APART = 'token plait:role = "snow"\n        float plait:spacing = 2.5'
_FACES = "[4, 4, 4, 4, 4, 4]"
_LIST = "[0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]"
_CORNER = "(0, 0, 0), (10, 0, 0)"
_CLOSE = 'token plait:role = "sand"\n        float plait:spacing = 2.5\n        uniform'


def _case(name: str, prim: str, attribute: str, *edits: tuple[str, str], **how: Any) -> Malformed:
    return Malformed(name, edits, prim, attribute, valid=VALID, **how)


def _tap(line: str) -> tuple[str, str]:
    return _SIZE, f"{_SIZE}\n        {line}"


CASES = (
    # what is filled
    _case(
        "open_mesh",
        PILE,
        "faceVertexIndices",
        (_FACES, "[4, 4, 4, 4, 4]"),
        (_LIST, _LIST[: -len(", 1, 3, 7, 5]")] + "]"),
    ),
    _case("one_face_turned", PILE, "faceVertexIndices", ("[0, 2, 3, 1,", "[1, 3, 2, 0,")),
    _case("nan_pile", PILE, "points", (_CORNER, "(nan, 0, 0), (10, 0, 0)")),
    _case("too_small_for_its_grains", PILE, "", (_CLOSE, _CLOSE.replace("2.5", "50"))),
    _case("more_than_memory", PILE, "plait:spacing", (_CLOSE, _CLOSE.replace("2.5", "0.0001"))),
    _case("role_of_curves", PILE, "plait:role", ('def Mesh "Pile"', 'def BasisCurves "Pile"')),
    # what pours
    _case("negative_rate", TAP, "plait:rate", ("rate = 90", "rate = -90")),
    _case("infinite_rate", TAP, "plait:rate", ("rate = 90", "rate = inf")),
    _case("fractional_limit", TAP, "plait:limit", _tap("float plait:limit = 0.5")),
    _case("nan_velocity", TAP, "plait:velocity", ("(0, -100, 0)", "(0, nan, 0)")),
    _case(
        "velocity_of_one_number",
        TAP,
        "plait:velocity",
        ("float3 plait:velocity = (0, -100, 0)", "float plait:velocity = 1"),
    ),
    _case(
        "emit_is_a_number",
        TAP,
        "plait:emit",
        ("bool plait:emit.timeSamples = { 1: 1, 2: 0 }", "int plait:emit = 1"),
    ),
    _case("no_size", TAP, "size", (_SIZE, "double size = 0")),
    # what is grains
    _case(
        "rate_of_points", DRIFT, "plait:rate", ("float[] widths", "float plait:rate = 5\n        float[] widths")
    ),
    _case("nan_grain", DRIFT, "points", (_POINTS, "[(50, 0, 0), (50, nan, 0)]")),
    _case("far_grain", DRIFT, "points", (_POINTS, "[(50, 0, 0), (1e20, 2, 0)]")),
    _case(
        "far_grain_of_many",
        DRIFT,
        "points",
        (_APART, 'token plait:role = "snow"'),
        (_POINTS, f"[(1e25, 0, 0), {', '.join(f'({k}, {k * k % 7}, {k * k % 5})' for k in range(99))}]"),
        ("vector3f[] velocities = [(0, 0, 0), (0, 1, 0)]\n", ""),
        ("float[] widths = [1, 1]\n", ""),
        ("int64[] ids = [7, 3]\n", ""),
    ),
    _case("too_few_widths", DRIFT, "widths", ("[1, 1]", "[1, 1, 1]")),
    _case("negative_widths", DRIFT, "widths", ("[1, 1]", "[1, -1]")),
    _case("too_few_velocities", DRIFT, "velocities", ("[(0, 0, 0), (0, 1, 0)]", "[(0, 0, 0)]")),
    _case("nan_velocities", DRIFT, "velocities", ("[(0, 0, 0), (0, 1, 0)]", "[(0, 0, 0), (0, 0, inf)]")),
    _case("too_few_ids", DRIFT, "ids", ("[7, 3]", "[7]")),
    _case("ids_twice", DRIFT, "ids", ("[7, 3]", "[7, 7]")),
    _case("at_one_place", DRIFT, "plait:spacing", (_APART, 'token plait:role = "snow"'), ("[1, 1]", "[0, 0]")),
    # parameters
    _case("density_of_the_material", POWDER, "physics:density", ("0.0004", "-1")),
    _case("hardening", POWDER, "plait:hardening", ("hardening = 5", "hardening = 500")),
    _case("friction_angle", TAP, "plait:frictionAngle", _tap("float plait:frictionAngle = 90")),
    _case("surface_is_a_number", TAP, "plait:surface", _tap("float plait:surface = 1")),
    _case("seed_of_no_whole_number", TAP, "plait:seed", _tap("float plait:seed = 1.5")),
    _case("no_surface_cell", TAP, "plait:surfaceCell", _tap("float plait:surfaceCell = 0")),
    _case(
        "tiny_surface_cell",
        PILE,
        "plait:surfaceCell",
        (_CLOSE, "float plait:surfaceCell = 1e-6\n        bool plait:surface = 1\n        " + _CLOSE),
    ),
    _case("velocity_of_the_command", "", "", config={"parameters": {"velocity": 3.0}}, usage=True),
    _case("spacing_of_the_command", "", "", config={"prim": {PILE: {"spacing": 0.0}}}, usage=True),
)
