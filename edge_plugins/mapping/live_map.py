"""The map of this drive: which frames become places of it, and where these are."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import VehiclePosition
from edge.reference_map import PartialMap
from edge.reference_map.gps_motion import GpsMotion
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.builder import Place, thumbnail
from edge_plugins.mapping.drive_store import DriveStore, SearchablePart
from edge_plugins.mapping.gps_consistency import GpsConsistency
from edge_plugins.mapping.missed_places import Trail, straight_m
from edge_plugins.mapping.outage import Outage, why_no_truth
from edge_plugins.mapping.place_log_records import MappedPlace
from edge_plugins.mapping.status import MappingStatus

MOST_APART = 40.0
"""Spacings between two places, after which a new drive begins: no line runs over a gap as long as itself. With 10, five
drives of `take-me-home-unseen-8` had 142 positions, with 40 they have 287."""
RESTARTED_M = 30.0
"""By how much less than before is driven after a restart of the odometer; less is a frame that was exposed earlier."""
SLOW_DISK = "the disk is too slow"
GPS_MOVES = "GPS moves otherwise than the vehicle"


class LiveMap:
    """Adds places to the file and the map in `store`, of which `searched` is searched."""

    def __init__(self, config: MappingConfig, store: DriveStore, *, keeps_pictures: bool = True) -> None:
        """It goes on with what is in the store. keeps_pictures: small ones of places, for people."""
        self._keeps_pictures = keeps_pictures
        self._config, self.store, self.searched = config, store, SearchablePart(store, config.behind_m)
        self.own = GpsConsistency(config, store.header.sampling.spacing_m)
        """Whoever owns this compares it before it adds the places that follow."""
        self._why = "no place yet"
        self._odometer = _Odometer(float(store.growing.places["route_m"][-1]) if self.searched.count else 0.0)
        self._motion = GpsMotion()
        self._outage, self._trail = Outage(config.max_sigma_m), Trail()

    @property
    def status(self) -> MappingStatus:
        """As of the last frame."""
        return self.searched.status(self._why)

    def add(
        self,
        raw: NDArray[np.float32],
        image: NDArray[np.uint8],
        position: VehiclePosition | None,
        distance_m: float | None,
        fault: str = "",
        missed: int = 0,
    ) -> None:
        """A frame at a new place: its raw descriptor (R, D), and what the autopilot says of its exposure.

        fault: why it is not mapped, such as GPS that is wrong by the places; "" where it is. missed: places that were
        passed without a frame since the last one that was handed over.
        """
        if distance_m is not None and position is not None:
            self._route_m(distance_m)  # which begins anew where the odometer did
            self._motion.move(distance_m, np.nan if position.heading_deg is None else position.heading_deg)
        self._why = fault or self._why_not(position, distance_m)
        if fault or self.store.why or (position is not None and position.source == "place_fixes"):
            self.store.last = None
            self._outage.reset()
        elif distance_m is None:
            self._outage.reset()
        elif position is None:
            self._outage.miss(1 + missed)
        elif not self._why:
            self._add_placed(self._mapped(raw, position, distance_m, image), missed, position.stamp_ns)
        elif self._outage.is_bridgeable:
            self._outage.wait(self._mapped(raw, position, distance_m, image), self._motion.moved, missed)

    def go_on(self, position: VehiclePosition, distance_m: float | None) -> None:
        """The vehicle is there, whether or not a camera shows it."""
        if distance_m is not None and not why_no_truth(position, self._config):
            self._trail.add(self._route_m(distance_m), position)

    def newly_searchable(self, distance_m: float | None) -> PartialMap | None:
        """The map with further places that now lie far enough behind the vehicle; None while there are too few."""
        return None if distance_m is None else self.searched.grown(self._route_m(distance_m), at_once=bool(self._why))

    def interrupt(self) -> None:
        """The odometer was silent: nobody knows how far the vehicle has driven meanwhile."""
        self._odometer.is_known, self._motion = False, GpsMotion()
        self._outage.reset()

    def driven_m(self, distance_m: float | None) -> float | None:
        """Where the vehicle is, in meters along all drives of the map; None without a place, or after a restart."""
        route_m = None if distance_m is None else self._route_m(distance_m)
        return route_m if self._odometer.is_known else None

    def _why_not(self, position: VehiclePosition | None, distance_m: float | None) -> str:
        """Why a place of this position may not be mapped, "" if it may."""
        if position is None:
            return "autopilot has no position"
        if distance_m is None:
            return "distance driven not known"
        return why_no_truth(position, self._config) or ("" if self._moves_alike(position) else GPS_MOVES)

    def _moves_alike(self, position: VehiclePosition) -> bool:
        """Whether a position agrees with odometer and heading, and is no more doubtful by them than it may be."""
        stated_m, most_m = position.sigma_m or 0.0, self._config.max_sigma_m
        found = self._motion.disagreement_at(position.lat_deg, position.lon_deg, stated_m)
        return found is None and not stated_m <= most_m < math.hypot(stated_m, self._motion.doubt_m)

    def _mapped(
        self, raw: NDArray[np.float32], position: VehiclePosition, distance_m: float, image: NDArray[np.uint8]
    ) -> MappedPlace:
        heading_deg, stated_m = (math.nan if one is None else one for one in (position.heading_deg, position.sigma_m))
        where = position.lat_deg, position.lon_deg, position.alt_m, heading_deg, self._route_m(distance_m)
        sigma_m = math.hypot(stated_m, self._motion.doubt_m)
        picture = thumbnail(image) if self._keeps_pictures else b""
        place = Place(self.store.growing.count, *where, picture, sigma_m, position.source)
        return MappedPlace(raw, place, self.store.keypoints.find(image))

    def _add_placed(self, now: MappedPlace, missed: int, stamp_ns: int) -> None:
        """A place with a position that is good, and before it those that waited for one. stamp_ns: of its exposure."""
        found = self._outage.end(now, missed, self._motion)
        is_measured = found is not None
        try:
            for new, passed in found or [self._after_gap(now)]:
                if not self._is_begun(new.place.route_m):
                    self._why = SLOW_DISK
                    return
                before = self.store.last
                between = self._trail.missed(before, new, passed, is_measured=is_measured) if before else ()
                for one in (*between, new):
                    self.store.add(one, is_vouched=self.own.vouches(stamp_ns))
                self._odometer.is_known |= self.store.last is not None
                if before and not is_measured:
                    self.store.growing.check()
        except OSError as error:
            self._why = self.store.failed(error)

    def _after_gap(self, now: MappedPlace) -> tuple[MappedPlace, int]:
        """A place after a way that nobody measured, and how many were missed; the drive goes on if it was straight."""
        last = self.store.last
        length_m = None if last is None else straight_m(last.place, now.place)
        if last is None or length_m is None:
            self.store.last = None
            return now, 0
        off_m = last.place.route_m + length_m - now.place.route_m
        self._odometer.base_m += off_m
        self._trail = Trail()
        missed = max(0, round(length_m / self.store.header.sampling.spacing_m) - 1)
        return replace(now, place=replace(now.place, route_m=now.place.route_m + off_m)), missed

    def _is_begun(self, route_m: float) -> bool:
        """Begin a drive with the first place after a gap; False where the disk has to catch up first. OSError."""
        last, apart_m = self.store.last, MOST_APART * self.store.header.sampling.spacing_m
        if last is not None and 0 <= route_m - last.place.route_m <= apart_m:
            return True
        is_begun = self.store.begin_drive()
        if is_begun:
            self.own.begin_drive()
        return is_begun

    def _route_m(self, distance_m: float) -> float:
        """Meters along all drives of the map."""
        if self._odometer.restarts(distance_m):
            self.interrupt()
        return self._odometer.base_m + distance_m


class _Odometer:
    """What has to be added to meters driven for those along all drives of the map, over restarts.

    is_known: whether all that was driven since the last place is.
    """

    def __init__(self, base_m: float) -> None:
        self.base_m, self.is_known = base_m, False
        self._driven_m = 0.0

    def restarts(self, distance_m: float) -> bool:
        """Whether it began anew with these meters."""
        if not distance_m < self._driven_m - RESTARTED_M:
            self._driven_m = max(self._driven_m, distance_m)
            return False
        self.base_m += self._driven_m - distance_m
        self._driven_m = distance_m
        return True
