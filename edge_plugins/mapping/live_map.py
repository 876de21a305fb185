"""The map of this drive: what may become a place of it, its file, and what of it is searched."""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.errors import ConfigError, MapError, reason
from edge.files import DISK_ERRORS, locked, named_by_time
from edge.geodesy import Origin, VehiclePosition, east_north_of
from edge.reference_map import MapSoFar, maps_in
from edge.reference_map.gps_motion import GpsMotion
from edge_plugins.layers.newest import choose
from edge_plugins.layers.stored import delete_oldest, source_of
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.builder import Place, thumbnail
from edge_plugins.mapping.growing_map import GrowingMap
from edge_plugins.mapping.live_keypoints import LiveKeypoints
from edge_plugins.mapping.missed_places import Trail, straight_m
from edge_plugins.mapping.outage import Outage, why_no_truth
from edge_plugins.mapping.own_motion import OwnMotion
from edge_plugins.mapping.place_log import RETRY_S, OpenLog, PlaceLog, complete, create_log, log_of, logs_in, map_of
from edge_plugins.mapping.place_log_records import DriveBegun, LogHeader, MappedPlace
from edge_plugins.mapping.status import MappingStatus, MappingView

STEP_PLACES = 16
"""Places that become searchable at once: a larger map is made of the map so far, which costs some milliseconds."""
MOST_APART = 40.0
"""Spacings between two places, after which a new drive begins: no line runs over a gap as long as itself. With 10, five
drives of `take-me-home-unseen-8` had 142 positions, with 40 they have 287."""
RESTARTED_M = 30.0
"""By how much less than before is driven after a restart of the odometer; less is a frame that was exposed earlier."""
RESUMED_AT_ONCE = 256
LINE_POINTS = 500
SLOWEST_S = 0.01
"""For a place of an earlier drive, on a small computer with a slow card; it took 0.0003 s on a desk's."""
SLOW_DISK = "the disk is too slow"
GPS_MOVES = "GPS moves otherwise than the vehicle"
log = logging.getLogger(__name__)


