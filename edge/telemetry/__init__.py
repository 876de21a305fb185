"""Telemetry: what the robot says about itself comes in, place fixes go out, over MAVLink 2.

`link` is the serial port or the socket, `codec` turns its bytes into messages, `vehicle` reads them (with
`boot_clock` for the autopilot's time and `odometer` for metres driven), `fixes` writes ours, `autopilot` joins
them into the one object that the daemon polls, and `journal` keeps what happened.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from edge.telemetry.link import Link, parse_connection


class PlaceFix(msgspec.Struct, frozen=True, tag_field="event", tag="place"):
    """A recognised place, as the robot is told of it and as the journal keeps it.

    stamp_ns: exposure of the frame, on CLOCK_MONOTONIC. place: row of the reference map. Latitude and longitude in
    degrees (WGS 84) and heading in degrees clockwise from north, each None where the map does not know it.
    sigma_m: one standard deviation, horizontal. direction: of travel against the map's. order: whether left and
    right regions matched their own side or the other. uniqueness: second-best cost over the best, outside a window.
    """

    stamp_ns: int
    place: int
    lat_deg: float | None
    lon_deg: float | None
    heading_deg: float | None
    sigma_m: float
    direction: Literal["forward", "reverse"]
    order: Literal["same", "swapped"]
    uniqueness: float
    category: str


def open_link(connection: str) -> Link:
    """Open `serial:DEVICE:BAUD`, `udp:HOST:PORT` or `udpin:HOST:PORT`.

    Raises ConfigError for a malformed string, and LinkLost when the port is missing, in use or not permitted.
    """
    return parse_connection(connection).open()
