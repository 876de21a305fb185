"""What is known of one autopilot in one session, and what a single message of it may not change: whether the vehicle
drives itself, and the origin.

On an unsigned link a stranger can send a message in the autopilot's name, but cannot keep the autopilot's own messages
from coming. So both change only when nothing contradicts that for a while; and so does which boot the clock is of, see
`boot_clock`. What two senders report in turns, `position_history` finds. No I/O.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import VehiclePosition, east_north_of, moved
from edge.telemetry.boot_clock import UNDISPUTED_NS, BootClock
from edge.telemetry.firmware import Firmware, firmware_of
from edge.telemetry.gps import Gps

MODE_NS = 2_500_000_000
"""For so long each heartbeat must say that it does not drive itself: they come once a second, and one may be lost."""
ORIGIN_M, ORIGIN_NS = 20.0, 1_000_000_000
"""How far an origin may be from where the autopilot's global and local positions put it, less what it drove between.
In 20 recorded flights 99 % were within 4.3 m; 4 in 32,000 were further off, each while its filter was reset."""
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
FINDS_ITS_WAY = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | mavlink.MAV_MODE_FLAG_AUTO_ENABLED
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Origin:
    """The origin of the autopilot's local frame: degrees (WGS 84), meters above mean sea level."""

    lat_deg: float
    lon_deg: float
    alt_m: float


class Modes:
    """Whether the vehicle drives itself, by the heartbeats of one connection."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._heard: deque[tuple[int, bool]] = deque()

    def add(self, base_mode: int, now_ns: int) -> None:
        """MAV_MODE_FLAG of a heartbeat."""
        self._first_ns = now_ns if self._first_ns is None else self._first_ns
        self._heard.append((now_ns, bool(base_mode & ARMED) and bool(base_mode & FINDS_ITS_WAY)))
        while now_ns - self._heard[0][0] > MODE_NS:
            self._heard.popleft()

    @property
    def drives_itself(self) -> bool | None:
        """Whether one of the newest heartbeats says so: armed, in such a mode. None where too few have come."""
        if any(drives for _, drives in self._heard):
            return True
        is_known = self._first_ns is not None and self._heard[-1][0] - self._first_ns >= MODE_NS
        return False if is_known else None


class Origins:
    """The origin of the autopilot's local frame in one session; None until one can be believed."""

    def __init__(self) -> None:
        self.known: Origin | None = None
        self._other: tuple[Origin, int] | None = None  # and since when it was not contradicted
        self._local: tuple[int, float, float] | None = None  # meters east and north of the origin
        self._has_warned = False

    def add_local(self, stamp_ns: int, east_m: float, north_m: float) -> None:
        """LOCAL_POSITION_NED."""
        self._local = stamp_ns, east_m, north_m

    def add(self, origin: Origin, own: VehiclePosition | None, now_ns: int) -> None:
        """GPS_GLOBAL_ORIGIN. own: the autopilot's position, which has to be where its local position says."""
        off_m = self._off_m(origin, own)
        if off_m is not None and off_m > ORIGIN_M:
            self._warn(f"the autopilot's own positions say that it is {off_m:.0f} m off")
        elif off_m is not None or self.known in (None, origin):
            self.known, self._other = origin, None
        elif self._other is None or self._other[0] != origin:
            self._other = origin, now_ns
            self._warn("it is not the one that is known")
        elif now_ns - self._other[1] >= UNDISPUTED_NS:
            log.warning("the autopilot has moved its origin")
            self.known, self._other = origin, None

    def of_place(self, lat_deg: float, lon_deg: float, alt_m: float) -> Origin:
        """The origin by which the autopilot's local position is at a place now."""
        east_m, north_m = self._local[1:] if self._local else (0.0, 0.0)
        return Origin(*moved(lat_deg, lon_deg, -east_m, -north_m), alt_m)

    def _off_m(self, origin: Origin, own: VehiclePosition | None) -> float | None:
        """How far the position is from the origin plus the local position; None where one of them is not known."""
        if own is None or self._local is None or abs(own.stamp_ns - self._local[0]) > ORIGIN_NS:
            return None
        there = moved(origin.lat_deg, origin.lon_deg, *self._local[1:])
        moved_m = own.speed_mps * abs(own.stamp_ns - self._local[0]) / 1e9
        return max(0.0, math.hypot(*east_north_of(*there, (own.lat_deg, own.lon_deg))) - moved_m)

    def _warn(self, why: str) -> None:
        if not self._has_warned:
            self._has_warned = True
            log.warning("GPS_GLOBAL_ORIGIN ignored: %s", why)


@dataclass
class Session:
    """What is known of an autopilot since the link came up or it has rebooted; the next session begins with nothing.

    number: of the sessions so far. autopilot, kind: MAV_AUTOPILOT and MAV_TYPE, None until connected. version: major
    and minor of the firmware, None until AUTOPILOT_VERSION arrived. heard_ns: when a message came last, by its id.
    position: the newest; accuracy: when the autopilot reported it, and its horizontal meters.
    """

    number: int = 0
    autopilot: int | None = None
    kind: int | None = None
    version: tuple[int, int] | None = None
    clock: BootClock = field(default_factory=BootClock)
    gps: Gps = field(default_factory=Gps)
    origins: Origins = field(default_factory=Origins)
    parameters: dict[str, float] = field(default_factory=dict)
    heard_ns: dict[int, int] = field(default_factory=dict)
    position: VehiclePosition | None = None
    accuracy: tuple[int, float] | None = None

    @property
    def firmware(self) -> Firmware:
        """What the autopilot can do."""
        return firmware_of(self.autopilot)
