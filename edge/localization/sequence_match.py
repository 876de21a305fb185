"""A match on the ground: the vehicle's position at its midpoint, and its displacement since.

Where the frame has a keypoint pose (`KeyframeMatch`), that alone counts: a `PoseMeasurement`. Else a sequence match is
most accurate at its midpoint, and measures the vehicle's along-track position on the map's drive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from edge.config import Config, RigConfig
from edge.geodesy import Origin, east_north_of
from edge.localization.events import GpsFix
from edge.localization.filter import left_of
from edge.localization.place_fix import OdometryWindow, heads_along, map_error_m, position_on_route, sequence_midpoint
from edge.localization.pose_measurement import PoseMeasurement, Vector, camera_pose
from edge.localization.state import DriveErrors, Matrix
from edge.reference_map import MapDrive, Position, Route
from edge.sequence import Direction, PlaceMatch

SHARP = 0.15
"""Sharpness of a sequence match below which its sigma grows, inversely, since a vehicle that leaves its lane sees less
of the map's view. In 68 recorded drives of 29 courses, rms over sigma was 1.3 at a sharpness of 0.05 to 0.08, and 0.8
to 1.1 above. Only where both cameras face the same way."""
OPPOSED_M = 7.5
"""The least along-track standard deviation of a sequence match where the two cameras face opposite ways. On three roads
that nothing was tuned on, in five lights, it is 5.9 to 9.3 m, alike over 45 m, whatever the sharpness."""
STAYS = 0.35
"""Standard deviation of what stays of a sequence match's error for a drive, as a share of what changes."""
WANDERS = 0.5
"""Share of the variance of a map's positions that wanders. The rest stays for its drive: of the antenna's place, and of
time."""
CREPT_WITHIN_M = 1000.0
"""Of a drive whose positions crept nobody knows where they were right: so far from there all are as uncertain."""


class LocalMidpoint(NamedTuple):
    """A point of a drive of the map, or of a lane beside it, that a vehicle passed.

    place_m: meters (2,). along: unit vector (2,) of travel there. since_m: (4,) how the vehicle moved since.
    """

    place_m: Vector
    along: Vector
    since_m: Vector


class RoutePoint(NamedTuple):
    """A point of a drive of the map, meters (2,), the direction of travel there, and one sigma of the map's error."""

    place_m: Vector
    along: Vector
    map_sigma_m: float


@dataclass(frozen=True)
class SequenceMatch:
    """A sequence match in local meters, measured at its midpoint.

    mapped: its drive of the map. midpoint: where the vehicle was at the middle of the sequence. along_m: of the vehicle
    now, along the drive. sigma_factor: of its sigma, over that of a sharp match. pose: the keypoint pose, in place of a
    sequence; `midpoint` is then where the vehicle is.
    """

    match: PlaceMatch
    mapped: MapDrive
    midpoint: LocalMidpoint
    along_m: float
    sigma_m: float
    errors: DriveErrors
    sigma_factor: float
    pose: PoseMeasurement | None = None

    @property
    def drive(self) -> tuple[int, Direction]:
        """What its errors are those of."""
        return self.mapped.segment, self.match.direction


@dataclass(frozen=True)
class StructureMeasurement:
    """Where structure has the vehicle, in local meters: in the middle of its window.

    drive: what its errors are those of. sigma_m: along-track and cross-track, without the error of the map.
    """

    drive: tuple[int, Direction]
    midpoint: LocalMidpoint
    sigma_m: tuple[float, float]
    errors: DriveErrors

    @property
    def covariance(self) -> Matrix:
        """East and north (2, 2)."""
        axes = np.array([self.midpoint.along, left_of(self.midpoint.along)])
        return np.asarray(axes.T @ np.diag(np.square(self.sigma_m)) @ axes)


