"""Frame ranges and the legs a run is cut into."""

from __future__ import annotations

import pytest

from plait.pipeline.errors import UsageError
from plait.pipeline.frames import FrameRange, parse, schedule


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1001", FrameRange(1001, 1001)),
        ("1:240", FrameRange(1, 240)),
        ("1-240", FrameRange(1, 240)),
        ("1:240x2", FrameRange(1, 240, 2)),
        ("-5:3", FrameRange(-5, 3)),
        ("-5--3", FrameRange(-5, -3)),
        ("0.5:2.5x0.5", FrameRange(0.5, 2.5, 0.5)),
    ],
)
def test_ranges_as_usd_and_farms_write_them(text, expected):
    assert parse(text) == expected


@pytest.mark.parametrize("text", ["", "a", "1:", "1:2:3", "5:1", "1:5x0", "1:9e9", "nan", "1:99999999", "1 2"])
def test_what_is_no_range_is_refused_by_name(text):
    with pytest.raises(UsageError, match="--frames"):
        parse(text)


def test_a_stride_keeps_the_end_only_if_it_falls_on_it():
    assert parse("1:6x2").codes == (1, 3, 5)
    assert parse("1:5x2").codes == (1, 3, 5)


def test_legs_end_exactly_on_frames_and_share_substeps_by_length():
    """A frame is divided so that substeps end on it; a stride of 2 simulates the frame between too."""
    begin, legs = schedule(FrameRange(10, 14, 2), preroll=3, substeps=8)
    assert begin == 7
    assert [leg.code for leg in legs] == [8, 9, 10, 11, 12, 13, 14]
    assert {leg.substeps for leg in legs} == {8}
    assert [leg.frame for leg in legs] == [None, None, 10, None, 12, None, 14]


def test_without_preroll_the_first_frame_is_the_start_itself():
    begin, legs = schedule(FrameRange(1, 2), preroll=0, substeps=4)
    assert begin == 1
    assert [(leg.code, leg.substeps) for leg in legs] == [(1, 0), (2, 4)]


def test_shutter_samples_stand_around_each_frame():
    _, legs = schedule(FrameRange(1, 2), preroll=1, substeps=8, shutter=(-0.25, 0.25))
    assert [leg.code for leg in legs if leg.frame == 1] == [0.75, 1.0, 1.25]
    assert [leg.code for leg in legs if leg.frame == 2] == [1.75, 2.0, 2.25]
    assert [leg.last_of_frame for leg in legs if leg.frame == 1] == [False, False, True]
    assert [leg.substeps for leg in legs if leg.frame == 2] == [4, 2, 2]


@pytest.mark.parametrize("shutter", [(-0.5, 0.5), (-0.7, 0.7)])
def test_shutter_samples_that_meet_or_pass_the_next_frames_are_refused(shutter: tuple[float, float]):
    with pytest.raises(UsageError, match="shutter"):
        schedule(FrameRange(1, 2), preroll=0, substeps=8, shutter=shutter)
