"""Joints as UsdPhysics describes them, and pairs that do not touch."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.errors import InputError

CUBE = """def Cube "{name}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"{more}])
{{
    double3 xformOp:translate = ({x}, 0, 0)
    float xformOp:rotateZ = 90
    float3 xformOp:scale = (3, 3, 3)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ", "xformOp:scale"]
    {lines}
}}
"""


def _cube(name: str, x: float, lines: str = "", more: str = "") -> str:
    return CUBE.format(name=name, x=x, lines=lines, more=more)


def _joint(kind: str, lines: str = "", body0: str = "/A", body1: str = "/B") -> str:
    sides = [f"rel physics:body{k} = <{path}>" for k, path in enumerate((body0, body1)) if path]
    return f'def Physics{kind}Joint "J"\n{{\n' + "\n".join([*sides, lines]) + "\n}\n"


BOTH = _cube("A", 100) + _cube("B", 800)
MIDDLE = "point3f physics:localPos0 = (0, -100, 0)\npoint3f physics:localPos1 = (0, 100, 0)\n"


def _only(shot):
    (joint,) = shot.scene.joints
    return joint


def _in_world(shot, joint, side: int) -> np.ndarray:
    body = joint.bodies[side]
    motion = joint.motion if body is None else shot.scene.rigid_bodies[body].motion
    return motion.pose(1 / 24).joint_transforms[0] @ joint.frames[side]


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_frames_meet_where_they_are_authored(axis: str, read) -> None:
    """Local (0, -100, 0), scaled by three and turned a quarter about z, is (300, 0, 0) cm away."""
    shot = read(BOTH + _joint("Revolute", f'{MIDDLE}uniform token physics:axis = "{axis}"'), meters=0.01)
    joint = _only(shot)
    assert joint.kind == "revolute" and joint.bodies == (0, 1) and not joint.collide and joint.limits is None
    wanted = {"X": (0, 1, 0), "Y": (-1, 0, 0), "Z": (0, 0, 1)}[axis]
    for side, x in ((0, 4.0), (1, 5.0)):
        frame = _in_world(shot, joint, side)
        np.testing.assert_allclose(frame[:3, 3] + shot.scene.origin, [x, 0, 0], atol=1e-6)
        np.testing.assert_allclose(frame[:3, 2], wanted, atol=1e-7)


def test_limits_are_degrees_and_stage_units(read) -> None:
    limits = "float physics:lowerLimit = -45\nfloat physics:upperLimit = 90"
    turned = _only(read(BOTH + _joint("Revolute", limits), meters=0.01))
    np.testing.assert_allclose(turned.limits, np.radians([-45.0, 90.0]))
    np.testing.assert_allclose(_only(read(BOTH + _joint("Prismatic", limits), meters=0.01)).limits, [-0.45, 0.9])
    cone = "float physics:coneAngle0Limit = 30\nfloat physics:coneAngle1Limit = 30"
    ball = _only(read(BOTH + _joint("Spherical", cone)))
    assert ball.cone == pytest.approx(np.radians(30.0)) and ball.limits is None
    with pytest.raises(InputError, match="physics:lowerLimit"):
        read(BOTH + _joint("Revolute", "float physics:lowerLimit = 9\nfloat physics:upperLimit = -9"))


def test_limits_beyond_half_a_turn_are_measured_from_their_middle(read) -> None:
    """-10 to 270 degrees are 140 either way of 130; so is a drive's target."""
    applied = '"J" (prepend apiSchemas = ["PhysicsDriveAPI:angular"])'
    lines = "float physics:lowerLimit = {}\nfloat physics:upperLimit = {}\n"
    drive = "float drive:angular:physics:stiffness = 1\nfloat drive:angular:physics:targetPosition = 200"
    whole = _only(read(BOTH + _joint("Revolute")))
    joint = _only(read(BOTH + _joint("Revolute", lines.format(-10, 270) + drive).replace('"J"', applied)))
    np.testing.assert_allclose(joint.limits, np.radians([-140.0, 140.0]))
    assert joint.drive.target == pytest.approx(np.radians(70.0))
    turn = np.linalg.inv(whole.frames[0]) @ joint.frames[0]
    np.testing.assert_allclose(turn[:2, 0], [np.cos(np.radians(130.0)), np.sin(np.radians(130.0))], atol=1e-7)
    np.testing.assert_array_equal(whole.frames[1], joint.frames[1])
    for lower, upper, limits, said in (
        (0, 360, None, False),
        (-360, 360, None, True),
        ("-inf", 90, (-180.0, 90.0), True),
        ("-inf", "inf", None, False),
    ):
        shot = read(BOTH + _joint("Revolute", lines.format(lower, upper)))
        found = _only(shot).limits
        assert found == (None if limits is None else pytest.approx(np.radians(limits)))
        assert any("Limit" in warning for warning in shot.warnings) == said