class Georeferencer:
    """Matches in local meters, with the odometer's readings at the frames of the sequence."""

    def __init__(self, route: Route, config: Config) -> None:
        self.route, self.rig = route, config.rig
        self.length = config.sequence_frames
        """Frames of a sequence."""
        self._readings = OdometryWindow(self.length)
        self._faces_back = config.camera.view == "rear"
        self._heading_sigma_rad = math.radians(config.tracking.heading_error_deg)
        self.origin: Origin | None = None
        """Of local meters."""

    def clear(self) -> None:
        """The next frame begins a new sequence."""
        self._readings.clear()

    def add(self, displacement_m: Vector) -> None:
        """A frame was used there (4,)."""
        self._readings.add(displacement_m)

    def local(self, position: Position | GpsFix) -> Vector:
        """Meters east and north (2,)."""
        if self.origin is None:
            self.origin = position.lat_deg, position.lon_deg
        return np.array(east_north_of(position.lat_deg, position.lon_deg, self.origin))

    def position(self, match: PlaceMatch, along_m: float) -> Position | None:
        """Where a match's drive of the map is after so many meters of its route_m, with the heading of travel."""
        offset_m = along_m - self.route.route_m(match.place_index)
        return position_on_route(self.route, match.place_index, offset_m, match.direction)

    def of(self, match: PlaceMatch) -> SequenceMatch | None:
        """A match in local meters; None where the map has no positions, or where the vehicle's course differs."""
        middle = sequence_midpoint(match, self.route, self.length)
        if middle is None or len(self._readings) < self.length:
            return None
        begin, there, end = (self._on_drive(match, m) for m in (middle.begins_m, middle.along_m, middle.ends_m))
        if begin is None or there is None or end is None:
            return None
        if not heads_along(_course_rad(end.place_m - begin.place_m), _course_rad(self._since(2 * middle.back))):
            return None
        faint = 1.0 if _is_opposed(match) else max(1.0, SHARP / match.sharpness)
        since_m, left_m = self._since(middle.back), self.rig.left_m(match.direction)
        sign = -1 if match.direction == "reverse" else 1
        drive = self.route.drive(match.place_index)
        return SequenceMatch(
            match=match,
            mapped=drive,
            midpoint=LocalMidpoint(there.place_m + left_m * left_of(there.along), there.along, since_m),
            along_m=middle.along_m + sign * (float(np.hypot(*since_m[:2])) - self._ahead_m(match)),
            sigma_m=middle.sigma_m,
            errors=self._errors(match, drive, middle.along_m, there.along, there.map_sigma_m, 0.0),
            sigma_factor=faint,
        )

    def pose_measurement(self, match: PlaceMatch, yaw_rad: float | None = None) -> SequenceMatch | None:
        """The keypoint pose of a match, with its drive; None without one, or if the keyframe has no heading.

        yaw_rad: see `PoseMeasurement`.
        """
        seen = match.seen
        if seen is None:
            return None
        route, drive, rig = self.route, self.route.drive(seen.place_index), self.rig
        way: Direction = "reverse" if route.faces_back(seen.place_index) != self._faces_back else "forward"
        match = replace(match, place_index=seen.place_index, direction=way, order="same")
        row = route.position(seen.place_index, 0.0)
        if row is None or row.heading_deg is None:
            return None
        row_rad = math.radians(row.heading_deg)
        camera_rad = row_rad + math.pi * route.faces_back(seen.place_index)
        position_m, pose = camera_pose(seen, self.local(row), camera_rad, self._heading_sigma_rad)
        heading_rad = camera_rad + seen.turn_rad + math.pi * self._faces_back
        heads = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        position_m = position_m - rig.look_ahead_m(match.direction) * heads
        forward_m = float((position_m - self.local(row)) @ np.array([math.sin(row_rad), math.cos(row_rad)]))
        road = position_on_route(route, seen.place_index, forward_m, match.direction)
        if road is None or road.heading_deg is None:
            return None
        road_rad = math.radians(road.heading_deg)
        along = np.array([math.sin(road_rad), math.cos(road_rad)])
        along_m = route.route_m(seen.place_index) + forward_m
        camera_m = rig.look_sigma_m or rig.sigma_along_m
        measured = PoseMeasurement(position_m, pose, heading_rad, seen.points, yaw_rad)
        return SequenceMatch(
            match=match,
            mapped=drive,
            midpoint=LocalMidpoint(position_m, along, np.zeros(4)),
            along_m=along_m,
            sigma_m=math.sqrt(float(along @ measured.covariance @ along)),
            errors=self._errors(match, drive, along_m, along, map_error_m(row), camera_m),
            sigma_factor=1.0,
            pose=measured,
        )

    def structure_measurement(self, match: PlaceMatch) -> StructureMeasurement | None:
        """A match's `StructureMatch` in local meters; None without one, or where the map has no positions."""
        seen = match.structure
        if seen is None or len(self._readings) <= seen.frames:
            return None
        place, rig, sign = seen.place_index, self.rig, 1 if match.direction == "forward" else -1
        road = position_on_route(self.route, place, seen.ahead_m, match.direction)
        if road is None or road.heading_deg is None:
            return None
        road_rad = math.radians(road.heading_deg)
        along = np.array([math.sin(road_rad), math.cos(road_rad)])
        since_m = self._since(seen.frames)
        if not heads_along(road_rad, _course_rad(since_m)):
            return None
        place_m = self.local(road) + sign * seen.left_m * left_of(along) - rig.look_ahead_m(match.direction) * along
        drive, camera_m = self.route.drive(place), rig.look_sigma_m or rig.sigma_along_m
        along_m = self.route.route_m(place) + seen.ahead_m
        return StructureMeasurement(
            (drive.segment, match.direction),
            LocalMidpoint(place_m, along, since_m),
            seen.sigma_m,
            self._errors(match, drive, along_m, along, map_error_m(road), camera_m),
        )

    def _errors(
        self, match: PlaceMatch, drive: MapDrive, along_m: float, along: Vector, map_m: float, ahead_sigma_m: float
    ) -> DriveErrors:
        """along_m: of the vehicle along the drive. ahead_sigma_m: of the along-track error that all matches share."""
        whole_m = math.hypot(drive.whole_sigma_m[0], ahead_sigma_m), drive.whole_sigma_m[1]
        ways, match_m = (along, left_of(along)), changing_sigma_m(match, self.rig)
        whole = sum((m**2 * np.outer(way, way) for m, way in zip(whole_m, ways, strict=True)), start=np.zeros((2, 2)))
        around_m2 = drive.crept_at(along_m + CREPT_WITHIN_M) - drive.crept_at(along_m - CREPT_WITHIN_M)
        whole += ((1 - WANDERS) * map_m**2 + around_m2 / 2) * np.eye(2)
        of_map, of_match = (math.sqrt(WANDERS) * map_m, whole), (STAYS * match_m, match_m, self.rig.sigma_cross_track_m)
        return DriveErrors(*of_map, *of_match, drive.crept_at(along_m))

    def _on_drive(self, match: PlaceMatch, along_m: float) -> RoutePoint | None:
        """Where the vehicle is on the map's drive when its sequence match is at `along_m`."""
        sign = 1 if match.direction == "forward" else -1
        found = self.position(match, along_m - sign * self._ahead_m(match))
        if found is None or found.heading_deg is None:
            return None
        heading_rad = math.radians(found.heading_deg)
        along = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        return RoutePoint(self.local(found), along, map_error_m(found))

    def _since(self, frames: float) -> Vector:
        """The displacement (4,) since so many frames ago."""
        return self._readings.back(0) - self._readings.back(frames)

    def _ahead_m(self, match: PlaceMatch) -> float:
        return self.rig.ahead_m(match.direction, match.order)


def _course_rad(moved_m: Vector) -> float:
    return math.atan2(moved_m[0], moved_m[1])


def changing_sigma_m(match: PlaceMatch, rig: RigConfig) -> float:
    """One standard deviation of a match along-track, but for what stays for a drive (STAYS of it) and its jitter."""
    return max(rig.sigma_m(match.direction, match.order), OPPOSED_M if _is_opposed(match) else 0.0)


def _is_opposed(match: PlaceMatch) -> bool:
    """Whether the two cameras face opposite ways."""
    return (match.direction, match.order) == ("forward", "swapped")
