"""The way home and other routes in the daemon: requests by the autopilot's link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from edge.plugin import Parts, Plugin
from edge.reference_map import MapSet
from edge_plugins.home import HomeConfig
from edge_plugins.home.home_requests import HomeRequests
from edge_plugins.home.route import RoutePlan, RouteStart, plan_route

if TYPE_CHECKING:
    from edge_plugins.mapping.plugin import Mapping


class Home(Plugin):
    """[home]: requests, and the plan by the maps that are searched."""

    def __init__(self, config: HomeConfig, parts: Parts) -> None:
        self._config, self._parts = config, parts
        self.service = self.requests = HomeRequests(config, parts.autopilot)

    def start(self) -> None:
        """From now on there are maps to plan by."""
        self.requests.plan = self._plan

    def _plan(self, start: RouteStart, places: Sequence[str]) -> RoutePlan:
        """With the map of this drive up to the vehicle, if there is one."""
        maps = self._parts.recognizer.map_set

        def driven(mapping: Mapping) -> tuple[MapSet, RouteStart]:
            return maps.with_newest(mapping.live.store.whole()), replace(start, route_m=mapping.driven_m())

        maps, start = self._parts.plugins.ask("mapping", driven) or (maps, start)
        return plan_route(maps, start, self._config, self._parts.config.rig, places=places)
