"""From matches to a position that follows the vehicle on the ground. Pure: no link, no clock.

A believed match says how far along the map's drive the vehicle is, and nothing across it. Between matches the vehicle
moves as the autopilot's velocity says, whose heading and scale are wrong by a little; `RouteEstimate` finds by how
much. A match is used only if its line moved over the ground as the autopilot's velocity did, and if it agrees with the
estimate. Where matches keep disagreeing with the estimate but agree with each other, a second estimate follows them
and replaces the first one after a correlation length without a match for that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from edge.config import RigConfig, TrackingConfig
from edge.geodesy import Origin, east_north_of, moved
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Displacement
from edge.localization.place_fix import LineMiddle, LineReadings, line_middle, moved_alike, position_on_route
from edge.localization.route_estimate import CORRELATION_M, RouteEstimate, Vector, VelocityErrors
from edge.reference_map import Position, Route
from edge.sequence import PlaceMatch

AGREE_SIGMAS = 3.0
STOOD_NS = 30_000_000_000
"""A vehicle without a new frame for so long may have been carried away: no line may have a frame from before that."""
FLOOR_M = 1.0
"""What no number of matches removes, one standard deviation in each direction: the map's own positions."""
FAR_M = 1000.0
"""Distance from the origin of local meters at which a new origin is chosen."""
RIVAL_MATCHES = 3
"""Matches in a row that disagree with the estimate before its positions are disputed."""


@dataclass(frozen=True)
class _Sighting:
    """A match in local meters: where the vehicle was at the middle of its line, and its displacement since then.

    along: unit vector (2,) of travel there. along_m: of the vehicle now, along the drive.
    """

    match: PlaceMatch
    segment: int
    place_m: Vector
    along: Vector
    since_m: Vector
    along_m: float
    sigma_m: float
    match_sigma_m: float


@dataclass
class _Track:
    """An estimate, the newest match that agreed with it, when, and what was driven in all and since that match."""

    estimate: RouteEstimate
    newest: _Sighting
    stamp_ns: int
    matches: int = 0
    since_m: float = 0.0
    driven_m: float = 0.0

    def move(self, displacement_m: Vector) -> None:
        self.estimate.predict(displacement_m)
        driven_m = float(np.hypot(*displacement_m))
        self.since_m += driven_m
        self.driven_m += driven_m

    def agrees(self, sighting: _Sighting) -> bool:
        off_m, sigma_m = self.estimate.innovation(
            sighting.place_m,
            sighting.along,
            sighting.since_m,
            math.hypot(sighting.sigma_m, self._new_drive_m(sighting)),
        )
        return abs(off_m) <= AGREE_SIGMAS * sigma_m

    def _new_drive_m(self, sighting: _Sighting) -> float:
        return sighting.match_sigma_m if self._begins_drive(sighting) else 0.0

    def _begins_drive(self, sighting: _Sighting) -> bool:
        now, before = sighting.match, self.newest.match
        return (sighting.segment, now.direction) != (self.newest.segment, before.direction)

    def add(self, sighting: _Sighting, road_sigma_m: float, stamp_ns: int) -> None:
        if self._begins_drive(sighting):
            self.estimate.begin_drive(sighting.match_sigma_m)
        self.estimate.keep_on_road(sighting.place_m, sighting.along, sighting.since_m, road_sigma_m)
        self.estimate.correct(sighting.place_m, sighting.along, sighting.since_m, sighting.sigma_m)
        self.newest, self.stamp_ns, self.since_m = sighting, stamp_ns, 0.0
        self.matches += 1


