"""Rigid bodies as UsdPhysics describes them: mass, shape, place and motion, in SI and in the world's axes."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.errors import InputError

BODY = "PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"
# float32 attributes: half a unit in the last place is 6e-8 of a value; a few of them meet.
ROUNDING = 1e-6


MESH = "int[] faceVertexCounts = [{}]\nint[] faceVertexIndices = [{}]\npoint3f[] points = [{}]"
EMPTY, TRIANGLE = MESH.format("", "", ""), MESH.format("3", "0, 1, 2", "(0, 0, 0), (1, 0, 0), (0, 1, 0)")
# A tetrahedron with a fifth point in its middle, to which one of its sides goes in.
DENTED = MESH.format(
    "3, 3, 3, 3, 3, 3",
    "0, 1, 3, 0, 3, 2, 0, 2, 1, 1, 2, 4, 2, 3, 4, 3, 1, 4",
    "(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4), (1, 1, 1)",
)


TURNED = "float3 physics:diagonalInertia = (1, 1, 1)\n"


def _prim(
    kind: str, lines: str = "", schemas: tuple[str, ...] = BODY, inside: str = "", name: str = "Body"
) -> str:
    applied = ", ".join(f'"{schema}"' for schema in schemas)
    metadata = f"(prepend apiSchemas = [{applied}])" if schemas else ""
    return f'def {kind} "{name}" {metadata}\n{{\n{lines}\n{inside}\n}}\n'


def _place(*operations: str) -> str:
    """Lines of operations, given as 'type name = value'."""
    names = ", ".join(f'"xformOp:{operation.split()[1]}"' for operation in operations)
    lines = [f"{kind} xformOp:{rest}" for kind, rest in (operation.split(" ", 1) for operation in operations)]
    return "\n".join([*lines, f"uniform token[] xformOpOrder = [{names}]"])


def _only(shot):
    (body,) = shot.scene.rigid_bodies
    return body


def test_mass_of_a_cube_in_centimetres(read) -> None:
    """m = rho a^3, I = m a^2 / 6; density 1000 kg/m3 where nothing is authored."""
    body = _only(read(_prim("Cube", "double size = 20"), meters=0.01))
    assert body.mass == pytest.approx(8.0, rel=ROUNDING)
    np.testing.assert_allclose(body.inertia, 8.0 * 0.2**2 / 6.0 * np.eye(3), atol=1e-9)
    np.testing.assert_allclose(body.center_of_mass, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("lines", "mass"),
    [
        ("float physics:mass = 3", 3.0),
        ("float physics:density = 500", 4000.0),
        ("float physics:mass = 3\nfloat physics:density = 500", 3.0),
        ("float physics:density = 500\nrel material:binding:physics = </Stuff>", 4000.0),
        ("rel material:binding:physics = </Stuff>", 16000.0),
        ("", 8000.0),
    ],
)
def test_mass_comes_before_density_and_density_before_the_material(lines: str, mass: float, read) -> None:
    stuff = _prim("Material", "float physics:density = 2000", ("PhysicsMaterialAPI",), name="Stuff")
    assert _only(read(_prim("Cube", lines) + stuff)).mass == pytest.approx(mass, rel=ROUNDING)


def test_parts_have_their_own_masses_unless_the_body_has_one(read) -> None:
    """Two balls, 2 m apart, of 1 and 3 kg: the centre lies at their weighted mean, and Steiner's theorem holds."""
    parts = "".join(
        _prim(
            "Sphere",
            f"float physics:mass = {mass}\n" + _place(f"double3 translate = ({x}, 0, 0)"),
            ("PhysicsCollisionAPI", "PhysicsMassAPI"),
            name=name,
        )
        for name, mass, x in (("A", 1, 0), ("B", 3, 2))
    )
    body = _only(read(_prim("Xform", schemas=("PhysicsRigidBodyAPI", "PhysicsMassAPI"), inside=parts)))
    assert body.mass == pytest.approx(4.0, rel=ROUNDING) and len(body.surfaces) == 2
    np.testing.assert_allclose(body.center_of_mass, [1.5, 0.0, 0.0], atol=ROUNDING)
    own, apart = 0.4 * 4.0, 0.75 * 2.0**2  # 2/5 m r^2; reduced mass times distance squared
    np.testing.assert_allclose(body.inertia, np.diag([own, own + apart, own + apart]), atol=1e-5)
    whole = _prim("Xform", "float physics:mass = 8", ("PhysicsRigidBodyAPI", "PhysicsMassAPI"), parts)
    heavy = _only(read(whole))
    assert heavy.mass == pytest.approx(8.0, rel=ROUNDING)
    np.testing.assert_allclose(heavy.inertia, 2.0 * body.inertia, rtol=1e-5, atol=1e-5)


