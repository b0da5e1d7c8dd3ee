"""The role of each prim, by every row of the table of roles, and what becomes of the others."""

from __future__ import annotations

import numpy as np
import pytest

from plait.solver.scene import Scene

HAIR = """def BasisCurves "Hair" ({schemas})
{{
    uniform token type = "linear"
    int[] curveVertexCounts = [2]
    point3f[] points = [(0, 0, 0), (0, 1, 0)]
    float[] widths = [0.0001] (interpolation = "constant")
    {more}
}}
"""
MESH = """def Mesh "{name}" ({schemas})
{{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(9, 0, 0), (10, 0, 0), (9, 1, 0)]
    {more}
}}
"""


def _hair(schemas: str = "", more: str = "") -> str:
    return HAIR.format(schemas=schemas, more=more)


def _mesh(name: str, schemas: str = "", more: str = "") -> str:
    return MESH.format(name=name, schemas=schemas, more=more)


def _apply(*names: str) -> str:
    return f"prepend apiSchemas = [{', '.join(f'{chr(34)}{name}{chr(34)}' for name in names)}]"


def _roles(shot) -> dict[str, str]:
    return {prim.path: prim.role for prim in shot.prims}


def _colliders(scene: Scene) -> set[str]:
    return {surface.name for surface in scene.surfaces if surface.collides}


# Of an open mesh, whose mass nothing else tells.
MASSIVE = "float physics:mass = 2\n    float3 physics:diagonalInertia = (1, 1, 1)\n    "
MASSIVE += "point3f physics:centerOfMass = (0, 0, 0)"
STRANDS = _apply("PhysicsCurvesDeformableSimAPI")


@pytest.mark.parametrize(
    ("schemas", "more", "role", "supported", "collides"),
    [
        (_apply("PhysicsVolumeDeformableSimAPI"), "", "flesh", True, True),
        (_apply("PhysicsSurfaceDeformableSimAPI"), "", "cloth", False, True),
        (_apply("PhysicsCollisionAPI"), "", "collider", True, True),
        (_apply("PhysicsCollisionAPI"), "bool physics:collisionEnabled = 0", "skipped", True, False),
        (_apply("PhysicsCollisionAPI", "PhysicsRigidBodyAPI", "PhysicsMassAPI"), MASSIVE, "rigid", True, True),
        (_apply("PhysicsRigidBodyAPI"), "", "rigid", False, False),
        (
            _apply("PhysicsCollisionAPI", "PhysicsRigidBodyAPI"),
            "bool physics:kinematicEnabled = 1",
            "animated prop",
            True,
            True,
        ),
        (
            _apply("PhysicsCollisionAPI", "PhysicsRigidBodyAPI"),
            "bool physics:rigidBodyEnabled = 0",
            "collider",
            True,
            True,
        ),
        ("", "", "skipped", True, False),
        ("", 'token plait:role = "collider"', "collider", True, True),
        ("", 'token plait:role = "flesh"', "flesh", True, True),
        ("", 'token plait:role = "enriched"', "enriched", False, False),
        (_apply("PhysicsCollisionAPI"), 'token plait:role = "none"', "skipped", True, False),
        (_apply("PhysicsVolumeDeformableSimAPI"), 'token plait:role = "collider"', "collider", True, True),
    ],
)
def test_meshes(schemas: str, more: str, role: str, supported: bool, collides: bool, read) -> None:
    """What is not simulated stays as authored, so strands collide with it where it is a body's surface."""
    shot = read(_hair(STRANDS) + _mesh("Thing", schemas, more))
    thing = next(prim for prim in shot.prims if prim.path == "/Thing")
    assert (thing.role, thing.supported) == (role, supported)
    assert ("/Thing" in _colliders(shot.scene)) is collides
    assert thing.recognised and (thing.reason or supported)


