"""Where strands grow: each convention, each way a groom may be drawn, and what is near no skin.

The promise under all of it: at the first frame every strand's root is where it was drawn, and afterwards it keeps
its place on what carries it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from plait.pipeline.config import Config
from plait.pipeline.read import read_shot
from plait.pipeline.read.placing import place_points
from plait.pipeline.shot import Shot

SAMPLE = "samples/Autodesk_arnold-usd/testsuite/test_1814/data/test.usda"

RIG = """
def SkelRoot "Body" (prepend apiSchemas = ["SkelBindingAPI"])
{{
    {placed}
    rel skel:skeleton = </Body/Rig>
    def Skeleton "Rig" (prepend apiSchemas = ["SkelBindingAPI"])
    {{
        uniform token[] joints = ["A", "B"]
        uniform matrix4d[] bindTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))]
        uniform matrix4d[] restTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))]
        rel skel:animationSource = </Body/Walk>
    }}
    def SkelAnimation "Walk"
    {{
        uniform token[] joints = ["A", "B"]
        float3[] translations.timeSamples = {{ 1: [(0, 3, 0), (0, 0, 0)], 10: [(5, 3, 0), (0, 0, 7)] }}
        quatf[] rotations.timeSamples = {{
            1: [(0.8, 0.6, 0, 0), (1, 0, 0, 0)], 10: [(0.6, 0.8, 0, 0), (0, 0, 1, 0)] }}
        half3[] scales = [(1, 1, 1), (1, 1, 1)]
    }}
    {skins}
}}
"""
SKIN = """
    def Mesh "{name}" (prepend apiSchemas = ["SkelBindingAPI"])
    {{
        uniform token subdivisionScheme = "none"
        uniform token orientation = "leftHanded"
        int[] faceVertexCounts = [4, 4, 3, 5]
        int[] faceVertexIndices = [0, 1, 4, 3, 1, 2, 5, 4, 3, 4, 6, 4, 5, 8, 7, 6]
        point3f[] points = {points}
        texCoord2f[] primvars:st = [
            (0, 0), (0.4, 0), (1, 0), (0, 0.5), (0.5, 0.5), (1, 0.6), (0.1, 1), (0.5, 1), (1, 1)] (
            interpolation = "vertex"
        )
        int[] primvars:skel:jointIndices = [{joint}] (
            interpolation = "constant"
        )
        float[] primvars:skel:jointWeights = [1] (
            interpolation = "constant"
        )
    }}
"""
PATCH = np.array(
    [(0, 0, 0), (1, 0, 0.2), (2, 0, 0), (0, 0.2, 1), (1, 0, 1), (2, 0, 1), (0, 0, 2), (1, 0, 2), (2, 0.1, 2)],
    float,
)
WALKS = """double3 xformOp:translate.timeSamples = { 1: (20, 0, 0), 10: (30, 0, 5) }
    uniform token[] xformOpOrder = ["xformOp:translate"]"""


def _by(x: float, y: float, z: float) -> np.ndarray:
    return np.array([x, y, z], dtype=float)


def _tuples(points: np.ndarray) -> str:
    return "[" + ", ".join(f"({x}, {y}, {z})" for x, y, z in points.tolist()) + "]"


def _skin(name: str = "Skin", joint: int = 0, points: np.ndarray = PATCH) -> str:
    return SKIN.format(name=name, joint=joint, points=_tuples(points))


def _rig(*skins: str, placed: str = "") -> str:
    return RIG.format(placed=placed, skins="".join(skins or (_skin(),)))


def _hair(roots: np.ndarray, primvars: str = "", schemas: str = "") -> str:
    points = (roots[:, None] + np.array([(0, 0, 0), (0, 0.3, 0), (0.1, 0.6, 0)])).reshape(-1, 3)
    return f"""
