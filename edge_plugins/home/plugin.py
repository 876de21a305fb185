"""The way home in the daemon: requests by the autopilot's link, `lookback home` and the page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from edge.opened_parts import OpenedParts
from edge.plugin import Plugin
from edge_plugins.home import Start, WayHome, plan_way_home
from edge_plugins.home.home_requests import HomeRequests
from edge_plugins.home.local_socket import LocalSocket
from edge_plugins.mapping.plugin import Mapping


class Home(Plugin):
    """[home]: requests of all kinds, and the plan by the maps that are searched."""

    def __init__(self, parts: OpenedParts) -> None:
        """ConfigError where the socket cannot be made."""
        self._parts, config = parts, parts.config.home
        self.requests = HomeRequests(config, parts.autopilot)
        self._socket = LocalSocket(Path(config.socket)) if config.enabled and config.socket else None

    def start(self) -> None:
        """From now on there are maps to plan by."""
        self.requests.plan = self._plan

    def turn(self) -> None:
        """Answer `lookback home`."""
        if self._socket is not None and (request := self._socket.requested()) is not None:
            self.requests.ask(self._socket.reply, restore=request == "restore")

    def close(self) -> None:
        """Remove the socket."""
        if self._socket is not None:
            self._socket.close()

    def _plan(self, start: Start) -> WayHome:
        maps, config, mapping = self._parts.recognizer.map_set, self._parts.config, self._parts.plugins.find(Mapping)
        if mapping is not None:  # with the map of this drive up to the vehicle
            maps = maps.with_newest(mapping.mapper.live.whole())
            start = replace(start, route_m=mapping.mapper.driven_m())
        return plan_way_home(maps, start, config.home, config.rig.left_reverse_m)


def open_plugin(parts: OpenedParts) -> Home:
    """Always: also what [home] does not allow is answered."""
    return Home(parts)
