"""The live page: `server` is its thread, `snapshot` what it shows, `metrics` the same for Prometheus.

`plugin` is the daemon's side of all this.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta

from edge.config import Config, Section


class PageConfig(Section, frozen=True):
    """[page]: the live page, on which nothing can be changed but where the operator says that the vehicle is."""

    plugin: ClassVar[str] = "edge_plugins.page.plugin:Page"
    bind: str = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 8642
    hosts: tuple[str, ...] = ()

    def asks(self, config: Config) -> bool:
        """Where it has a port."""
        return self.port > 0
