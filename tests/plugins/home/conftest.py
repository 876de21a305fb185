"""The way home over our connection, against a simulated autopilot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.reference_map import open_map_set
from edge_plugins.home.route import RoutePlan, RouteStart, plan_route
from tests.plugins.home.home_requests import ENABLED
from tests.telemetry import conftest
from tests.telemetry.rig import START_NS, OpenRig, Rig

open_rig, rig = conftest.open_rig, conftest.rig


@pytest.fixture
def open_home(open_rig: OpenRig, map_along: Callable[..., Path]) -> OpenRig:
    """A connection whose vehicle drives along the map, with some way behind it and its position known."""
    along_m = np.arange(-40.0, 400.0, 2.0)[:, None]
    bend_m = 10 * np.sin(along_m / 60)
    course = np.array([np.sin(np.radians(60)), np.cos(np.radians(60))])
    maps = open_map_set(map_along(along_m * course + bend_m * [-course[1], course[0]]))

    def open_one(**options: Any) -> Rig:
        config = options.setdefault("home", ENABLED)
        rig = open_rig(**options)

        def plan(start: RouteStart, places: Sequence[str]) -> RoutePlan:
            # The simulated vehicle drives away from home, which is only a warning.
            return plan_route(maps, start, config, places=places)

        rig.home.plan = plan

        def is_ready() -> bool:
            return rig.bounded_m is not None and rig.connection.vehicle.drives_itself is not None

        assert rig.run(12.0, lambda: is_ready() and rig.now_ns > START_NS + 9e9)
        return rig

    return open_one


@pytest.fixture(params=["ardupilot", "px4"])
def home(open_home: OpenRig, request: pytest.FixtureRequest) -> Rig:
    return open_home(firmware=request.param)