@pytest.mark.parametrize("kinematic", [False, True])
def test_a_side_may_be_the_world_or_what_is_animated(kinematic: bool, read) -> None:
    """Nothing named is the stage's own origin; a kinematic body carries its side."""
    lines = "point3f physics:localPos0 = (0, 0, 5)\nbool physics:collisionEnabled = 1"
    held = _cube("A", 100, "bool physics:kinematicEnabled = 1") + _cube("B", 800)
    shot = read(held + _joint("Fixed", lines, body0="/A" if kinematic else ""), meters=0.01)
    joint = _only(shot)
    assert joint.bodies == (None, 0) and joint.collide
    expected = [1.0, 0.0, 0.15] if kinematic else [0.0, 0.0, 0.05]
    np.testing.assert_allclose(_in_world(shot, joint, 0)[:3, 3] + shot.scene.origin, expected, atol=1e-9)


def test_what_holds_nothing_is_left_out(read) -> None:
    shot = read(BOTH + _joint("Fixed", body0="", body1=""))
    assert not shot.scene.joints and any("</J>" in warning for warning in shot.warnings)
    assert not read(BOTH + _joint("Fixed", "bool physics:jointEnabled = 0")).scene.joints


def test_a_joint_that_lets_go_later_holds_and_that_is_said(read) -> None:
    for first in (0, 1):
        lines = f"bool physics:jointEnabled.timeSamples = {{1: {first}, 5: {1 - first}}}"
        shot = read(BOTH + _joint("Fixed", lines))
        assert len(shot.scene.joints) == first and len(shot.scene.filtered) == first
        assert any("</J> physics:jointEnabled: is animated" in warning for warning in shot.warnings)


def test_what_is_not_active_holds_nothing(read) -> None:
    shot = read(BOTH.replace('"A" (', '"A" (active = false\n') + _joint("Fixed"))
    assert not shot.scene.joints and any(
        "</J>" in warning and "not active" in warning for warning in shot.warnings
    )


@pytest.mark.parametrize("turn", [0.0, 30.0, 77.0])
def test_mirrored_hinges_keep_their_line(turn: float, read) -> None:
    """All mirrored and turned alike: the axis lies along what is drawn, and the frames stay together."""
    group = f"""def Xform "Group"
{{
    float xformOp:rotateX = {turn}
    float3 xformOp:scale = (-1, 1, 1)
    uniform token[] xformOpOrder = ["xformOp:rotateX", "xformOp:scale"]
{BOTH}
}}
"""
    lines = f"{MIDDLE}quatf physics:localRot0 = (0.8, 0, 0.6, 0)\nquatf physics:localRot1 = (0.8, 0, 0.6, 0)\n"
    joint = _joint("Revolute", lines, "/Group/A", "/Group/B")
    shot = read(group + joint, meters=0.01)
    # The axis X, turned about Y by 2 acos(.8), then by the cube's quarter about Z, mirrored, and turned about X.
    drawn = np.array([-0.0, 0.28, -0.96])
    angle = np.radians(turn)
    rolled = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    frames = [_in_world(shot, _only(shot), side) for side in (0, 1)]
    np.testing.assert_allclose(np.abs(frames[0][:3, 2] @ rolled @ drawn), 1.0, atol=1e-6)
    np.testing.assert_allclose(frames[0][:3, :3], frames[1][:3, :3], atol=1e-6)
    assert np.linalg.det(frames[0][:3, :3]) == pytest.approx(1.0)


