"""Strands that nothing holds: which, and where they start."""

from __future__ import annotations

import numpy as np

SHOT = """
def Mesh "Table" (prepend apiSchemas = ["PhysicsCollisionAPI"])
{{
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-5, 0, -5), (-5, 0, 5), (5, 0, 5), (5, 0, -5)]
}}
def BasisCurves "Rope" (prepend apiSchemas = ["PhysicsCurvesDeformableSimAPI"])
{{
    uniform token type = "linear"
    int[] curveVertexCounts = [2, 1, 3]
    point3f[] points = [(0, 0.1, 0), (0, 0.1, 1), (4, 4, 4), (1, 0.1, 0), (1, 0.1, 1), (1, 0.1, 2)]
    float[] widths = [0.02] (interpolation = "constant")
    double3 xformOp:translate = (0, 0, 2)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    {line}
}}
"""
PAINTED = 'bool[] primvars:plait:free = [1, 0, 0] (interpolation = "uniform")'


def _roots(shot) -> str:
    return next(prim.roots for prim in shot.prims if prim.path == "/Rope")


def test_no_strand_is_free_unasked(read) -> None:
    shot = read(SHOT.format(line=""))
    assert shot.scene.strands[0].free is None
    assert "on /Table" in _roots(shot)


def test_all_strands_of_a_prim(read) -> None:
    """They grow on nothing, however near: what carries them to where they start is their own prim."""
    shot = read(SHOT.format(line="bool plait:free = true"))
    (rope,) = shot.scene.strands
    np.testing.assert_array_equal(rope.free, [True, True, True])
    surface = shot.scene.surfaces[rope.roots.surface]
    assert surface.name != "/Table" and not surface.collides
    assert _roots(shot).startswith("3 of 3 strands are free")
    start = rope.points @ rope.rest_transform[:3, :3].T + rope.rest_transform[:3, 3] + shot.scene.origin
    np.testing.assert_allclose(start[0], [0, 0.1, 2], atol=1e-7)
    assert read(SHOT.format(line=""), prim={"/Ro*": {"free": True}}).scene.strands[0].free.all()


def test_some_strands_of_a_prim(read) -> None:
    """A value a drawn curve; the others stay rooted, and all start on the skin."""
    (rope,) = read(SHOT.format(line=PAINTED)).scene.strands
    np.testing.assert_array_equal(rope.free, [True, False, False])


def test_a_skin_named_carries_free_strands_to_their_start(read) -> None:
    shot = read(SHOT.format(line="bool plait:free = true\n    rel plait:skin = </Table>"))
    assert shot.scene.surfaces[shot.scene.strands[0].roots.surface].name == "/Table"
