"""Shots of flesh that cannot be right, as `malformed.py` has them of hair."""

from __future__ import annotations

from typing import Any

from malformed import Malformed

VALID = """#usda 1.0
(
    defaultPrim = "Body"
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 2
    timeCodesPerSecond = 24
    kilogramsPerUnit = 1
)

def SkelRoot "Body"
{
    def Skeleton "Rig" (prepend apiSchemas = ["SkelBindingAPI"])
    {
        uniform token[] joints = ["Shoulder", "Shoulder/Elbow"]
        uniform matrix4d[] bindTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (5, 5, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (5, 5, 15, 1))]
        uniform matrix4d[] restTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (5, 5, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 15, 1))]
    }

    def Mesh "Arm" (prepend apiSchemas = ["SkelBindingAPI", "PhysicsVolumeDeformableSimAPI"])
    {
        rel skel:skeleton = </Body/Rig>
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]
        point3f[] points = [
            (0, 0, 0), (10, 0, 0), (0, 10, 0), (10, 10, 0), (0, 0, 30), (10, 0, 30), (0, 10, 30), (10, 10, 30)]
        int[] primvars:skel:jointIndices = [0, 0, 0, 0, 1, 1, 1, 1] (elementSize = 1; interpolation = "vertex")
        float[] primvars:skel:jointWeights = [1, 1, 1, 1, 1, 1, 1, 1] (elementSize = 1; interpolation = "vertex")
        float[] primvars:plait:coreDepth = [0.2, 0.2, 0.2, 0.2, 0.6, 0.6, 0.6, 0.6] (interpolation = "vertex")
        float plait:tetEdge = 6
    }

    def TetMesh "Belly" (prepend apiSchemas = ["SkelBindingAPI", "PhysicsVolumeDeformableSimAPI"])
    {
        rel skel:skeleton = </Body/Rig>
        point3f[] points = [(50, 0, 0), (60, 0, 0), (50, 10, 0), (50, 0, 10), (60, 10, 10)]
        int4[] tetVertexIndices = [(0, 1, 2, 3), (1, 2, 3, 4)]
        int3[] surfaceFaceVertexIndices = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 4), (2, 3, 4), (3, 1, 4)]
        int[] primvars:skel:jointIndices = [0, 0, 0, 0, 1] (elementSize = 1; interpolation = "vertex")
        float[] primvars:skel:jointWeights = [1, 1, 1, 1, 1] (elementSize = 1; interpolation = "vertex")
        rel material:binding:physics = </Fat>
        float plait:coreDepth = 1
    }
}

def Material "Fat"
{
    float physics:youngsModulus = 300
    float physics:poissonsRatio = 0.4
}
"""

ARM, BELLY, FAT = "/Body/Arm", "/Body/Belly", "/Fat"
_PAINT = "[0.2, 0.2, 0.2, 0.2, 0.6, 0.6, 0.6, 0.6]"
_EDGE = "float plait:tetEdge = 6"
_TETS = "[(0, 1, 2, 3), (1, 2, 3, 4)]"
_CORNER = "(0, 0, 0), (10, 0, 0)"
_DEPTH = 'coreDepth = [0.2, 0.2, 0.2, 0.2, 0.6, 0.6, 0.6, 0.6] (interpolation = "vertex")'


def _case(name: str, prim: str, attribute: str, *edits: tuple[str, str], **how: Any) -> Malformed:
    return Malformed(name, edits, prim, attribute, valid=VALID, **how)


def _arm(line: str) -> tuple[str, str]:
    return _EDGE, f"{_EDGE}\n        {line}"