def BasisCurves "Hair" ({schemas})
{{
    uniform token type = "linear"
    int[] curveVertexCounts = {[3] * len(roots)}
    point3f[] points = {_tuples(points)}
    float[] widths = [0.0001] (interpolation = "constant")
    {primvars}
}}
"""


def _quad(u: float, v: float, corners: np.ndarray) -> np.ndarray:
    weights = np.array([(1 - u) * (1 - v), (1 - u) * v, u * v, u * (1 - v)])
    return weights @ corners


FACES = [[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 6], [4, 5, 8, 7, 6]]
PLACES = [(0, 0.2, 0.7), (1, 0.5, 0.5), (2, 0.25, 0.5), (3, 0.3, 0.6), (0, 0.9, 0.1)]


def _spot(face: int, u: float, v: float) -> np.ndarray:
    corners = PATCH[FACES[face]]
    if len(corners) == 4:
        return _quad(u, v, corners)
    if len(corners) == 3:
        return (1 - u - v) * corners[0] + u * corners[1] + v * corners[2]
    along = u * 5
    start = int(along)
    edge = corners[start] + (along - start) * (corners[(start + 1) % 5] - corners[start])
    return edge + v * (corners.mean(axis=0) - edge)


ROOTS = np.array([_spot(*place) for place in PLACES])
FACE_LIST = [place[0] for place in PLACES]
UVS = _tuples(np.array([(u, v, 0) for _, u, v in PLACES]))
NAMED = f"""int[] primvars:skinprim = {FACE_LIST} (interpolation = "uniform")
    float3[] primvars:skinprimuv = {UVS} (interpolation = "uniform")"""
SWAPPED = NAMED.replace(UVS, _tuples(np.array([(v, u, 0) for _, u, v in PLACES])))


def _places(shot: Shot, code: float) -> np.ndarray:
    """(strand_count, 3) the places strands are bound to, in the shot's world, at a time code."""
    strands = shot.scene.strands[0]
    surface = shot.scene.surfaces[strands.roots.surface]
    points = place_points(surface, surface.motion.pose(code / shot.info.time_codes_per_second))
    corners = points[surface.triangles[strands.roots.triangle]]
    return np.einsum("sk,skd->sd", strands.roots.barycentric, corners) + shot.scene.origin


def _drawn(shot: Shot) -> np.ndarray:
    """(strand_count, 3) roots where the artist drew them, in the shot's world, by `rest_transform`."""
    strands = shot.scene.strands[0]
    roots = strands.points[strands.offsets[:-1]]
    return roots @ strands.rest_transform[:3, :3].T + strands.rest_transform[:3, 3] + shot.scene.origin


def _joint_a(code: float, points: np.ndarray) -> np.ndarray:
    """What joint A of the rig does to points, by hand: turn about X, then move."""
    part = (code - 1.0) / 9.0
    start, end = 2.0 * np.arctan2(0.6, 0.8), 2.0 * np.arctan2(0.8, 0.6)
    angle = start + part * (end - start)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([(1, 0, 0), (0, c, -s), (0, s, c)])
    return points @ turn.T + np.array([5.0 * part, 3.0, 0.0])


def _how(shot: Shot) -> str:
    return next(prim.roots for prim in shot.prims if prim.path == "/Hair")


@pytest.mark.parametrize(
    ("primvars", "how"),
    [
        (NAMED, "skinprim and skinprimuv on /Body/Skin"),
        (SWAPPED, "skinprim and skinprimuv, u and v swapped on /Body/Skin"),
        (f'point3f[] primvars:restroot = {_tuples(ROOTS)} (interpolation = "uniform")', "rest on /Body/Skin"),
        (f'point3f[] primvars:rest = {_tuples(ROOTS)} (interpolation = "uniform")', "rest on /Body/Skin"),
        ("rel plait:skin = </Body/Skin>", "plait:skin; closest point on /Body/Skin"),
        ("", "closest point on /Body/Skin"),
    ],
    ids=["skinprim", "swapped", "restroot", "rest", "named", "closest"],
)
def test_conventions(primvars: str, how: str, read) -> None:
    """All find the same places on the bind pose, and those move as the skin does, between frames too."""
    shot = read(_rig() + _hair(ROOTS, primvars))
    assert _how(shot).startswith(how) and _how(shot).endswith("drawn beside its rest shape")
    np.testing.assert_allclose(_drawn(shot), ROOTS, atol=1e-6)
    for code in (1.0, 4.5, 10.0):
        # The places of a quad that is not flat lie off its two triangles by at most its warp.
        np.testing.assert_allclose(_places(shot, code), _joint_a(code, ROOTS), atol=0.06)


def test_the_skins_own_rest(read) -> None:
    """Skin and groom are drawn elsewhere than at rest; `rest` on both says how they belong together."""
    shifted = _by(3, 0, 1)
    own = f'    point3f[] primvars:rest = {_tuples(PATCH + shifted)} (interpolation = "vertex")\n'
    skin = _skin().replace("        point3f[] points", f"    {own}        point3f[] points")
    hair = _hair(ROOTS, f'point3f[] primvars:rest = {_tuples(ROOTS + shifted)} (interpolation = "uniform")')
    shot = read(_rig(skin) + hair)
    assert _how(shot).startswith("rest, on the skin's own rest on /Body/Skin")
    np.testing.assert_allclose(_places(shot, 10.0), _joint_a(10.0, ROOTS), atol=0.06)