class RouteFilter:
    """Follows the vehicle over the ground along the drives of a map."""

    def __init__(self, route: Route, tracking: TrackingConfig, rig: RigConfig, length: int) -> None:
        """length: frames in a sequence."""
        self._route, self._config, self._rig = route, tracking, rig
        self._readings, self._length = LineReadings(length), length
        self._origin: Origin | None = None
        self.reset()

    def reset(self) -> None:
        """Begin anew (after a blindness, or where the motion is not known): nothing that was matched so far counts."""
        self._readings.clear()
        self._at: Displacement | None = None
        self._last_ns = 0
        self._exposure: PlaceFix | None = None
        self._track: _Track | None = None
        self._rival: _Track | None = None

    def update(
        self, match: PlaceMatch | None, stamp_ns: int, displacement: Displacement | None, missed: int = 0
    ) -> None:
        """Use the answer to one frame; displacement: by the autopilot's velocity at its exposure, None where unknown.

        missed: as `observe` got it. Without a displacement there is no position.
        """
        if displacement is None or (self._at is not None and displacement.leg != self._at.leg):
            self.reset()
        if displacement is None:
            return
        if stamp_ns - self._last_ns > STOOD_NS or missed > self._length // 2:
            self._readings.clear()
        self._last_ns = stamp_ns
        self._move(displacement, missed)
        track = self._track
        if track is not None and self._is_lost(track, stamp_ns, 0.0):
            self._track = self._exposure = None
        # Where another place fits this frame better, the votes know the place, but no line says where it ends.
        if match is None or not match.accepted or match.uniqueness < 1:
            return
        sighting = self._sighting(match)
        if sighting is not None:
            self._use(sighting, stamp_ns)
            self._choose_origin()

    def at_exposure(self) -> PlaceFix | None:
        """The position at the exposure of the last match that agreed; None while the vehicle is lost."""
        exposure = self._exposure
        return exposure if exposure is None else replace(exposure, disputed=self._is_disputed)

    @property
    def _is_disputed(self) -> bool:
        return self._rival is not None and self._rival.matches >= RIVAL_MATCHES

    def at(self, stamp_ns: int, displacement: Displacement | None) -> PlaceFix | None:
        """The position at another moment, moved on by the autopilot's velocity; None while that is not known."""
        track, before = self._track, self._at
        if track is None or before is None or displacement is None or displacement.leg != before.leg:
            return None
        since_m = _vector(displacement) - _vector(before)
        driven_m = float(np.hypot(*since_m))
        if self._is_lost(track, stamp_ns, driven_m):
            return None
        estimate = track.estimate.copy()
        estimate.predict(since_m)
        return self._fix(track, estimate, stamp_ns, track.since_m + driven_m)

    def _is_lost(self, track: _Track, stamp_ns: int, driven_m: float) -> bool:
        is_silent = not 0 <= stamp_ns - track.stamp_ns <= self._config.lost_after_s * 1e9
        return is_silent or track.since_m + driven_m > self._config.lost_after_m

    def _move(self, displacement: Displacement, missed: int) -> None:
        now_m = _vector(displacement)
        self._readings.add(now_m, missed)
        for track in (self._track, self._rival):
            if track is not None and self._at is not None:
                track.move(now_m - _vector(self._at))
        self._at = displacement

    def _use(self, sighting: _Sighting, stamp_ns: int) -> None:
        track = self._track
        if track is None:
            track = self._track = self._begin(sighting, stamp_ns)
        elif track.agrees(sighting):
            track.add(sighting, self._rig.sigma_across_m, stamp_ns)
            self._rival = None
        else:
            track = self._dispute(sighting, stamp_ns)
        if track is not None:
            self._exposure = self._fix(track, track.estimate, stamp_ns, 0.0)

    def _dispute(self, sighting: _Sighting, stamp_ns: int) -> _Track | None:
        """A match that disagrees with the estimate; returns the one that replaces it, if it is time for that."""
        rival = self._rival
        if rival is None or not rival.agrees(sighting):
            self._rival = self._begin(sighting, stamp_ns)
            return None
        rival.add(sighting, self._rig.sigma_across_m, stamp_ns)
        if rival.driven_m < CORRELATION_M:
            return None
        self._track, self._rival = rival, None
        return rival

    def _begin(self, sighting: _Sighting, stamp_ns: int) -> _Track:
        config = self._config
        errors = VelocityErrors(
            math.radians(config.heading_error_deg),
            config.drift_percent / 100,
            sighting.match_sigma_m,
        )
        estimate = RouteEstimate(sighting.place_m, sighting.along, self._rig.sigma_across_m, errors)
        estimate.predict(sighting.since_m)
        track = _Track(estimate, sighting, stamp_ns)
        track.add(sighting, self._rig.sigma_across_m, stamp_ns)
        return track

    def _sighting(self, match: PlaceMatch) -> _Sighting | None:
        """The match in local meters; None where the map has no positions, or if the line did not move as we did."""
        line = line_middle(match, self._route, self._length)
        if line is None or len(self._readings) < self._length:
            return None
        sign = 1 if match.direction == "forward" else -1
        ahead_m = self._rig.ahead_m(match.direction, match.order)
        at_m = [along_m - sign * ahead_m for along_m in (line.begins_m, line.along_m, line.ends_m)]
        found = [self._position(match, along_m) for along_m in at_m]
        begin, middle, end = found
        if begin is None or middle is None or end is None or middle.heading_deg is None:
            return None
        place_m, now_m = self._local(middle), self._readings.back(0)
        moved_m = now_m - self._readings.back(2 * line.back)
        if not self._moved_alike(self._local(end) - self._local(begin), moved_m):
            return None
        return self._seen(match, line, middle.heading_deg, place_m, now_m - self._readings.back(line.back), at_m[1])

    def _seen(
        self, match: PlaceMatch, line: LineMiddle, heading_deg: float, place_m: Vector, since_m: Vector, middle_m: float
    ) -> _Sighting:
        heading_rad = math.radians(heading_deg)
        along = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        reverse = match.direction == "reverse"
        left_m = self._rig.left_reverse_m if reverse else self._rig.left_forward_m
        place_m = place_m + left_m * np.array([-along[1], along[0]])
        along_m = middle_m + (-1 if reverse else 1) * float(np.hypot(*since_m))
        match_sigma_m = self._rig.sigma_m(match.direction, match.order)
        return _Sighting(match, line.segment, place_m, along, since_m, along_m, line.sigma_m, match_sigma_m)

    def _moved_alike(self, line_m: Vector, moved_m: Vector) -> bool:
        """Whether a line passed over the ground as the vehicle moved, by the autopilot's velocity."""
        if self._track is None:
            return moved_alike(line_m, moved_m, 2 * self._config.drift_percent / 100)
        estimate = self._track.estimate
        return moved_alike(line_m, estimate.truly(moved_m), 2 * estimate.scale_sigma)

    def _position(self, match: PlaceMatch, along_m: float) -> Position | None:
        offset_m = along_m - self._route.route_m(match.place_index)
        return position_on_route(self._route, match.place_index, offset_m, match.direction)

    def _local(self, position: Position) -> Vector:
        if self._origin is None:
            self._origin = position.lat_deg, position.lon_deg
        return np.array(east_north_of(position.lat_deg, position.lon_deg, self._origin))

    def _choose_origin(self) -> None:
        """A new origin for local meters where the last one is far away."""
        track = self._track
        if track is None or self._origin is None or float(np.hypot(*track.estimate.position_m)) < FAR_M:
            return
        shift_m = track.estimate.position_m.copy()
        self._origin = moved(*self._origin, float(shift_m[0]), float(shift_m[1]))
        for one in (self._track, self._rival):
            if one is not None:
                one.estimate.mean[:2] -= shift_m

    def _fix(self, track: _Track, estimate: RouteEstimate, stamp_ns: int, since_m: float) -> PlaceFix | None:
        newest, match = track.newest, track.newest.match
        sign = 1 if match.direction == "forward" else -1
        found = self._position(match, newest.along_m + sign * since_m)
        if found is None or found.heading_deg is None or self._origin is None:
            return None
        lat_deg, lon_deg = moved(*self._origin, float(estimate.position_m[0]), float(estimate.position_m[1]))
        heading_rad = math.radians(found.heading_deg)
        along = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        covariance = estimate.covariance[:2, :2] + FLOOR_M**2 * np.eye(2)
        along_var = float(along @ covariance @ along)
        return PlaceFix(
            stamp_ns=stamp_ns,
            place=match.place,
            # To a tenth of a millimeter, so that the last digits of a matrix product on this computer do not matter.
            lat_deg=round(lat_deg, 9),
            lon_deg=round(lon_deg, 9),
            heading_deg=found.heading_deg,
            sigma_along_m=round(math.sqrt(along_var), 2),
            sigma_across_m=round(math.sqrt(float(np.trace(covariance)) - along_var), 2),
            direction=match.direction,
            order=match.order,
            uniqueness=round(match.uniqueness, 4),
            category=match.category or "",
            matches=track.matches,
            segment=newest.segment,
            confidence=round(match.confidence, 3),
            velocity_error=round(estimate.velocity_error, 4),
            disputed=self._is_disputed,
            map=UNSET if match.map is None else match.map,
        )


def _vector(displacement: Displacement) -> Vector:
    return np.array([displacement.east_m, displacement.north_m])