def test_filtered_pairs(read) -> None:
    apart = _cube("A", 100, "rel physics:filteredPairs = </B>", ', "PhysicsFilteredPairsAPI"') + _cube("B", 800)
    shot = read(apart)
    names = [surface.name for surface in shot.scene.surfaces]
    assert shot.scene.filtered == ((names.index("/A"), names.index("/B")),)


def test_a_filtered_pair_that_is_not_there_is_told(read) -> None:
    gone = _cube("A", 100, "rel physics:filteredPairs = </Gone>", ', "PhysicsFilteredPairsAPI"')
    assert any("</A> physics:filteredPairs: names </Gone>" in line for line in read(gone).warnings)


def test_a_joint_that_usd_does_not_know_is_told(read) -> None:
    warnings = read(BOTH + _joint("Gear")).warnings
    assert any("</J>" in line and "PhysicsGearJoint" in line for line in warnings)


def test_a_joint_keeps_what_it_holds_apart(read) -> None:
    """Also from what is not simulated; unless it says otherwise."""
    ground = 'def Cube "A" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {}\n'
    enabled = "bool physics:collisionEnabled"
    for lines, count in (("", 1), (f"{enabled} = 1", 0), (f"{enabled}.timeSamples = {{0: 1}}", 0)):
        assert len(read(ground + _cube("B", 800) + _joint("Fixed", lines)).scene.filtered) == count


def test_groups_that_do_not_collide(read) -> None:
    """Members of one that filters itself, and of two of which one filters the other; a stranger touches all."""
    group = """def PhysicsCollisionGroup "{name}" (prepend apiSchemas = ["CollectionAPI:colliders"])
    {{
        rel collection:colliders:includes = [{members}]
        rel physics:filteredGroups = [{other}]
    }}
    """
    cubes = "".join(_cube(name, 800 * k) for k, name in enumerate("ABCD"))
    for other, expected in (("One", {"AB"}), ("Two", {"AC", "BC"})):
        one = group.format(name="One", members="</A>, </B>", other=f"</{other}>")
        two = group.format(name="Two", members="</C>", other="")
        shot = read(cubes + one + two)
        name = [surface.name[1:] for surface in shot.scene.surfaces]
        assert {name[a] + name[b] for a, b in shot.scene.filtered} == expected


@pytest.mark.parametrize("type_", ["force", "acceleration"])
def test_drives_in_si(type_: str, read) -> None:
    """kg, cm and degrees: 1 kg cm^2 / degree = 1e-4 * 180 / pi kg m^2 / rad."""
    values = {"stiffness": 2, "damping": 3, "targetPosition": 90, "targetVelocity": 180, "maxForce": 5}
    for kind, name in (("Revolute", "angular"), ("Prismatic", "linear")):
        lines = [f"float drive:{name}:physics:{key} = {value}" for key, value in values.items()]
        lines.append(f'uniform token drive:{name}:physics:type = "{type_}"')
        applied = f'"J" (prepend apiSchemas = ["PhysicsDriveAPI:{name}"])'
        drive = _only(read(BOTH + _joint(kind, "\n".join(lines)).replace('"J"', applied), meters=0.01)).drive
        turns, mass = kind == "Revolute", type_ == "force"
        angle = np.pi / 180.0 if turns else 0.01
        scale = (1.0 / angle if turns else 1.0) * (1e-4 if turns and mass else 1.0)
        assert drive.stiffness == pytest.approx(2.0 * scale) and drive.damping == pytest.approx(3.0 * scale)
        assert drive.target == pytest.approx(90.0 * angle) and drive.target_velocity == pytest.approx(
            180.0 * angle
        )
        assert drive.most == pytest.approx(5.0 * (1e-4 if turns else 0.01))
        assert drive.per_inertia == (not mass)


