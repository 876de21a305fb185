"""From a match to a position of the vehicle on the ground. Pure.

A sequence match is most accurate at its midpoint: a small error of its slope, times half its length, is an error of its
end. So the filter uses the midpoint, and moves it on to the newest frame by the autopilot's velocity. On simulated
drives home (night, dusk, rain) the end is then right to 3.0 m where it was to 5.0.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from edge.config import RigConfig
from edge.journal.records import FrameUsed, PlaceFix
from edge.reference_map import Position, Route
from edge.sequence import MOST_OFF_COURSE_RAD, Direction, PlaceMatch

UNTRACKED_SIGMA_M = 10.0
"""Of a match that the filter does not follow: the first sequence matches on a road were up to 20 m off."""
PUSHED = 3.0
"""Places from an end of the drive within which a match may be biased inward."""
JITTER_M = 1.5
"""What else differs from match to match."""
MAP_LEAST_M = 1.0
"""The least error of the map's positions in each direction: of the antenna's place, time, and optimistic receivers."""


def position_on_route(route: Route, place_index: int, offset_m: float, direction: Direction) -> Position | None:
    """The position `offset_m` further along the map's drive than a place, with the heading of travel; None: unknown."""
    position = route.position(place_index, offset_m)
    if position is None or position.heading_deg is None:
        return position
    return replace(position, heading_deg=(position.heading_deg + (0 if direction == "forward" else 180)) % 360)


def map_error_m(position: Position) -> float:
    """One standard deviation of the map's error there, in each direction."""
    return max(MAP_LEAST_M, position.sigma_m / math.sqrt(2))


def match_position(match: PlaceMatch, route: Route, rig: RigConfig) -> Position | None:
    """Where the vehicle was at the match's newest frame: the place moved by the rig's offset."""
    # A keypoint pose is that of the vehicle. The place of a sequence match lies ahead of it.
    ahead_m = rig.ahead_m(match.direction, match.order) if match.has_line else 0.0
    # On the way back "ahead" is towards the start of the map's drive.
    offset_m = -ahead_m if match.direction == "forward" else ahead_m
    return position_on_route(route, match.place_index, offset_m, match.direction)


def frame_used(
    frame: int, stamp_ns: int, match: PlaceMatch | None, route: Route, rig: RigConfig, missed: int = 0
) -> FrameUsed:
    """The record of a frame and of its match. missed: places passed without a frame before it."""
    if match is None:
        return FrameUsed(frame, stamp_ns, missed=missed or UNSET)
    position = match_position(match, route, rig)
    return FrameUsed(
        frame=frame,
        stamp_ns=stamp_ns,
        accepted=match.accepted,
        confidence=round(match.confidence, 4),
        emitted=match.event,
        missed=missed or UNSET,
        map=UNSET if match.map is None else match.map,
        place=match.place,
        map_row=route.map_row(match.place_index),
        uniqueness=round(match.uniqueness, 6),
        distance=round(match.distance, 6),
        direction=match.direction,
        order=match.order,
        lat_deg=position.lat_deg if position else None,
        lon_deg=position.lon_deg if position else None,
        heading_deg=position.heading_deg if position else None,
    )


def untracked_fix(match: PlaceMatch, stamp_ns: int, route: Route, rig: RigConfig) -> PlaceFix:
    """A match as it is, where nothing has been tracked."""
    position = match_position(match, route, rig)
    map_m = position.sigma_m / math.sqrt(2) if position else 0.0
    return PlaceFix(
        stamp_ns=stamp_ns,
        place=match.place,
        lat_deg=position.lat_deg if position else None,
        lon_deg=position.lon_deg if position else None,
        heading_deg=position.heading_deg if position else None,
        sigma_along_m=math.hypot(max(rig.sigma_m(match.direction, match.order), UNTRACKED_SIGMA_M), map_m),
        sigma_cross_track_m=math.hypot(rig.sigma_cross_track_m, map_m),
        direction=match.direction,
        order=match.order,
        uniqueness=match.uniqueness,
        confidence=match.confidence,
        map=UNSET if match.map is None else match.map,
    )


@dataclass(frozen=True)
class SequenceMidpoint:
    """Meters along the drive, in its own route_m: of the places at the first frame, the middle, and the newest frame.

    back: frames from the middle to the newest. sigma_m: one standard deviation of along_m, by the spacing of places.
    """

    segment: int
    recording: str
    begins_m: float
    along_m: float
    ends_m: float
    back: float
    sigma_m: float


def sequence_midpoint(match: PlaceMatch, route: Route, frames: int) -> SequenceMidpoint | None:
    """The midpoint of a match of so many frames; None without a sequence or meters, and where it may be biased.

    Where only some of the frames are on the map, the best match still lies on it, and so begins or ends at its end.
    """
    if not match.has_line:
        return None
    drive, ends_m = route.drive(match.place_index), route.route_m(match.place_index)
    if drive.places < 2 or math.isnan(ends_m) or not drive.spacing_m > 0:
        return None
    sign = 1 if match.direction == "forward" else -1
    evenly = match.slope * np.arange(frames)
    passed_m = np.array([*match.passed[:frames], *evenly[len(match.passed) :]]) * drive.spacing_m
    begins_m, middle_m = (ends_m - sign * float(of) for of in (passed_m[-1], np.median(passed_m)))
    margin_m = PUSHED * drive.spacing_m
    if not drive.from_m + margin_m <= min(begins_m, ends_m) <= max(begins_m, ends_m) <= drive.to_m - margin_m:
        return None
    sigma_m = math.hypot(drive.spacing_m / math.sqrt(12), JITTER_M)
    back = (frames - 1) / 2
    return SequenceMidpoint(drive.segment, drive.recording, begins_m, middle_m, ends_m, back, sigma_m)


def heads_along(road_rad: float, heading_rad: float) -> bool:
    """Whether a vehicle goes along the road of a match, which may go on through a turn of the map's drive."""
    return math.cos(road_rad - heading_rad) >= math.cos(MOST_OFF_COURSE_RAD)


class OdometryWindow:
    """The vehicle's dead reckoning at each frame of the newest sequence, (n <= length, k) meters."""

    def __init__(self, length: int) -> None:
        """length: frames in a sequence."""
        self._readings: deque[NDArray[np.float64]] = deque(maxlen=length)

    def __len__(self) -> int:
        return len(self._readings)

    def add(self, reading: NDArray[np.float64]) -> None:
        """The reading at a further frame of the sequence."""
        self._readings.append(reading)

    def back(self, frames: float) -> NDArray[np.float64]:
        """The reading so many frames before the newest, between two of them by interpolation."""
        at = max(0.0, len(self._readings) - 1 - frames)
        first = int(at)
        after = min(first + 1, len(self._readings) - 1)
        return self._readings[first] + (at - first) * (self._readings[after] - self._readings[first])

    def clear(self) -> None:
        """The next frame begins a new sequence."""
        self._readings.clear()
