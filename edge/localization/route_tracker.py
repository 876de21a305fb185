"""From matches to a position that follows the vehicle along the map's drive. Pure: no link, no clock.

Each accepted match says where on the drive the vehicle is; the odometer says how far it has come since. The difference
of the two, the offset, is constant while the vehicle stays on the drive, so matches in a row can be held against each
other, averaged, and moved on between frames:

    along the drive = offset + meters driven (forward), offset - meters driven (reverse)
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from msgspec import UNSET

from edge.config import RigConfig, TrackingConfig
from edge.geodesy import moved_left
from edge.journal.records import PlaceFix
from edge.localization.line_refinement import LineRefinement
from edge.localization.place_fix import position_on_route
from edge.reference_map import Position, Route
from edge.sequence import Direction, PlaceMatch

AGREE_SIGMAS = 3.0
RIVAL_MATCHES = 3
"""So many matches in a row that agree with each other but not with the track begin a new one."""


@dataclass(frozen=True)
class _Matched:
    """The last match that agreed with the track, its exposure, and the odometer's reading then."""

    match: PlaceMatch
    stamp_ns: int
    odometer_m: float


@dataclass
class _Track:
    """Matches that agree with each other: offset of the drive against the odometer, and deviation, of each."""

    segment: int
    direction: Direction
    offsets_m: deque[float]
    sigmas_m: deque[float] = field(default_factory=deque)
    matches: int = 0

    @property
    def sign(self) -> int:
        return 1 if self.direction == "forward" else -1

    @property
    def offset_m(self) -> float:
        return float(np.mean(self.offsets_m))

    @property
    def sigma_m(self) -> float:
        """Of the mean. Errors of neighboring matches are alike, so that averaging is not taken to reduce them."""
        return math.hypot(float(np.mean(self.sigmas_m)), float(np.std(self.offsets_m)))

    def agrees(self, other: _Track, drifted_m: float) -> bool:
        if (self.segment, self.direction) != (other.segment, other.direction):
            return False
        allowed_m = AGREE_SIGMAS * max(self.sigma_m, other.sigma_m) + drifted_m
        return abs(other.offset_m - self.offset_m) <= allowed_m

    def merge(self, other: _Track) -> None:
        self.offsets_m.extend(other.offsets_m)
        self.sigmas_m.extend(other.sigmas_m)
        self.matches += other.matches