@pytest.mark.parametrize("name", ["PhysicsDistanceJoint", "DistancePhysicsJoint"])
def test_distances(name: str, read) -> None:
    """The latter is what drafts of UsdPhysics called it; below zero is no limit."""
    for lower, upper, limits in ((10, 50, (0.1, 0.5)), (-1, 50, (-np.inf, 0.5)), (-1, -1, None)):
        lines = f"float physics:minDistance = {lower}\nfloat physics:maxDistance = {upper}"
        joint = _only(read(BOTH + _joint("Distance", lines).replace("PhysicsDistanceJoint", name), meters=0.01))
        assert joint.kind == "distance" and joint.limits == (pytest.approx(limits) if limits else None)


def test_what_joints_leave_unheeded_is_said(read) -> None:
    applied = '"J" (prepend apiSchemas = ["PhysicsDriveAPI:angular"])'
    joint = _joint("Fixed", "float physics:breakForce = 10").replace('"J"', applied)
    warnings = read(BOTH + joint).warnings
    assert any("physics:breakForce" in line for line in warnings) and any(
        "drive:angular" in line for line in warnings
    )


@pytest.mark.parametrize(
    ("free", "kind"),
    [((), "fixed"), (("rotY",), "revolute"), (("transX",), "prismatic"), (("rotX", "rotY", "rotZ"), "spherical")],
)
def test_a_generic_joint_is_what_its_limits_leave_free(free: tuple[str, ...], kind: str, read) -> None:
    """A lower limit above the upper one locks."""
    freedoms = [f"{what}{axis}" for what in ("trans", "rot") for axis in "XYZ" if f"{what}{axis}" not in free]
    applied = ", ".join(f'"PhysicsLimitAPI:{freedom}"' for freedom in freedoms)
    lines = "\n".join(
        f"float limit:{freedom}:physics:low = 1\nfloat limit:{freedom}:physics:high = -1" for freedom in freedoms
    )
    joint = _only(read(BOTH + _joint("", lines).replace('"J"', f'"J" (prepend apiSchemas = [{applied}])')))
    assert joint.kind == kind and joint.limits is None and joint.cone is None
    if len(free) == 1:
        axis = np.eye(3)["XYZ".index(free[0][-1])]
        # Both cubes are turned by a quarter about z.
        np.testing.assert_allclose(joint.frames[0][:3, 2], [-axis[1], axis[0], axis[2]], atol=1e-7)


def test_a_generic_joint_is_locked_by_samples_too(read) -> None:
    freedoms = [f"{what}{axis}" for what in ("trans", "rot") for axis in "XYZ"]
    applied = ", ".join(f'"PhysicsLimitAPI:{freedom}"' for freedom in freedoms)
    lines = "\n".join(
        f"float limit:{freedom}:physics:low.timeSamples = {{1: 1}}\n"
        f"float limit:{freedom}:physics:high.timeSamples = {{1: -1}}"
        for freedom in freedoms
    )
    joint = _only(read(BOTH + _joint("", lines).replace('"J"', f'"J" (prepend apiSchemas = [{applied}])')))
    assert joint.kind == "fixed"


