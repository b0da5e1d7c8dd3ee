"""Every example runs, does what its page says, and has a picture that is small enough to ship."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from plait.assets.jelly import ball
from plait.pipeline import preview
from plait.pipeline.errors import PlaitError

EXAMPLES = sorted(path for path in (Path(__file__).parents[1] / "examples").iterdir() if path.is_dir())


def load(folder: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{folder.name}", folder / "example.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where its dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


def runs() -> list[Any]:
    """Each example once; those that come in sizes small, and, slow, as large as their pages show them."""
    found = []
    for folder in EXAMPLES:
        sized = "SIZES" in (folder / "example.py").read_text()
        found.append(pytest.param(folder, "small" if sized else None, id=folder.name))
        if sized:
            found.append(pytest.param(folder, "default", id=f"{folder.name}-default", marks=pytest.mark.slow))
    return found


@pytest.mark.parametrize(("folder", "size"), runs())
def test_example_runs_and_holds(folder, size, tmp_path):
    """`main` runs it, checks it and draws it; where nothing can be drawn it does the rest."""
    example = load(folder)
    sized = {"size": size} if size else {}
    try:
        preview.probe()
    except PlaitError:
        example.main(tmp_path, draw=False, **sized)
        return
    example.main(tmp_path, **sized)
    (picture,) = tmp_path.glob("*.jpg")
    assert picture.stat().st_size > 5_000


@pytest.mark.parametrize("folder", EXAMPLES, ids=lambda folder: folder.name)
def test_example_has_a_page_with_its_picture(folder):
    page = (folder / "README.md").read_text()
    (picture,) = folder.glob("*.jpg")
    assert f"({picture.name})" in page and "What to look at" in page
    assert picture.stat().st_size < 150_000


def test_a_broken_result_fails_its_check():
    """The checks can fail: ropes that a ball is simply moved through."""
    example = load(next(folder for folder in EXAMPLES if folder.name == "ropes_and_ball"))
    still = example.scene().strands[0].points.reshape(1, example.ROPES, example.NODES, 3)
    centres = [example.ball_centre(time) for time in (0.0, 0.4, 0.8)]
    result = example.Result(still.repeat(3, axis=0), example.np.array(centres), example.np.zeros(3))
    with pytest.raises(AssertionError):
        example.check(result)


def test_bears_left_as_they_started_fail_their_check():
    example = load(next(folder for folder in EXAMPLES if folder.name == "inversion"))
    body, skin = example.jelly.soft_body(*example.jelly.bear(600), 0.05)
    layout = example.build_layout(example.Scene(surfaces=(skin,), bodies=(body,)))
    started = example.starts(layout.rest, 0.05)
    left = {(name, 1.0): nodes for name, nodes in started.items()}
    recovered = {key: layout.rest for key in left}
    example.check(example.Result(layout, skin, started, hybrid=recovered, plain=left))
    for hybrid, plain in ((left, left), (recovered, recovered)):
        with pytest.raises(AssertionError):
            example.check(example.Result(layout, skin, started, hybrid=hybrid, plain=plain))


def test_a_braid_left_loose_or_passed_through_fails_its_check():
    example = load(next(folder for folder in EXAMPLES if folder.name == "braid"))
    loose = example.braided(example.SIZES["small"])
    through = loose * [1.0, 1.0, -1.0]
    for after in (loose, through):
        with pytest.raises(AssertionError):
            example.check(example.Result(example.np.stack([loose, after]), 0.0))


def test_a_tube_that_one_strand_passes_through_fails_its_check():
    example = load(next(folder for folder in EXAMPLES if folder.name == "hair_tubes"))
    points = {"upper": example.np.zeros((2, 4, 9, 3)), "lower": example.np.zeros((2, 4, 9, 3))}
    without = example.Played(points, missed=16, strain=0.0, seconds=0.0)
    example.check({"none": without, "implicit": example.replace(without, missed=0)})
    for broken in ({"missed": 1}, {"missed": 0, "strain": 0.1}):
        with pytest.raises(AssertionError):
            example.check({"none": without, "implicit": example.replace(without, **broken)})


def test_hair_that_stays_braided_or_passes_through_fails_its_check():
    example = load(next(folder for folder in EXAMPLES if folder.name == "braiding"))
    size, np = example.SIZES["small"], example.np
    down = np.linspace(0.0, example.LENGTH, 400)
    # Hair along the paths that the ends are led on is braided as they are.
    made = np.array([example.led(size, time) for time in np.linspace(0.0, size.make, 400)]).swapaxes(0, 1)
    made[..., 1] = -down
    straight = made[:, :1] - down[:, None] * [0.0, 1.0, 0.0]
    points = np.array([straight] * (size.frames + 1))[:, :, None]
    points[size.made] = made[:, None]
    held = example.Result(points, missed=0, strain=0.0)
    example.check(size, held)
    never, still = points.copy(), points.copy()
    never[size.made], still[-1] = points[0], points[size.made]
    for broken in ({"points": never}, {"points": still}, {"missed": 1}, {"strain": 0.1}):
        with pytest.raises(AssertionError):
            example.check(size, example.replace(held, **broken))


def test_hair_on_a_ball_that_overlaps_or_passes_through_fails_its_check():
    example = load(next(folder for folder in EXAMPLES if folder.name == "hair_ball"))
    size, np = example.SIZES["small"], example.np
    straight = example.scene(size).strands[0].points.reshape(1, size.hairs, -1, 3)
    without = example.Result(straight, missed=1000, strain=0.0, volume=0.9)
    held = example.replace(without, missed=0, volume=example.kept(straight[0], size.radius))
    assert held.volume > 0.99  # none overlaps; and half of them is left of hairs that are two and two in one place
    assert example.kept(np.repeat(straight[0, ::2], 2, axis=0), size.radius) == pytest.approx(0.5, abs=0.01)
    example.check(size, {"implicit": held, "none": without})
    inside = 0.5 * straight
    for broken in ({"missed": 1}, {"strain": 0.1}, {"volume": 0.9}, {"points": inside}):
        with pytest.raises(AssertionError):
            example.check(size, {"implicit": example.replace(held, **broken), "none": without})
    with pytest.raises(AssertionError):
        example.check(size, {"implicit": held, "none": example.replace(without, missed=size.hairs // 2)})


def test_hair_that_goes_stiffly_with_the_head_fails_its_check():
    """Neither swings as she walks, nor flies out as she dances, nor wraps."""
    walking, dancer = (
        load(next(folder for folder in EXAMPLES if folder.name == name))
        for name in ("walking_with_hair", "dancer")
    )
    np, frames = walking.np, 33
    head = np.array([[0.0, 170.0, 0.0]])
    hair = np.array([[[0.0, 165.0, 10.0], [0.0, 140.0, 12.0]]] * 4)
    moved = np.linspace(0.0, 1.0, frames)[:, None] * [0.0, 0.0, 200.0]
    worn = walking.wig.Worn(hair + moved[:, None, None], head + moved[:, None], np.zeros((0, 3), int))
    for example in (walking, dancer):
        with pytest.raises(AssertionError):
            example.check(worn)


def test_pinwheels_that_stand_still_or_hold_sand_fail_their_check():
    example = load(next(folder for folder in EXAMPLES if folder.name == "pinwheels"))
    np, shot = example.np, example.SHOT
    axes, senses = shot["axes"](3), shot["senses"](3)

    def shown(turns, off=0.0):
        wheels = np.tile(np.eye(4), (len(turns), 3, 1, 1))
        wheels[..., :3, 3] = axes + np.array([off, 0.0, 0.0])
        for frame, turn in enumerate(turns):
            cos, sin = np.cos(turn), np.sin(turn * senses)
            wheels[frame, :, 0, 0], wheels[frame, :, 0, 1] = cos, -sin
            wheels[frame, :, 1, 0], wheels[frame, :, 1, 1] = sin, cos
        return example.Shown(wheels, [], [])

    around = np.linspace(0.0, 4.0, 5)
    example.check_wheels(shown(around))
    for broken in (shown(0.0 * around), shown(-around), shown(around, off=0.01 * shot["RADIUS"])):
        with pytest.raises(AssertionError):
            example.check_wheels(broken)
    clear, within = np.array([[0.0, 1.0, 0.0]]), axes[:1]
    behind = clear + np.array([0.0, 0.0, 2.0 * shot["HALF_DEPTH"]])
    example.check_clear(shown(around), "clear", [clear] * 5, 0.01)
    for broken in (within, behind):
        with pytest.raises(AssertionError):
            example.check_clear(shown(around), "broken", [clear] * 4 + [broken], 0.01)


def test_jellies_that_hold_sand_within_or_shrink_fail_their_check():
    example = load(next(folder for folder in EXAMPLES if folder.name == "sand_on_jellies"))
    np, size = example.np, example.SIZES["default"]
    points, triangles = ball(0.05)
    points = points + np.array([0.0, 0.05, 0.0])
    on = np.array([[0.0, 0.11, 0.0], [0.2, 0.01, 0.0]])
    modulus = size.moduli[0]
    held = example.Jelly(points, 0.999 * points, triangles, on)
    assert held.held == 0.5
    example.check_jelly(held, modulus, size)
    for broken in ({"points": 0.8 * points}, {"grains": on - np.array([0.0, 0.05, 0.0])}, {"grains": on[1:]}):
        with pytest.raises(AssertionError):
            example.check_jelly(replace(held, **broken), modulus, size)


def test_hair_that_snow_does_not_push_or_throws_fails_its_check():
    example = load(next(folder for folder in EXAMPLES if folder.name == "snowball_on_hair"))
    np, size = example.np, example.SIZES["default"]
    out = ball(1.0)[0]
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    along = np.linspace(0.0, example.SHOT["HAIR"], size.segments + 1)[:, None]
    straight = example.SHOT["RADIUS"] * out[:, None] + along * out[:, None]
    aside = np.cross(out, [0.3, 0.5, 0.8])  # the way of no point of the ball
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    bent = straight[:, :1] + along * aside[:, None]
    hit, far = example.struck(straight[:, 0])
    assert hit.any() and far.any() and not (hit & far).any()
    frames = np.array([straight] * (size.frames + 1))
    frames[1, hit] = bent[hit]
    frames[size.landed + 1] = bent  # all of it, as the ball shakes
    speeds = np.full(frames.shape[:2], 0.9 * np.linalg.norm(example.SHOT["VELOCITY"]))
    held = example.Shown(frames, speeds, [])
    example.check_hair(held, size)
    untouched, everywhere, left = frames.copy(), frames.copy(), frames.copy()
    untouched[1], everywhere[1], left[-1] = straight, bent, bent
    for broken in ({"hair": untouched}, {"hair": everywhere}, {"hair": left}, {"speeds": 4.0 * speeds}):
        with pytest.raises(AssertionError):
            example.check_hair(replace(held, **broken), size)


def test_snow_that_stays_or_goes_into_the_ball_fails_its_check():
    example = load(next(folder for folder in EXAMPLES if folder.name == "snowball_on_hair"))
    np, size = example.np, example.SIZES["default"]
    thrown = 0.045 * ball(1.0)[0] / np.abs(ball(1.0)[0]).max() + example.SHOT["START"]
    flat = (thrown - example.SHOT["START"]) * [1.2, 0.1, 1.2] + [0.0, 0.1, 0.0]
    snow = [thrown] + [flat] * size.landed + [10.0 * thrown] * (size.frames - size.landed)
    held = example.Shown(np.zeros(0), np.zeros(0), snow)
    example.check_snow(held, size)
    within = [*snow[:5], flat - [0.0, 0.1, 0.0], *snow[6:]]
    ricochet = [thrown] + snow[-1:] * size.frames
    whole = [thrown] + [thrown - example.SHOT["START"] + [0.0, 0.13, 0.0]] * size.landed + snow[size.landed + 1 :]
    for broken in (within, ricochet, whole, [*snow[:-1], flat]):
        with pytest.raises(AssertionError):
            example.check_snow(replace(held, snow=broken), size)
