"""Whether GPS moves as the vehicle does by what GPS has no part in: only that vouches for the map of a drive. Pure.

While an autopilot uses GPS, its velocity is that of GPS, and moves along with one that is dragged. So positions are
compared with wheels, with another program's odometry or with our camera, and with the heading, at the moments at which
these have counted: wheels do so once a second (ArduPilot 4.6.3), in which a car drives 8 m.
"""

from __future__ import annotations

import math

from edge.geodesy import VehiclePosition, east_north_of
from edge.reference_map.gps_motion import GpsMotion
from edge.telemetry.vehicle_velocity import WHEELS_APART_NS, OwnDriven
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.outage import why_no_truth


class OwnMotion:
    """What has counted so far, and whether the positions of the present drive agree with it."""

    def __init__(self, config: MappingConfig, spacing_m: float) -> None:
        """spacing_m: least way between two comparisons."""
        self._config, self._spacing_m = config, spacing_m
        self._motion, self._origin = GpsMotion(), (0.0, 0.0)
        self._newest: OwnDriven | None = None
        self._compared_m = math.nan
        self._agrees = True

    def begin_drive(self) -> None:
        """A drive begins. What GPS was compared with before stays: a drag that has ended is an offset."""
        self._agrees = True

    def vouches(self, stamp_ns: int) -> bool:
        """Whether all positions of the drive up to a moment moved so; False where that is not known."""
        return self._agrees and self._newest is not None and stamp_ns - self._newest.stamp_ns <= WHEELS_APART_NS

    def compare(self, own: OwnDriven, position: VehiclePosition | None) -> None:
        """What has counted since the last time, and the position at its stamp, None where that is not known."""
        before, self._newest = self._newest, own
        if before is None or own.gaps != before.gaps:
            self._motion, self._compared_m, self._agrees = GpsMotion(), math.nan, self._agrees and before is None
        if position is None or abs(own.driven_m - self._compared_m) < self._spacing_m:
            return
        if math.isnan(self._compared_m):
            self._origin = position.lat_deg, position.lon_deg
        self._compared_m = own.driven_m
        unknown = self._motion.moved.unknown
        self._motion.move(own.driven_m, math.nan if position.heading_deg is None else position.heading_deg)
        self._agrees &= self._motion.moved.unknown == unknown
        if not why_no_truth(position, self._config):
            point_m = east_north_of(position.lat_deg, position.lon_deg, self._origin)
            self._agrees &= self._motion.disagreement(point_m, position.sigma_m or 0.0) is None