class RouteTracker:
    """Follows the vehicle along the drives of a map."""

    def __init__(self, route: Route, tracking: TrackingConfig, rig: RigConfig, length: int) -> None:
        """length: frames in a sequence."""
        self._route = route
        self._ends = LineRefinement(route, length)
        self._config = tracking
        self._rig = rig
        self._track: _Track | None = None
        self._rival: _Track | None = None
        self._matched: _Matched | None = None
        self._newest: PlaceMatch | None = None  # that was accepted, whether it agreed or not

    def update(self, match: PlaceMatch | None, stamp_ns: int, driven_m: float | None, missed: int = 0) -> None:
        """Take in the answer to one used frame; driven_m is the odometer at its exposure, None where nobody tells.

        Without an odometer the line's own slope tells how far the vehicle has come. missed: as `observe` was told.
        """
        if not self._ends.move(match, driven_m, missed):
            self.reset()
        self._lose_if_due(stamp_ns)
        if match is None or not match.accepted:
            return
        self._newest = match
        sighting = self._sighting(match)
        if sighting is None:
            return
        matched = _Matched(match, stamp_ns, self._ends.odometer_m)
        if self._track is None:
            self._follow(sighting, matched)
        elif self._track.agrees(sighting, self._drift_m(self._ends.odometer_m)):
            self._track.merge(sighting)
            self._rival = None
            self._matched = matched
        else:
            self._dispute(sighting, matched)

    def reset(self) -> None:
        """Begin anew (after a blindness): nothing that was matched so far counts any more."""
        self._track = self._rival = None

    def at_exposure(self) -> PlaceFix | None:
        """The position at the last match's exposure; None while the vehicle is lost."""
        matched = self._matched
        return None if matched is None else self._fix(matched.stamp_ns, matched.odometer_m)

    def at(self, stamp_ns: int, driven_m: float | None) -> PlaceFix | None:
        """The position at another moment, moved on by what has been driven since; None while that is not known."""
        odometer_m = self._ends.odometer_at(driven_m)
        if odometer_m is None or self._matched is None:
            return None
        self._lose_if_due(stamp_ns)
        is_near = odometer_m - self._matched.odometer_m <= self._config.lost_after_m
        return self._fix(stamp_ns, odometer_m) if is_near else None

    def _lose_if_due(self, stamp_ns: int) -> None:
        matched = self._matched
        if matched is None:
            return
        is_silent = not 0 <= stamp_ns - matched.stamp_ns <= self._config.lost_after_s * 1e9
        if is_silent or self._ends.odometer_m - matched.odometer_m > self._config.lost_after_m:
            self._track = None

    def _drift_m(self, odometer_m: float) -> float:
        """What the odometer may be wrong by since the last match that agreed."""
        assert self._matched is not None
        return self._config.drift_percent / 100 * (odometer_m - self._matched.odometer_m)

    def _sighting(self, match: PlaceMatch) -> _Track | None:
        """A track of this one match."""
        end = self._ends.end_of(match)
        if end is None:
            return None
        sign = 1 if match.direction == "forward" else -1
        # What is seen lies ahead of the vehicle.
        along_m = end.along_m - sign * self._rig.ahead_m(match.direction, match.order)
        sigma_m = math.hypot(end.sigma_m, self._rig.sigma_m(match.direction, match.order))
        kept = self._config.matches
        offsets_m = deque([along_m - sign * self._ends.odometer_m], maxlen=kept)
        return _Track(end.segment, match.direction, offsets_m, deque([sigma_m], maxlen=kept), matches=1)

    def _follow(self, track: _Track, matched: _Matched) -> None:
        self._track, self._rival, self._matched = track, None, matched

    def _dispute(self, sighting: _Track, matched: _Matched) -> None:
        """A match that disagrees with the track: an error, unless more of its kind follow."""
        if self._rival is not None and self._rival.agrees(sighting, 0.0):
            self._rival.merge(sighting)
        else:
            self._rival = sighting
        if self._rival.matches >= RIVAL_MATCHES:
            self._follow(self._rival, matched)

    def _fix(self, stamp_ns: int, odometer_m: float) -> PlaceFix | None:
        track, matched, newest = self._track, self._matched, self._newest
        if track is None or matched is None or newest is None:
            return None
        place_index = matched.match.place_index
        along_m = track.offset_m + track.sign * odometer_m
        offset_m = along_m - self._route.route_m(place_index)
        found = position_on_route(self._route, place_index, offset_m, track.direction)
        if found is None or not self._route.reaches(place_index, along_m):
            return None
        lat_deg, lon_deg = self._to_the_left(found, track.direction)
        return PlaceFix(
            stamp_ns=stamp_ns,
            place=matched.match.place,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            heading_deg=found.heading_deg,
            sigma_along_m=round(math.hypot(track.sigma_m, self._drift_m(odometer_m)), 2),
            sigma_across_m=self._rig.sigma_across_m,
            direction=track.direction,
            order=newest.order,
            uniqueness=round(newest.uniqueness, 4),
            category=newest.category or "",
            matches=track.matches,
            map=UNSET if matched.match.map is None else matched.match.map,
        )

    def _to_the_left(self, position: Position, direction: Direction) -> tuple[float, float]:
        """Latitude and longitude moved by the rig's offset to the left, seen in the direction of travel."""
        if position.heading_deg is None:
            return position.lat_deg, position.lon_deg
        left_m = self._rig.left_reverse_m if direction == "reverse" else self._rig.left_forward_m
        return moved_left(position.lat_deg, position.lon_deg, position.heading_deg, left_m)
