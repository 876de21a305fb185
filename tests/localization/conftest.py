"""The map of `straight_road`, and route filters on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from edge.config import RigConfig, SamplingConfig
from edge.localization.route_filter import RouteFilter
from edge.reference_map.map_set import MapSet
from edge.reference_map.route import Route
from edge.reference_map.store import ModelKey, RegionsKey, open_map
from edge_plugins.mapping.builder import MapBuilder, Place
from tests.localization.straight_road import LAT_DEG, METRE_DEG, SPACING_M, settings


@pytest.fixture(scope="module")
def map_set(tmp_path_factory: pytest.TempPathFactory) -> MapSet:
    """Two drives of 200 places, the second 1 km further north."""
    path = tmp_path_factory.mktemp("tracking") / "map"
    raw = np.random.default_rng(1).random((200, 2, 8), np.float32)
    with MapBuilder(
        path, ModelKey("test", "0" * 64, "fc6", 8), RegionsKey("left-right", 0.4, "set"), SamplingConfig()
    ) as b:
        for drive_m in (0.0, 1000.0):
            b.begin_segment("drive", "rear")
            for row in range(200):
                lat_deg = LAT_DEG + (drive_m + row * SPACING_M) * METRE_DEG
                known = row, lat_deg, 153.0, 0.0, 0.0, row * SPACING_M
                b.add(raw[row], Place(*known, position_sigma_m=1.0, position_source="gps"))
        b.finish()
    return MapSet.of(open_map(path))


@pytest.fixture(scope="module")
def route(map_set: MapSet) -> Route:
    return Route(map_set)


@pytest.fixture
def open_filter(route: Route) -> Callable[..., RouteFilter]:
    def open_one(rig: RigConfig = RigConfig(), **tracking: Any) -> RouteFilter:  # noqa: B008  # frozen
        return RouteFilter(route, settings(rig, **tracking))

    return open_one
