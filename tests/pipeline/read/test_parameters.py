"""Parameters: units, order of precedence, derived stiffness, and the table that drives all three."""

from __future__ import annotations

import numpy as np
import pytest

from plait.pipeline.config import Config
from plait.pipeline.errors import UsageError
from plait.pipeline.read import parameter_table, parameters
from plait.pipeline.read.strands import EARTH, LOCK_GRAVITY_NUMBER

HAIR = """
def BasisCurves "Hair" (prepend apiSchemas = ["PhysicsCurvesDeformableSimAPI"])
{{
    uniform token type = "linear"
    int[] curveVertexCounts = [3]
    point3f[] points = [(0, 0, 0), (0, 1, 0), (0, 2, 0)]
    float[] widths = [{width}] (interpolation = "constant")
    {on_prim}
    rel material:binding:physics = </Keratin>
}}
def Material "Keratin"
{{
    {on_material}
}}
"""


def _hair(on_prim: str = "", on_material: str = "", width: float = 1e-4) -> str:
    return HAIR.format(on_prim=on_prim, on_material=on_material, width=width)


def _strands(read, *args: str, meters: float = 1.0, **more):
    width = more.pop("width", 1e-4)
    return read(_hair(*args, width=width), meters=meters, **more).scene.strands[0]


def test_precedence(read) -> None:
    """Default, material, prim; UsdPhysics before proposal before plait; configuration, then prims by path."""
    assert _strands(read).density[0] == 1300.0
    assert _strands(read, "", "float physics:density = 1100").density[0] == 1100.0
    both = ("float physics:density = 1000", "float plait:density = 1100")
    assert _strands(read, *both).density[0] == 1000.0, "what is on the prim comes before its material"
    on_one = ("", "float physics:density = 1000\n    float plait:density = 1100")
    assert _strands(read, *on_one).density[0] == 1100.0
    configured = {"parameters": {"density": 900.0}}
    assert _strands(read, *both, **configured).density[0] == 900.0
    configured["prim"] = {"/Ha*": {"density": 800}, "/Other": {"density": 700}}
    assert _strands(read, *both, **configured).density[0] == 800.0


def test_zero_asks_for_the_default_in_usdphysics(read) -> None:
    assert _strands(read, "", "float physics:density = 0").density[0] == 1300.0


def test_thin_hair_is_damped_by_air(read) -> None:
    """Drag a length and speed is that of any thin cylinder, mass goes with thickness squared: 2 + 8 at 80 um."""
    np.testing.assert_allclose(_strands(read, width=8e-5).damping, 10.0, rtol=1e-6)
    np.testing.assert_allclose(_strands(read, width=16e-5).damping, 4.0, rtol=1e-6)


def test_stage_units(read) -> None:
    """Centimetres: force is kg cm/s2 = 1e-2 N, EI kg cm3/s2 = 1e-6 N m2, pressure kg/(cm s2) = 100 Pa."""
    on_material = """float physics:density = 0.002
    float physics:curvesThickness = 0.5
    float physics:curvesStretchStiffness = 300
    float physics:curvesBendStiffness = 40
    float physics:curvesTwistStiffness = 50
    float physics:dynamicFriction = 0.25"""
    strands = _strands(read, "float plait:damping = 3", on_material, meters=0.01)
    np.testing.assert_allclose(strands.density, 2000.0, rtol=1e-6)
    np.testing.assert_allclose(strands.radius, 0.0025, rtol=1e-6)
    np.testing.assert_allclose(strands.stretch_stiffness, 3.0, rtol=1e-6)
    np.testing.assert_allclose(strands.bend_stiffness, 4e-5, rtol=1e-6)
    np.testing.assert_allclose(strands.twist_stiffness, 5e-5, rtol=1e-6)
    np.testing.assert_allclose(strands.friction, 0.25, rtol=1e-6)
    np.testing.assert_allclose(strands.damping, 3.0, rtol=1e-6)
    soft = _strands(
        read, "", "float physics:youngsModulus = 1e6\n    float physics:curvesThickness = 2", meters=0.01
    )
    np.testing.assert_allclose(soft.stretch_stiffness, 1e8 * np.pi * 0.01**2, rtol=1e-6)


def test_stiffness_of_a_round_section(read) -> None:
    """EA, EI = E pi r^4 / 4 and GJ = E / (2 (1 + nu)) pi r^4 / 2."""
    strands = _strands(read, "float plait:youngsModulus = 2e9\n    float plait:poissonsRatio = 0.25")
    r = 0.5e-4
    np.testing.assert_allclose(strands.stretch_stiffness, 2e9 * np.pi * r**2, rtol=1e-6)
    np.testing.assert_allclose(strands.bend_stiffness, 2e9 * np.pi * r**4 / 4, rtol=1e-6)
    np.testing.assert_allclose(strands.twist_stiffness, 2e9 / 2.5 * np.pi * r**4 / 2, rtol=1e-6)


