"""Whether a vehicle that GPS keeps on the map's drive is no longer recognized there. Pure: no link, no clock.

An autopilot that steers by a GPS that is dragged across the road leaves the road, and GPS stays on it. Then no place is
believed that could contradict GPS. What is left is that GPS goes on along the mapped drive of the last believed place,
and nothing of that drive is recognized. That is no call: a changed road looks the same to the daemon.
"""

from __future__ import annotations

import math

from edge.config import RigConfig
from edge.geodesy import east_north_of, moved_left
from edge.localization.gps_referee import GpsFix
from edge.localization.place_fix import map_error_m, position_on_route
from edge.localization.route_estimate import CORRELATION_M
from edge.reference_map import Position, Route
from edge.sequence import PlaceMatch

FIRM = 0.85
"""Confidence of a firm recognition: known after CORRELATION_M of it, until as much was less firm or unseen.
At 0.8, two of five simulated drives in snow that were hardly recognized were warned of."""
UNSEEN_M = 80.0
"""What is not recognized before that is said. With honest GPS the longest stretch on 18 km was 56 m, in snow."""
BESIDE_SIGMAS = 2.0
"""Beside the lane, of the road, the map and GPS: as far GPS is on the drive."""
MOST_PLACES = 2
"""A frame says something of so many places at most: what was driven without frames says nothing."""


class UnseenRoad:
    """Follows GPS along the drive of the last believed place, while no place is believed."""

    def __init__(self, route: Route, rig: RigConfig) -> None:
        self._route, self._rig = route, rig
        self.reset()

    def reset(self) -> None:
        """Nothing is known of where the vehicle was recognized last."""
        self._last: PlaceMatch | None = None
        self._firm_m = self._ahead_m = self._unseen_m = 0.0

    def update(self, match: PlaceMatch | None, gps: GpsFix | None) -> bool:
        """After the answer to one more frame: whether the vehicle is not recognized where GPS has it.

        gps: at the exposure.
        """
        if match is None:
            self.reset()  # a sequence begins anew, and cannot be recognized yet
        elif match.accepted:
            self._see(match)
        elif self._last is not None and gps is not None:
            self._follow(self._last, gps)
        return self._unseen_m >= UNSEEN_M

    def _see(self, match: PlaceMatch) -> None:
        spacing_m = self._route.drive(match.place_index).spacing_m
        gained_m = (spacing_m if match.confidence >= FIRM else -spacing_m) - self._unseen_m
        self._firm_m = min(CORRELATION_M, max(0.0, self._firm_m + gained_m))
        is_firm = self._firm_m >= CORRELATION_M or (self._last is not None and self._firm_m > 0)
        self._last = match if is_firm else None
        self._ahead_m = self._unseen_m = 0.0

    def _follow(self, last: PlaceMatch, gps: GpsFix) -> None:
        sign, rig = (1 if last.direction == "forward" else -1), self._rig
        seen_m, behind_m = sign * self._ahead_m, sign * rig.ahead_m(last.direction, last.order)
        here = position_on_route(self._route, last.place_index, seen_m - behind_m, last.direction)
        is_mapped = self._route.reaches(last.place_index, self._route.route_m(last.place_index) + seen_m)
        if here is None or here.heading_deg is None or not is_mapped:
            self.reset()
            return
        ahead_m, left_m = along_and_left_m(gps, here, rig.left_m(last.direction))
        if abs(left_m) > BESIDE_SIGMAS * math.hypot(rig.sigma_across_m, map_error_m(here), gps.sigma_m):
            self.reset()
            return
        most_m = MOST_PLACES * self._route.drive(last.place_index).spacing_m
        self._ahead_m += ahead_m
        self._unseen_m += max(-most_m, min(ahead_m, most_m))


def along_and_left_m(gps: GpsFix, place: Position, lane_m: float) -> tuple[float, float]:
    """How far GPS is ahead of a place, and to the left of the lane that is `lane_m` to the left of it."""
    heading_deg = place.heading_deg or 0.0
    lane = moved_left(place.lat_deg, place.lon_deg, heading_deg, lane_m)
    east_m, north_m = east_north_of(gps.lat_deg, gps.lon_deg, lane)
    sin, cos = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    return east_m * sin + north_m * cos, north_m * sin - east_m * cos
