"""Shots that cannot be right, as data: each is a valid small shot with one thing spoilt.

`CASES` is for any test of how bad input is refused: `case.write(folder)` makes the file, `case.frames` and
`case.configuration()` go with it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from plait.pipeline.config import Config

VALID = """#usda 1.0
(
    defaultPrim = "Body"
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 10
    timeCodesPerSecond = 24
    kilogramsPerUnit = 1
)

def SkelRoot "Body"
{
    def Skeleton "Rig" (
        prepend apiSchemas = ["SkelBindingAPI"]
    )
    {
        uniform token[] joints = ["Hip", "Hip/Head"]
        uniform matrix4d[] bindTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 50, 0, 1))]
        uniform matrix4d[] restTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 50, 0, 1))]
        rel skel:animationSource = </Body/Walk>
    }

    def SkelAnimation "Walk"
    {
        uniform token[] joints = ["Hip/Head"]
        float3[] translations.timeSamples = { 1: [(0, 50, 0)], 10: [(0, 60, 0)] }
        quatf[] rotations = [(1, 0, 0, 0)]
        half3[] scales = [(1, 1, 1)]
    }

    def Mesh "Skin" (
        prepend apiSchemas = ["SkelBindingAPI"]
    )
    {
        rel skel:skeleton = </Body/Rig>
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 60, 0), (0, 60, 10), (10, 60, 10), (10, 60, 0)]
        int[] primvars:skel:jointIndices = [0, 1, 0, 1, 0, 1, 0, 1] (elementSize = 2; interpolation = "vertex")
        float[] primvars:skel:jointWeights = [0.5, 0.5, 0.5, 0.5, 1, 0, 1, 0] (
            elementSize = 2
            interpolation = "vertex"
        )
        matrix4d primvars:skel:geomBindTransform = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    }
}

def BasisCurves "Hair" (
    prepend apiSchemas = ["PhysicsCurvesDeformableSimAPI"]
)
{
    uniform token type = "linear"
    int[] curveVertexCounts = [3, 2]
    point3f[] points = [(1, 60, 1), (1, 70, 1), (1, 80, 1), (5, 60, 5), (5, 80, 5)]
    float[] widths = [0.008] (interpolation = "constant")
    int[] primvars:skinprim = [0, 0] (interpolation = "uniform")
    float3[] primvars:skinprimuv = [(0.1, 0.1, 0), (0.5, 0.5, 0)] (interpolation = "uniform")
    rel material:binding:physics = </Keratin>
}

def Material "Keratin"
{
    float physics:density = 0.0013
}

def PhysicsScene "Physics"
{
    vector3f physics:gravityDirection = (0, -1, 0)
    float physics:gravityMagnitude = 981
}