CASES = (
    # what is painted
    _case("painted_too_few", ARM, "primvars:plait:coreDepth", (_PAINT, "[0.2, 0.2]")),
    _case("painted_one_for_all_points", ARM, "primvars:plait:coreDepth", (_PAINT, "[0.2]")),
    _case("painted_out_of_range", ARM, "primvars:plait:coreDepth", (_PAINT, _PAINT.replace("[0.2", "[1.2"))),
    _case("painted_nan", ARM, "primvars:plait:coreDepth", (_PAINT, _PAINT.replace("[0.2", "[nan"))),
    _case("painted_on_faces", ARM, "primvars:plait:coreDepth", (_DEPTH, _DEPTH.replace("vertex", "uniform"))),
    _case(
        "painted_negative_stiffness",
        ARM,
        "primvars:plait:attachStiffness",
        _arm("float primvars:plait:attachStiffness = -1"),
    ),
    # parameters
    _case(
        "poissons_ratio_of_a_half", FAT, "physics:poissonsRatio", ("poissonsRatio = 0.4", "poissonsRatio = 0.5")
    ),
    _case("nan_youngs_modulus", FAT, "physics:youngsModulus", ("youngsModulus = 300", "youngsModulus = nan")),
    _case("negative_edge", ARM, "plait:tetEdge", (_EDGE, "float plait:tetEdge = -6")),
    _case("no_budget", ARM, "plait:tetBudget", (_EDGE, "int plait:tetBudget = 0")),
    _case("depth_of_the_core", ARM, "plait:coreDepth", _arm("float plait:coreDepth = 2")),
    _case("unknown_law", ARM, "plait:law", _arm('token plait:law = "hookean"')),
    _case("restitution", ARM, "physics:restitution", _arm("float physics:restitution = 1.5")),
    _case("law_of_the_command", "", "", config={"parameters": {"law": "hookean"}}, usage=True),
    _case("ratio_of_the_command", "", "", config={"parameters": {"poissonsRatio": 0.5}}, usage=True),
    _case("file_of_the_command", "", "", config={"prim": {ARM: {"tetMesh": "gone.vtu"}}}, usage=True),
    # the mesh
    _case("nan_flesh_point", ARM, "points", (_CORNER, _CORNER.replace("(10", "(nan"))),
    _case(
        "flesh_without_faces",
        ARM,
        "faceVertexIndices",
        ("faceVertexCounts = [4, 4, 4, 4, 4, 4]", "faceVertexCounts = []"),
        ("[0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]", "[]"),
    ),
    _case("normals_nan", ARM, "normals", _arm("normal3f[] normals = [(nan, 0, 0)]")),
    # tets
    _case("tet_file_missing", ARM, "plait:tetMesh", _arm("asset plait:tetMesh = @gone.vtu@")),
    _case("tet_file_is_no_mesh", ARM, "plait:tetMesh", _arm("asset plait:tetMesh = @tet_file_is_no_mesh.usda@")),
    _case("tet_file_in_words", ARM, "plait:tetMesh", _arm('string plait:tetMesh = "arm.vtu"')),
    _case("no_tets", BELLY, "tetVertexIndices", (_TETS, "[]")),
    _case("tet_names_no_point", BELLY, "tetVertexIndices", (_TETS, "[(0, 1, 2, 3), (1, 2, 3, 5)]")),
    _case("flat_tet", BELLY, "tetVertexIndices", (_TETS, "[(0, 1, 2, 3), (1, 2, 3, 3)]")),
    _case(
        "tets_animated",
        BELLY,
        "tetVertexIndices",
        (f"tetVertexIndices = {_TETS}", f"tetVertexIndices.timeSamples = {{ 1: {_TETS}, 2: {_TETS} }}"),
    ),
    _case("surface_names_no_point", BELLY, "surfaceFaceVertexIndices", ("[(0, 2, 1), ", "[(0, 7, 1), ")),
    _case("surface_names_a_point_of_no_tet", BELLY, "surfaceFaceVertexIndices", (_TETS, "[(0, 1, 2, 3)]")),
    _case("nan_tet_point", BELLY, "points", ("(60, 10, 10)]", "(60, 10, nan)]")),
    _case(
        "tets_weights_too_few",
        BELLY,
        "primvars:skel:joint",
        ("jointWeights = [1, 1, 1, 1, 1] (", "jointWeights = [1, 1, 1] ("),
    ),
    _case(
        "tets_name_no_joint",
        BELLY,
        "primvars:skel:jointIndices",
        ("jointIndices = [0, 0, 0, 0, 1] (", "jointIndices = [0, 0, 0, 0, 9] ("),
    ),
)
