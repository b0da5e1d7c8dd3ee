"""Guides from USD to USD: who leads whom, and what is written of curves that follow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from plait.pipeline import inspect
from plait.pipeline.cli import main
from plait.pipeline.config import Config
from plait.pipeline.errors import EXIT_DONE, EXIT_FAILED, InputError
from plait.pipeline.read import read_shot
from plait.pipeline.shot import Shot
from plait.pipeline.validate import validate
from plait.solver.diagnostics import Diverged
from plait.solver.step import Simulation

HEADER = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 6
    timeCodesPerSecond = 24
)
def Xform "World"
{
"""
# A plate 20 cm wide that turns and moves.
PLATE = """
    def Mesh "Plate"
    {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-10, 0, -10), (-10, 0, 10), (10, 0, 10), (10, 0, -10)]
        double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 6: (5, 1, 0) }
        float xformOp:rotateZ.timeSamples = { 1: 0, 6: 40 }
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
    }
"""
CURVES = """
    def BasisCurves "{name}"
    {{
        uniform token type = "linear"
        int[] curveVertexCounts = {counts}
        point3f[] points = {points}
        normal3f[] normals = {normals} (interpolation = "uniform")
        float[] widths = [0.01] (interpolation = "constant")
        {more}
    }}
"""
GUIDE_PURPOSE = 'uniform token purpose = "guide"'
SEGMENTS = 6


def _curls(count: int, seed: int) -> np.ndarray:
    """(count, 7, 3) [cm], some 12 cm long."""
    random = np.random.default_rng(seed)
    points = np.cumsum(random.normal([0.0, 2.0, 0.0], 0.4, size=(count, SEGMENTS + 1, 3)), axis=1)
    points += random.uniform(-6, 6, size=(count, 1, 3)) * [1, 0, 1] - points[:, :1]
    return points.astype(np.float32)


GUIDES = _curls(5, 1)
# What follows: others, and one drawn like the second guide.
OTHERS = np.concatenate([_curls(12, 2), GUIDES[1:2]])


def _curves(name: str, lines: np.ndarray, *more: str) -> str:
    points = ", ".join(str(tuple(point)) for point in lines.reshape(-1, 3).tolist())
    counts, normals = [lines.shape[1]] * len(lines), [(1, 0, 0)] * len(lines)
    return CURVES.format(
        name=name, counts=counts, points=f"[{points}]", normals=normals, more="\n        ".join(more)
    )


def _marks(marked: list[int]) -> str:
    return f'int[] primvars:groom_guide = {marked} (interpolation = "uniform")'


SEPARATE = PLATE + _curves("Guides", GUIDES, GUIDE_PURPOSE) + _curves("Hair", OTHERS)
# The guides between the others.
ORDER = np.insert(np.arange(5, 18), [0, 0, 4, 9, 13], np.arange(5))
TOGETHER = PLATE + _curves(
    "Hair", np.concatenate([GUIDES, OTHERS])[ORDER], _marks((ORDER < 5).astype(int).tolist())
)


def _write(folder: Path, body: str, name: str = "shot") -> Path:
    path = folder / f"{name}.usda"
    path.write_text(HEADER + body + "}\n")
    return path


def _read(folder: Path, body: str, name: str = "shot") -> Shot:
    """name: of its own for each, as USD keeps the layers of a shot that is still held."""
    return read_shot(_write(folder, body, name), Config())


def _sim(path: Path, *more: str) -> int:
    output = path.parent / "out" / path.name
    command = ["sim", str(path), "-o", str(output), "--preroll", "0", "--chunk", "2", "--progress", "none"]
    return main([*command, *more])


def _samples(path: Path, prim: str, name: str = "points") -> np.ndarray:
    """(6, n, 3) of the result for `path`, a sample a frame."""
    stage = Usd.Stage.Open(str(path.parent / "out" / path.name))
    attribute = stage.GetPrimAtPath(f"/World/{prim}").GetAttribute(name)
    return np.array([attribute.Get(code) for code in range(1, 7)], dtype=np.float64)


@pytest.fixture(scope="module")
def separate(tmp_path_factory) -> Path:
    path = _write(tmp_path_factory.mktemp("separate"), SEPARATE)
    assert _sim(path) == EXIT_DONE
    return path


