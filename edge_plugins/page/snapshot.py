"""What the live page shows: a short history of used frames, the maps, and a snapshot when somebody looks.

The records are immutable: the daemon's loop makes them, and the page's thread reads them and writes them as JSON.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

import edge
from edge.camera import CameraHealth, Frame
from edge.config import FEWEST_FRAMES, SamplingConfig
from edge.geodesy import east_north
from edge.journal.records import FrameUsed, PlaceFix
from edge.keypoints.intrinsics import CameraDifference
from edge.reference_map import Bounds, MapSet, Route
from edge.sequence import Correspondences, PlaceMatch
from edge.telemetry import LinkStatus
from edge_plugins.mapping.status import MappingView

HISTORY = 2400
RATE_FRAMES = 20
POINTS_SHOWN_NS = 1_000_000_000
"""A frame is shown with its points for so long, since most frames are not verified."""


class HistoryFrame(msgspec.Struct, frozen=True):
    """One used frame, and where the autopilot said the vehicle then was: degrees (WGS 84), None where not known.

    searched: how far the vehicle had gone since a place was recognized, as in Status.
    """

    used: FrameUsed
    vehicle: tuple[float, float] | None
    searched: float = 0.0


class DaemonStatus(msgspec.Struct, frozen=True, kw_only=True):
    """What the daemon says of itself. stamp_ns: CLOCK_MONOTONIC now. stages_ms: medians.

    position: at the exposure of the last match that passed the innovation test; beside_lane_m: see `beside_lane_m`.
    no_pose_m: driven since the newest keypoint pose, None without one.
    """

    stamp_ns: int
    map_name: str
    state: str
    why: str
    stages_ms: dict[str, float]
    journal_lost: int
    camera: CameraHealth
    camera_by_keypoints: CameraDifference | None = None
    link: LinkStatus
    mapping: MappingView | None = None
    position: PlaceFix | None = None
    beside_lane_m: float | None = None
    no_pose_m: float | None = None


class Status(DaemonStatus, frozen=True, kw_only=True):
    """Everything about it that is words and numbers.

    started_unix_s identifies the run of the daemon. newest: the newest used frame, with its match where there is one.
    searched: how far the vehicle has gone since a place was recognized, how far that takes on this map, and the unit.
    fps: used frames per second over the recent ones. history: oldest first.
    """

    started_unix_s: float
    version: str
    model: str
    newest: FrameUsed | None
    searched: tuple[float, float, str]
    frames_used: int
    events: int
    fps: float
    confidence_from: float
    history: tuple[HistoryFrame, ...]


@dataclass(frozen=True)
class PageSnapshot:
    """A status with the newest used frame (H, W, 3) uint8 BGR.

    correspondences: keypoint matches of that frame and of its place; None: not verified, or no match.
    """

    status: Status
    image: NDArray[np.uint8] | None
    correspondences: Correspondences | None = None

    def as_json(self, since_ns: int, picture: bytes = b"") -> bytes:
        """The status, and its history after `since_ns`.

        picture: JPEG of the newest frame, in base64 within, which saves a request; b"" for who has it already.
        """
        history = tuple(sample for sample in self.status.history if sample.used.stamp_ns > since_ns)
        fields = msgspec.structs.asdict(msgspec.structs.replace(self.status, history=history))
        points = self.correspondences
        pair = points and {"place": points.place_index, "points": points.shares.round(3).tolist()}
        return msgspec.json.encode({**fields, "inliers": pair, "picture": picture})


class LiveStatus:
    """Keeps every used frame for a while, which costs microseconds, and makes a snapshot when it is asked for one."""

    def __init__(
        self,
        model: str,
        confidence_from: float,
        unix_time_s: Callable[[], float] = time.time,
        *,
        sequence_frames: int = FEWEST_FRAMES,
        sampling: SamplingConfig | None = None,
    ) -> None:
        """model: its name, for people. confidence_from: from which on a place is believed. sequence_frames: of a line.

        sampling: how far frames are apart.
        """
        sampling = sampling or SamplingConfig()
        self._step, self._unit = {
            "distance": (sampling.spacing_m, "m"),
            "time": (sampling.interval_s, "s"),
            "frames": (float(sampling.spacing_frames), "frames"),
        }[sampling.by]
        self._sequence = sequence_frames * self._step
        self._unrecognized = 0
        self._model, self._confidence_from = model, confidence_from
        self._started_unix_s = round(unix_time_s(), 3)
        self._history: deque[HistoryFrame] = deque(maxlen=HISTORY)
        self._frame: Frame | None = None
        self._verified: tuple[Frame, Correspondences] | None = None
        self.match: PlaceMatch | None = None
        self.frames_used = self.events = 0

    def add(
        self,
        frame: Frame,
        match: PlaceMatch | None,
        used: FrameUsed,
        vehicle: tuple[float, float] | None,
        correspondences: Correspondences | None = None,
    ) -> None:
        """A frame was used: what it gave, its record, and the autopilot's own latitude and longitude.

        correspondences: the points by which it shows the place of its match.
        """
        self._frame, self.match = frame, match
        if match is not None and match.seen is not None and correspondences is not None:
            self._verified = frame, correspondences
        self.frames_used += 1
        self.events += used.emitted
        self._unrecognized = 0 if used.accepted else self._unrecognized + 1
        self._history.append(HistoryFrame(used, vehicle, round(self._unrecognized * self._step, 1)))

    def snapshot(self, daemon: DaemonStatus) -> PageSnapshot:
        """What is to be shown now."""
        status = Status(
            **msgspec.structs.asdict(daemon),
            started_unix_s=self._started_unix_s,
            version=edge.__version__,
            model=self._model,
            newest=self._history[-1].used if self._history else None,
            searched=(round(self._unrecognized * self._step, 1), self._sequence, self._unit),
            frames_used=self.frames_used,
            events=self.events,
            fps=self._fps(daemon.stamp_ns),
            confidence_from=self._confidence_from,
            history=tuple(self._history),
        )
        if self._frame is None:
            return PageSnapshot(status, None)
        if self._verified and self.match and self._frame.stamp_ns - self._verified[0].stamp_ns <= POINTS_SHOWN_NS:
            frame, correspondences = self._verified
            return PageSnapshot(status, frame.image, correspondences)
        return PageSnapshot(status, self._frame.image)

    def _fps(self, now_ns: int) -> float:
        stamps_ns = [sample.used.stamp_ns for sample in list(self._history)[-RATE_FRAMES:]]
        if len(stamps_ns) < 2:
            return 0.0
        # A camera that stopped shows as a rate that falls.
        return round((len(stamps_ns) - 1) * 1e9 / max(max(stamps_ns[-1], now_ns - 1e9) - stamps_ns[0], 1), 2)


def beside_lane_m(fix: PlaceFix, route: Route, place_index: int) -> float | None:
    """How far to the right of the drive of a place a position is, as the vehicle heads: meters.

    None where nothing but the lane says where cross-track it is, and without positions.
    """
    drive = route.drive(place_index)
    if fix.by_lane or not fix.is_position or not drive.route_m.size:
        return None
    from_fix_m = east_north(drive.lat_deg, drive.lon_deg, (fix.lat_deg or 0.0, fix.lon_deg or 0.0))
    nearest = int(np.hypot(*from_fix_m.T).argmin())
    heading_rad = np.radians(drive.heading_deg[nearest] + (180.0 if fix.direction == "reverse" else 0.0))
    right_m = from_fix_m[nearest] @ (-np.cos(heading_rad), np.sin(heading_rad))
    return None if np.isnan(right_m) else round(float(right_m), 2)


DRIVE_POINTS = 2000
Line = tuple[tuple[float, float], ...]
"""(latitude, longitude) in degrees (WGS 84)."""


@dataclass(frozen=True)
class MapView:
    """What the page shows of the map.

    places: how many there are in all. starts: how many places come before each map of a folder, by the map's name.
    drives: lists of (latitude, longitude), empty where unknown. thumbnail: the small JPEG of a place, counted through
    all maps (any thread may ask); b"" where there is none. own_camera: whether a drive of a camera that faces as this
    one does is among them; True for an empty map.
    """

    places: int
    starts: dict[str, int]
    drives: tuple[Line, ...]
    thumbnail: Callable[[int], bytes]
    own_camera: bool = True

    def as_json(self) -> bytes:
        """All but the thumbnails."""
        return msgspec.json.encode({name: of for name, of in vars(self).items() if name != "thumbnail"})


def map_view(maps: MapSet, view: str = "front") -> MapView:
    """What is shown of these maps to a vehicle whose camera has that view."""
    starts = dict(zip(maps.names, maps.index.starts, strict=False)) if maps.is_folder else {}
    views = {one.view for header in maps.headers for one in header.segments}
    return MapView(maps.index.places, starts, _outline(maps), maps.thumbnail, not views or view in views)


def _outline(maps: MapSet) -> tuple[Line, ...]:
    """The drives of a map, thinned out where they are long; of maps in a folder, their bounds."""
    if maps.is_folder:
        return tuple(_rectangle(header.bounds) for header in maps.headers if header.bounds)
    index = maps.index
    drives = [maps.places[start:end] for _, start, end in index.by_segment([(0, index.places)])]
    return tuple(_line(drive[:: max(1, len(drive) // DRIVE_POINTS)]) for drive in drives)


def _line(drive: NDArray[np.void]) -> Line:
    known = drive[~np.isnan(drive["lat_deg"])]
    return tuple(zip(known["lat_deg"].tolist(), known["lon_deg"].tolist(), strict=True))


def _rectangle(bounds: Bounds) -> Line:
    south, west, north, east = bounds.south, bounds.west, bounds.north, bounds.east
    return (south, west), (south, east), (north, east), (north, west), (south, west)
