"""Shared fixtures."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real USD samples and reference values that lies beside a developer's checkout."""
    if not SHARED.is_dir():
        pytest.skip("real samples and references are not part of a clone; they lie beside a developer's checkout")
    return SHARED


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of the test session's own: what earlier versions kept must not decide what is tested."""
    before = os.environ.get("PLAIT_CACHE")
    folder = tmp_path_factory.mktemp("cache")
    os.environ["PLAIT_CACHE"] = str(folder)
    yield folder
    if before is None:
        del os.environ["PLAIT_CACHE"]
    else:
        os.environ["PLAIT_CACHE"] = before
