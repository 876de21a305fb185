"""Whether GPS moves as the vehicle does by what GPS has no part in: only that vouches for the map of a drive. Pure.

While an autopilot uses GPS, its velocity is that of GPS, and follows a spoofed one. So positions are
compared with wheels, with another program's odometry or with our camera, and with the heading, at the moments at which
these have counted: wheels do so once a second (ArduPilot 4.6.3), in which a car drives 8 m.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from edge.geodesy import VehiclePosition
from edge.localization import MAX_SPEED_MPS
from edge.reference_map.gps_motion import GpsMotion
from edge.telemetry.vehicle_velocity import CAMERA_FRESH_NS, ODOMETRY, SPEED_FRESH_NS, WHEELS, WHEELS_APART_NS
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.outage import why_no_truth


class GpsFreeDistance(NamedTuple):
    """Meters driven by a moment, less those backwards, by what GPS has no part in; gaps: how often nobody counted."""

    stamp_ns: int
    driven_m: float
    gaps: int


class GpsFreeOdometer:
    """Meters by the wheels, else by odometry, else by our camera."""

    def __init__(self) -> None:
        self.driven: GpsFreeDistance | None = None
        """None before the first of them has counted."""
        self._newest: dict[int, tuple[int, float]] = {}
        self._moving: dict[int, int] = {}  # when each was last known to say a speed

    def hear(self, stamp_ns: int, value: float, source: int | None) -> None:
        """See `VehicleVelocity.listen`."""
        if source is None:
            self._newest.clear()
            self._moving.clear()
            return
        before = self._newest.get(source)
        self._newest[source] = stamp_ns, value
        longest_ns = WHEELS_APART_NS if source == WHEELS else CAMERA_FRESH_NS
        is_next = before is not None and 0 < stamp_ns - before[0] <= longest_ns
        if source != WHEELS or is_next:
            self._moving[source] = stamp_ns
        fresh = ((WHEELS, SPEED_FRESH_NS), (ODOMETRY, CAMERA_FRESH_NS))
        if any(source > better and stamp_ns - self._moving.get(better, -ns - 1) <= ns for better, ns in fresh):
            return
        if before is None or not is_next:
            self._count(stamp_ns, None, 0.0)
        elif source == WHEELS:
            self._count(stamp_ns, before[0], value - before[1])
        else:
            self._count(stamp_ns, before[0], (before[1] + value) / 2 * (stamp_ns - before[0]) / 1e9)

    def _count(self, stamp_ns: int, since_ns: int | None, moved_m: float) -> None:
        """So many meters since a moment; None: not since when it had last."""
        if self.driven is not None and stamp_ns <= self.driven.stamp_ns:
            return
        last_ns, driven_m, gaps = self.driven or (stamp_ns, 0.0, 0)
        if since_ns != last_ns or not abs(moved_m) <= MAX_SPEED_MPS * (stamp_ns - last_ns) / 1e9:
            moved_m, gaps = 0.0, gaps + 1
        self.driven = GpsFreeDistance(stamp_ns, driven_m + moved_m, gaps)


class GpsConsistency:
    """What has counted so far, and whether the positions of the present drive agree with it."""

    def __init__(self, config: MappingConfig, spacing_m: float) -> None:
        """spacing_m: least way between two comparisons."""
        self._config, self._spacing_m = config, spacing_m
        self._motion = GpsMotion()
        self._newest: GpsFreeDistance | None = None
        self._compared_m = math.nan
        self._agrees = True

    def begin_drive(self) -> None:
        """A drive begins. What GPS was compared with before stays: a spoofing drift that has ended is an offset."""
        self._agrees = True

    def vouches(self, stamp_ns: int) -> bool:
        """Whether all positions of the drive up to a moment moved so; False where that is not known."""
        return self._agrees and self._newest is not None and stamp_ns - self._newest.stamp_ns <= WHEELS_APART_NS

    def compare(self, own: GpsFreeDistance, position: VehiclePosition | None) -> None:
        """What has counted since the last time, and the position at its stamp, None where that is not known."""
        before, self._newest = self._newest, own
        if before is None or own.gaps != before.gaps:
            self._motion, self._compared_m, self._agrees = GpsMotion(), math.nan, self._agrees and before is None
        if position is None or abs(own.driven_m - self._compared_m) < self._spacing_m:
            return
        self._compared_m = own.driven_m
        unknown = self._motion.moved.unknown
        self._motion.move(own.driven_m, math.nan if position.heading_deg is None else position.heading_deg)
        self._agrees &= self._motion.moved.unknown == unknown
        if not why_no_truth(position, self._config):
            found = self._motion.disagreement_at(position.lat_deg, position.lon_deg, position.sigma_m or 0.0)
            self._agrees &= found is None