@pytest.fixture(scope="module")
def together(tmp_path_factory) -> Path:
    path = _write(tmp_path_factory.mktemp("together"), TOGETHER)
    assert _sim(path) == EXIT_DONE
    return path


# float32 of coordinates up to 20 cm, through transforms to metres and back.
SINGLE = 20 * 4 * np.finfo(np.float32).eps


def test_the_first_frame_is_as_drawn(separate, together):
    np.testing.assert_allclose(_samples(separate, "Hair")[0], OTHERS.reshape(-1, 3), atol=SINGLE)
    drawn = np.concatenate([GUIDES, OTHERS])[ORDER].reshape(-1, 3)
    np.testing.assert_allclose(_samples(together, "Hair")[0], drawn, atol=SINGLE)


def test_a_curve_drawn_like_a_guide_is_written_like_it(separate):
    points = {name: _samples(separate, name).reshape(6, -1, SEGMENTS + 1, 3) for name in ("Guides", "Hair")}
    np.testing.assert_allclose(points["Hair"][:, -1], points["Guides"][:, 1], atol=SINGLE)
    assert np.abs(np.diff(points["Guides"][:, 1], axis=0)).max() > 0.1, "they move"


def test_roots_go_with_the_skin_and_nothing_shrinks(separate):
    """Roots by the plate's own transform; lengths by the guides' strain, which stays below 1 %."""
    points = _samples(separate, "Hair").reshape(6, -1, SEGMENTS + 1, 3)
    stage = Usd.Stage.Open(str(separate))
    for code, frame in enumerate(points, start=1):
        matrix = UsdGeom.XformCache(code).GetLocalToWorldTransform(stage.GetPrimAtPath("/World/Plate"))
        roots = np.array([matrix.Transform(tuple(map(float, root))) for root in OTHERS[:, 0]])
        np.testing.assert_allclose(frame[:, 0], roots, atol=SINGLE)
    length = np.linalg.norm(np.diff(points, axis=2), axis=3)
    np.testing.assert_allclose(length, np.broadcast_to(length[0], length.shape), rtol=1e-2)


def test_velocities_tell_where_points_go(tmp_path):
    """Between shutter samples a tenth of a frame apart, in which guides change their speed by 3 % of the most."""
    path = _write(tmp_path, SEPARATE)
    more = ["--set", "output.shutter=[-0.05, 0.05]", "--substeps", "20"]
    assert _sim(path, "-f", "4", "--preroll", "3", *more) == EXIT_DONE
    stage = Usd.Stage.Open(str(path.parent / "out" / path.name))
    prim = stage.GetPrimAtPath("/World/Hair")
    earlier, later = (np.array(prim.GetAttribute("points").Get(code), dtype=float) for code in (3.95, 4.05))
    velocities = np.array(prim.GetAttribute("velocities").Get(4.0))
    expected = (later - earlier) / 0.1 * 24
    np.testing.assert_allclose(velocities, expected, atol=0.05 * np.linalg.norm(expected, axis=1).max())


def test_the_result_is_sound(separate, together):
    """Passes every validator that its source passes, and our own; normals are refreshed and unit."""
    for path in (separate, together):
        assert validate(path.parent / "out" / path.name) == []
        normals = _samples(path, "Hair", "normals")
        np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, atol=1e-6)
        assert np.abs(normals[-1] - normals[0]).max() > 0.1, "they turn"


def test_both_forms_give_the_same(separate, together):
    """Guides in a prim of their own, or marked among others."""
    whole = _samples(together, "Hair").reshape(6, -1, SEGMENTS + 1, 3)
    np.testing.assert_allclose(whole[:, ORDER < 5].reshape(6, -1, 3), _samples(separate, "Guides"), atol=SINGLE)
    np.testing.assert_allclose(whole[:, ORDER >= 5].reshape(6, -1, 3), _samples(separate, "Hair"), atol=SINGLE)


def test_resumed_they_end_in_the_same_bits(together, tmp_path, monkeypatch):
    path, advance = _write(tmp_path, TOGETHER), Simulation.advance_frame

    def fail(self, end, substeps=None):
        if end * 24.0 > 4.5:
            raise Diverged("position", "as asked", end)
        return advance(self, end, substeps)

    monkeypatch.setattr(Simulation, "advance_frame", fail)
    assert _sim(path) == EXIT_FAILED
    monkeypatch.setattr(Simulation, "advance_frame", advance)
    assert _sim(path, "--resume") == EXIT_DONE
    for name in ("points", "velocities", "normals"):
        assert _samples(path, "Hair", name).tobytes() == _samples(together, "Hair", name).tobytes()