def test_authored_inertia_turns_with_its_axes_and_the_prim(read) -> None:
    """A quarter turn of the axes about x, then one of the prim about z: (1, 2, 3) -> (1, 3, 2) -> (3, 1, 2)."""
    lines = (
        "float physics:mass = 2\nfloat3 physics:diagonalInertia = (1, 2, 3)\n"
        "quatf physics:principalAxes = (0.70710678, 0.70710678, 0, 0)\n"
        "point3f physics:centerOfMass = (1, 0, 0)\n" + _place("double rotateZ = 90")
    )
    body = _only(read(_prim("Cube", lines)))
    np.testing.assert_allclose(body.inertia, np.diag([3.0, 1.0, 2.0]), atol=1e-5)
    np.testing.assert_allclose(body.center_of_mass, [0.0, 1.0, 0.0], atol=1e-6)


def test_a_shape_that_is_animated_is_told(read) -> None:
    """A body keeps the shape of the first frame."""
    shot = read(_prim("Cube", "double size.timeSamples = { 1: 2, 5: 3 }"))
    assert any("</Body> size: is animated" in line for line in shot.warnings)
    np.testing.assert_allclose(np.ptp(shot.scene.surfaces[0].points, axis=0), 2.0)


def test_an_inertia_that_no_body_has_is_told(read) -> None:
    """A plate's largest moment is the sum of the others; more than that none has."""
    for largest, told in ((2, False), (3, True)):
        warnings = read(_prim("Cube", f"float3 physics:diagonalInertia = (1, 1, {largest})")).warnings
        assert any("physics:diagonalInertia" in line for line in warnings) == told


def test_a_part_has_its_own_centre_and_inertia(read) -> None:
    """Of two balls one tells all; the body's follow by Steiner's theorem. Scales move its centre alone."""
    lines = (
        "float physics:mass = 2\npoint3f physics:centerOfMass = (0, 1, 0)\n"
        "float3 physics:diagonalInertia = (1, 2, 3)\n"
        "quatf physics:principalAxes = (0.70710678, 0, 0, 0.70710678)\n"
    )
    told = _prim("Sphere", lines + _place("float3 scale = (3, 3, 3)"), ("PhysicsCollisionAPI", "PhysicsMassAPI"))
    plain = _prim("Sphere", "float physics:mass = 6", ("PhysicsCollisionAPI", "PhysicsMassAPI"), name="Plain")
    body = _only(read(_prim("Xform", schemas=("PhysicsRigidBodyAPI",), inside=told + plain, name="All")))
    # 2 kg at y = 3, turned a quarter about z, so of inertia (2, 1, 3); 6 kg at the origin.
    assert body.mass == pytest.approx(8.0, rel=ROUNDING)
    np.testing.assert_allclose(body.center_of_mass, [0.0, 0.75, 0.0], atol=1e-6)
    apart, own = 2.0 * 6.0 / 8.0 * 3.0**2, 0.4 * 6.0
    np.testing.assert_allclose(body.inertia, np.diag([2.0 + own + apart, 1.0 + own, 3.0 + own + apart]), atol=1e-5)


