"""Sand and snow as USD describes them: what is filled, poured and taken as it is, in SI, in the world's axes."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.config import Config
from plait.pipeline.read import read_shot
from plait.pipeline.read.grain_points import find_spacing
from plait.pipeline.shot import GrainOutput, GrainSurfaceOutput

# float32 attributes: half a unit in the last place is 6e-8 of a value; a few of them meet.
ROUNDING = 1e-6
BOX_FACES = "[0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]"


def _prim(kind: str, *lines: str, name: str = "Pile", role: str = "sand", inside: str = "") -> str:
    body = "\n".join([f'token plait:role = "{role}"', *lines, inside])
    return f'def {kind} "{name}"\n{{\n{body}\n}}\n'


def _place(*operations: str) -> str:
    """Lines of operations, given as 'type name = value'."""
    names = ", ".join(f'"xformOp:{operation.split()[1].split(".")[0]}"' for operation in operations)
    lines = [f"{kind} xformOp:{rest}" for kind, rest in (operation.split(" ", 1) for operation in operations)]
    return "\n".join([*lines, f"uniform token[] xformOpOrder = [{names}]"])


def _box(*lines: str, faces: str = BOX_FACES, side: float = 8.0) -> str:
    """A mesh of a cube with a corner in the origin."""
    corners = ", ".join(f"({x}, {y}, {z})" for z in (0, side) for y in (0, side) for x in (0, side))
    topology = f"int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]\nint[] faceVertexIndices = {faces}"
    return _prim("Mesh", topology, f"point3f[] points = [{corners}]", *lines)


def _points(places: np.ndarray, *lines: str) -> str:
    listed = ", ".join(f"({x}, {y}, {z})" for x, y, z in places)
    return _prim("Points", f"point3f[] points = [{listed}]", *lines)


def _only(shot):
    (granular,) = shot.scene.granular
    return granular


@pytest.mark.parametrize("faces", [BOX_FACES, "[" + ", ".join(reversed(BOX_FACES[1:-1].split(", "))) + "]"])
def test_a_box_of_whole_spacings_is_filled_exactly(faces: str, read) -> None:
    """8 x 8 x 8 grains 1 cm apart, each within its own cube, whichever way the faces are drawn."""
    sand = _only(read(_box("float plait:spacing = 1", faces=faces), meters=0.01))
    assert sand.law == "sand" and len(sand.positions) == 512
    np.testing.assert_allclose(sand.volumes, 1e-6, rtol=ROUNDING)
    np.testing.assert_allclose(sand.widths, 0.01, rtol=ROUNDING)
    assert sand.ids.tolist() == list(range(512))
    cubes = np.floor(sand.positions / 0.01).astype(int)
    assert len(np.unique(cubes, axis=0)) == 512


def test_what_is_filled_is_filled_where_it_stands(read) -> None:
    """A turned, moved, stretched ball in centimetres, far from the origin: inside, as many as it holds."""
    turned = _place("double3 translate = (9e4, 100, 0)", "float rotateZ = 30", "float3 scale = (2, 1, 1)")
    shot = read(_prim("Sphere", "double radius = 5", "float plait:spacing = 0.8", turned), meters=0.01)
    places = _only(shot).positions + shot.scene.origin - [900.0, 1.0, 0.0]
    angle = np.radians(30.0)
    own = places @ np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    assert (np.linalg.norm(own / [0.1, 0.05, 0.05], axis=1) < 1.0).all()
    # The polyhedron lies within; a layer of half a spacing is uncertain, at random and mostly to both sides.
    volume = 4.0 / 3.0 * np.pi * 0.1 * 0.05 * 0.05
    assert len(places) == pytest.approx(volume / 0.008**3, rel=0.03)


@pytest.mark.parametrize(
    ("kind", "lines", "volume"),
    [
        ("Cube", "double size = 1", 1.0),
        ("Sphere", "double radius = 0.5", np.pi / 6.0),
        ("Cylinder", "double radius = 0.5\ndouble height = 1", np.pi / 4.0),
        ("Cone", "double radius = 0.5\ndouble height = 1", np.pi / 12.0),
        ("Capsule", "double radius = 0.5\ndouble height = 1", np.pi / 4.0 + np.pi / 6.0),
        (
            "TetMesh",
            "point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]\n"
            "int4[] tetVertexIndices = [(0, 1, 2, 3)]",
            1.0 / 6.0,
        ),
    ],
)
def test_shapes_are_filled(kind: str, lines: str, volume: float, read) -> None:
    """As many grains as the volume holds, but for a layer of half a spacing, and polygons that lie inside."""
    places = _only(read(_prim(kind, lines, "float plait:spacing = 0.05"))).positions
    assert len(places) == pytest.approx(volume / 0.05**3, rel=0.05)


def test_parameters_in_stage_units(read) -> None:
    stuff = 'def Material "Stuff"\n{\nfloat physics:density = 0.002\nfloat physics:youngsModulus = 500\n}\n'
    lines = (
        "float plait:spacing = 2",
        "rel material:binding:physics = </Stuff>",
        "float plait:frictionAngle = 30",
        "float physics:dynamicFriction = 0.7",
        "float plait:width = 0.5",
        "float3 plait:velocity = (0, 100, 0)",
        _place("float rotateZ = 90"),
    )
    sand = _only(read(_box(*lines) + stuff, meters=0.01))
    assert sand.density == pytest.approx(2000.0, rel=ROUNDING)
    assert sand.youngs_modulus == pytest.approx(5e4, rel=ROUNDING)
    assert sand.friction_angle == pytest.approx(np.pi / 6.0, rel=ROUNDING)
    assert sand.friction == pytest.approx(0.7, rel=ROUNDING)
    np.testing.assert_allclose(sand.widths, 0.005, rtol=ROUNDING)
    np.testing.assert_allclose(sand.velocities, np.tile([-1.0, 0.0, 0.0], (len(sand.positions), 1)), atol=ROUNDING)


def test_snow_has_its_own_defaults(read) -> None:
    shot = read(_prim("Sphere", "float plait:hardening = 7", role="snow"), parameters={"grainBudget": 500.0})
    snow = _only(shot)
    assert (snow.law, snow.density, snow.hardening, snow.critical_stretch) == ("snow", 400.0, 7.0, 0.0075)


def test_budgets_space_alike_what_gives_no_spacing(read) -> None:
    """The larger of two boxes has its budget, the smaller as many as fit at the same spacing."""
    small = _prim("Cube", "double size = 0.5", _place("double3 translate = (5, 0, 0)"), name="Small")
    shot = read(_prim("Cube", "double size = 1") + small, parameters={"grainBudget": 1000.0})
    large, small = shot.scene.granular
    np.testing.assert_allclose([large.volumes[0], small.volumes[0]], 1e-3, rtol=ROUNDING)
    assert len(large.positions) == pytest.approx(1000, rel=0.2) and len(small.positions) == pytest.approx(
        125, rel=0.2
    )


def test_uneven_spacings_are_told(read) -> None:
    boxes = _box("float plait:spacing = 1") + _prim("Cube", "float plait:spacing = 0.2", name="Fine")
    assert "share one grid" in " ".join(read(boxes).warnings)


@pytest.mark.parametrize(
    ("spacing", "lines"),
    [(0.02, "float[] widths = [0.5]"), (0.02, ""), (0.03, "float plait:spacing = 0.03")],
)
def test_points_are_taken_as_they_are(spacing: float, lines: str, read) -> None:
    """Their room is told by how they lie, not by how wide they are drawn, unless a spacing is authored."""
    places = 0.02 * np.indices((6, 6, 6)).reshape(3, -1).T
    sand = _only(read(_points(places, lines)))
    np.testing.assert_allclose(sand.positions, places, atol=ROUNDING)
    # A cell of so many of a lattice's points may hold a row more or less.
    np.testing.assert_allclose(np.cbrt(sand.volumes), spacing, rtol=0.2)


def test_points_that_are_animated_are_told(read) -> None:
    """They are grains as they lie at the first frame."""
    lines = "point3f[] points.timeSamples = { 1: [(0, 0, 0)], 5: [(0, 9, 0)] }\nfloat plait:spacing = 1"
    shot = read(_prim("Points", lines))
    np.testing.assert_array_equal(_only(shot).positions + shot.scene.origin, [(0, 0, 0)])
    assert any("</Pile> points: is animated" in line for line in shot.warnings)


def test_points_keep_ids_and_widths_and_velocities(read) -> None:
    lines = (
        "int64[] ids = [40, 7]",
        "float[] widths = [3, 2]",
        "vector3f[] velocities = [(1, 0, 0), (0, 2, 0)]",
        _place("float rotateZ = 90", "float3 scale = (2, 2, 2)"),
    )
    sand = _only(read(_points(np.array([[1, 0, 0], [2, 0, 0]]), *lines), meters=0.1))
    assert sand.ids.tolist() == [40, 7]
    np.testing.assert_allclose(sand.widths, [0.6, 0.4], rtol=ROUNDING)
    np.testing.assert_allclose(sand.velocities, [[0, 0.2, 0], [-0.4, 0, 0]], atol=ROUNDING)
    np.testing.assert_allclose(
        np.cbrt(sand.volumes), 0.5, rtol=ROUNDING, err_msg="so few are as far apart as wide"
    )


def test_spacing_of_grains_that_lie_at_random() -> None:
    places = np.random.default_rng(1).random((20000, 3)) * [2.0, 1.0, 0.5]
    stray = np.append(places, [[500.0, 0.0, 0.0]], axis=0)
    for found in (find_spacing(places), find_spacing(stray)):
        # The median cell holds a Poisson number of them, and cells at the edges are not full.
        assert found == pytest.approx((1.0 / 20000) ** (1.0 / 3.0), rel=0.15)
    assert find_spacing(places[:5]) == 0.0 and find_spacing(np.zeros((500, 3))) == 0.0


def test_an_emitter_pours_from_its_box(read) -> None:
    """A tap that turns and switches: where it pours, which way, how many until the end of the shot."""
    tap = _prim(
        "Cube",
        "double size = 2",
        "float plait:rate = 48",
        "float3 plait:velocity = (0, -300, 0)",
        "bool plait:emit.timeSamples = { 1: 1, 5: 0 }",
        _place(
            "double3 translate = (0, 500, 0)",
            "float rotateZ.timeSamples = { 1: 90, 3: 180 }",
            "float3 scale = (3, 4, 5)",
        ),
        name="Tap",
    )
    shot = read(tap, meters=0.01)
    sand = _only(shot)
    emitter = sand.emitter
    assert len(sand.positions) == 0 and emitter.limit == 18, "48 a second for 9 frames of 1/24 s"
    assert emitter.switch.on(1 / 24) and not emitter.switch.on(5 / 24)
    pose = emitter.motion.pose(1 / 24).joint_transforms[0]
    corner = pose @ [*emitter.upper, 1.0] + [*shot.scene.origin, 0.0]
    np.testing.assert_allclose(corner[:3], [-0.04, 5.03, 0.05], atol=1e-6)
    np.testing.assert_allclose(emitter.velocity, [0.0, -3.0, 0.0], atol=ROUNDING)
    # As dense as at rest: 3 m/s through 6 cm x 10 cm, 48 a second.
    assert emitter.volume == pytest.approx(3.0 * 0.06 * 0.1 / 48.0, rel=1e-5)


def test_more_than_passes_is_told(read) -> None:
    tap = _prim(
        "Plane", "float plait:rate = 1e6", "float plait:spacing = 0.1", "float3 plait:velocity = (0, 0, 1)"
    )
    assert any("more than pass its box" in warning for warning in read(tap).warnings)


def test_an_emitter_on_a_prop_is_told(read) -> None:
    """It stays where the shot has it, while the prop falls."""
    tap = _prim("Cube", "float plait:rate = 100", name="Tap")
    prop = 'def Cube "Prop" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])\n{{\n{}\n}}\n'
    assert any(
        "/Prop/Tap" in warning and "does not move" in warning for warning in read(prop.format(tap)).warnings
    )
    assert not any("does not move" in warning for warning in read(prop.format("") + tap).warnings)


@pytest.mark.parametrize("scale", [1, -1])
def test_a_collider_that_faces_inwards_is_told_whether_mirrored_or_not(scale: int, read) -> None:
    """Grains are kept where its faces point: of that the artist hears, and only of that."""
    inward = "[" + ", ".join(reversed(BOX_FACES[1:-1].split(", "))) + "]"
    sand = _prim("Sphere", "float plait:spacing = 0.5", name="Heap")
    for faces, told in ((BOX_FACES, False), (inward, True)):
        box = _box(_place(f"float3 scale = ({scale}, 1, 1)"), faces=faces).replace('"sand"', '"collider"')
        assert any("</Pile> orientation" in line for line in read(box + sand).warnings) == told


def test_grains_start_with_the_shot_or_the_frames_to_write(write) -> None:
    path = write(_box("float plait:spacing = 4"))
    for frames, first in ((None, 1), ((4, 8), 1), ((-3, 8), -3)):
        assert read_shot(path, Config(), frames).scene.granular_start == pytest.approx(first / 24.0)


def test_where_they_come_back(read) -> None:
    """Beside the prim, under no geometry, by a name that no prim has."""
    inner = _prim("Cube", "float plait:spacing = 1", name="Heap", inside="bool plait:surface = 1")
    taken = 'def Scope "Heap_grains"\n{\n}\n'
    shot = read(f'def Xform "Set"\n{{\ndef Mesh "Frame"\n{{\n{inner}\n}}\n{taken}\n}}\n')
    grains, surface = shot.grains
    assert isinstance(grains, GrainOutput) and isinstance(surface, GrainSurfaceOutput)
    assert (grains.prim_path, surface.prim_path) == ("/Set/Heap_grains2", "/Set/Heap_surface")
    assert grains.source_path == surface.source_path == "/Set/Frame/Heap"
    assert grains.hidden and surface.cell == pytest.approx(1.5)
    report = next(prim for prim in shot.prims if prim.path == "/Set/Frame/Heap")
    assert "/Set/Heap_grains2" in report.recognised and report.sizes == {"grains": 8}
    assert not any("drawn already" in warning for warning in shot.warnings)


def test_a_surface_finer_than_its_grains_and_a_shot_that_is_a_result_are_said(read) -> None:
    lines = "bool plait:surface = 1\nfloat plait:surfaceCell = 0.5"
    shot = read(_prim("Cube", "float plait:spacing = 1", name="Heap", inside=lines))
    assert any("</Heap> plait:surfaceCell" in warning for warning in shot.warnings)
    result = _prim("Cube", "float plait:spacing = 1", name="Heap") + 'def Points "Heap_grains"\n{\n}\n'
    shot = read(result)
    assert any("</Heap_grains>: is drawn already" in warning for warning in shot.warnings)
    assert shot.grains[0].prim_path == "/Heap_grains2"


def test_no_points_are_no_grains(read) -> None:
    shot = read('def Points "Dust"\n{\ntoken plait:role = "sand"\npoint3f[] points = []\n}\n')
    assert shot.scene.granular == () and shot.prims[0].role == "skipped" and shot.prims[0].reason == "empty"


def test_a_report_fills_nothing(write) -> None:
    path = write(_box("float plait:spacing = 1"))
    shot = read_shot(path, Config(), fill=False)
    assert len(_only(shot).positions) == 0 and shot.prims[0].sizes["grains (about)"] == 512


def test_a_group_passes_its_role_on(read) -> None:
    """To what can be filled; what cannot is refused by name, in a report that goes on."""
    curve = (
        'def BasisCurves "Hair"\n{\nint[] curveVertexCounts = [2]\npoint3f[] points = [(0, 0, 0), (0, 1, 0)]\n}\n'
    )
    group = 'def Xform "Beach"\n{\ntoken plait:role = "sand"\ndef Cone "Castle"\n{\nfloat plait:spacing = 0.3\n}\n'
    shot = read(f"{group}{curve}}}\n")
    assert [granular.name for granular in shot.scene.granular] == ["/Beach/Castle"]
    hair = next(prim for prim in shot.prims if prim.path == "/Beach/Hair")
    assert not hair.supported and "BasisCurves cannot be sand" in hair.reason


def test_what_is_instanced_is_refused(read) -> None:
    original = 'class Xform "_Heap"\n{\ndef Cube "Sand"\n{\ntoken plait:role = "sand"\n}\n}\n'
    used = 'def Xform "A" (instanceable = true\ninherits = </_Heap>)\n{\n}\n'
    sand = next(prim for prim in read(original + used).prims if prim.path == "/A/Sand")
    assert not sand.supported and "instance" in sand.reason