def test_a_body_above_gives_its_role(read) -> None:
    body = f'def Xform "Body" ({_apply("PhysicsVolumeDeformableSimAPI")})\n{{\n{_mesh("Skin")}}}\n'
    assert _roles(read(_hair(STRANDS) + body))["/Body/Skin"] == "flesh"
    prop = (
        f'def Xform "Prop" ({_apply("PhysicsRigidBodyAPI")})\n{{\n    bool physics:kinematicEnabled = 1\n'
        f"{_mesh('Hull', _apply('PhysicsCollisionAPI'))}}}\n"
    )
    assert _roles(read(_hair(STRANDS) + prop))["/Prop/Hull"] == "animated prop"


def test_plait_role_holds_for_all_beneath(read) -> None:
    group = f'def Xform "Set"\n{{\n    token plait:role = "none"\n{_mesh("A", _apply("PhysicsCollisionAPI"))}}}\n'
    assert _roles(read(_hair(STRANDS) + group))["/Set/A"] == "skipped"


def test_curves_of_a_shot_without_roles_are_strands(read) -> None:
    """Colliders and exclusions are no roles of something simulated."""
    assert _roles(read(_hair()))["/Hair"] == "strands"
    assert _roles(read(_hair() + _mesh("Floor", _apply("PhysicsCollisionAPI"))))["/Hair"] == "strands"
    assert _roles(read(_hair() + _mesh("Hat", "", 'token plait:role = "none"')))["/Hair"] == "strands"


def test_curves_beside_authored_roles_are_left_alone(read) -> None:
    other = _hair(STRANDS).replace('"Hair"', '"Rope"')
    shot = read(_hair() + other)
    assert _roles(shot) == {"/Hair": "skipped", "/Rope": "strands"}
    assert "/Rope" in shot.prims[0].reason and "plait:role" in shot.prims[0].reason


@pytest.mark.parametrize("how", ['token visibility = "invisible"', 'uniform token purpose = "proxy"'])
def test_hidden_prims_take_part_only_if_asked(how: str, read) -> None:
    assert _roles(read(_hair("", how)))["/Hair"] == "skipped"
    assert _roles(read(_hair(STRANDS, how)))["/Hair"] == "strands"
    shot = read(_hair(STRANDS) + _mesh("Hull", _apply("PhysicsCollisionAPI"), how))
    assert "/Hull" in _colliders(shot.scene), "collision shapes are usually hidden"


@pytest.mark.parametrize(
    "mark", ['uniform token purpose = "guide"', 'int[] primvars:groom_guide = [1] (interpolation = "uniform")']
)
def test_guides_are_simulated_and_told_of(mark: str, read) -> None:
    shot = read(_hair("", mark))
    assert _roles(shot)["/Hair"] == "strands"
    assert any("guides" in warning for warning in shot.warnings)


def test_skipped_curves_are_told_of_once_a_reason(read) -> None:
    hidden = _hair("", 'token visibility = "invisible"')
    shot = read(hidden + hidden.replace('"Hair"', '"Beard"'))
    assert [w for w in shot.warnings if "not simulated (and 1 more): invisible" in w and "</Hair>" in w]


def test_what_appears_later_takes_part(read) -> None:
    appears = 'token visibility.timeSamples = { 1: "invisible", 3: "inherited" }'
    assert _roles(read(_hair("", appears)))["/Hair"] == "strands"


def test_empty_curves_are_skipped(read) -> None:
    prim = read('def BasisCurves "Hair" {}\n').prims[0]
    assert (prim.role, prim.reason) == ("skipped", "empty")


def test_an_inactive_prim_is_not_there(read) -> None:
    assert read(_hair("active = false")).prims == ()


def test_a_shot_without_strands_or_flesh_reads_no_skin(read) -> None:
    """A mesh whose points would be refused is never read when nothing could collide with it."""
    broken = _mesh("Floor", _apply("PhysicsCollisionAPI")).replace("(9, 1, 0)", "(nan, 1, 0)")
    shot = read(broken)
    assert shot.scene.surfaces == () and shot.scene.strands == ()
    assert _roles(shot) == {"/Floor": "collider"}


