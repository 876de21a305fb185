"""What is known of one autopilot in one session; and whether it is armed, and drives itself, by more than one message.

On an unsigned link a stranger can send a message in the autopilot's name, but cannot keep the autopilot's own messages
from coming. So that changes only when nothing contradicts it for a while; and so does which boot the clock is of, see
`boot_clock`. Signing is for the rest. No I/O.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import VehiclePosition, moved
from edge.telemetry.boot_clock import BootClock
from edge.telemetry.firmware import Firmware, firmware_of
from edge.telemetry.gps import Gps

MODE_NS = 2_500_000_000
"""For so long each heartbeat must say that it does not drive itself: they come once a second, and one may be lost."""
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
FINDS_ITS_WAY = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | mavlink.MAV_MODE_FLAG_AUTO_ENABLED


@dataclass(frozen=True)
class Origin:
    """The origin of the autopilot's local frame: degrees (WGS 84), meters above mean sea level."""

    lat_deg: float
    lon_deg: float
    alt_m: float


class Modes:
    """Whether the vehicle is armed and drives itself, by the heartbeats of one connection."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._heard: deque[tuple[int, int]] = deque()

    def add(self, base_mode: int, now_ns: int) -> None:
        """MAV_MODE_FLAG of a heartbeat."""
        self._first_ns = now_ns if self._first_ns is None else self._first_ns
        self._heard.append((now_ns, base_mode))
        while now_ns - self._heard[0][0] > MODE_NS:
            self._heard.popleft()

    def are(self, *flags: int) -> bool | None:
        """Whether one of the newest heartbeats has any of each of these flags; None where too few have come."""
        if any(all(mode & one for one in flags) for _, mode in self._heard):
            return True
        is_known = self._first_ns is not None and self._heard[-1][0] - self._first_ns >= MODE_NS
        return False if is_known else None


@dataclass
class Session:
    """What is known of an autopilot since the link came up or it has rebooted; the next session begins with nothing.

    number: of the sessions so far. autopilot, kind: MAV_AUTOPILOT and MAV_TYPE, None until connected. version: major
    and minor of the firmware, None until AUTOPILOT_VERSION arrived. heard_ns: when a message came last, by its id.
    origin: None until it is reported. local_m: meters east and north of it. position: the newest; accuracy: when the
    autopilot reported it, and its horizontal meters.
    """

    number: int = 0
    autopilot: int | None = None
    kind: int | None = None
    version: tuple[int, int] | None = None
    clock: BootClock = field(default_factory=BootClock)
    gps: Gps = field(default_factory=Gps)
    origin: Origin | None = None
    local_m: tuple[float, float] = (0.0, 0.0)
    parameters: dict[str, float] = field(default_factory=dict)
    heard_ns: dict[int, int] = field(default_factory=dict)
    position: VehiclePosition | None = None
    accuracy: tuple[int, float] | None = None

    @property
    def firmware(self) -> Firmware:
        """What the autopilot can do."""
        return firmware_of(self.autopilot)

    def origin_of_place(self, lat_deg: float, lon_deg: float, alt_m: float) -> Origin:
        """The origin by which the autopilot's local position is at a place now."""
        east_m, north_m = self.local_m
        return Origin(*moved(lat_deg, lon_deg, -east_m, -north_m), alt_m)
