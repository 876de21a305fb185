"""The map of this drive as it is kept, in its file and in memory, and the part of it that is searched."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import PINHOLE, Lens
from edge.errors import ConfigError, MapError, reason
from edge.files import DISK_ERRORS, locked, named_by_time
from edge.reference_map import PartialMap
from edge_plugins.layers.stored import source_of
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.earlier_drives import finish_earlier
from edge_plugins.mapping.growing_map import GrowingMap
from edge_plugins.mapping.live_keypoints import LiveKeypoints
from edge_plugins.mapping.place_log import RETRY_S, OpenLog, PlaceLog, create_log, log_of, map_of
from edge_plugins.mapping.place_log_records import LogHeader, MappedPlace, View
from edge_plugins.mapping.status import MappingStatus, MappingView

STEP_PLACES = 16
"""Places that become searchable at once: a larger map is made of the map so far, which costs some milliseconds."""
RESUMED_AT_ONCE = 256
LINE_POINTS = 500
log = logging.getLogger(__name__)


class DriveStore:
    """Owns the file and the map in memory; nothing that happens to them stops anything else."""

    def __init__(
        self,
        config: MappingConfig,
        header: LogHeader,
        view: View,
        unix_time_s: Callable[[], float] = time.time,
        before_long: Callable[[float], object] = lambda seconds: None,
        retry_s: float = RETRY_S,
        fov_deg: float | None = None,
        lens: Lens = PINHOLE,
        focal_sigma: float = 0.0,
    ) -> None:
        """Make maps of earlier drives, and go on with the last one if it is of `resume_min` ago, after a restart.

        header: how places are made. view: of the camera that maps. before_long: is called with the seconds that
        reading or finishing a drive may take here. retry_s: see `PlaceLog`. fov_deg, focal_sigma: see `LiveKeypoints`.
        """
        self.header, self._view, self._unix_time_s = header, view, unix_time_s
        self._writer = partial(PlaceLog, min_free_bytes=config.min_free_mb * 1e6, retry_s=retry_s)
        self.keypoints = LiveKeypoints(fov_deg, lens, focal_sigma, faces_back=view == "rear")
        self._log: PlaceLog | None = None
        self.last: MappedPlace | None = None
        """The newest place; None where the next one begins a drive."""
        self.stopped = ""
        self._lock, folder = -1, Path(config.folder)
        path = named_by_time(folder, unix_time_s(), lambda path: path.exists() or log_of(path).exists())
        self.growing = self._new_map(path)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            try:
                self._lock = locked(folder)
            except BlockingIOError:
                raise ConfigError(f"[mapping] folder: {folder}: another daemon maps there; stop it first") from None
            finish_earlier(config, before_long, partial(self._resume, younger_than_s=60 * config.resume_min))
        except (MapError, OSError) as error:
            if getattr(error, "errno", None) not in DISK_ERRORS:
                self._stop(reason(error))

    @property
    def why(self) -> str:
        """Why it takes no place now, "" where it does."""
        of_disk = self.stopped or (self._log.stopped if self._log else "")
        return of_disk or ("the map is full" if self.growing.is_full else "")

    @property
    def waiting(self) -> int:
        """How many places are not in the file yet."""
        return self._log.waiting if self._log is not None else 0

    def whole(self) -> PartialMap:
        """The map with all places, also those that are not searched yet."""
        return self.growing.first(self.growing.count)

    def begin_drive(self) -> bool:
        """Begin a drive, the first one with a file; False where the disk is too far behind. OSError."""
        self.last = None
        if self._log is None:
            self._use(create_log(log_of(self.growing.path), self.keypoints.header_of(self.header)))
        assert self._log is not None
        if not self._log.begin_drive(self._view):
            return False
        self.keypoints.begin_drive(self.growing.count)
        self._begin_segment(self._view)
        return True

    def add(self, new: MappedPlace, *, is_vouched: bool) -> None:
        """To the file and to the memory, or, where the disk is behind or the map is full, to neither. OSError.

        is_vouched: see `PlacePassed`.
        """
        self.last = None
        if self._log is None or self.growing.is_full:
            return
        place = replace(new.place, row=self.growing.count)
        if not self._log.add(new.raw, place, self._unix_time_s(), is_vouched=is_vouched):
            return
        self.last = new
        self.keypoints.add(place, new.keypoints)
        self.growing.add(new.raw, place)
        if not is_vouched:
            self.growing.doubt()

    def failed(self, error: OSError) -> str:
        """Why a place is not kept; the next one begins the file, if there is room by then, or none is kept any more."""
        if self._log is not None or error.errno not in DISK_ERRORS:
            self._stop(f"{self.growing.path}: {reason(error)}")
        return reason(error)

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

    def _new_map(self, path: Path) -> GrowingMap:
        key = self.header.model, self.header.regions, self.header.sampling
        return GrowingMap(path, *key, self._raw_rows, thumbnails=self._thumbnail, keypoints=self.keypoints)

    def _raw_rows(self, rows: Sequence[int]) -> NDArray[np.float32]:
        assert self._log is not None  # with its first place there is one
        return self._log.raw_rows(rows)

    def _thumbnail(self, row: int) -> bytes:
        return self._log.thumbnail(row) if self._log else b""

    def _use(self, file: OpenLog) -> None:
        """Write to this file."""
        self._log = self._writer(file)
        self.keypoints.write_to(self._log)
        self.growing.keep_keypoints(file.header.keypoints)

    def _begin_segment(self, view: View) -> None:
        self.growing.begin_segment(source_of(self.growing.path), view, has_odometer=True, whole_sigma_m=0.0)

    def _resume(self, found: OpenLog, younger_than_s: float) -> bool:
        """Whether the drive goes on in this file of an earlier run. OSError."""
        made, now = found.header, self.header
        is_alike = (made.model, made.regions, made.sampling) == (now.model, now.regions, now.sampling)
        # Without a battery the computer's clock may have fallen behind the file: then it was just now.
        newest_s = found.newest.unix_s if found.newest else -np.inf
        is_recent = younger_than_s > 0 and self._unix_time_s() - newest_s < younger_than_s
        is_of_this_drive = is_alike and is_recent and self.keypoints.is_alike(made.keypoints)
        if self._log is not None or not found.is_sound or not is_of_this_drive:
            return False
        self.growing = self._new_map(map_of(found.path))
        self._use(found)
        for first, end, view in found.segments():
            self._begin_segment(view)
            for row in range(first, end, RESUMED_AT_ONCE):
                records = [found.place(one) for one in range(row, min(row + RESUMED_AT_ONCE, end))]
                self.growing.add_all(np.stack([found.raw_of(one) for one in records]), [one.place for one in records])
                if not all(one.is_vouched for one in records):
                    self.growing.doubt()
        self.growing.renew()
        if view == self._view:
            self.last = MappedPlace(found.raw_of(records[-1]), records[-1].place)
        log.info("%s: mapping goes on with %d places", self.growing.path, self.growing.count)
        return True

    def _stop(self, why: str) -> None:
        self.stopped = why
        log.warning("mapping stopped: %s", why)


class SearchablePart:
    """The first places of the map, `count` of them, which are searched; and what people are shown of it."""

    def __init__(self, store: DriveStore, behind_m: float) -> None:
        """At first all that there are; behind_m: how far the vehicle has to be from a place that is searched."""
        self._store, self._behind_m = store, behind_m
        self.count = store.growing.count

    def so_far(self) -> PartialMap:
        """As a map."""
        return self._store.growing.first(self.count)

    def grown(self, at_m: float, *, at_once: bool) -> PartialMap | None:
        """With further places that lie far enough behind the vehicle by now; None while there are too few.

        at_m: where it is, along all drives of the map. at_once: one further place is enough, as where none follow.
        """
        route_m, ready = self._store.growing.places["route_m"], self.count
        while ready < len(route_m) and route_m[ready] <= at_m - self._behind_m:
            ready += 1
        if ready < self.count + (1 if at_once else STEP_PLACES):
            return None
        self.count = ready
        return self.so_far()

    def status(self, why: str) -> MappingStatus:
        """What is mapped; why: nothing is mapped now, if not for the store's sake; "" where it is."""
        store, growing, why = self._store, self._store.growing, self._store.why or why
        state: Literal["mapping", "waiting", "stopped"] = "waiting" if why else "mapping"
        if store.stopped:
            state = "stopped"
        return MappingStatus(state, why, growing.path.name, growing.count, self.count, growing.mapped_m)

    def view(self, status: MappingStatus) -> MappingView:
        """What people are shown."""
        places = self._store.growing.places
        step = max(1, -(-len(places) // LINE_POINTS))
        shown = places[::step]
        line = tuple(zip(shown["lat_deg"].tolist(), shown["lon_deg"].tolist(), strict=True))
        return MappingView(status, line, -(-self.count // step))
