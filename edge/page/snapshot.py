"""What the live page shows of the daemon: a short history of used frames, and a snapshot when somebody looks."""

from __future__ import annotations

import logging
import os
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import edge
from edge.camera import Frame
from edge.camera.newest import CameraHealth
from edge.config import Config, PageConfig
from edge.health.stage_times import StageTimes
from edge.journal.journal import Journal
from edge.page.status import CameraStatus, FrameSample, LinkStatus, MapView, MatchStatus, Snapshot, Status
from edge.recognizer import PlaceRecognizer
from edge.reference_map import COST_ONE, Bounds, MapSet, Position
from edge.sequence import PlaceMatch
from edge.telemetry.autopilot import AutopilotConnection

if TYPE_CHECKING:
    from edge.page.server import StatusPage

HISTORY = 2400
RATE_FRAMES = 20
WINDOW_PLACES = 60
"""So many places on either side of the match are shown of the cost matrix."""
DRIVE_POINTS = 2000
log = logging.getLogger(__name__)


def open_page(config: PageConfig, map_set: MapSet) -> StatusPage | None:
    """The live page, or None and a line in the log: without it places are recognised just as well."""
    if config.port == 0:
        return None
    try:
        # Imported here: a vehicle without the page never loads a web server.
        from edge.page.server import StatusPage

        page = StatusPage(config, map_view(map_set))
    except ModuleNotFoundError as error:
        log.info("no live page: it needs %s: pip install 'lookback[page]'", error.name)
        return None
    except OSError as error:
        log.warning("no live page: [page] %s:%d: %s", config.bind, config.port, os.strerror(error.errno or 0))
        return None
    log.info("live page: http://%s:%d", f"[{config.bind}]" if ":" in config.bind else config.bind, page.port)
    return page