def test_joints_are_reported(read) -> None:
    shot = read(_hair(STRANDS) + 'def PhysicsRevoluteJoint "Hinge"\n{\n}\n')
    hinge = next(prim for prim in shot.prims if prim.path == "/Hinge")
    assert (hinge.role, hinge.supported) == ("rigid", True)
    loose = read(_hair(STRANDS) + 'def PhysicsJoint "Loose"\n{\n}\n').prims[-1]
    assert not loose.supported and "PhysicsJoint" in loose.reason


def test_inside_an_instance_curves_cannot_be_written(read) -> None:
    hair = _hair().replace("def", "    def")
    text = f'class Xform "Asset"\n{{\n{hair}}}\n'
    text += 'def Xform "Copy" (instanceable = true; references = </Asset>)\n{\n}\n'
    prim = next(prim for prim in read(text).prims if prim.path == "/Copy/Hair")
    assert prim.role == "skipped" and "instance" in prim.reason


@pytest.mark.parametrize("shape", ["Cube", "Sphere", "Cylinder", "Cone", "Capsule", "Plane"])
@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_shapes_are_closed_and_face_outwards(shape: str, axis: str, read) -> None:
    """Signed volume (divergence theorem) is that of an inscribed solid: positive, below and near the true one."""
    line = "" if shape in ("Cube", "Sphere") else f'uniform token axis = "{axis}"'
    shot = read(_hair(STRANDS) + f'def {shape} "S" ({_apply("PhysicsCollisionAPI")})\n{{\n    {line}\n}}\n')
    surface = next(s for s in shot.scene.surfaces if s.name == "/S")
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    if shape == "Plane":
        area = 0.5 * np.cross(b - a, c - a).sum(axis=0)
        np.testing.assert_allclose(area, 4.0 * np.eye(3)["XYZ".index(axis)], atol=1e-12)
        return
    volume = np.sum(a * np.cross(b, c)) / 6.0
    # UsdGeom's fallback sizes: size 2, radius 1, height 2 (capsule: radius 0.5, height 1).
    true = {
        "Cube": 8.0,
        "Sphere": 4 / 3 * np.pi,
        "Cylinder": 2 * np.pi,
        "Cone": 2 / 3 * np.pi,
        "Capsule": 0.25 * np.pi + np.pi / 6,
    }[shape]
    # Faces of a solid turned and cut at 32 angles lie no nearer the middle than cos(pi / 32)^2 of its size.
    assert np.cos(np.pi / 32) ** 6 * true <= volume <= true * (1 + 1e-12)
    edges = np.sort(surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2), "every edge has two triangles"
    if shape == "Capsule":
        assert "XYZ"[int(np.argmax(np.ptp(surface.points, axis=0)))] == axis


@pytest.mark.parametrize("left_handed", [False, True])
def test_what_is_mirrored_faces_outwards_all_the_same(left_handed: bool, read) -> None:
    """A tetrahedron of volume 1/6, scaled by -2 along one axis: its signed volume is 1/3."""
    faces = "[0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]"
    turned = "[1, 2, 0, 3, 1, 0, 2, 3, 0, 3, 2, 1]"
    body = f"""    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    int[] faceVertexCounts = [3, 3, 3, 3]
    int[] faceVertexIndices = {turned if left_handed else faces}
    uniform token orientation = "{"leftHanded" if left_handed else "rightHanded"}"
    float3 xformOp:scale = (1, 1, -2)
    uniform token[] xformOpOrder = ["xformOp:scale"]
"""
    shot = read(_hair(STRANDS) + f'def Mesh "S" ({_apply("PhysicsCollisionAPI")})\n{{\n{body}}}\n')
    surface = next(s for s in shot.scene.surfaces if s.name == "/S")
    points = surface.points @ surface.motion.pose(0.0).joint_transforms[0][:3, :3].T
    a, b, c = (points[surface.triangles[:, k]] for k in range(3))
    assert np.sum(a * np.cross(b, c)) / 6.0 == pytest.approx(1.0 / 3.0)
