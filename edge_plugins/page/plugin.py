"""[page] in the daemon: what the live page shows, and what is requested on it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from edge.opened_parts import OpenedParts
from edge.plugin import Plugin, UsedFrame
from edge_plugins.home.plugin import Home
from edge_plugins.mapping.plugin import Mapping
from edge_plugins.page import LiveStatus, map_view, open_page

if TYPE_CHECKING:
    from edge_plugins.page.server import StatusPage


class Page(Plugin):
    """The daemon's side of the page's thread, `StatusPage`."""

    def __init__(self, parts: OpenedParts) -> None:
        self._parts = parts
        self.server: StatusPage | None = None

    def start(self) -> None:
        """Serve it, if that is possible."""
        config, recognizer = self._parts.config, self._parts.recognizer
        self._live = LiveStatus(recognizer.model_name, config.acceptance.confidence_from)
        self.server = open_page(config.page, map_view(recognizer.map_set))

    def frame_used(self, used: UsedFrame) -> None:
        """Keep it for a while."""
        position = self._parts.autopilot.vehicle.position(self._parts.clock_ns())
        vehicle = (position.lat_deg, position.lon_deg) if position else None
        self._live.add(used.frame, used.match, used.record, vehicle)

    def maps_changed(self) -> None:
        """Show those that are searched now."""
        if self.server is not None:
            self.server.show_map(map_view(self._parts.recognizer.map_set))

    def turn(self) -> None:
        """Answer what was requested, and hand over what somebody waits for."""
        server = self.server
        if server is None:
            return
        if (wanted := server.requested()) is not None:
            self._request(server, wanted)
        if server.wanted:
            self._show(server)

    def close(self) -> None:
        """Stop serving."""
        if self.server is not None:
            self.server.close()

    def _request(self, server: StatusPage, wanted: str) -> None:
        home, mapping = self._parts.plugins.find(Home), self._parts.plugins.find(Mapping)
        if wanted in ("home", "restore"):
            if home is None:
                server.reply("the way home has failed: see the log")
            else:
                home.requests.ask(lambda answer: server.reply(answer.text), restore=wanted == "restore")
        elif mapping is not None:
            mapper = mapping.mapper
            mapper.paused = "paused on the page" if wanted == "pause" else ""
            server.reply(f"mapping {mapper.paused or 'goes on'}")
        else:
            server.reply("nothing is mapped: [mapping] folder is empty")

    def _show(self, server: StatusPage) -> None:
        parts, live = self._parts, self._live
        health, maps, mapping = parts.monitor.health, parts.recognizer.map_set, parts.plugins.find(Mapping)
        shown = live.snapshot(
            parts.clock_ns(),
            health.state,
            health.why,
            map_name=f"{Path(parts.config.map.path).name}, {maps}",
            costs=parts.recognizer.cost_view(live.match),
            camera=parts.camera.health,
            link=parts.autopilot.status(),
            stages_ms=parts.times.medians_ms(),
            journal_lost=parts.journal.lost if parts.journal else 0,
            mapping=mapping.mapper.view() if mapping else None,
        )
        server.show(shown)


def open_plugin(parts: OpenedParts) -> Page | None:
    """Where [page] port is set."""
    return Page(parts) if parts.config.page.port else None
