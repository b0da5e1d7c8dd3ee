"""Meshes and tet meshes as elastic bodies: where nodes go, what holds them, and how points come back."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import trimesh

from plait.pipeline.read import read_shot
from plait.pipeline.read.placing import place_points
from plait.solver.scene import Scene, Surface, TetBody

BALL = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
POINTS, FACES = np.round(BALL.vertices, 6), BALL.faces
LIMB = POINTS * [1.0, 3.0, 1.0]
# Float32 points of a shot of some metres, through a few matrices.
FLOAT32 = 1e-6


def _array(rows: np.ndarray) -> str:
    return "[" + ", ".join(f"({', '.join(f'{x:.9g}' for x in row)})" for row in rows) + "]"


def _mesh(
    points: np.ndarray = POINTS,
    faces: np.ndarray = FACES,
    more: str = "",
    name: str = "Jelly",
    schemas: Sequence[str] = ("PhysicsVolumeDeformableSimAPI",),
    edge: float = 0.45,
) -> str:
    applied = ", ".join(f'"{schema}"' for schema in schemas)
    return textwrap.dedent(f"""
        def Mesh "{name}" (prepend apiSchemas = [{applied}])
        {{
            uniform token subdivisionScheme = "none"
            int[] faceVertexCounts = {[3] * len(faces)}
            int[] faceVertexIndices = {np.asarray(faces).ravel().tolist()}
            point3f[] points = {_array(points)}
            float plait:tetEdge = {edge}
            {more}
        }}
        """)


SKELETON = """
def SkelRoot "Root"
{{
    def Skeleton "Rig" (prepend apiSchemas = ["SkelBindingAPI"])
    {{
        uniform token[] joints = ["A", "A/B", "A/B/C"]
        uniform matrix4d[] bindTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, -1, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 1, 0, 1))]
        uniform matrix4d[] restTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, -1, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 1, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 1, 0, 1))]
        rel skel:animationSource = </Root/Move>
    }}
    def SkelAnimation "Move"
    {{
        uniform token[] joints = ["A", "A/B"]
        float3[] translations = [(3, -1, 0), (0, 1, 0)]
        quatf[] rotations = [({a}), ({b})]
        half3[] scales = [(1, 1, 1), (1, 1, 1)]
        {more}
    }}
    {meshes}
}}
"""
BINDING = """rel skel:skeleton = </Root/Rig>
            int[] primvars:skel:jointIndices = {indices} (elementSize = 2; interpolation = "vertex")
            float[] primvars:skel:jointWeights = {weights} (elementSize = 2; interpolation = "vertex")
            {more}"""


def _skinned(a: str = "1, 0, 0, 0", b: str = "1, 0, 0, 0", more: str = "", of_shapes: str = "", **mesh) -> str:
    """A limb, a ball drawn out along y, on joints A (below) and B (above the middle), blended between."""
    points = mesh.setdefault("points", LIMB)
    upper = np.clip(0.5 + points[:, 1], 0.0, 1.0)
    weights = np.round(np.stack([1.0 - upper, upper], axis=1), 6)
    binding = BINDING.format(indices=[0, 1] * len(points), weights=[float(w) for w in weights.ravel()], more=more)
    schemas = ("PhysicsVolumeDeformableSimAPI", "SkelBindingAPI")
    return SKELETON.format(a=a, b=b, more=of_shapes, meshes=_mesh(more=binding, schemas=schemas, **mesh))


def _body(shot) -> tuple[TetBody, Surface]:
    (body,) = shot.scene.bodies
    return body, shot.scene.surfaces[body.surface]


def _nodes(body: TetBody, time: float) -> np.ndarray:
    """Where the animation alone takes the nodes."""
    held = Surface(
        body.name, body.nodes, np.zeros((0, 3), np.int32), body.motion, body.skinning, body.blend_shapes
    )
    return place_points(held, body.motion.pose(time))


def _embedded(body: TetBody, nodes: np.ndarray) -> np.ndarray:
    return np.einsum("pa,pad->pd", body.embedding.barycentric, nodes[body.tets[body.embedding.tet]])


def _volumes(body: TetBody) -> np.ndarray:
    x = body.nodes[body.tets]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / 6.0


def test_a_prop_is_free_and_its_skin_lies_in_its_tets(read) -> None:
    shot = read(
        _mesh(more="double3 xformOp:translate = (5, 2, 0)\nuniform token[] xformOpOrder = ['xformOp:translate']")
    )
    body, surface = _body(shot)
    assert surface.body == 0 and surface.collides and surface.name == body.name == "/Jelly"
    assert not body.pinned.any() and not body.attachment.any()
    assert (_volumes(body) > 0.0).all()
    np.testing.assert_allclose(_embedded(body, body.nodes), surface.points, atol=1e-12)
    world = _nodes(body, 0.0) + shot.scene.origin
    np.testing.assert_allclose(
        world.mean(axis=0), body.nodes.mean(axis=0) + np.array([5.0, 2.0, 0.0]), atol=FLOAT32
    )
    assert np.all(body.youngs_modulus <= 5e4 * 1.1) and body.density.max() <= 1000.0 * 1.1
    assert set(body.poissons_ratio) == {0.45} and body.law == "fixed-corotated"


def test_parameters_in_the_units_of_the_stage(read) -> None:
    """Centimetres: a pressure of 1 is 1 kg/(cm s2) = 100 Pa, an edge of 45 is 0.45 m, N/m4 is kg/(s2 m3)."""
    more = """float plait:youngsModulus = 80
    float plait:attachStiffness = 2
    float plait:density = 0.002
    token plait:law = "neo-hookean"
    float physics:restitution = 0.25
    float physics:dynamicFriction = 0.7
    float plait:stiffnessDamping = 0.01
    float plait:damping = 3"""
    body, surface = _body(read(_mesh(100.0 * POINTS, more=more, edge=45.0), meters=0.01))
    x = body.nodes[body.tets]
    assert np.linalg.norm(x[:, 1] - x[:, 0], axis=1).mean() == pytest.approx(0.45, rel=0.2)
    whole = body.density.max()
    assert whole == pytest.approx(2000.0, rel=0.1)
    np.testing.assert_allclose(body.youngs_modulus / body.density, 8000.0 / 2000.0, rtol=1e-6)
    volume = (body.density / 2000.0) @ _volumes(body)
    np.testing.assert_allclose(body.attachment.sum(), 2e6 * volume, rtol=1e-6)
    assert (body.law, body.restitution, surface.friction) == ("neo-hookean", 0.25, pytest.approx(0.7))
    assert (body.stiffness_damping, body.mass_damping) == (pytest.approx(0.01), 3.0)


def test_the_core_of_a_character_follows_its_joints(read) -> None:
    """Pinned nodes exist; where all joints do the same, every node does exactly that."""
    turn = "0.7071068, 0, 0.7071068, 0"
    body, surface = _body(read(_skinned(a=turn)))
    assert 0 < body.pinned.sum() < len(body.nodes) and not body.attachment.any()
    np.testing.assert_allclose(body.skinning.joint_weights.sum(axis=1), 1.0, atol=1e-12)
    pose = body.motion.pose(0.0)
    np.testing.assert_allclose(pose.joint_transforms[0], pose.joint_transforms[1], atol=FLOAT32)
    x = body.nodes @ pose.joint_transforms[0][:3, :3].T + pose.joint_transforms[0][:3, 3]
    np.testing.assert_allclose(_nodes(body, 0.0), x, atol=FLOAT32)
    np.testing.assert_allclose(_embedded(body, x), place_points(surface, pose), atol=FLOAT32)


def test_a_bend_between_joints_reaches_the_nodes(read) -> None:
    """What the skin does between the joints, the nodes do to the order of a tet.

    The weights' slope of 1 breaks off at heights of .5: linear tets of edge .25 miss a kink by a quarter of that,
    .06, of the way between what the two joints do there, 1.12 from the joint: at 30 degrees .58.
    """
    body, surface = _body(read(_skinned(b="0.9659258, 0, 0, 0.2588190", edge=0.25)))
    error = np.linalg.norm(
        _embedded(body, _nodes(body, 0.0)) - place_points(surface, surface.motion.pose(0.0)), axis=1
    )
    assert error.max() < 0.06 * 0.58


def test_painted_depth(read) -> None:
    """All bone above, all flesh below; what is painted comes before what is set for all."""
    depth = np.where(LIMB[:, 1] > 0.0, 1.0, 0.0)
    paint = f"float[] primvars:plait:coreDepth = {[float(d) for d in depth]} (interpolation = 'vertex')"
    body, _ = _body(read(_skinned(more=f"{paint}\n            float plait:coreDepth = 0.5")))
    assert body.pinned[body.nodes[:, 1] > 1.5].mean() > 0.8
    assert not body.pinned[body.nodes[:, 1] < -1.5].any()
    for depth, share in ((0.0, 0.0), (1.0, 1.0)):
        body, _ = _body(read(_skinned(more=paint), parameters={"coreDepth": depth}))
        assert body.pinned.mean() == share, "the configuration wins over all"


def test_painted_attachment(read) -> None:
    """Springs are in proportion to the flesh about a node, and what is painted on one side stays there."""
    paint = [float(x) for x in np.where(POINTS[:, 0] > 0.0, 1e4, 0.0)]
    more = f"float[] primvars:plait:attachStiffness = {paint} (interpolation = 'vertex')"
    body, _ = _body(read(_mesh(more=more)))
    held = body.attachment > 0.1 * body.attachment.max()
    assert held[body.nodes[:, 0] > 0.6].any() and not held[body.nodes[:, 0] < -0.6].any()
    assert not body.pinned.any()


def test_a_core_may_be_asked_of_a_prop(read) -> None:
    body, _ = _body(read(_mesh(more="float plait:coreDepth = 0.5")))
    deep = np.linalg.norm(body.nodes, axis=1)
    assert body.pinned.any() and deep[body.pinned].max() < 0.75


def test_shells_inside_out_are_turned(read) -> None:
    """A closed skin's volume is positive whichever way its faces or the stage's handedness go."""
    for faces, more in ((FACES[:, ::-1], ""), (FACES, 'uniform token orientation = "leftHanded"')):
        _, surface = _body(read(_mesh(faces=faces, more=more)))
        a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
        assert np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0 == pytest.approx(BALL.volume, rel=1e-5)


def test_points_come_back_in_the_artists_order(read) -> None:
    """Split along a seam, a point that no face has among them: as many as authored, each where it was."""
    loose = [[0.1, 0.2, 0.3]]
    points = np.concatenate([POINTS[:10], loose, POINTS[10:], POINTS])
    number = np.concatenate([np.arange(10), np.arange(11, len(POINTS) + 1)])
    faces = number[FACES]
    other = FACES[:, 0] % 2 == 0
    faces[other] = len(POINTS) + 1 + FACES[other]
    shot = read(_mesh(points, faces))
    body, surface = _body(shot)
    assert len(surface.points) == len(POINTS), "welded"
    (output,) = shot.meshes
    assert output.point_count == len(points)
    drawn = output.drawn(surface.points, body.nodes)
    np.testing.assert_allclose(drawn, points, atol=FLOAT32)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        output.drawn(surface.points @ turned.T, body.nodes @ turned.T), points @ turned.T, atol=FLOAT32
    )


def test_blend_shapes_move_the_nodes(read) -> None:
    """A shape that lifts the whole ball lifts every node; one that swells it is followed at the skin."""
    offsets = {"Lift": np.tile([0.0, 0.5, 0.0], (len(LIMB), 1)), "Swell": 0.2 * LIMB}
    shapes = "".join(
        f'def BlendShape "{name}" {{\n uniform vector3f[] offsets = {_array(rows)}\n}}\n'
        for name, rows in offsets.items()
    )
    more = f"uniform token[] skel:blendShapes = ['Lift', 'Swell']\n rel skel:blendShapeTargets = " \
           f"[</Root/Jelly/Lift>, </Root/Jelly/Swell>]\n {shapes}"  # fmt: skip
    for weights, move in (("1, 0", lambda x: x + np.array([0.0, 0.5, 0.0])), ("0, 1", lambda x: 1.2 * x)):
        animated = f"uniform token[] blendShapes = ['Lift', 'Swell']\n float[] blendShapeWeights = [{weights}]"
        body, _ = _body(read(_skinned(more=more, of_shapes=animated)))
        pose = body.motion.pose(0.0)
        matrix = pose.joint_transforms[0]
        world = move(body.nodes) @ matrix[:3, :3].T + matrix[:3, 3]
        np.testing.assert_allclose(_nodes(body, 0.0), world, atol=1e-5)


def test_animated_points_take_the_nodes_along(read) -> None:
    """A cache of two samples that differ by an affine map: the nodes go by that map, half way between by half."""
    matrix = np.array([[0.0, -1.0, 0.0], [1.2, 0.0, 0.0], [0.0, 0.3, 0.9]])
    text = _mesh().replace(
        f"points = {_array(POINTS)}",
        f"points.timeSamples = {{ 1: {_array(POINTS)}, 3: {_array(POINTS @ matrix.T)} }}",
    )
    body, _ = _body(read(text))
    assert body.pinned.any() or body.attachment.any(), "a cached character does not fall"
    for code, share in ((1.0, 0.0), (2.0, 0.5), (3.0, 1.0), (5.0, 1.0)):
        expected = body.nodes @ ((1.0 - share) * np.eye(3) + share * matrix).T
        np.testing.assert_allclose(_nodes(body, code / 24.0), expected, atol=1e-5)


TETS = """
def TetMesh "Blob" (prepend apiSchemas = ["PhysicsVolumeDeformableSimAPI"])
{{
    point3f[] points = [(9, 9, 9), (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]
    int4[] tetVertexIndices = [{tets}]
    {more}
}}
"""


@pytest.mark.parametrize(
    ("tets", "more", "warns"),
    [
        ("(1, 2, 3, 4), (2, 3, 4, 5)", "", False),
        ("(1, 3, 2, 4), (2, 4, 3, 5)", 'uniform token orientation = "leftHanded"', False),
        ("(1, 2, 3, 4), (2, 4, 3, 5)", "", True),
    ],
)
def test_a_tet_mesh_is_used_as_it_is(tets: str, more: str, warns: bool, read) -> None:
    """Its points are the nodes, but for one that no tet has; either handedness; tets inside out are turned."""
    shot = read(TETS.format(tets=tets, more=more))
    body, surface = _body(shot)
    (output,) = shot.meshes
    assert output.of_nodes and output.point_count == 6
    np.testing.assert_allclose(_volumes(body), [1 / 6, 1 / 3], rtol=1e-6)
    np.testing.assert_allclose(_embedded(body, body.nodes), surface.points, atol=1e-12)
    assert len(surface.triangles) == 6
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    assert np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0 == pytest.approx(0.5, rel=1e-6)
    held = output.drawn(surface.points, 2.0 * body.nodes)
    np.testing.assert_allclose(held[1:], 2.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]))
    np.testing.assert_allclose(held[0], [18.0] * 3, rtol=1e-6)
    assert any("inside out" in line for line in shot.warnings) is warns


@pytest.mark.parametrize("api_on", ["body", "tets"])
def test_other_meshes_of_a_deformable_body_are_drawn_in_its_tets(api_on: str, read) -> None:
    """As tools lay a deformable body out: a TetMesh to simulate, meshes beside it to look at or to collide with.

    A mesh within the tets follows any affine map of theirs; it is neither a body nor a collider of its own.
    """
    on_body = ["PhysicsDeformableBodyAPI"] if api_on == "tets" else ["PhysicsVolumeDeformableSimAPI"]
    tets = TETS.format(tets="(1, 2, 3, 4), (2, 3, 4, 5)", more="")
    if api_on == "body":
        tets = tets.replace(' (prepend apiSchemas = ["PhysicsVolumeDeformableSimAPI"])', "")
    look = _mesh(0.1 * POINTS + 0.25, name="Look", schemas=("PhysicsCollisionAPI",), more="normal3f[] normals = "
                 + _array(POINTS))  # fmt: skip
    shot = read(f'def Xform "Body" (prepend apiSchemas = ["{on_body[0]}"])\n{{\n{tets}\n{look}\n}}\n')
    body, surface = _body(shot)
    assert [s.name for s in shot.scene.surfaces] == ["/Body/Blob"] == [body.name]
    output = next(output for output in shot.meshes if output.prim_path == "/Body/Look")
    matrix = np.array([[1.0, 0.2, 0.0], [0.0, 1.5, 0.1], [0.3, 0.0, 0.8]])
    drawn = output.drawn(surface.points @ matrix.T, body.nodes @ matrix.T)
    np.testing.assert_allclose(drawn, (0.1 * POINTS + 0.25) @ matrix.T, atol=FLOAT32)
    assert output.normals is not None
    look_report = next(prim for prim in shot.prims if prim.path == "/Body/Look")
    assert look_report.role == "flesh" and "/Body/Blob" in look_report.recognised


def test_tets_of_a_file(read, tmp_path: Path) -> None:
    """Through meshio, in the prim's own units; a file in others does not hold the mesh."""
    import meshio

    corners = np.array([[-2, -2, -2], [8, -2, -2], [-2, 8, -2], [-2, -2, 8]], float)
    meshio.write(tmp_path / "cage.vtk", meshio.Mesh(corners, [("tetra", np.array([[0, 1, 2, 3]]))]))
    body, surface = _body(read(_mesh(more="asset plait:tetMesh = @./cage.vtk@"), meters=0.01))
    np.testing.assert_allclose(body.nodes, 0.01 * corners, atol=1e-9)
    np.testing.assert_allclose(_embedded(body, body.nodes), surface.points, atol=1e-9)
    meshio.write(tmp_path / "cage.vtk", meshio.Mesh(0.01 * corners, [("tetra", np.array([[0, 1, 2, 3]]))]))
    with pytest.raises(Exception, match="do not hold the mesh"):
        read(_mesh(more="asset plait:tetMesh = @./cage.vtk@"), meters=0.01)


def test_hair_grows_on_flesh(read) -> None:
    hair = """
def BasisCurves "Hair" (prepend apiSchemas = ["PhysicsCurvesDeformableSimAPI"])
{
    uniform token type = "linear"
    int[] curveVertexCounts = [2]
    point3f[] points = [(0, 1, 0), (0, 1.3, 0)]
    float[] widths = [0.0001] (interpolation = "constant")
}
def Sphere "Ball" (prepend apiSchemas = ["PhysicsCollisionAPI"])
{
    double3 xformOp:translate = (9, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
    scene: Scene = read(hair + _mesh()).scene
    skin = scene.surfaces[scene.strands[0].roots.surface]
    assert skin.body == 0 and scene.bodies[0].surface == scene.strands[0].roots.surface
    assert {surface.name: surface.body for surface in scene.surfaces} == {"/Ball": None, "/Jelly": 0}


def test_a_slab_is_told_of(read) -> None:
    shot = read(_mesh(POINTS * [1.0, 0.0, 1.0], FACES[:40]))
    assert any("encloses no volume" in line for line in shot.warnings)


@pytest.mark.parametrize("how", ["instance", "shape"])
def test_what_cannot_be_written_is_not_simulated(how: str, read) -> None:
    if how == "instance":
        text = f'class Xform "Asset"\n{{\n{_mesh()}}}\n'
        text += 'def Xform "Copy" (instanceable = true; references = </Asset>) {}\n'
        path, reason = "/Copy/Jelly", "instance"
    else:
        text = 'def Cube "Box" (prepend apiSchemas = ["PhysicsVolumeDeformableSimAPI"]) {}\n'
        path, reason = "/Box", "convert it to a Mesh"
    shot = read(text)
    prim = next(prim for prim in shot.prims if prim.path == path)
    assert (prim.role, prim.supported) == ("flesh", False) and reason in prim.reason
    assert shot.scene.bodies == ()


def test_a_body_above_makes_its_meshes_flesh(read) -> None:
    mesh = _mesh(schemas=("GeomModelAPI",))
    text = f'def Xform "Body" (prepend apiSchemas = ["PhysicsVolumeDeformableSimAPI"])\n{{\n{mesh}}}\n'
    shot = read(text)
    assert [body.name for body in shot.scene.bodies] == ["/Body/Jelly"]
    assert {prim.path: prim.role for prim in shot.prims} == {"/Body": "skipped", "/Body/Jelly": "flesh"}
    empty = read('def Xform "Body" (prepend apiSchemas = ["PhysicsVolumeDeformableSimAPI"]) {}\n')
    assert [(prim.role, prim.supported) for prim in empty.prims] == [("flesh", False)]


def test_inspecting_fills_nothing_and_loads_no_warp(write) -> None:
    """Estimates are within a factor of two; nothing is compiled, not even imported."""
    path = write(_mesh())
    code = f"""
import sys
from pathlib import Path
from plait.pipeline.config import Config
from plait.pipeline.inspect import as_data
from plait.pipeline.read import read_shot
data = as_data(read_shot(Path({str(path)!r}), Config(), fill=False))
assert "warp" not in sys.modules
print(data["prims"][0]["sizes"]["tets (about)"], data["stages"][-1])
"""
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    from plait.pipeline.config import Config

    count = len(read_shot(path, Config()).scene.bodies[0].tets)
    assert 0.5 * count < int(told[0]) < 2.0 * count and told[1] == "tets"