def test_on_flesh_they_go_with_the_simulated_skin(tmp_path):
    """A soft block falls and turns; a curve's root at its corner is where the corner is written to be."""
    corners = [(x, y, z) for x in (-5, 5) for y in (-5, 5) for z in (-5, 5)]
    block = f"""
    def Mesh "Block"
    {{
        uniform token subdivisionScheme = "none"
        token plait:role = "flesh"
        float plait:tetEdge = 4
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
        point3f[] points = {corners}
    }}
"""
    strands = 'token plait:role = "strands"'
    short = 0.3 * (GUIDES - GUIDES[:, :1])
    guides = _curves(
        "Guides", short[:3] + np.float32([[[0, 5, 0]], [[2, 5, 2]], [[-3, 5, 1]]]), strands, GUIDE_PURPOSE
    )
    hair = _curves("Hair", short[3:] + np.float32([5, 5, 5]), strands)
    path = _write(tmp_path, block + guides + hair)
    assert _sim(path, "--substeps", "2") == EXIT_DONE
    roots = _samples(path, "Hair").reshape(6, 2, -1, 3)[:, :, 0]
    corner = _samples(path, "Block")[:, corners.index((5, 5, 5))]
    assert abs(corner[-1, 1] - 5.0) > 10.0, "it falls"
    np.testing.assert_allclose(roots, np.repeat(corner[:, None], 2, axis=1), atol=4 * SINGLE)
    velocities = _samples(path, "Hair", "velocities").reshape(6, 2, -1, 3)[:, :, 0]
    expected = _samples(path, "Block", "velocities")[:, corners.index((5, 5, 5))]
    np.testing.assert_allclose(velocities, np.repeat(expected[:, None], 2, axis=1), rtol=1e-3, atol=0.1)


# --- who leads whom ---------------------------------------------------------------------------------------------


def _reports(shot: Shot) -> dict[str, tuple[str, str]]:
    return {prim.path.rpartition("/")[2]: (prim.role, prim.guides) for prim in shot.prims}


def _led(shot: Shot) -> dict[str, int]:
    """How many curves of each prim follow."""
    return {
        output.prim_path.rpartition("/")[2]: len(output.followers.strands) if output.followers else 0
        for output in shot.curves
    }


def test_told_by_inspect(tmp_path):
    shot = _read(tmp_path, SEPARATE)
    reports = _reports(shot)
    assert reports["Guides"] == ("strands", "by purpose guide; followed by /World/Hair")
    followed = "13 strands follow the nearest of 5 guides in /World/Guides (on the same skin)"
    assert reports["Hair"] == ("interpolated", followed)
    sizes = inspect.as_data(shot)["sizes"]
    assert (sizes["strands"], sizes["interpolated strands"]) == (5, 13)
    assert not any("guide" in warning for warning in shot.warnings)


def test_marked_among_others(tmp_path):
    shot = _read(tmp_path, TOGETHER)
    assert _reports(shot)["Hair"] == ("strands", "5 of 18 strands, by groom_guide; the others follow")
    np.testing.assert_allclose(
        shot.scene.strands[0].points + shot.scene.origin, GUIDES.reshape(-1, 3) * 0.01, atol=1e-7
    )


def test_marked_prim_by_prim(tmp_path):
    """One for guides, zero for the rest, each for a whole prim; it counts for more than the purpose."""
    mark = "int primvars:groom_guide = {} (interpolation = 'constant')"
    guides, hair = _curves("Guides", GUIDES, mark.format(1)), _curves("Hair", OTHERS, mark.format(0))
    shot = _read(tmp_path, PLATE + guides + hair)
    assert _led(shot) == {"Guides": 0, "Hair": 13}
    assert not any("guide" in warning for warning in shot.warnings)
    shot = _read(tmp_path, PLATE + guides + _curves("Hair", OTHERS, mark.format(0), GUIDE_PURPOSE), "purpose")
    assert _led(shot)["Hair"] == 13


def test_without_marks_all_are_simulated(tmp_path):
    shot = _read(tmp_path, PLATE + _curves("Guides", GUIDES) + _curves("Hair", OTHERS))
    assert _led(shot) == {"Guides": 0, "Hair": 0}
    assert sum(strands.strand_count for strands in shot.scene.strands) == 18


