"""Fixtures that several folders of tests need."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real recordings and float weights beside the checkout; what needs it is skipped without it."""
    if not SHARED.is_dir():
        pytest.skip(f"needs the real recordings in {SHARED.name}/ beside the checkout, which is not there")
    return SHARED
