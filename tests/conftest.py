"""Fixtures shared by all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from headless import find_browser

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = ROOT.parent / "shared" / "reference"


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder of what the published simulator was recorded to do; skips where it is absent."""
    if not REFERENCE.is_dir():
        pytest.skip("no recorded reference: the folder ../shared/reference is absent")
    return REFERENCE


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the project's own test data."""
    return Path(__file__).parent / "data"


@pytest.fixture(scope="session")
def browser() -> str:
    return find_browser()