def test_texture_coordinates(read) -> None:
    """On flat triangles, places with the same coordinates; there `st` names them exactly."""
    flat = PATCH * [1, 0, 1]
    coordinates = np.array([(0, 0), (0.4, 0), (1, 0), (0, 0.5), (0.5, 0.5), (1, 0.6), (0.1, 1), (0.5, 1), (1, 1)])
    # Inside the triangle 3 4 6, the only face of three corners.
    weights = np.array([(0.2, 0.3, 0.5), (0.6, 0.3, 0.1)])
    roots, named = weights @ flat[[3, 4, 6]], weights @ coordinates[[3, 4, 6]]
    st = ", ".join(f"({u}, {v})" for u, v in named)
    shot = read(
        _rig(_skin(points=flat))
        + _hair(roots, f'texCoord2f[] primvars:groom_root_uv = [{st}] (interpolation = "uniform")')
    )
    assert _how(shot).startswith("texture coordinates on /Body/Skin")
    np.testing.assert_allclose(_places(shot, 10.0), _joint_a(10.0, roots), atol=1e-5)


def test_of_several_skins_the_one_that_agrees(read) -> None:
    """`skinprim` fits every mesh with enough faces; only one has its places where the roots are."""
    far = _skin("Far", joint=1, points=PATCH + _by(0, 0, 40))
    shot = read(_rig(far, _skin()) + _hair(ROOTS, NAMED))
    assert "on /Body/Skin" in _how(shot)


def test_a_convention_that_disagrees_is_not_used(read) -> None:
    wrong = NAMED.replace(str(FACE_LIST), str(FACE_LIST[::-1])).replace("skinprimuv = [(", "skinprimuv = [(1")
    shot = read(_rig(_skin(points=PATCH * 10)) + _hair(ROOTS * 10, wrong))
    assert "closest point" in _how(shot)
    assert any("skinprim" in warning and "not used" in warning for warning in shot.warnings)


def test_drawn_in_the_pose_of_the_first_frame(read) -> None:
    """The groom lies where the skin is at the first frame: it is bound there, and later follows."""
    posed = _joint_a(1.0, ROOTS)
    shot = read(_rig() + _hair(posed, NAMED))
    assert _how(shot).endswith("drawn in the pose of the first frame")
    np.testing.assert_allclose(_drawn(shot), posed, atol=1e-5)
    np.testing.assert_allclose(_places(shot, 1.0), posed, atol=0.06)
    np.testing.assert_allclose(_places(shot, 10.0), _joint_a(10.0, ROOTS), atol=0.06)


def test_drawn_in_the_skins_own_coordinates(read) -> None:
    """A groom made on the mesh as modelled, which its bind transform moves to the skeleton."""
    bind = "        matrix4d primvars:skel:geomBindTransform = "
    bind += "((0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 1, 0), (50, 0, 0, 1))\n"
    skin = _skin().replace("        point3f[] points", f"{bind}        point3f[] points")
    shot = read(_rig(skin) + _hair(ROOTS, NAMED))
    assert _how(shot).endswith("drawn in the skin's own coordinates")
    bound = ROOTS @ np.array([(0, 1, 0), (-1, 0, 0), (0, 0, 1)]) + _by(50, 0, 0)
    np.testing.assert_allclose(_places(shot, 10.0), _joint_a(10.0, bound), atol=0.06)


def test_drawn_in_the_skeletons_coordinates(read) -> None:
    """A groom exported without the transform above its skin."""
    shot = read(_rig(placed=WALKS) + _hair(ROOTS, NAMED))
    assert _how(shot).endswith("drawn in the skeleton's coordinates")
    np.testing.assert_allclose(_places(shot, 10.0), _joint_a(10.0, ROOTS) + _by(30, 0, 5), atol=0.06)


def test_drawn_beside_a_skin_that_walks(read) -> None:
    shot = read(_rig(placed=WALKS) + _hair(ROOTS + _by(20, 0, 0), NAMED))
    assert _how(shot).endswith("drawn beside its rest shape")
    np.testing.assert_allclose(_places(shot, 10.0), _joint_a(10.0, ROOTS) + _by(30, 0, 5), atol=0.06)


def test_on_two_skins_and_on_none(read) -> None:
    """Each strand follows what it is closest to; what is near nothing stays with the curves prim."""
    other = PATCH + _by(0, 0, 40)
    roots = np.concatenate([ROOTS, ROOTS + _by(0, 0, 40), [(90.0, 0, 0)]])
    shot = read(_rig(_skin(), _skin("Other", joint=1, points=other)) + _hair(roots))
    count = len(ROOTS)
    assert "/Body/Skin" in _how(shot) and "/Body/Other" in _how(shot) and "(1 of 11 strands)" in _how(shot)
    np.testing.assert_allclose(_drawn(shot), roots, atol=1e-5)
    placed = _places(shot, 10.0)
    np.testing.assert_allclose(placed[:count], _joint_a(10.0, ROOTS), atol=0.06)
    turned = roots[count : 2 * count] * [-1, 1, -1] + _by(0, 0, 7)
    np.testing.assert_allclose(placed[count : 2 * count], turned, atol=0.06)
    np.testing.assert_allclose(placed[-1], roots[-1], atol=1e-9)
    surfaces = {surface.name: surface.collides for surface in shot.scene.surfaces}
    assert surfaces == {"/Body/Skin": True, "/Body/Other": True, "/Hair (roots)": False}


