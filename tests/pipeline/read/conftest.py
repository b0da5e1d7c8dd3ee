"""Small shots written as text."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import pytest

from plait.pipeline.config import Config
from plait.pipeline.read import read_shot
from plait.pipeline.shot import Shot

HEADER = """#usda 1.0
(
    metersPerUnit = {meters}
    upAxis = "{up}"
    startTimeCode = 1
    endTimeCode = 10
    timeCodesPerSecond = 24
)
"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """write(text, meters=1, up='Y') -> the path of a stage with that body."""

    def make(text: str, meters: float = 1.0, up: str = "Y", name: str = "shot") -> Path:
        path = tmp_path / f"{name}.usda"
        path.write_text(HEADER.format(meters=meters, up=up) + text)
        return path

    return make


@pytest.fixture
def read(write: Callable[..., Path]) -> Callable[..., Shot]:
    """read(text, meters=1, up='Y', **configuration) -> the shot."""

    numbers = itertools.count()

    def make(text: str, meters: float = 1.0, up: str = "Y", **configuration) -> Shot:
        # A name of its own for each: USD keeps the layers of a shot that is still held.
        return read_shot(write(text, meters, up, f"shot{next(numbers)}"), Config(**configuration))

    return make
