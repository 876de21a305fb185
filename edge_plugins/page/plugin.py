"""[page] in the daemon: what the live page shows."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING

from edge.extras import install_command
from edge.plugin import Parts, Plugin, UsedFrame
from edge_plugins.page import PageConfig
from edge_plugins.page.snapshot import DaemonStatus, LiveStatus, MapView, beside_lane_m, map_view

if TYPE_CHECKING:
    from edge_plugins.mapping.plugin import Mapping
    from edge_plugins.mapping.status import MappingView
    from edge_plugins.page.server import StatusPage

log = logging.getLogger(__name__)


class Page(Plugin):
    """The daemon's side of the page's thread, `StatusPage`."""

    def __init__(self, config: PageConfig, parts: Parts) -> None:
        self._config, self._parts = config, parts
        self.server: StatusPage | None = None

    def start(self) -> None:
        """Serve it, if that is possible."""
        config, recognizer = self._parts.config, self._parts.recognizer
        self._live = LiveStatus(
            recognizer.model_name,
            config.acceptance.confidence_from,
            sequence_frames=recognizer.config.sequence_frames,
            sampling=recognizer.config.sampling,
        )
        self._maps = recognizer.map_set
        self.server = open_page(self._config, map_view(self._maps, self._parts.config.camera.view))

    def frame_used(self, used: UsedFrame) -> None:
        """Keep it for a while."""
        position = self._parts.autopilot.vehicle.position(self._parts.clock_ns())
        vehicle = (position.lat_deg, position.lon_deg) if position else None
        self._live.add(used.frame, used.match, used.record, vehicle, self._parts.recognizer.correspondences)

    def turn(self, spare_s: float | None) -> None:
        """Hand over what somebody waits for; maps as they are searched now."""
        server, maps = self.server, self._parts.recognizer.map_set
        if server is None:
            return
        if maps is not self._maps:
            self._maps, self._live.match = maps, None
            server.show_map(map_view(maps, self._parts.config.camera.view))
        if server.wanted:
            self._show(server)
        stated, now_ns = self._parts.autopilot.stated, self._parts.clock_ns()
        server.answer_stated(lambda lat_deg, lon_deg, sigma_m: stated.use(lat_deg, lon_deg, sigma_m, "page", now_ns))

    def close(self) -> None:
        """Stop serving."""
        if self.server is not None:
            self.server.close()

    def _show(self, server: StatusPage) -> None:
        parts, health, match = self._parts, self._parts.health(), self._live.match
        position = parts.drive.state.position

        def mapped(mapping: Mapping) -> MappingView:
            return mapping.view()

        status = DaemonStatus(
            stamp_ns=parts.clock_ns(),
            map_name=f"{Path(parts.config.map.path).name}, {self._maps}",
            state=health.state,
            why=health.why,
            stages_ms=parts.times.medians_ms(),
            journal_lost=parts.lost(),
            camera=parts.camera.health,
            camera_by_keypoints=parts.recognizer.camera,
            link=parts.autopilot.status(),
            mapping=parts.plugins.ask("mapping", mapped),
            position=position,
            beside_lane_m=beside_lane_m(position, parts.drive.route, match.place_index) if position and match else None,
            no_pose_m=health.no_pose_m,
        )
        server.show(self._live.snapshot(status))


def open_page(config: PageConfig, maps: MapView) -> StatusPage | None:
    """The live page, or None and a line in the log: without it places are recognized just as well."""
    try:
        # Imported here: a vehicle without the page never loads a web server.
        from edge_plugins.page.server import StatusPage

        page = StatusPage(config, maps)
    except ModuleNotFoundError as error:
        log.info("no live page: the package %s is missing: %s", error.name, install_command("page"))
        return None
    except OSError as error:
        log.warning("no live page: [page] %s:%d: %s", config.bind, config.port, os.strerror(error.errno or 0))
        return None
    log.info("live page: http://%s:%d", f"[{config.bind}]" if ":" in config.bind else config.bind, page.port)
    return page