def test_nothing_grows_on_a_mesh_scaled_to_nothing(read) -> None:
    gone = """float3 xformOp:scale = (0, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:scale"]
        int[] faceVertexCounts"""
    head = _skin("Head").replace(
        '    def Mesh "Head" (prepend apiSchemas = ["SkelBindingAPI"])', 'def Mesh "Head"'
    )
    assert "no skin near" in _how(read(head.replace("int[] faceVertexCounts", gone) + _hair(ROOTS)))


def test_a_mesh_without_a_role_that_hair_grows_on_collides(read) -> None:
    head = _skin("Head").replace(
        '    def Mesh "Head" (prepend apiSchemas = ["SkelBindingAPI"])', 'def Mesh "Head"'
    )
    shot = read(head + _hair(ROOTS))
    report = next(prim for prim in shot.prims if prim.path == "/Head")
    assert (report.role, report.reason) == ("collider", "") and "/Hair grows on it" in report.recognised
    far = read(head + _hair(ROOTS + _by(50, 0, 0)))
    assert [surface.name for surface in far.scene.surfaces] == ["/Hair (roots)"]


def test_skinned_curves_without_a_skin(read) -> None:
    """UsdSkel can bind curves: then the joints of each root carry it."""
    binding = """rel skel:skeleton = </Body/Rig>
    int[] primvars:skel:jointIndices = [0] (interpolation = "constant")
    float[] primvars:skel:jointWeights = [1] (interpolation = "constant")"""
    hair = _hair(ROOTS, binding, 'prepend apiSchemas = ["SkelBindingAPI"]').strip()
    rig = RIG.format(placed="", skins=hair.replace("def BasisCurves", "    def BasisCurves"))
    shot = read(rig)
    assert "its own" not in shot.prims[0].roots and "own skeleton binding" in shot.prims[0].roots
    np.testing.assert_allclose(_places(shot, 10.0), _joint_a(10.0, ROOTS), atol=1e-5)
    assert shot.curves[0].skinned


def test_an_animated_transform_carries_its_curves(read) -> None:
    moving = """double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 10: (0, 0, 9) }
    uniform token[] xformOpOrder = ["xformOp:translate"]"""
    shot = read(_hair(ROOTS, moving))
    np.testing.assert_allclose(_places(shot, 4.0), ROOTS + _by(0, 0, 3), atol=1e-9)


def test_animated_points_carry_their_roots(read) -> None:
    """Roots follow the cache; their triangle turns with the whole prim, also about the strand's own axis."""
    angle = 1.1
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([(c, 0, s), (0, 1, 0), (-s, 0, c)])
    start = (ROOTS[:, None] + np.array([(0, 0, 0), (0, 0.5, 0), (0, 1.0, 0)])).reshape(-1, 3)
    end = start @ turn.T + [2, 0, 0]
    text = _hair(ROOTS)
    at = text.index("point3f[] points = ")
    line = text[at : text.index("\n", at)]
    samples = f"point3f[] points.timeSamples = {{ 1: {_tuples(start)}, 10: {_tuples(end)} }}"
    shot = read(text.replace(line, samples))
    np.testing.assert_allclose(_places(shot, 10.0), ROOTS @ turn.T + [2, 0, 0], atol=1e-6)
    surface = shot.scene.surfaces[0]
    rest = surface.points.reshape(-1, 3, 3)
    placed = surface.motion.pose(10.0 / 24.0).points.reshape(-1, 3, 3)
    np.testing.assert_allclose(placed[:, 1] - placed[:, 0], (rest[:, 1] - rest[:, 0]) @ turn.T, atol=1e-5)


def test_houdini_fur(shared: Path) -> None:
    """The sample's fur names its places by `skinprim`, but not on which mesh: the drawing decides, exactly."""
    shot = read_shot(shared / SAMPLE, Config())
    report = next(prim for prim in shot.prims if prim.role == "strands")
    expected = "skinprim and skinprimuv on /world/geo/cubeB_geo, drawn beside its rest shape"
    assert report.roots == expected
    assert "swapped" not in report.roots
    strands = shot.scene.strands[0]
    surface = shot.scene.surfaces[strands.roots.surface]
    corners = surface.points[surface.triangles[strands.roots.triangle]]
    places = np.einsum("sk,skd->sd", strands.roots.barycentric, corners)
    roots = strands.points[strands.offsets[:-1]]
    # float32 of coordinates up to 12 m
    np.testing.assert_allclose(places, roots, atol=12 * 2.0**-22)
