"""Positions as NMEA 0183 for phones, plotters and gpsd: `sentences` spells them, `outlets` hands them out.

Report only: nothing here goes to an autopilot.
"""

from __future__ import annotations

import ipaddress
from typing import Annotated, ClassVar

from msgspec import Meta

from edge.config import Config, FilePath, Section


class NmeaConfig(Section, frozen=True):
    """[nmea]: positions for other programs as NMEA 0183; off without a port and without a pty."""

    plugin: ClassVar[str] = "edge_plugins.nmea.plugin:Nmea"
    port: Annotated[int, Meta(ge=0, le=65535)] = 0
    bind: str = "127.0.0.1"
    pty: FilePath = ""
    standing_s: Annotated[float, Meta(ge=0, le=600)] = 60.0

    def __post_init__(self) -> None:
        try:
            ipaddress.ip_address(self.bind)
        except ValueError:
            raise ValueError(f"bind: {self.bind!r} is not an IP address, such as 127.0.0.1") from None

    @property
    def is_local(self) -> bool:
        """Whether no other computer can read it."""
        return self.port == 0 or ipaddress.ip_address(self.bind).is_loopback

    def asks(self, config: Config) -> bool:
        """Where there is an outlet."""
        return self.port > 0 or bool(self.pty)