def test_what_is_drawn_thicker_than_hair_hangs_like_a_lock(read) -> None:
    """rho A g L^3 / EI is LOCK_GRAVITY_NUMBER where no stiffness is authored; E counts where it is."""
    thick = _strands(read, width=0.2)
    weight = 1300.0 * np.pi * 0.1**2 * EARTH * 2.0**3
    np.testing.assert_allclose(weight / thick.bend_stiffness, LOCK_GRAVITY_NUMBER, rtol=1e-6)
    np.testing.assert_allclose(thick.stretch_stiffness, 4e9 * np.pi * 0.1**2, rtol=1e-6)
    stiff = _strands(read, "float plait:youngsModulus = 4e9", width=0.2)
    np.testing.assert_allclose(stiff.bend_stiffness, 4e9 * np.pi * 0.1**4 / 4, rtol=1e-6)


def test_contact_between_strands(read) -> None:
    """Distance kept in the stage's lengths, the grid's part without a unit; defaults where nothing is authored."""
    plain, told = _strands(read), "float plait:clearance = 0.2\n    float plait:picFraction = 0.5"
    assert (plain.thickness, plain.pic_fraction, plain.free) == (0.0, 0.05, None)
    strands = _strands(read, told, meters=0.01)
    assert strands.thickness == pytest.approx(0.002) and strands.pic_fraction == 0.5
    np.testing.assert_allclose(strands.radius, 0.5e-6, rtol=1e-6)  # the diameter is another parameter
    assert _strands(read, told, parameters={"picFraction": 0.25}).pic_fraction == 0.25


def test_rest_shape(read) -> None:
    assert _strands(read).rest_shape == "sagfree"
    assert _strands(read, 'token plait:restShape = "authored"').rest_shape == "authored"
    assert _strands(read, parameters={"restShape": "authored"}).rest_shape == "authored"


def test_colliders_have_their_own(read) -> None:
    ball = """
def Sphere "Ball" (prepend apiSchemas = ["PhysicsCollisionAPI"])
{
    float plait:clearance = 2
    rel material:binding:physics = </Ice>
}
def Material "Ice"
{
    float physics:dynamicFriction = 0.02
}
"""
    shot = read(_hair() + ball, meters=0.01)
    surface = next(s for s in shot.scene.surfaces if s.name == "/Ball")
    assert surface.friction == pytest.approx(0.02) and surface.thickness == pytest.approx(0.02)
    plain = next(s for s in read(_hair() + 'def Sphere "Ball" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {}')
                 .scene.surfaces if s.name == "/Ball")  # fmt: skip
    assert plain.friction is None and plain.thickness == 0.0


def test_a_name_slightly_wrong_is_guessed() -> None:
    with pytest.raises(UsageError, match="did you mean damping"):
        parameters.check_configuration(Config(parameters={"damping_": 1.0}))


def test_names_of_the_proposal_are_known_to_the_configuration(read) -> None:
    strands = _strands(read, parameters={"curvesThickness": 0.002})
    np.testing.assert_allclose(strands.radius, 0.001)


def test_a_pattern_that_matches_nothing_is_told(read) -> None:
    shot = read(_hair(), prim={"/Beard*": {"damping": 1.0}})
    assert any("/Beard*" in warning for warning in shot.warnings)


@pytest.mark.parametrize("parameter", parameter_table.PARAMETERS, ids=lambda p: p.name)
def test_every_default_is_within_its_range(parameter) -> None:
    if parameter.choices:
        assert parameter.default in parameter.choices
    elif parameter.flag:
        assert parameter.default in (True, False)
    elif parameter.default is not None:
        assert parameter.low <= parameter.default <= parameter.high
    else:
        assert parameter.default_text


def test_the_table_has_a_row_for_each() -> None:
    lines = parameter_table.as_markdown().splitlines()
    assert len(lines) == 2 + len(parameter_table.PARAMETERS)
    assert all(line.count("|") == lines[0].count("|") for line in lines)


def test_what_is_misspelt_is_told(read) -> None:
    """An attribute of `plait:` that nothing reads, with what it may have been meant to be."""
    warnings = read(_hair("float plait:dampng = 5", "float plait:density = 900")).warnings
    (line,) = [line for line in warnings if "plait:" in line]
    assert "</Hair> plait:dampng" in line and "plait:damping" in line
