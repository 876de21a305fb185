"""The live page: `server` is its thread, `snapshot` what it shows, `metrics` the same for Prometheus.

`coverage_job` computes where a map works, and `plugin` is the daemon's side of all this.
"""

from __future__ import annotations

import logging
import os
from typing import TYPE_CHECKING

from edge.config import PageConfig
from edge.extras import install_command
from edge_plugins.page.snapshot import LiveStatus, MapView, Snapshot, map_view

if TYPE_CHECKING:
    from edge_plugins.page.server import StatusPage

__all__ = ["LiveStatus", "MapView", "Snapshot", "map_view", "open_page"]
log = logging.getLogger(__name__)


def open_page(config: PageConfig, maps: MapView) -> StatusPage | None:
    """The live page, or None and a line in the log: without it places are recognized just as well."""
    if config.port == 0:
        return None
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