def test_a_parts_inertia_is_about_its_authored_centre(read) -> None:
    """As UsdPhysicsRigidBodyAPI.ComputeMassProperties has it: the shape's is moved there by Steiner's theorem."""
    lines = "float physics:mass = 5\npoint3f physics:centerOfMass = (0, 2, 0)\n"
    ball = _prim("Sphere", lines, ("PhysicsCollisionAPI", "PhysicsMassAPI"))
    body = _only(read(_prim("Xform", schemas=("PhysicsRigidBodyAPI",), inside=ball, name="All")))
    np.testing.assert_allclose(body.center_of_mass, [0.0, 2.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(body.inertia, np.diag([2.0 + 20.0, 2.0, 2.0 + 20.0]), rtol=1e-6, atol=1e-5)


def test_an_open_mesh_that_tells_all_of_its_mass_is_a_part(read) -> None:
    lines = "float physics:mass = 5\npoint3f physics:centerOfMass = (0, 2, 0)\n"
    lines += f"float3 physics:diagonalInertia = (1, 2, 3)\n{TRIANGLE}"
    sheet = _prim("Mesh", lines, ("PhysicsCollisionAPI", "PhysicsMassAPI"))
    body = _only(read(_prim("Xform", schemas=("PhysicsRigidBodyAPI",), inside=sheet, name="All")))
    np.testing.assert_allclose(body.inertia, np.diag([1.0, 2.0, 3.0]), atol=1e-6)


def test_a_body_that_is_a_collider_itself_has_the_mass_of_all(read) -> None:
    """Its 3 kg lie in itself and its part by volume: a ball of twice the radius has eight parts in nine."""
    inner = _prim(
        "Sphere", "double radius = 2\n" + _place("double3 translate = (9, 0, 0)"), BODY[1:2], name="Part"
    )
    body = _only(read(_prim("Sphere", "float physics:mass = 3", BODY, inner)))
    assert body.mass == pytest.approx(3.0, rel=ROUNDING)
    np.testing.assert_allclose(body.center_of_mass, [8.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("kind", ["Cube", "Sphere", "Cylinder", "Cone", "Capsule"])
def test_masses_in_closed_form_off_the_centre(kind: str, read) -> None:
    """Under a scale of 2, of a unit shape of density 500, 3 m off the body's origin."""
    rho, r, h = 500.0, 2.0, 4.0
    ball, barrel = 4.0 / 3.0 * np.pi * r**3, np.pi * r**2 * h
    volume, center, about = {
        "Cube": ((2 * r) ** 3, 0.0, (2 * r) ** 2 / 6.0),
        "Sphere": (ball, 0.0, 0.4 * r**2),
        "Cylinder": (barrel, 0.0, 0.5 * r**2),
        "Cone": (barrel / 3.0, -h / 4.0, 0.3 * r**2),
        "Capsule": (barrel + ball, 0.0, (0.5 * barrel + 0.4 * ball) * r**2 / (barrel + ball)),
    }[kind]
    size = {"Cube": "double size = 2", "Sphere": "double radius = 1"}.get(
        kind, "double radius = 1\ndouble height = 2"
    )
    lines = f"{size}\nfloat physics:density = {rho}\n" + _place(
        "double3 translate = (3, 0, 0)", "float3 scale = (2, 2, 2)"
    )
    part = _prim(kind, lines, ("PhysicsCollisionAPI", "PhysicsMassAPI"), name="Part")
    body = _only(read(_prim("Xform", schemas=("PhysicsRigidBodyAPI",), inside=part)))
    assert body.mass == pytest.approx(rho * volume, rel=1e-6)
    np.testing.assert_allclose(body.center_of_mass, [3.0, 0.0, center], atol=1e-6)
    assert body.inertia[2, 2] == pytest.approx(rho * volume * about, rel=1e-6)


def test_velocities_are_in_degrees_and_the_parents_space(read) -> None:
    inner = _prim(
        "Cube", "vector3f physics:velocity = (100, 0, 0)\nvector3f physics:angularVelocity = (180, 0, 0)"
    )
    turned = f'def Xform "Up"\n{{\n{_place("double rotateZ = 90")}\n{inner}}}\n'
    body = _only(read(turned, meters=0.01))
    np.testing.assert_allclose(body.velocity, [0.0, 1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(body.angular_velocity, [0.0, np.pi, 0.0], atol=1e-9)
    place = _place("double rotateZ = 90", "float3 scale = (2, 3, 4)")
    body = _only(read(f'def Xform "Up"\n{{\n{place}\n{inner}}}\n', meters=0.01))
    np.testing.assert_allclose(body.velocity, [0.0, 2.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(body.angular_velocity, [0.0, np.pi, 0.0], atol=1e-9)


def test_what_is_mirrored_has_its_inertia_and_spin_mirrored(read) -> None:
    """I -> Q I Q^T; a spin is an axial vector, w -> det(Q) Q w."""
    lines = "float physics:mass = 1\nfloat3 physics:diagonalInertia = (1, 2, 4)\n"
    lines += "quatf physics:principalAxes = (0.8, 0, 0.6, 0)\nvector3f physics:angularVelocity = (10, 20, 30)\n"
    place = "float xformOp:rotateZ = 25\nfloat3 xformOp:scale = ({}, 1, 1)\n"
    place += 'uniform token[] xformOpOrder = ["xformOp:rotateZ", "xformOp:scale"]'
    plain, mirrored = (
        _only(read(_prim("Xform", place.format(x), (), _prim("Cube", lines), "Group"))) for x in (1, -1)
    )
    angle = np.radians(25.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    flip = turn @ np.diag([-1.0, 1.0, 1.0]) @ turn.T
    np.testing.assert_allclose(mirrored.inertia, flip @ plain.inertia @ flip.T, atol=1e-6)
    np.testing.assert_allclose(mirrored.angular_velocity, -flip @ plain.angular_velocity, atol=1e-6)


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize("kind", ["Cylinder", "Cone", "Capsule"])
def test_shapes_keep_their_axis_and_bake_one_scale(kind: str, axis: str, read) -> None:
    """The drawn polygons are inscribed in the shape, and reach its ends."""
    lines = f'double radius = 0.5\ndouble height = 3\nuniform token axis = "{axis}"\n'
    lines += _place("double3 translate = (1, 2, 3)", "double rotateX = 30", "float3 scale = (2, 2, 2)")
    surface = read(_prim(kind, lines)).scene.surfaces[0]
    shape = surface.shape
    assert shape.kind == kind.lower() and shape.size[:2] == pytest.approx([1.0, 3.0])
    local = (surface.points - shape.frame[:3, 3]) @ shape.frame[:3, :3]
    top = 4.0 if kind == "Capsule" else 3.0
    assert local[:, 2].max() == pytest.approx(top) and local[:, 2].min() == pytest.approx(-top)
    across = np.linalg.norm(local[:, :2], axis=1)
    assert across.max() == pytest.approx(1.0)
    if kind == "Cone":
        assert across[np.argmax(local[:, 2])] == pytest.approx(0.0, abs=1e-12), "the apex is at +z"


@pytest.mark.parametrize("kind", ["none", "convexHull", "boundingCube", "boundingSphere", "convexDecomposition"])
def test_what_touches_for_a_mesh(kind: str, read) -> None:
    """A bounding shape touches and has the mass; hollows stay, and that is said."""
    lines = f'{DENTED}\nuniform token physics:approximation = "{kind}"\n' + _place("float3 scale = (2, 2, 2)")
    shot = read(_prim("Mesh", lines, (*BODY, "PhysicsMeshCollisionAPI")))
    shape, mass = shot.scene.surfaces[0].shape, _only(shot).mass
    told = any("physics:approximation" in line for line in shot.warnings)
    assert told == kind.startswith("convex")
    if kind == "boundingCube":
        assert shape.kind == "box" and mass == pytest.approx(1000.0 * 8.0**3)
        np.testing.assert_allclose(shape.size, 4.0)
        np.testing.assert_allclose(shape.frame[:3, 3], 4.0)
    elif kind == "boundingSphere":
        assert shape.kind == "sphere" and shape.size[0] == pytest.approx(4.0 * np.sqrt(3.0))
    else:
        assert shape is None


@pytest.mark.parametrize(("kind", "newer"), [("Cylinder", "Cylinder_1"), ("Capsule", "Capsule_1")])
def test_newer_shapes_are_the_older_where_their_radii_are_alike(kind: str, newer: str, read) -> None:
    """With two radii what touches is drawn; of a cylinder that is a frustum, V = pi h (a^2 + a b + b^2) / 3."""
    same = [
        read(_prim(name, f"double height = 3\n{radii}")).scene.surfaces[0]
        for name, radii in (
            (kind, "double radius = 0.5"),
            (newer, "double radiusTop = 0.5\ndouble radiusBottom = 0.5"),
        )
    ]
    assert same[0].shape.kind == same[1].shape.kind == kind.lower()
    np.testing.assert_array_equal(same[0].shape.size, same[1].shape.size)
    np.testing.assert_array_equal(same[0].points, same[1].points)
    two = read(_prim(newer, "double height = 3\ndouble radiusTop = 0.5\ndouble radiusBottom = 1"))
    points = two.scene.surfaces[0].points
    assert two.scene.surfaces[0].shape is None
    caps = (1.0, 0.5) if kind == "Capsule" else (0.0, 0.0)
    assert points[:, 2].min() == pytest.approx(-1.5 - caps[0]) and points[:, 2].max() == pytest.approx(
        1.5 + caps[1]
    )
    if kind == "Cylinder":
        frustum = 1000.0 * np.pi * 3.0 * (0.25 + 0.5 + 1.0) / 3.0
        # A polygon of 32 sides has sin(2 pi / 32) / (2 pi / 32) of its circle's area.
        assert _only(two).mass == pytest.approx(frustum * np.sinc(1.0 / 16.0), rel=1e-6)


def test_what_is_drawn_beneath_a_body_carries_hair_and_touches_nothing(read) -> None:
    """A render mesh beside the shape that collides: hair on it, and hair on nothing, goes where the body goes."""
    role = 'token plait:role = "strands"\n' + 'uniform token type = "linear"\nint[] curveVertexCounts = [3]\n'
    hair = "".join(
        _prim("BasisCurves", f"{role}point3f[] points = [{points}]\nfloat[] widths = [0.001]", (), name=name)
        for name, points in (
            ("OnMesh", "(1, 1, 0), (1.2, 1.2, 0), (1.4, 1.4, 0)"),
            ("OnNothing", "(50, 0, 0), (51, 0, 0), (52, 0, 0)"),
        )
    )
    drawn = _prim("Mesh", DENTED, (), name="Drawn")
    proxy = _prim("Cube", schemas=("PhysicsCollisionAPI",), name="Proxy")
    lines = _place("double3 translate = (0, 9, 0)", "double rotateZ = 30", "float3 scale = (2, 1, 1)")
    text = _prim("Xform", lines, ("PhysicsRigidBodyAPI",), drawn + proxy + hair)
    shot = read(text)
    scene = shot.scene
    assert {surface.name: surface.collides for surface in scene.surfaces} == {
        "/Body/Drawn": False, "/Body/Proxy": True, "/Body/OnNothing (roots)": False,
    }  # fmt: skip
    assert all(surface.rigid == 0 for surface in scene.surfaces) and not any("/Body/" in w for w in _moves(shot))
    turn = np.array([[np.sqrt(0.75), -0.5], [0.5, np.sqrt(0.75)]])
    for strands, root in zip(scene.strands, ((1.0, 1.0), (50.0, 0.0)), strict=True):
        to_world = scene.rigid_bodies[0].motion.pose(1 / 24).joint_transforms[0]
        place = to_world[:3, :3] @ strands.points[0] + to_world[:3, 3] + scene.origin
        np.testing.assert_allclose(place[:2], turn @ np.multiply(root, (2.0, 1.0)) + (0.0, 9.0), atol=1e-5)
    kinds = {prim.path: prim.role for prim in shot.prims}
    assert kinds["/Body/Drawn"] == "carrier" and kinds["/Body/Proxy"] == "rigid"


def _moves(shot) -> list[str]:
    return [warning for warning in shot.warnings if "does not move with the rigid body" in warning]


def test_what_cannot_go_with_the_body_it_is_drawn_beneath_is_said(read) -> None:
    sand = 'token plait:role = "sand"\nfloat plait:rate = 100\nfloat3 plait:velocity = (0, -1, 0)'
    text = _prim("Cube", inside=_prim("Cube", sand, (), name="Nozzle"))
    assert any("</Body/Nozzle>" in warning for warning in _moves(read(text)))


def test_colliders_beneath_a_body_are_its_parts_or_go_with_it(read) -> None:
    """As UsdPhysics has it a disabled body is none; a kinematic one beneath another has no mass in that."""
    collider = _prim("Cube", schemas=("PhysicsCollisionAPI",))
    off, held = (
        _prim("Xform", f"bool physics:{line}", ("PhysicsRigidBodyAPI",), collider, name)
        for line, name in (("rigidBodyEnabled = 0", "Off"), ("kinematicEnabled = 1", "Held"))
    )
    shot = read(_prim("Xform", schemas=("PhysicsRigidBodyAPI",), inside=off + held, name="All"))
    assert {prim.path: prim.role for prim in shot.prims} == {
        "/All": "rigid", "/All/Off/Body": "rigid", "/All/Held": "animated prop", "/All/Held/Body": "animated prop",
    }  # fmt: skip
    assert [(surface.rigid, surface.collides) for surface in shot.scene.surfaces] == [(0, True), (0, True)]
    assert _only(shot).mass == pytest.approx(8000.0) and not _moves(shot)
    alone = read(_prim("Cube") + off).scene.surfaces
    assert [(surface.rigid, surface.collides) for surface in alone] == [(0, True), (None, True)]


def test_a_collider_by_role_beneath_a_body_is_part_of_it(read) -> None:
    """On the body itself, or above it, the role stands over its physics."""
    role = 'token plait:role = "collider"'
    part = _prim("Cube", role, (), name="Part")
    assert len(_only(read(_prim("Xform", schemas=("PhysicsRigidBodyAPI",), inside=part))).surfaces) == 1
    still = read(_prim("Xform", "bool physics:kinematicEnabled = 1", ("PhysicsRigidBodyAPI",), part))
    assert not still.scene.rigid_bodies
    assert {prim.path: prim.role for prim in read(_prim("Cube", role)).prims} == {"/Body": "collider"}


@pytest.mark.parametrize("name", ["kinematicEnabled", "rigidBodyEnabled", "collisionEnabled"])
def test_switches_count_at_the_first_frame_and_what_they_do_later_is_said(name: str, read) -> None:
    """Samples alone: the schema's fallback, which is what a value without a time is, must not be taken."""
    massive = "float physics:mass = 1\nfloat3 physics:diagonalInertia = (1, 1, 1)\n"
    for first in (0, 1):
        one = read(_prim("Cube", f"{massive}bool physics:{name} = {first}"))
        shot = read(_prim("Cube", f"{massive}bool physics:{name}.timeSamples = {{1: {first}, 5: {1 - first}}}"))
        assert any(f"physics:{name}: is animated" in warning for warning in shot.warnings)
        assert [prim.role for prim in shot.prims] == [prim.role for prim in one.prims]
        assert len(shot.scene.surfaces) == len(one.scene.surfaces)


def test_prototypes_of_an_instancer_do_not_collide_and_that_is_said(read) -> None:
    """They would at their own place, where none of their instances is."""
    rock = _prim("Cube", schemas=("PhysicsCollisionAPI",), name="Rock")
    shot = read(_prim("Cube", name="Body") + _prim("PointInstancer", schemas=(), inside=rock, name="Rocks"))
    assert [surface.name for surface in shot.scene.surfaces] == ["/Body"]
    assert any("</Rocks/Rock>" in warning and "PointInstancer" in warning for warning in shot.warnings)
    (held,) = [prim for prim in read(_prim("PointInstancer", inside=rock)).prims if prim.path == "/Body/Rock"]
    assert not held.supported and "PointInstancer" in held.reason


def test_a_plane_ends_where_it_is_drawn_and_that_is_said(read) -> None:
    floor = _prim("Plane", schemas=("PhysicsCollisionAPI",), name="Floor")
    assert any("</Floor>" in warning and "endless" in warning for warning in read(_prim("Cube") + floor).warnings)


def test_uneven_scales(read) -> None:
    """A box stays one; a ball becomes what is drawn, and that is said."""
    place = _place("float3 scale = (1, 2, 3)")
    box = read(_prim("Cube", place))
    np.testing.assert_allclose(box.scene.surfaces[0].shape.size, [1.0, 2.0, 3.0])
    assert _only(box).mass == pytest.approx(1000.0 * 2 * 4 * 6)
    ball = read(_prim("Sphere", place))
    assert ball.scene.surfaces[0].shape is None
    assert any("</Body>" in warning and "polygons" in warning for warning in ball.warnings)
    assert 0.9 < _only(ball).mass / (1000.0 * 4 / 3 * np.pi * 6) < 1.0, "inscribed"


def test_materials_give_friction_and_restitution(read) -> None:
    lines = "float physics:dynamicFriction = 0.7\nfloat physics:restitution = 0.25"
    stuff = _prim("Material", lines, ("PhysicsMaterialAPI",), name="Stuff")
    shot = read(_prim("Cube", "rel material:binding:physics = </Stuff>") + stuff)
    assert shot.scene.surfaces[0].friction == pytest.approx(0.7)
    assert _only(shot).restitution == pytest.approx(0.25)
    assert read(_prim("Cube")).scene.surfaces[0].friction is None, "left to the solver's own"
    still = _prim("Cube", "rel material:binding:physics = </Stuff>", ("PhysicsCollisionAPI",), name="Still")
    scene = read(_prim("Cube") + still + stuff).scene
    assert [scene.restitution(surface) for surface in scene.surfaces] == pytest.approx([0.0, 0.25])


def test_what_is_not_simulated(read) -> None:
    assert not read(_prim("Cube", "bool physics:kinematicEnabled = 1")).scene.rigid_bodies
    assert not read(_prim("Cube", "bool physics:rigidBodyEnabled = 0")).scene.rigid_bodies
    massive = "float physics:mass = 1\nfloat3 physics:diagonalInertia = (1, 1, 1)\n"
    off = read(_prim("Cube", massive + "bool physics:collisionEnabled = 0"))
    assert not off.scene.surfaces and _only(off).mass == 1.0
    awake = read(_prim("Cube", "bool physics:startsAsleep = 1"))
    assert any("startsAsleep" in warning for warning in awake.warnings)


@pytest.mark.parametrize(
    ("text", "attribute"),
    [
        (_prim("Cube", "float physics:mass = -1"), "physics:mass"),
        (_prim("Cube", "float3 physics:diagonalInertia = (1, -1, 1)"), "physics:diagonalInertia"),
        (_prim("Cube", "point3f physics:centerOfMass = (nan, 0, 0)"), "physics:centerOfMass"),
        (_prim("Cube", "vector3f physics:velocity = (inf, 0, 0)"), "physics:velocity"),
        (_prim("Cube", "vector3f physics:velocity = (0, 1e30, 0)"), "physics:velocity"),
        (_prim("Cube", "vector3f physics:angularVelocity = (0, 1e20, 0)"), "physics:angularVelocity"),
        (_prim("Cube", 'string physics:velocity = "fast"'), "physics:velocity"),
        (_prim("Cube", 'string physics:mass = "two"'), "physics:mass"),
        (_prim("Cube", "string physics:kinematicEnabled = 'yes'"), "physics:kinematicEnabled"),
        (_prim("Cube", f"{TURNED}quatf physics:principalAxes = (nan, 0, 0, 0)"), "physics:principalAxes"),
        (_prim("Cube", "float physics:mass = inf"), "physics:mass"),
        (_prim("Cube", 'string physics:mass = "heavy"'), "physics:mass"),
        (_prim("Cube", "float physics:velocity = 1"), "physics:velocity"),
        (_prim("Cube", 'string size = "large"'), "size"),
        (_prim("Cube", "float physics:density = -2"), "physics:density"),
        (_prim("Cube", _place("double3 translate = (nan, 0, 0)")), "xformOpOrder"),
        (_prim("Cube", _place("float3 scale = (0, 1, 1)")), "xformOpOrder"),
        (_prim("Cylinder", 'uniform token axis = "Q"'), "axis"),
        (_prim("Mesh", EMPTY), "has no triangle"),
        (_prim("Mesh", TRIANGLE), "encloses no volume"),
    ],
)
def test_values_that_cannot_be_are_refused_by_name(text: str, attribute: str, read) -> None:
    with pytest.raises(InputError) as caught:
        read(text)
    assert "</Body>" in str(caught.value) and attribute in str(caught.value)
