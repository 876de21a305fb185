"""Places that were passed without a frame, as while a camera is opened again: where they are, and what they show. Pure.

Lines are searched by places: one over a gap would be bent there, and could not be found. So each missed place shows
what the nearest one with a frame shows, and lies where the vehicle went meanwhile. After a restart nobody measured
that way: a drive goes on only where it was straight, and has no heading there, so that it does not count as one that
moved as its odometer said.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from edge.geodesy import VehiclePosition, east_north_of
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.place_log_records import MappedPlace

STEP_M, KEPT_POINTS = 1.0, 128
AT_REST_M, STRAIGHT_RAD = 10.0, math.radians(15.0)
"""Between two positions by GPS, within which the direction from one to the other says nothing; and by how much each
heading may differ from it on a straight way: the middle of a bend of 80 m is then 5 m off its chord."""


class Trail:
    """Where the vehicle has gone lately, whether or not a camera showed it."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, float, float, float]] = deque(maxlen=KEPT_POINTS)

    def add(self, route_m: float, position: VehiclePosition) -> None:
        """It is there after so many meters along all drives of the map."""
        if not self._points or not 0 <= route_m - self._points[-1][0] < STEP_M:
            self._points.append((route_m, position.lat_deg, position.lon_deg, position.alt_m))

    def missed(
        self, before: MappedPlace, after: MappedPlace, missed: int, *, is_measured: bool = True
    ) -> Iterator[MappedPlace]:
        """The `missed` places between two that have a frame, evenly apart, with the less accurate position of both.

        is_measured: whether the way between them was; else they have no heading, and lie beside it where it was bent.
        """
        first, last = before.place, after.place
        turned_rad = math.radians((last.heading_deg - first.heading_deg + 180.0) % 360.0 - 180.0)
        lateral_m = 0.0 if is_measured else (last.route_m - first.route_m) * abs(turned_rad) / 8
        ends = [(one.route_m, one.lat_deg, one.lon_deg, one.alt_m) for one in (first, last)]
        between = [point for point in self._points if first.route_m < point[0] < last.route_m]
        route_m, lat_deg, lon_deg, alt_m = np.array([ends[0], *between, ends[1]]).T
        east_deg = (lon_deg - first.lon_deg + 180.0) % 360.0 - 180.0
        for number in range(1, missed + 1):
            share = number / (missed + 1)
            at_m = first.route_m + share * (last.route_m - first.route_m)
            nearest = before if share <= 0.5 else after
            place = replace(
                nearest.place,
                lat_deg=float(np.interp(at_m, route_m, lat_deg)),
                lon_deg=(first.lon_deg + float(np.interp(at_m, route_m, east_deg)) + 180.0) % 360.0 - 180.0,
                alt_m=float(np.interp(at_m, route_m, alt_m)),
                route_m=at_m,
                heading_deg=nearest.place.heading_deg if is_measured else math.nan,
                position_sigma_m=math.hypot(np.maximum(first.position_sigma_m, last.position_sigma_m), lateral_m),
            )
            yield replace(nearest, place=place, keypoints=None)  # which would say that it is where it is not


def straight_m(before: Place, after: Place) -> float | None:
    """The length of the way between two places, if it was straight; None where it was not, or nothing says so."""
    east_m, north_m = east_north_of(after.lat_deg, after.lon_deg, (before.lat_deg, before.lon_deg))
    length_m, ahead_rad = math.hypot(east_m, north_m), math.atan2(east_m, north_m)
    headings_rad = math.radians(before.heading_deg), math.radians(after.heading_deg)
    ahead_rad = ahead_rad if length_m > AT_REST_M else headings_rad[1]
    is_straight = all(abs(math.remainder(one - ahead_rad, math.tau)) <= STRAIGHT_RAD for one in headings_rad)
    return length_m if is_straight else None
