"""Places that were passed without a frame, as while a camera is opened again: where they are, and what they show. Pure.

Lines are searched by places: one over a gap would be bent there, and could not be found. So each missed place shows
what the nearest one with a frame shows, and lies where the vehicle went meanwhile.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from edge.geodesy import VehiclePosition
from edge.mapping.place_log_records import MappedPlace

STEP_M, KEPT = 1.0, 128


class Trail:
    """Where the vehicle has gone lately, whether or not a camera showed it."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, float, float, float]] = deque(maxlen=KEPT)

    def add(self, route_m: float, position: VehiclePosition) -> None:
        """It is there after so many meters along all drives of the map."""
        if not self._points or not 0 <= route_m - self._points[-1][0] < STEP_M:
            self._points.append((route_m, position.lat_deg, position.lon_deg, position.alt_m))

    def missed(self, before: MappedPlace, after: MappedPlace, missed: int) -> Iterator[MappedPlace]:
        """The `missed` places between two that have a frame, evenly apart, with the less accurate position of both."""
        first, last = before.place, after.place
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
                position_sigma_m=float(np.maximum(first.position_sigma_m, last.position_sigma_m)),
            )
            yield replace(nearest, place=place)
