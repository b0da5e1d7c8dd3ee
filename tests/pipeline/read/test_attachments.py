"""Ties and clamps as the scene has them: what is held, where on what, how stiffly and when."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline import inspect
from plait.pipeline.read.placing import place_points
from plait.pipeline.shot import Shot
from plait.solver.scene import AlwaysOn, Attachment

# Three locks of three points, 1 apart along x; the last point of each is drawn twice.
SHOT = """
def Xform "World" (kind = "group")
{{
    def BasisCurves "Hair" (prepend apiSchemas = ["PhysicsCurvesDeformableSimAPI"])
    {{
        uniform token type = "linear"
        int[] curveVertexCounts = [4, 4, 4]
        point3f[] points = [
            (0, 0, 0), (0, 1, 0), (0, 2, 0), (0, 2, 0),
            (1, 0, 0), (1, 1, 0), (1.2, 2, 0), (1.2, 2, 0),
            (2, 0, 0), (2, 1, 0), (1.5, 2, 0), (1.5, 2, 0)]
        float[] widths = [0.01] (interpolation = "constant")
        {lines}
    }}
    {others}
}}
"""
CLAMP = """
    def Xform "Clamp"
    {
        double3 xformOp:translate.timeSamples = { 1: (0, 3, 0), 10: (0, 3, 9) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""
TABLE = """
    def Mesh "Table"
    {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-9, 2.5, -9), (-9, 2.5, 9), (9, 2.5, 9), (9, 2.5, -9)]
    }
"""
ROPE = """
    def BasisCurves "Rope" (prepend apiSchemas = ["PhysicsCurvesDeformableSimAPI"])
    {
        uniform token type = "linear"
        int[] curveVertexCounts = [3]
        point3f[] points = [(0, 2.2, 1), (0, 2.2, 0), (3, 2.2, 0)]
        float[] widths = [0.01] (interpolation = "constant")
        bool plait:free = true
    }
"""
TIPS = [2, 5, 8]


def _shot(read, *lines: str, others: str = "", **more) -> Shot:
    return read(SHOT.format(lines="\n        ".join(lines), others=others), **more)


def _places(shot: Shot, held: Attachment, code: float) -> np.ndarray:
    """(n, 3) what the points are held to, in the shot's world, at a time code."""
    surface = shot.scene.surfaces[held.surface]
    points = place_points(surface, surface.motion.pose(code / shot.info.time_codes_per_second))
    corners = points[surface.triangles[held.triangle]]
    return np.einsum("nk,nkd->nd", held.barycentric, corners) + shot.scene.origin


def test_tips_on_a_mesh(read) -> None:
    """Without points, the tips; at the nearest places; a mesh without a role collides with nothing."""
    shot = _shot(read, "rel plait:attach:pin = </World/Table>", others=TABLE)
    (held,) = shot.scene.attachments
    np.testing.assert_array_equal(held.point, TIPS)
    assert held.strands == 0 and held.stiffness == np.inf and isinstance(held.switch, AlwaysOn)
    assert not shot.scene.surfaces[held.surface].collides
    np.testing.assert_allclose(_places(shot, held, 1.0), [(0, 2.5, 0), (1.2, 2.5, 0), (1.5, 2.5, 0)], atol=1e-6)


def test_a_mesh_that_collides_is_one_surface(read) -> None:
    collider = TABLE.replace('"Table"', '"Table" (prepend apiSchemas = ["PhysicsCollisionAPI"])')
    shot = _shot(read, "rel plait:attach:pin = </World/Table>", others=collider)
    surface = shot.scene.surfaces[shot.scene.attachments[0].surface]
    assert surface.collides and [s.name for s in shot.scene.surfaces].count("/World/Table") == 1


def test_points_as_drawn_on_what_moves(read) -> None:
    """Indices of the artist's points, those drawn at one place once; the clamp goes where its prim goes."""
    line = "int[] plait:attach:clamp:points = [3, 2, 5]"
    shot = _shot(read, "rel plait:attach:clamp = </World/Clamp>", line, others=CLAMP, meters=0.01)
    (held,) = shot.scene.attachments
    np.testing.assert_array_equal(held.point, [2, 4])
    np.testing.assert_allclose(_places(shot, held, 1.0), np.tile([0, 0.03, 0], (2, 1)), atol=1e-9)
    np.testing.assert_allclose(_places(shot, held, 10.0), np.tile([0, 0.03, 0.09], (2, 1)), atol=1e-9)
    assert not shot.scene.surfaces[held.surface].collides


def test_the_nearest_points_of_other_strands(read) -> None:
    shot = _shot(read, "rel plait:attach:tie = </World/Rope>", others=ROPE)
    (held,) = shot.scene.attachments
    assert held.surface is None and shot.scene.strands[held.other].name == "/World/Rope"
    np.testing.assert_array_equal(held.point, TIPS)
    np.testing.assert_array_equal(held.other_point, [1, 1, 1])


def test_strands_of_one_prim_each_pair_once(read) -> None:
    """The nearest points of other strands than a point's own; tips 1 and 2 are each other's, and tied once."""
    (held,) = _shot(read, "rel plait:attach:band = </World/Hair>").scene.attachments
    assert held.strands == held.other == 0
    pairs = set(zip(held.point.tolist(), held.other_point.tolist(), strict=True))
    assert pairs == {(2, 5), (5, 8)}


def test_of_several_targets_the_nearest(read) -> None:
    """Tip 0 is .2 from the rope; the others 1.2 or more from its points and .5 from the table."""
    rel = "rel plait:attach:tie = [</World/Table>, </World/Rope>]"
    on_table, on_rope = _shot(read, rel, others=TABLE + ROPE).scene.attachments
    np.testing.assert_array_equal(on_table.point, TIPS[1:])
    np.testing.assert_array_equal(on_rope.point, TIPS[:1])
    assert on_table.surface is not None and on_rope.other is not None


def test_several_attachments_a_prim(read) -> None:
    lines = ["rel plait:attach:a = </World/Clamp>", "int[] plait:attach:a:points = [1]"]
    lines += ["rel plait:attach:b = </World/Clamp>", "int[] plait:attach:b:points = [5, 9]"]
    shot = _shot(read, *lines, others=CLAMP)
    a, b = shot.scene.attachments
    assert a.point.tolist() == [1] and b.point.tolist() == [4, 7]
    assert a.surface == b.surface
    report = next(prim for prim in shot.prims if prim.path == "/World/Hair")
    assert report.attachments == ("a: 1 points to /World/Clamp", "b: 2 points to /World/Clamp")
    assert inspect.as_data(shot)["sizes"]["attached points"] == 3


def test_stiffness_in_the_stages_units(read) -> None:
    """kg/s2, whatever the unit of length."""
    line = "float plait:attach:pin:stiffness = 25"
    for meters in (1.0, 0.01):
        shot = _shot(read, "rel plait:attach:pin = </World/Clamp>", line, others=CLAMP, meters=meters)
        assert shot.scene.attachments[0].stiffness == 25.0


def test_a_clamp_that_opens(read) -> None:
    """Held between time samples, as USD does with bools."""
    line = "bool plait:attach:pin:enabled.timeSamples = { 1: 0, 3: 1, 6: 0 }"
    (held,) = _shot(read, "rel plait:attach:pin = </World/Clamp>", line, others=CLAMP).scene.attachments
    states = [held.switch.on(code / 24.0) for code in (-5, 1, 2.99, 3, 5.5, 6, 9)]
    assert states == [False, False, False, True, True, False, False]


@pytest.mark.parametrize(("value", "count"), [("true", 1), ("false", 0)])
def test_enabled_or_not(read, value: str, count: int) -> None:
    shot = _shot(
        read, "rel plait:attach:pin = </World/Clamp>", f"bool plait:attach:pin:enabled = {value}", others=CLAMP
    )
    assert len(shot.scene.attachments) == count


def test_roots_of_free_strands_may_be_held(read) -> None:
    lines = ["bool plait:free = true", "rel plait:attach:root = </World/Clamp>"]
    lines += ["int[] plait:attach:root:points = [0, 4, 8]"]
    (held,) = _shot(read, *lines, others=CLAMP).scene.attachments
    np.testing.assert_array_equal(held.point, [0, 3, 6])


def test_on_a_skin_drawn_in_its_bind_pose(read) -> None:
    """Hair and skin lie side by side in the bind pose, 3 below where the skeleton is at the first frame."""
    rig = """
    def SkelRoot "Body" (prepend apiSchemas = ["SkelBindingAPI"])
    {
        rel skel:skeleton = </World/Body/Rig>
        def Skeleton "Rig" (prepend apiSchemas = ["SkelBindingAPI"])
        {
            uniform token[] joints = ["A"]
            uniform matrix4d[] bindTransforms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))]
            uniform matrix4d[] restTransforms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))]
            rel skel:animationSource = </World/Body/Walk>
        }
        def SkelAnimation "Walk"
        {
            uniform token[] joints = ["A"]
            float3[] translations.timeSamples = { 1: [(0, 3, 0)], 10: [(0, 3, 9)] }
            quatf[] rotations = [(1, 0, 0, 0)]
            half3[] scales = [(1, 1, 1)]
        }
        %s
    }
    """
    influence = """int[] primvars:skel:jointIndices = [0] (interpolation = "constant")
        float[] primvars:skel:jointWeights = [1] (interpolation = "constant")
        point3f[] points"""
    skin = TABLE.replace("point3f[] points", influence).replace(
        '"Table"', '"Table" (prepend apiSchemas = ["SkelBindingAPI"])'
    )
    shot = _shot(read, "rel plait:attach:pin = </World/Body/Table>", others=rig % skin)
    (held,) = shot.scene.attachments
    np.testing.assert_allclose(_places(shot, held, 1.0), [(0, 5.5, 0), (1.2, 5.5, 0), (1.5, 5.5, 0)], atol=1e-6)
    np.testing.assert_allclose(_places(shot, held, 10.0), [(0, 5.5, 9), (1.2, 5.5, 9), (1.5, 5.5, 9)], atol=1e-6)


def test_on_flesh_and_on_what_is_drawn_in_its_tets(read) -> None:
    """Both are held to the skin of the simulated body."""
    body = """
    def Xform "Block" (prepend apiSchemas = ["PhysicsDeformableBodyAPI", "PhysicsVolumeDeformableSimAPI"])
    {
        def TetMesh "Tets"
        {
            point3f[] points = [(-4, 2.5, -4), (8, 2.5, -4), (0, 2.5, 8), (0, 9, 0)]
            int4[] tetVertexIndices = [(0, 2, 1, 3)]
            int3[] surfaceFaceVertexIndices = [(0, 1, 2), (0, 3, 1), (1, 3, 2), (0, 2, 3)]
        }
        def Mesh "Seen"
        {
            int[] faceVertexCounts = [3]
            int[] faceVertexIndices = [0, 1, 2]
            point3f[] points = [(-1, 2.6, -1), (2, 2.6, -1), (0, 2.6, 2)]
        }
    }
    """
    role = 'token plait:role = "strands"'
    for target in ("Tets", "Seen"):
        shot = _shot(read, role, f"rel plait:attach:pin = </World/Block/{target}>", others=body)
        (held,) = shot.scene.attachments
        assert shot.scene.surfaces[held.surface].body == 0
        np.testing.assert_allclose(
            _places(shot, held, 1.0), [(0, 2.5, 0), (1.2, 2.5, 0), (1.5, 2.5, 0)], atol=1e-6
        )


def test_told_where_it_has_no_effect(read) -> None:
    table = TABLE.replace(
        "int[] faceVertexCounts", "rel plait:attach:pin = </World>\n        int[] faceVertexCounts"
    )
    told = "</World/Table> plait:attach: without effect"
    assert any(told in warning for warning in _shot(read, others=table).warnings)