def map_view(map_set: MapSet) -> MapView:
    """The map's drives as lines, thinned out where they are long; of maps in a folder, the bounds."""
    index = map_set.index
    if map_set.is_folder:
        drives = [_outline(header.bounds) for header in map_set.headers if header.bounds]
    else:
        pieces = [map_set.places[start:end] for _, start, end in index.by_segment([(0, index.places)])]
        drives = [_line(drive[:: max(1, len(drive) // DRIVE_POINTS)]) for drive in pieces]
    return MapView(index.places, tuple(drives), map_set.thumbnail)


def _line(drive: NDArray[np.void]) -> tuple[tuple[float, float], ...]:
    known = drive[~np.isnan(drive["lat_deg"])]
    return tuple(zip(known["lat_deg"].tolist(), known["lon_deg"].tolist(), strict=True))


def _outline(bounds: Bounds) -> tuple[tuple[float, float], ...]:
    south, west, north, east = bounds.south, bounds.west, bounds.north, bounds.east
    return (south, west), (south, east), (north, east), (north, west), (south, west)


class LiveStatus:
    """Takes a note of every used frame, which costs microseconds, and makes a snapshot when it is asked for one."""

    def __init__(
        self,
        config: Config,
        model_name: str,
        recognizer: PlaceRecognizer,
        times: StageTimes,
        camera_health: Callable[[], CameraHealth],
        autopilot: AutopilotConnection,
        journal: Journal | None,
        clock_ns: Callable[[], int],
        unix_time_s: Callable[[], float] = time.time,
    ) -> None:
        self._config, self._recognizer, self._times = config, recognizer, times
        self._camera_health, self._autopilot = camera_health, autopilot
        self._journal, self._clock_ns = journal, clock_ns
        self._model_name = model_name
        self._started_unix_s = round(unix_time_s(), 3)
        self._history: deque[FrameSample] = deque(maxlen=HISTORY)
        self._frame: Frame | None = None
        self._match: PlaceMatch | None = None
        self._position: Position | None = None
        self._category = ""
        self._frames_used = self._events = 0

    def note(self, frame: Frame, match: PlaceMatch | None, found: Position | None) -> None:
        """A frame was used, `match` is what it gave, and `found` where that puts the vehicle."""
        self._frame, self._match, self._position = frame, match, found
        self._frames_used += 1
        position = self._autopilot.vehicle.position(self._clock_ns())
        lat_deg = position.lat_deg if position else found.lat_deg if found and match and match.accepted else None
        lon_deg = position.lon_deg if position else found.lon_deg if found and match and match.accepted else None
        event = match is not None and match.event
        self._events += event
        if match is not None and match.category:
            self._category = match.category
        uniqueness = round(match.uniqueness, 4) if match else None
        place = match.place_index if match else None
        state = self._recognizer.state
        fix = (found.lat_deg, found.lon_deg) if found and event else (None, None)
        self._history.append(FrameSample(frame.stamp_ns, state, uniqueness, place, event, lat_deg, lon_deg, *fix))

    def snapshot(self, state: str, why: str) -> Snapshot:
        """What is to be shown now; `state` is the daemon's, and why it is so."""
        frame, match, search = self._frame, self._match, self._recognizer.matcher.search
        window, window_start = self._window(match)
        places = search.part.places if search.part is not None else np.zeros(0, dtype=np.intp)
        costs = search.newest_costs if search.newest_costs.shape[1] == len(places) else np.zeros((0, 0), np.int32)
        return Snapshot(
            status=self._status(state, why),
            image=frame.image if frame else None,
            costs=costs,
            places=places[: costs.shape[1]],
            window=window,
            window_start=window_start,
            cost_one=COST_ONE,
        )

    def _status(self, state: str, why: str) -> Status:
        now_ns = self._clock_ns()
        frame = self._frame
        return Status(
            stamp_ns=now_ns,
            started_unix_s=self._started_unix_s,
            version=edge.__version__,
            map_name=f"{Path(self._config.map.path).name}, {self._recognizer.map_set}",
            model=self._model_name,
            state=state,
            why=why,
            frame_stamp_ns=frame.stamp_ns if frame else None,
            frames_used=self._frames_used,
            events=self._events,
            fps=self._fps(now_ns),
            category=self._category,
            uniqueness_min=self._config.acceptance.uniqueness_min,
            stages_ms=self._times.medians_ms(),
            journal_lost=self._journal.lost if self._journal else 0,
            camera=self._camera_status(),
            link=self._link_status(now_ns),
            match=self._match_status(),
            history=tuple(self._history),
        )

    def _match_status(self) -> MatchStatus | None:
        match, position = self._match, self._position
        if match is None:
            return None
        return MatchStatus(
            place=match.place_index,
            direction=match.direction,
            order=match.order,
            slope=round(match.slope, 4),
            distance=round(match.distance, 4),
            uniqueness=round(match.uniqueness, 4),
            accepted=match.accepted,
            lat_deg=position.lat_deg if position else None,
            lon_deg=position.lon_deg if position else None,
            map=match.map,
            row=match.place,
        )

    def _window(self, match: PlaceMatch | None) -> tuple[np.ndarray, int]:
        """The cost rows of the line of the newest match, around its place."""
        part = self._recognizer.matcher.search.part
        if match is None or part is None:
            return np.zeros((0, 0), dtype=np.int32), 0
        at = int(np.searchsorted(part.places, match.place_index))
        first = max(0, at - WINDOW_PLACES)
        rows = part.recent_costs(match.direction, match.order)[:, first : at + WINDOW_PLACES + 1]
        return rows, int(part.places[min(first, len(part.places) - 1)])

    def _fps(self, now_ns: int) -> float:
        stamps_ns = [used.stamp_ns for used in list(self._history)[-RATE_FRAMES:]]
        if len(stamps_ns) < 2:
            return 0.0
        # A camera that stopped shows as a rate that falls.
        return round((len(stamps_ns) - 1) * 1e9 / max(max(stamps_ns[-1], now_ns - 1e9) - stamps_ns[0], 1), 2)

    def _camera_status(self) -> CameraStatus:
        health = self._camera_health()
        return CameraStatus(
            health.state,
            health.reason,
            health.differences,
            health.delivered,
            health.overwritten,
            health.bad,
            health.reopened,
        )

    def _link_status(self, now_ns: int) -> LinkStatus:
        config, vehicle = self._config.telemetry, self._autopilot.vehicle
        position = vehicle.position(now_ns)
        return LinkStatus(
            state=self._autopilot.state,
            connection=config.connection,
            emit=config.emit,
            lat_deg=position.lat_deg if position else None,
            lon_deg=position.lon_deg if position else None,
            heading_deg=position.heading_deg if position else None,
            speed_mps=vehicle.speed_mps(now_ns),
            gps_healthy=vehicle.gps_healthy(now_ns),
        )