def test_an_empty_relationship_simulates_all(tmp_path):
    hair = _curves("Hair", OTHERS, "rel plait:guides = []")
    shot = _read(tmp_path, PLATE + _curves("Guides", GUIDES, GUIDE_PURPOSE) + hair)
    assert _led(shot) == {"Guides": 0, "Hair": 0}
    assert any("nothing follows" in warning for warning in shot.warnings)


def test_guides_of_another_skin_do_not_lead(tmp_path):
    """Here another plate, 50 cm off; named, they do."""
    other = PLATE.replace('"Plate"', '"Other"').replace("(0, 0, 0), 6: (5, 1, 0)", "(50, 0, 0), 6: (55, 1, 0)")
    far = _curves("Beard", OTHERS + np.float32([50, 0, 0]))
    body = PLATE + other + _curves("Guides", GUIDES, _marks([1] * 5))
    assert _led(_read(tmp_path, body + far)) == {"Guides": 0, "Beard": 0}
    named = far.replace('type = "linear"', 'type = "linear"\n        rel plait:guides = </World/Guides>')
    shot = _read(tmp_path, body + named, "named")
    assert _led(shot)["Beard"] == 13
    assert "plait:guides" in _reports(shot)["Beard"][1]


def test_near_no_skin_those_of_the_same_group_lead(tmp_path):
    marked, rest = _curves("Guides", GUIDES, GUIDE_PURPOSE), _curves("Hair", OTHERS)
    assert _led(_read(tmp_path, marked + rest))["Hair"] == 13
    apart = 'def Xform "A"\n{' + marked + '}\ndef Xform "B"\n{' + rest + "}\n"
    assert _led(_read(tmp_path, apart, "apart"))["Hair"] == 0


def test_named_guides_lead_curves_without_a_role(tmp_path):
    """In a shot with roles, where such curves are else left alone."""
    guides = _curves("Guides", GUIDES, 'token plait:role = "strands"')
    hair = _curves("Hair", OTHERS, "rel plait:guides = </World/Guides>")
    assert _led(_read(tmp_path, PLATE + guides + hair))["Hair"] == 13


@pytest.mark.parametrize(
    ("guides", "hair", "prim", "attribute"),
    [
        ([], ["rel plait:guides = </World/Gone>"], "Hair", "plait:guides"),
        ([], ["rel plait:guides = </World/Plate>"], "Hair", "plait:guides"),
        ([], ["rel plait:guides = </World/Hair>"], "Hair", "plait:guides"),
        (["rel plait:guides = </World/Hair>"], ["rel plait:guides = </World/Guides>"], "Guides", "plait:guides"),
        (["bool plait:free = true"], ["rel plait:guides = </World/Guides>"], "Guides", "plait:free"),
        (["bool plait:free = true", _marks([1, 0, 0, 0, 0])], [], "Guides", "plait:free"),
        ([_marks([1, 0])], [], "Guides", "primvars:groom_guide"),
        (['string primvars:groom_guide = "all"'], [], "Guides", "primvars:groom_guide"),
        ([GUIDE_PURPOSE], ["rel plait:attach:tie = </World/Plate>"], "Hair", "plait:attach"),
    ],
)
def test_what_cannot_lead_or_follow_is_refused(guides, hair, prim, attribute, tmp_path):
    with pytest.raises(InputError) as refusal:
        _read(tmp_path, PLATE + _curves("Guides", GUIDES, *guides) + _curves("Hair", OTHERS, *hair))
    line = str(refusal.value)
    assert f"</World/{prim}> {attribute}: " in line and ";" in line and "\n" not in line


def test_points_of_followers_cannot_be_attached(tmp_path):
    first = int(np.argmax(ORDER >= 5)) * (SEGMENTS + 1) + 3
    lines = f"rel plait:attach:tie = </World/Plate>\n        int[] plait:attach:tie:points = [{first}]"
    body = TOGETHER.replace("int[] primvars:groom_guide", f"{lines}\n        int[] primvars:groom_guide")
    with pytest.raises(InputError, match="whose curve follows guides"):
        _read(tmp_path, body)
    held = _read(tmp_path, body.replace(f"[{first}]", "[2]"), "held").scene.attachments[0]
    assert held.point.tolist() == [2]