def Sphere "Ball" (
    prepend apiSchemas = ["PhysicsCollisionAPI"]
)
{
    double radius = 5
    double3 xformOp:translate = (30, 60, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


@dataclass(frozen=True)
class Malformed:
    """One spoilt shot.

    edits: (what stands in the valid shot, what stands there instead).
    prim, attribute: what the message must name.
    frames, config: how the shot is read.  usage: the command is at fault (exit 2), not the file (exit 5).
    """

    name: str
    edits: tuple[tuple[str, str], ...]
    prim: str = ""
    attribute: str = ""
    frames: tuple[float, float] | None = None
    config: dict[str, Any] = field(default_factory=dict)
    usage: bool = False
    valid: str = VALID

    def text(self) -> str:
        result = self.valid
        for old, new in self.edits:
            assert result.count(old) == 1, f"{self.name}: {old!r} is there {result.count(old)} times"
            result = result.replace(old, new)
        return result

    def write(self, folder: Path) -> Path:
        path = folder / f"{self.name}.usda"
        path.write_text(self.text())
        return path

    def configuration(self) -> Config:
        return Config(**self.config)


def _case(name: str, prim: str, attribute: str, *edits: tuple[str, str], **how: Any) -> Malformed:
    return Malformed(name, edits, prim, attribute, **how)


TIE = "plait:attach:tie"
RIG, SKIN, HAIR, WALK = "/Body/Rig", "/Body/Skin", "/Hair", "/Body/Walk"
_POINTS = "(1, 60, 1), (1, 70, 1), (1, 80, 1), (5, 60, 5), (5, 80, 5)"
_SKIN_POINTS = "(0, 60, 0), (0, 60, 10), (10, 60, 10), (10, 60, 0)"
_WEIGHTS = "[0.5, 0.5, 0.5, 0.5, 1, 0, 1, 0]"
_JOINTS = "[0, 1, 0, 1, 0, 1, 0, 1]"
_HEAD_BIND = "            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 50, 0, 1))]\n"
_BIND = "bindTransforms = [\n            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),\n" + _HEAD_BIND
_ONE_BIND = "bindTransforms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))]\n"
_HAIR_TYPE = 'uniform token type = "linear"'
_UVS = "[(0.1, 0.1, 0), (0.5, 0.5, 0)]"


def _hair(line: str) -> tuple[str, str]:
    return _HAIR_TYPE, f"{_HAIR_TYPE}\n    {line}"


def _tie(line: str) -> tuple[str, str]:
    return _hair(f"rel {TIE} = </Ball>\n    {line}")


def _beside(text: str) -> tuple[str, str]:
    return 'def Material "Keratin"', f'{text}\n\ndef Material "Keratin"'


def _skin(line: str) -> tuple[str, str]:
    return "int[] faceVertexCounts = [4]", f"int[] faceVertexCounts = [4]\n        {line}"


def _material(line: str) -> tuple[str, str]:
    return "float physics:density = 0.0013", line


_CACHE = """def Mesh "Cache" (prepend apiSchemas = ["PhysicsCollisionAPI"])
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points.timeSamples = { 1: [(0, 0, 0), (1, 0, 0), (0, 1, 0)], 9: [(0, 0, 0)] }
}"""
_SCALE = 'uniform token[] xformOpOrder = ["xformOp:scale"]'
_TRANSLATE = 'uniform token[] xformOpOrder = ["xformOp:translate"]'

CASES = (
    # the stage
    _case("not_usd", "", "", ("#usda 1.0", "usda, more or less")),
    _case("syntax", "", "", ("def BasisCurves", "def BasisCurves {")),
    _case("zero_meters_per_unit", "", "metersPerUnit", ("metersPerUnit = 0.01", "metersPerUnit = 0")),
    _case("negative_meters_per_unit", "", "metersPerUnit", ("metersPerUnit = 0.01", "metersPerUnit = -1")),
    _case("nan_meters_per_unit", "", "metersPerUnit", ("metersPerUnit = 0.01", "metersPerUnit = nan")),
    _case("zero_rate", "", "timeCodesPerSecond", ("timeCodesPerSecond = 24", "timeCodesPerSecond = 0")),
    _case("zero_mass_unit", "", "kilogramsPerUnit", ("kilogramsPerUnit = 1", "kilogramsPerUnit = 0")),
    _case("range_backwards", "", "endTimeCode", ("endTimeCode = 10", "endTimeCode = -10")),
    _case("range_infinite", "", "endTimeCode", ("endTimeCode = 10", "endTimeCode = inf")),
    _case("missing_reference", "/Prop", "", _beside('def Xform "Prop" (references = @gone.usda@) {}')),
    _case("missing_payload", "/Prop", "", _beside('def Xform "Prop" (payload = @gone.usda@) {}')),
    _case("missing_prim_of_reference", "/Prop", "", _beside('def Xform "Prop" (references = </Gone>) {}')),
    _case("missing_sublayer", "", "", ('    upAxis = "Y"', '    upAxis = "Y"\n    subLayers = [@gone.usda@]')),
    _case("frames_backwards", "", "", frames=(10.0, 1.0), usage=True),
    _case("frames_nan", "", "", frames=(float("nan"), 1.0), usage=True),
    # curves
    _case("nan_point", HAIR, "points", (_POINTS, _POINTS.replace("(1, 70, 1)", "(1, nan, 1)"))),
    _case("infinite_point", HAIR, "points", (_POINTS, _POINTS.replace("(5, 80, 5)", "(5, inf, 5)"))),
    _case("too_few_points", HAIR, "points", (_POINTS, "(1, 60, 1), (1, 70, 1)")),
    _case("no_points", HAIR, "points", (f"[{_POINTS}]", "[]"), ("[3, 2]", "[]")),
    _case("negative_count", HAIR, "curveVertexCounts", ("[3, 2]", "[6, -1]")),
    _case("counts_too_large", HAIR, "points", ("[3, 2]", "[3, 3]")),
    _case(
        "counts_change",
        HAIR,
        "curveVertexCounts",
        ("curveVertexCounts = [3, 2]", "curveVertexCounts.timeSamples = { 1: [3, 2], 5: [2, 3] }"),
    ),
    _case(
        "points_change_number",
        HAIR,
        "points",
        (f"points = [{_POINTS}]", f"points.timeSamples = {{ 1: [{_POINTS}], 5: [(1, 60, 1)] }}"),
    ),
    _case(
        "points_of_wrong_type",
        HAIR,
        "points",
        (f"point3f[] points = [{_POINTS}]", "float[] points = [1, 2, 3, 4, 5]"),
    ),
    _case("negative_width", HAIR, "widths", ("[0.008]", "[-0.008]")),
    _case("nan_width", HAIR, "widths", ("[0.008]", "[nan]")),
    _case(
        "too_many_widths",
        HAIR,
        "widths",
        ('[0.008] (interpolation = "constant")', '[0.01, 0.01, 0.01, 0.01] (interpolation = "vertex")'),
    ),
    _case("skinprim_count", HAIR, "primvars:skinprim", ("skinprim = [0, 0]", "skinprim = [0, 0, 0]")),
    _case("skinprimuv_nan", HAIR, "primvars:skinprimuv", (_UVS, "[(nan, 0, 0), (0.5, 0.5, 0)]")),
    _case("skin_missing", HAIR, "plait:skin", _hair("rel plait:skin = </Gone>")),
    _case("skin_is_no_mesh", HAIR, "plait:skin", _hair("rel plait:skin = </Body/Rig>")),
    _case(
        "transform_nan", HAIR, "xformOpOrder", _hair(f"double3 xformOp:translate = (nan, 0, 0)\n    {_TRANSLATE}")
    ),
    _case("transform_singular", HAIR, "xformOpOrder", _hair(f"float3 xformOp:scale = (1, 0, 1)\n    {_SCALE}")),
    # roles and parameters
    _case("unknown_role", HAIR, "plait:role", _hair('token plait:role = "hair"')),
    _case("role_of_another_type", HAIR, "plait:role", _hair('token plait:role = "flesh"')),
    _case("strands_on_a_mesh", SKIN, "plait:role", _skin('token plait:role = "strands"')),
    _case("negative_density", "/Keratin", "physics:density", _material("float physics:density = -1")),
    _case("density_in_si", "/Keratin", "physics:density", _material("float physics:density = 1300")),
    _case("nan_density", "/Keratin", "physics:density", _material("float physics:density = nan")),
    _case("infinite_youngs_modulus", HAIR, "plait:youngsModulus", _hair("float plait:youngsModulus = inf")),
    _case("poissons_ratio", HAIR, "plait:poissonsRatio", _hair("float plait:poissonsRatio = 0.7")),
    _case(
        "negative_bend_stiffness",
        "/Keratin",
        "physics:curvesBendStiffness",
        _material("float physics:curvesBendStiffness = -2"),
    ),
    _case("zero_thickness", HAIR, "plait:thickness", _hair("float plait:thickness = 0")),
    _case("negative_damping", HAIR, "plait:damping", _hair("float plait:damping = -0.1")),
    _case("damping_in_words", HAIR, "plait:damping", _hair('string plait:damping = "much"')),
    _case(
        "negative_friction",
        "/Ball",
        "plait:friction",
        ("double radius = 5", "double radius = 5\n    float plait:friction = -0.5"),
    ),
    _case("unknown_rest_shape", HAIR, "plait:restShape", _hair('token plait:restShape = "straight"')),
    _case("negative_clearance", HAIR, "plait:clearance", _hair("float plait:clearance = -0.1")),
    _case("pic_fraction_above_one", HAIR, "plait:picFraction", _hair("float plait:picFraction = 1.5")),
    _case("free_in_numbers", HAIR, "plait:free", _hair("float plait:free = 1")),
    _case("free_animated", HAIR, "plait:free", _hair("bool plait:free.timeSamples = { 1: 0, 5: 1 }")),
    _case(
        "free_of_too_many_curves",
        HAIR,
        "primvars:plait:free",
        _hair('bool[] primvars:plait:free = [1, 0, 1] (interpolation = "uniform")'),
    ),
    _case(
        "free_a_point",
        HAIR,
        "primvars:plait:free",
        _hair('bool[] primvars:plait:free = [1, 0, 1, 0, 1] (interpolation = "vertex")'),
    ),
    _case(
        "free_neither_true_nor_false",
        HAIR,
        "primvars:plait:free",
        _hair('int[] primvars:plait:free = [1, 2] (interpolation = "uniform")'),
    ),
    _case("free_configured_in_words", "", "", config={"parameters": {"free": "yes"}}, usage=True),
    _case("material_missing", HAIR, "material:binding:physics", ("</Keratin>", "</Gone>")),
    _case("gravity_nan", "/Physics", "physics:gravityDirection", ("(0, -1, 0)", "(0, nan, 0)")),
    _case(
        "gravity_infinite",
        "/Physics",
        "physics:gravityMagnitude",
        ("gravityMagnitude = 981", "gravityMagnitude = inf"),
    ),
    _case(
        "gravity_in_words",
        "/Physics",
        "physics:gravityMagnitude",
        ("float physics:gravityMagnitude = 981", 'string physics:gravityMagnitude = "down"'),
    ),
    _case("unknown_parameter", "", "", config={"parameters": {"dampings": 1.0}}, usage=True),
    _case("parameter_out_of_range", "", "", config={"parameters": {"density": -1.0}}, usage=True),
    _case("parameter_of_wrong_type", "", "", config={"prim": {"/Hair*": {"damping": "much"}}}, usage=True),
    _case("parameter_choice", "", "", config={"prim": {"/Hair*": {"restShape": "straight"}}}, usage=True),
    # attachments
    _case("attachment_without_a_name", HAIR, "plait:attach", _hair("rel plait:attach = </Ball>")),
    _case("attachment_is_no_relationship", HAIR, TIE, _hair("bool plait:attach:tie = true")),
    _case("attachment_names_nothing", HAIR, TIE, _hair("rel plait:attach:tie")),
    _case("attachment_target_missing", HAIR, TIE, _hair("rel plait:attach:tie = </Gone>")),
    _case("attachment_to_a_material", HAIR, TIE, _hair("rel plait:attach:tie = </Keratin>")),
    _case(
        "attachment_to_curves_that_are_not_simulated",
        HAIR,
        TIE,
        _hair("rel plait:attach:tie = </Wire>"),
        _beside(
            """def BasisCurves "Wire"
{
    int[] curveVertexCounts = [2]
    point3f[] points = [(0, 0, 0), (0, 1, 0)]
}"""
        ),
    ),
    _case("attachment_of_an_unknown_part", HAIR, f"{TIE}:stiff", _tie("float plait:attach:tie:stiff = 3")),
    _case(
        "attachment_that_is_not_there",
        HAIR,
        "plait:attach:tip:points",
        _tie("int[] plait:attach:tip:points = [1]"),
    ),
    _case("attachment_points_in_floats", HAIR, f"{TIE}:points", _tie("float[] plait:attach:tie:points = [1]")),
    _case("attachment_without_points", HAIR, f"{TIE}:points", _tie("int[] plait:attach:tie:points = []")),
    _case("attachment_beyond_the_points", HAIR, f"{TIE}:points", _tie("int[] plait:attach:tie:points = [1, 5]")),
    _case("attachment_before_the_points", HAIR, f"{TIE}:points", _tie("int[] plait:attach:tie:points = [-1]")),
    _case("attachment_of_a_root", HAIR, f"{TIE}:points", _tie("int[] plait:attach:tie:points = [2, 3]")),
    _case("attachment_stiffness_zero", HAIR, f"{TIE}:stiffness", _tie("float plait:attach:tie:stiffness = 0")),
    _case("attachment_stiffness_nan", HAIR, f"{TIE}:stiffness", _tie("float plait:attach:tie:stiffness = nan")),
    _case(
        "attachment_stiffness_in_words",
        HAIR,
        f"{TIE}:stiffness",
        _tie('string plait:attach:tie:stiffness = "hard"'),
    ),
    _case("attachment_enabled_in_numbers", HAIR, f"{TIE}:enabled", _tie("int plait:attach:tie:enabled = 1")),
    # bodies
    _case("nan_skin_point", SKIN, "points", (_SKIN_POINTS, _SKIN_POINTS.replace("(0, 60, 0)", "(nan, 60, 0)"))),
    _case("face_names_no_point", SKIN, "faceVertexIndices", ("[0, 1, 2, 3]", "[0, 1, 2, 4]")),
    _case("face_counts", SKIN, "faceVertexIndices", ("faceVertexCounts = [4]", "faceVertexCounts = [5]")),
    _case(
        "negative_face_count", SKIN, "faceVertexCounts", ("faceVertexCounts = [4]", "faceVertexCounts = [6, -2]")
    ),
    _case(
        "faces_animated",
        SKIN,
        "faceVertexIndices",
        (
            "faceVertexIndices = [0, 1, 2, 3]",
            "faceVertexIndices.timeSamples = { 1: [0, 1, 2, 3], 2: [3, 2, 1, 0] }",
        ),
    ),
    _case("ball_without_size", "/Ball", "radius", ("double radius = 5", "double radius = -5")),
    _case("cached_points_change_number", "/Cache", "points", _beside(_CACHE)),
    # skeletons
    _case(
        "skeleton_missing",
        SKIN,
        "skel:skeleton",
        ("rel skel:skeleton = </Body/Rig>", "rel skel:skeleton = </Body/Gone>"),
    ),
    _case(
        "skeleton_of_wrong_type",
        SKIN,
        "skel:skeleton",
        ("rel skel:skeleton = </Body/Rig>", "rel skel:skeleton = </Body/Walk>"),
    ),
    _case("animation_of_wrong_type", RIG, "skel:animationSource", ("</Body/Walk>", "</Body/Skin>")),
    _case("bind_transforms_too_few", RIG, "bindTransforms", (_BIND, _ONE_BIND)),
    _case("joints_not_in_order", RIG, "joints", ('joints = ["Hip", "Hip/Head"]', 'joints = ["Hip/Head", "Hip"]')),
    _case("joint_index_too_large", SKIN, "primvars:skel:jointIndices", (_JOINTS, "[0, 7, 0, 1, 0, 1, 0, 1]")),
    _case("joint_index_negative", SKIN, "primvars:skel:jointIndices", (_JOINTS, "[0, -1, 0, 1, 0, 1, 0, 1]")),
    _case("weights_too_few", SKIN, "primvars:skel:joint", (_WEIGHTS, "[0.5, 0.5]")),
    _case("weight_nan", SKIN, "primvars:skel:jointWeights", (_WEIGHTS, "[nan, 0.5, 0.5, 0.5, 1, 0, 1, 0]")),
    _case("joint_the_skeleton_lacks", SKIN, "skel:joints", _skin('uniform token[] skel:joints = ["Hip", "Tail"]')),
    _case(
        "bind_nan",
        SKIN,
        "primvars:skel:geomBindTransform",
        ("geomBindTransform = ((1, 0, 0, 0)", "geomBindTransform = ((nan, 0, 0, 0)"),
    ),
    _case("animation_nan", WALK, "translations", ("{ 1: [(0, 50, 0)]", "{ 1: [(0, nan, 0)]")),
)
