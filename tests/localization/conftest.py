"""A mapped road, and vehicles on it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.localization.events_of import Road
from tests.localization.route_course import Stretch


@pytest.fixture(scope="session")
def road(tmp_path_factory: pytest.TempPathFactory) -> Road:
    """Two stretches of 400 m, the second one from 1 km on."""
    return Road(tmp_path_factory.mktemp("road"), Stretch(0, 400, sigma_m=1.0), Stretch(1000, 1400, sigma_m=1.0))


@pytest.fixture
def mapped(tmp_path: Path) -> Callable[..., Road]:
    """A road with the map of some stretches of it."""
    return lambda *stretches: Road(tmp_path, *stretches)
