"""Telemetry: what the robot says about itself comes in, place fixes go out, over MAVLink 2.

`link` is the serial port or the socket, `codec` (with `signing`) turns its bytes into messages, and `port` keeps it
open. `vehicle` reads what arrives, with `boot_clock` for the autopilot's time, `odometer` for meters driven and
`displacement` for meters east and north. `fixes` writes what we send, `ways` says which message carries a position to
which firmware, `gates` (with `witnesses`) when it may go, `answers` what an acknowledgement means, and `positions`
joins those. `manners` keeps the link as others expect it, `texts` and `reports` tell people. `autopilot` joins all into
the one object that the daemon polls, and `journal` keeps what happened.
"""

from __future__ import annotations

from dataclasses import dataclass

from edge.telemetry.link import Link, parse_connection


@dataclass(frozen=True)
class LinkStatus:
    """state: closed | waiting | up. Degrees (WGS 84), heading clockwise from north; None where not known."""

    state: str
    connection: str
    emit: str
    lat_deg: float | None = None
    lon_deg: float | None = None
    heading_deg: float | None = None
    speed_mps: float | None = None
    gps_healthy: bool = False


def open_link(connection: str) -> Link:
    """Open `serial:DEVICE:BAUD`, `udp:HOST:PORT` or `udpin:HOST:PORT`.

    Raises ConfigError for a malformed string, and LinkLost when the port is missing, in use or not permitted.
    """
    return parse_connection(connection).open()
