"""Shared fixtures."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real USD samples and reference values that lies beside a developer's checkout."""
    if not SHARED.is_dir():
        pytest.skip("real samples and references are not part of a clone; they lie beside a developer's checkout")
    return SHARED