def test_switches_that_are_animated_are_told(read) -> None:
    """They are read at the first frame, by their samples where they have no default."""
    switch = "bool {}.timeSamples = {{ 1: {}, 5: {} }}"
    joined = read(BOTH + _joint("Fixed", switch.format("physics:jointEnabled", 1, 0)))
    assert joined.scene.joints and any("physics:jointEnabled" in line for line in joined.warnings)
    kinematic = read(_cube("A", 100, switch.format("physics:kinematicEnabled", 1, 0)) + _cube("B", 800))
    assert len(kinematic.scene.rigid_bodies) == 1
    assert any("</A> physics:kinematicEnabled: is animated" in line for line in kinematic.warnings)
    appears = read(
        _cube("A", 100, "bool physics:collisionEnabled = 0\n" + switch.format("physics:collisionEnabled", 1, 1))
    )
    assert len(appears.scene.surfaces) == 1 and appears.scene.surfaces[0].collides


def test_a_generic_joint_of_other_freedoms_is_refused(read) -> None:
    shot = read(BOTH + _joint(""))
    (prim,) = [prim for prim in shot.prims if prim.path == "/J"]
    assert not prim.supported and "PhysicsJoint" in prim.reason


@pytest.mark.parametrize(
    ("joint", "attribute"),
    [
        (_joint("Fixed", body1="/Gone"), "physics:body1"),
        (_joint("Revolute", 'uniform token physics:axis = "Q"'), "physics:axis"),
        (_joint("Revolute", 'string physics:upperLimit = "wide"'), "physics:upperLimit"),
        (_joint("Fixed", "float physics:localPos0 = 1"), "physics:localPos0"),
        (_joint("Fixed", "float3 physics:localRot1 = (1, 0, 0)"), "physics:localRot1"),
        (_joint("Fixed").replace("</B>", "[</B>, </A>]"), "physics:body1"),
        (_joint("Fixed", "quatf physics:localRot0 = (0, 0, 0, 0)"), "physics:localRot0"),
        (_joint("Fixed", "point3f physics:localPos1 = (nan, 0, 0)"), "physics:localPos1"),
        (_joint("Fixed", "string physics:localPos1 = 'here'"), "physics:localPos1"),
        (_joint("Fixed", "string physics:jointEnabled = 'yes'"), "physics:jointEnabled"),
        (_joint("Revolute", "string physics:upperLimit = 'up'"), "physics:upperLimit"),
        (
            _joint("Revolute", "float drive:angular:physics:stiffness = inf").replace(
                '"J"', '"J" (prepend apiSchemas = ["PhysicsDriveAPI:angular"])'
            ),
            "drive:angular:physics:stiffness",
        ),
        (
            _joint("Distance", "float physics:minDistance = 9\nfloat physics:maxDistance = 5"),
            "physics:minDistance",
        ),
        (
            _joint("Revolute", 'uniform token drive:angular:physics:type = "torque"').replace(
                '"J"', '"J" (prepend apiSchemas = ["PhysicsDriveAPI:angular"])'
            ),
            "drive:angular:physics:type",
        ),
        (
            _joint("Revolute", "float drive:angular:physics:damping = -1").replace(
                '"J"', '"J" (prepend apiSchemas = ["PhysicsDriveAPI:angular"])'
            ),
            "drive:angular:physics:damping",
        ),
    ],
)
def test_joints_that_cannot_be_are_refused_by_name(joint: str, attribute: str, read) -> None:
    with pytest.raises(InputError) as caught:
        read(BOTH + joint)
    assert "</J>" in str(caught.value) and attribute in str(caught.value) and "\n" not in str(caught.value)


def test_joints_may_make_a_ring_but_not_hold_a_body_to_itself(read) -> None:
    ring = _joint("Fixed") + _joint("Fixed", body0="/B", body1="/A").replace('"J"', '"K"')
    assert len(read(BOTH + ring).scene.joints) == 2
    shot = read(BOTH + _joint("Fixed", body1="/A"))
    assert not shot.scene.joints and any("</J>" in warning for warning in shot.warnings)


def test_the_report_tells_masses_and_joints(read) -> None:
    told = {prim.path: prim.recognised for prim in read(BOTH + _joint("Revolute"), meters=0.01).prims}
    assert "0.216 kg" in told["/A"] and "revolute: holds /B to /A" in told["/J"]
