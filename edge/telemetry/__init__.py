"""Telemetry over MAVLink 2: what the autopilot reports comes in, place fixes go out.

In: `link` is the serial port or the socket, `codec` (with `signing`) turns its bytes into messages, and `port` opens it
again when it is lost. `vehicle` reads those: with `boot_clock` for the autopilot's time, `gps` for its receivers, and
`vehicle_velocity` for how it moves. What it knows of one autopilot is a `session`, which another one replaces.
`position_history` has its position at an exposure.

Out: `firmware` is what each autopilot can do. `link_protocol` requests what is read, and says what measures the
velocity without GPS. `position_sender` sends positions; `acknowledgements` says what an answer means and follows what
the autopilot makes of each position, and `source_selection` selects whether its filter uses GPS. `wheel_store` keeps
what drives show of the wheels. `steering` is by what the vehicle steers. `people` is for people, and `encoders` writes
all that is sent. `autopilot` joins all into the one object that the daemon polls.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from edge.telemetry.link import Link, parse_connection


@dataclass(frozen=True)
class LinkStatus:
    """What is known of the autopilot's link; degrees (WGS 84), heading clockwise from north; None where not known.

    state: closed | waiting | up. gps: healthy | not healthy | unknown; gps_why: why it is unknown.
    velocity_aid: what measures velocity without GPS by its parameters, "none" where nothing does. wheels: by how much
    these measure too little, in words, by this drive and those before. gps_verdict, gps_off_m, gps_off, gps_doubt:
    what the places say of GPS, see GpsVerdict; gps_off in words. gps_use, steers_by, reckoned_m: see
    `Steering`. sent: how many positions have left, by MAVLink message; sent_ns: when the newest did (CLOCK_MONOTONIC);
    sent_sigma_m: its standard deviation; level_along_m, level_cross_track_m: its protection level, None where nothing
    bounds it. confirmed_ns: when the autopilot last agreed with one.
    """

    state: str
    connection: str
    emit: str
    lat_deg: float | None = None
    lon_deg: float | None = None
    heading_deg: float | None = None
    speed_mps: float | None = None
    gps: str = "unknown"
    gps_why: str = ""
    velocity_aid: str | None = None
    wheels: str | None = None
    gps_verdict: str = "cannot say"
    gps_off_m: float | None = None
    gps_off: str = ""
    gps_doubt: float | None = None
    gps_use: str = "unknown"
    steers_by: str = "unknown"
    reckoned_m: float | None = None
    sent: dict[str, int] = field(default_factory=dict)
    sent_ns: int | None = None
    sent_sigma_m: float | None = None
    confirmed_ns: int | None = None
    level_along_m: float | None = None
    level_cross_track_m: float | None = None


def open_link(connection: str) -> Link:
    """Open `serial:DEVICE:BAUD`, or `udp`, `udpin`, `tcp` or `tcpin`, each with `:HOST:PORT`.

    Raises ConfigError for a malformed string, and LinkLost when the port is missing, in use or not permitted.
    """
    return parse_connection(connection).open()