class LiveMap:
    """Owns the file and the map in memory; nothing that happens to them stops anything else."""

    def __init__(
        self,
        config: MappingConfig,
        header: LogHeader,
        view: Literal["front", "rear"],
        unix_time_s: Callable[[], float] = time.time,
        before_long: Callable[[float], object] = lambda seconds: None,
        retry_s: float = RETRY_S,
        fov_deg: float | None = None,
    ) -> None:
        """Make maps of earlier drives, and go on with the last one if it is of `resume_min` ago, after a restart.

        header: how places are made. view: of the camera that maps. before_long: is called with the seconds that
        reading or finishing a drive may take here. retry_s: see `PlaceLog`. fov_deg: horizontal, of the pictures; None
        where they get no keypoints.
        """
        self._config, self._header, self._view = config, header, view
        self._unix_time_s, self._before_long, self._retry_s = unix_time_s, before_long, retry_s
        self._folder = Path(config.folder)
        back = view == "rear"
        self.keypoints = LiveKeypoints(fov_deg, looks_back=back)
        self._lock = -1
        self._why = "no place yet"
        self._stopped = ""
        self._log: PlaceLog | None = None
        self._base_m = self._driven_m = self._mapped_m = 0.0
        self._last: MappedPlace | None = None  # the place before, of the same drive
        self._is_continuous = False  # whether all that was driven since the last place is known
        self._motion = GpsMotion()
        self._outage, self._trail = Outage(config.max_sigma_m), Trail()
        self._origin: Origin | None = None  # of its meters
        self._placed_ns = 0  # the exposure of the newest place
        self.own = OwnMotion(config, header.sampling.spacing_m)
        """Whoever owns this compares it before it adds the places that follow."""
        self.searchable = 0
        """How many of the places are searched."""
        self._path = named_by_time(self._folder, unix_time_s(), lambda path: path.exists() or log_of(path).exists())
        self._growing = self._new_map()
        try:
            self._open()
        except (MapError, OSError) as error:
            if getattr(error, "errno", None) not in DISK_ERRORS:
                self._stop(reason(error))

    @property
    def status(self) -> MappingStatus:
        """As of the last frame."""
        why = self._stopped or (self._log.stopped if self._log else "") or self._why
        state: Literal["mapping", "waiting", "stopped"] = "mapping" if not why else "waiting"
        if self._stopped:
            state = "stopped"
        return MappingStatus(state, why, self._path.name, self._growing.count, self.searchable, self._mapped_m)

    @property
    def waiting(self) -> int:
        """How many places are not in the file yet."""
        return self._log.waiting if self._log is not None else 0

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
        if not self._why and position is not None and self._is_elsewhere(position):
            self._why = GPS_MOVES
        may_wait = position is None or position.source != "place_fixes"
        is_held_up = self._stopped or (self._log and self._log.stopped)
        if fault or not may_wait or self._growing.is_full or is_held_up:
            self._break_off()
        elif distance_m is None:
            self._outage.reset()
        elif position is None:
            self._outage.miss(1 + missed)
        elif not self._why:
            self._placed_ns = position.stamp_ns
            self._add_at(self._mapped(raw, position, distance_m, image), missed)
        elif self._outage.is_bridgeable:
            self._outage.wait(self._mapped(raw, position, distance_m, image), self._motion.moved, missed)

    def go_on(self, position: VehiclePosition, distance_m: float | None) -> None:
        """The vehicle is there, whether or not a camera shows it."""
        if distance_m is not None and not why_no_truth(position, self._config):
            self._trail.add(self._route_m(distance_m), position)

    def _mapped(
        self, raw: NDArray[np.float32], position: VehiclePosition, distance_m: float, image: NDArray[np.uint8]
    ) -> MappedPlace:
        place = self._place(position, self._route_m(distance_m), image)
        return MappedPlace(raw, place, self.keypoints.find(image))

    def _add_at(self, now: MappedPlace, missed: int) -> None:
        """A place with a position that is good, and before it those that waited for one."""
        found = self._outage.end(now, missed, self._motion)
        is_measured = found is not None
        try:
            for new, passed in found or [self._after_gap(now)]:
                if not self._begin_if_new(new.place.route_m):
                    self._why = SLOW_DISK
                    return
                before = self._last
                for between in self._trail.missed(before, new, passed, is_measured=is_measured) if before else ():
                    self._add(between)
                self._add(new)
                if before and not is_measured:
                    self._growing.check()
        except OSError as error:
            if self._log is None and error.errno in DISK_ERRORS:  # the next place begins the file, if there is room
                self._why = reason(error)
            else:
                self._stop(f"{self._path}: {reason(error)}")

    def _after_gap(self, now: MappedPlace) -> tuple[MappedPlace, int]:
        """A place after a way that nobody measured, and how many were missed; the drive goes on if it was straight."""
        last = self._last
        length_m = None if last is None else straight_m(last.place, now.place)
        if last is None or length_m is None:
            self._last = None
            return now, 0
        off_m = last.place.route_m + length_m - now.place.route_m
        self._base_m += off_m
        self._trail = Trail()
        missed = max(0, round(length_m / self._header.sampling.spacing_m) - 1)
        return replace(now, place=replace(now.place, route_m=now.place.route_m + off_m)), missed

    def _break_off(self) -> None:
        """The next place begins a new drive."""
        self._last = None
        self._outage.reset()

    def newly_searchable(self, distance_m: float | None) -> MapSoFar | None:
        """The map with further places that now lie far enough behind the vehicle; None while there are too few."""
        if distance_m is None:
            return None
        places, ready = self._growing.places, self.searchable
        limit_m = self._route_m(distance_m) - self._config.behind_m
        while ready < len(places) and places["route_m"][ready] <= limit_m:
            ready += 1
        if ready < self.searchable + STEP_PLACES and not (self._why and ready > self.searchable):
            return None
        self.searchable = ready
        return self.so_far()

    def view(self) -> MappingView:
        """What people are shown."""
        places = self._growing.places
        step = max(1, -(-len(places) // LINE_POINTS))
        shown = places[::step]
        line = tuple(zip(shown["lat_deg"].tolist(), shown["lon_deg"].tolist(), strict=True))
        return MappingView(self.status, line, -(-self.searchable // step))

    def so_far(self) -> MapSoFar:
        """The part of the map that is searched."""
        return self._growing.first(self.searchable)

    def whole(self) -> MapSoFar:
        """The map with all places, also those that are not searched yet."""
        return self._growing.first(self._growing.count)

    def interrupt(self) -> None:
        """The odometer was silent: nobody knows how far the vehicle has driven meanwhile."""
        self._is_continuous, self._motion = False, GpsMotion()
        self._outage.reset()

    def driven_m(self, distance_m: float | None) -> float | None:
        """Where the vehicle is, in meters along all drives of the map; None without a place, or after a restart."""
        route_m = None if distance_m is None else self._route_m(distance_m)
        return route_m if self._is_continuous else None

    def end(self) -> None:
        """Begin to write what is left."""
        if self._log is not None:
            self.keypoints.end(then=self._log.end)

    def close(self) -> None:
        """Write what is left; more than once is harmless."""
        self.end()
        self.keypoints.close()
        if self._log is not None:
            self._log.close()
        self._log = None
        if self._lock >= 0:
            os.close(self._lock)
        self._lock = -1

    def _why_not(self, position: VehiclePosition | None, distance_m: float | None) -> str:
        """Why a place of this position may not be mapped, "" if it may."""
        if position is None:
            return "the autopilot has no position"
        if distance_m is None:
            return "the distance driven is not known"
        return "the map is full" if self._growing.is_full else why_no_truth(position, self._config)

    def _is_elsewhere(self, position: VehiclePosition) -> bool:
        """Whether a position disagrees with odometer and heading, or is too doubtful by them."""
        self._origin = self._origin or (position.lat_deg, position.lon_deg)
        point_m = east_north_of(position.lat_deg, position.lon_deg, self._origin)
        stated_m = position.sigma_m or 0.0
        found = self._motion.disagreement(point_m, stated_m)
        return found is not None or stated_m <= self._config.max_sigma_m < math.hypot(stated_m, self._motion.doubt_m)

    def _route_m(self, distance_m: float) -> float:
        """Meters along all drives of the map, which go on over a restart of the odometer."""
        if distance_m < self._driven_m - RESTARTED_M:
            self._base_m += self._driven_m - distance_m
            self._driven_m = distance_m
            self.interrupt()
        self._driven_m = max(self._driven_m, distance_m)
        return self._base_m + distance_m

    def _begin_if_new(self, route_m: float) -> bool:
        """Begin a file with the first place, and a drive with the first one after a gap. OSError.

        False where the disk is too far behind: the drive begins when it has caught up.
        """
        if self._log is None:
            self._use(create_log(log_of(self._path), self.keypoints.header_of(self._header)))
        assert self._log is not None
        apart_m = MOST_APART * self._header.sampling.spacing_m
        since_m = route_m - self._last.place.route_m if self._last is not None else -1.0
        if 0 <= since_m <= apart_m:
            self._mapped_m += since_m
            return True
        self._last = None
        begun = self._log.begin_drive(DriveBegun(self._view))
        if begun:
            self.own.begin_drive()
            self.keypoints.begin_drive(self._growing.count)
            self._growing.begin_segment(source_of(self._path), self._view, has_odometer=True, whole_sigma_m=0.0)
        return begun

    def _add(self, new: MappedPlace) -> None:
        """To the file and to the memory, or, where the disk is behind or the map is full, to neither. OSError."""
        place, is_vouched = replace(new.place, row=self._growing.count), self.own.vouches(self._placed_ns)
        if (
            self._log is None
            or self._growing.is_full
            or not self._log.add(new.raw, place, self._unix_time_s(), is_vouched=is_vouched)
        ):
            self._last = None
            return
        self._last, self._is_continuous = new, True
        self.keypoints.add(place, new.keypoints)
        self._growing.add(new.raw, place)
        if not is_vouched:
            self._growing.doubt()

    def _place(self, position: VehiclePosition, route_m: float, image: NDArray[np.uint8]) -> Place:
        stated_m = math.nan if position.sigma_m is None else position.sigma_m
        return Place(
            row=self._growing.count,
            lat_deg=position.lat_deg,
            lon_deg=position.lon_deg,
            alt_m=position.alt_m,
            heading_deg=float("nan") if position.heading_deg is None else position.heading_deg,
            route_m=route_m,
            thumbnail=thumbnail(image),
            position_sigma_m=math.hypot(stated_m, self._motion.doubt_m),
            position_source=position.source,
        )

    def _new_map(self) -> GrowingMap:
        made = self._header
        return GrowingMap(
            self._path,
            made.model,
            made.regions,
            made.sampling,
            self._raw_rows,
            thumbnails=self._thumbnail,
            keypoints=self.keypoints,
        )

    def _raw_rows(self, rows: Sequence[int]) -> NDArray[np.float32]:
        assert self._log is not None  # with its first place there is one
        return self._log.raw_rows(rows)

    def _thumbnail(self, row: int) -> bytes:
        return self._log.thumbnail(row) if self._log else b""

    def _open(self) -> None:
        """Go on with the last drive, and make maps of the others. MapError, OSError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        try:
            self._lock = locked(self._folder)
        except BlockingIOError:
            raise ConfigError(f"[mapping] folder: {self._folder}: another daemon maps there; stop it first") from None
        delete_oldest(self._folder, self._config.quota_mb * 1e6)
        for file in reversed(logs_in(self._folder)):
            try:
                self._continue_or_complete(OpenLog(file))
            except MapError as error:
                log.warning("%s", error)
        delete_oldest(self._folder, self._config.quota_mb * 1e6)
        self._retire_older()

    def _retire_older(self) -> None:
        """Search the newest drives of each road from the next start on, not all that were ever made."""
        layers = self._config.layers
        try:
            if 0 < layers < len(maps_in(self._folder)):
                choose(self._folder, layers, anew=False).mark()
        except MapError as error:
            log.warning("%s; no map is retired", error)

    def _continue_or_complete(self, found: OpenLog) -> None:
        self._before_long(SLOWEST_S * len(found.places_at))
        if self._log is None and self._is_of_this_drive(found):
            self._resume(found)
            return
        try:
            complete(found)
        finally:
            found.close()

    def _is_of_this_drive(self, found: OpenLog) -> bool:
        made, now = found.header, self._header
        alike = (made.model, made.regions, made.sampling) == (now.model, now.regions, now.sampling)
        alike &= self.keypoints.is_alike(made.keypoints)
        # Without a battery the computer's clock may have fallen behind the file: then it was just now.
        age_s = self._unix_time_s() - found.written_unix_s
        return alike and bool(found.places_at) and age_s < 60 * self._config.resume_min and self._config.resume_min > 0

    def _use(self, file: OpenLog) -> None:
        """Write to this file."""
        self._log = PlaceLog(file, self._config.min_free_mb * 1e6, self._retry_s)
        self.keypoints.write_to(self._log)
        self._growing.keep_keypoints(file.header.keypoints)

    def _resume(self, found: OpenLog) -> None:
        self._path = map_of(found.path)
        self._growing = self._new_map()
        self._use(found)
        for first, end, drive in found.segments():
            self._growing.begin_segment(source_of(self._path), drive.view, has_odometer=True, whole_sigma_m=0.0)
            for row in range(first, end, RESUMED_AT_ONCE):
                records = [found.place(one) for one in range(row, min(row + RESUMED_AT_ONCE, end))]
                self._growing.add_all(np.stack([found.raw_of(one) for one in records]), [one.place for one in records])
                if not all(one.is_vouched for one in records):
                    self._growing.doubt()
            self._mapped_m += float(np.ptp(self._growing.places["route_m"][first:end])) if first < end else 0.0
        self._growing.renew()
        if drive.view == self._view:
            self._last = MappedPlace(found.raw_of(records[-1]), records[-1].place)
        self._base_m = float(self._growing.places["route_m"][-1])
        self.searchable = self._growing.count
        log.info("%s: mapping goes on with %d places", self._path, self.searchable)

    def _stop(self, why: str) -> None:
        self._stopped = why
        log.warning("mapping stopped: %s", why)
