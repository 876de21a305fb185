"""Places that were passed while no position was good enough: placed once one is again. Pure.

GPS is lost below a bridge, and moves otherwise than the vehicle between high buildings. A map that broke off there
would cost the way home more than those meters: places are recognized anew only after a whole sequence. So dead
reckoning by odometer and heading goes on from the last good position to the next one, whose error is distributed:

    place = begin + moved + share * (end - begin - moved to the end)    share: of the way driven, 0 to 1
    sigma^2 = (that of begin and end, by share)^2 + (OFF_SHARE * way * share * (1 - share))^2
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from edge.geodesy import WORST_FIRST, VehiclePosition, east_north_of, moved
from edge.reference_map.gps_motion import OFF_SHARE, GpsMotion, PlanarOdometry
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.place_log_records import MappedPlace

MOST_WAITING = 200
"""That wait to be placed: 32 or 55 kB each. On a map of 2 m they are as long as `max_sigma_m` of 5 m allows."""


class PendingPlace(NamedTuple):
    """A place that has no position yet, how the vehicle has moved, and places missed before."""

    new: MappedPlace
    at: PlanarOdometry
    missed: int


class Outage:
    """What was passed since the last good position."""

    def __init__(self, most_sigma_m: float) -> None:
        """most_sigma_m: of a place's position, beyond which the outage is not bridged."""
        self._most_sigma_m = most_sigma_m
        self._begin: tuple[Place, PlanarOdometry] | None = None
        self._waiting: list[PendingPlace] = []
        self._missed = 0

    def reset(self) -> None:
        """Nothing can be bridged before the next good position."""
        self._begin, self._waiting, self._missed = None, [], 0

    @property
    def is_bridgeable(self) -> bool:
        """Whether a place that waits may be placed later: there was a good position before, and not too far back."""
        return self._begin is not None

    def wait(self, new: MappedPlace, at: PlanarOdometry, missed: int) -> None:
        """A place without a good position; missed: places that were passed before it without a frame."""
        assert self._begin is not None
        self._waiting.append(PendingPlace(new, at, missed + self._missed))
        self._missed = 0
        way_m = at.way_m - self._begin[1].way_m
        if OFF_SHARE * way_m / 4 > self._most_sigma_m or len(self._waiting) > MOST_WAITING:
            self.reset()

    def miss(self, places: int) -> None:
        """Places of whose frames not even the heading is known; they are interpolated as if they had none."""
        self._missed += places

    def end(self, new: MappedPlace, missed: int, motion: GpsMotion) -> list[tuple[MappedPlace, int]] | None:
        """A place with a good position, and before it those that waited; how many were missed before each.

        None where nothing leads there from the last good one: the motion is not known, or they are too far apart.
        """
        begin, waiting, missed = self._begin, self._waiting, missed + self._missed
        self.reset()
        self._begin = new.place, motion.moved
        placed = None if begin is None else self._placed(*begin, waiting, new.place, motion)
        return None if placed is None else [*placed, (new, missed)]

    def _placed(
        self, begin: Place, then: PlanarOdometry, waiting: list[PendingPlace], end: Place, motion: GpsMotion
    ) -> list[tuple[MappedPlace, int]] | None:
        now = motion.moved
        way_m = now.way_m - then.way_m
        if waiting and (then.unknown != now.unknown or way_m <= 0):
            return None
        origin = begin.lat_deg, begin.lon_deg
        off_m = complex(*east_north_of(end.lat_deg, end.lon_deg, origin)) - motion.truly(then, now)
        placed = []
        for one in waiting:
            share = (one.at.way_m - then.way_m) / way_m
            point_m = motion.truly(then, one.at) + share * off_m
            ends_m = (1 - share) * begin.position_sigma_m + share * end.position_sigma_m
            sigma_m = math.hypot(ends_m, OFF_SHARE * way_m * share * (1 - share))
            if sigma_m > self._most_sigma_m:
                return None
            lat_deg, lon_deg = moved(*origin, point_m.real, point_m.imag)
            alt_m = begin.alt_m + share * (end.alt_m - begin.alt_m)
            place = replace(
                one.new.place,
                lat_deg=lat_deg,
                lon_deg=lon_deg,
                alt_m=alt_m,
                position_sigma_m=sigma_m,
                position_source="dead_reckoning",
            )
            placed.append((replace(one.new, place=place), one.missed))
        return placed


def why_no_truth(position: VehiclePosition, config: MappingConfig) -> str:
    """Why a position may not enter a map, "" if it may."""
    if position.source == "place_fixes":
        return "position is by places"
    if position.source == "dead_reckoning" and config.without_gps == "continue":
        return "" if position.sigma_m is not None else "position error not known"
    if position.source in WORST_FIRST:
        return "no GPS"
    is_good = position.sigma_m is not None and position.sigma_m <= config.max_sigma_m
    return "" if is_good else f"position not known to {config.max_sigma_m:g} m"
