"""From matches to a position that follows the vehicle along the map's drive. Pure: no link, no clock.

Each accepted match says where on the drive the vehicle is; the odometer says how far it has come since. The difference
of the two, the offset, is constant while the vehicle stays on the drive, so matches in a row can be held against each
other, averaged, and moved on between frames:

    along the drive = offset + metres driven (forward), offset - metres driven (reverse)
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from edge.config import RigConfig, TrackingConfig
from edge.geodesy import moved_left
from edge.localization.line_refinement import LineRefinement
from edge.reference_map import Route
from edge.sequence import Direction, PlaceMatch

AGREE_SIGMAS = 3.0
TAKEN_OVER_BY = 3
"""So many matches in a row that agree with each other but not with the track begin a new one."""


@dataclass(frozen=True)
class TrackedPosition:
    """Where the vehicle was at `stamp_ns`: degrees (WGS 84), heading of travel clockwise from north.

    place_index: the last place that was recognized, counted through all maps. heading_deg: None where it is not known.
    sigma_along_m, sigma_across_m: one standard deviation along and across the drive. matches: how many in a row agree.
    """

    stamp_ns: int
    place_index: int
    direction: Direction
    lat_deg: float
    lon_deg: float
    heading_deg: float | None
    sigma_along_m: float
    sigma_across_m: float
    matches: int


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
        """Of the mean. Errors of neighbouring matches are alike, so that averaging is not taken to reduce them."""
        return math.hypot(float(np.mean(self.sigmas_m)), float(np.std(self.offsets_m)))

    def agrees(self, other: _Track, drifted_m: float) -> bool:
        if (self.segment, self.direction) != (other.segment, other.direction):
            return False
        allowed_m = AGREE_SIGMAS * max(self.sigma_m, other.sigma_m) + drifted_m
        return abs(other.offset_m - self.offset_m) <= allowed_m

    def take_in(self, other: _Track) -> None:
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
        self._matched: tuple[int, float, int] = (0, 0.0, 0)  # of the last match that agreed: when, odometer, place

    def see(self, match: PlaceMatch | None, stamp_ns: int, driven_m: float | None, missed: int = 0) -> None:
        """Take in the answer to one used frame; driven_m is the odometer at its exposure, None where nobody tells.

        Without an odometer the line's own slope tells how far the vehicle has come. missed: as `observe` was told.
        """
        if not self._ends.move(match, driven_m, missed):
            self.forget()
        self._lose_if_due(stamp_ns)
        if match is None or not match.accepted:
            return
        sighting = self._sighting(match)
        if sighting is None:
            return
        if self._track is None:
            self._follow(sighting, stamp_ns, match.place_index)
        elif self._track.agrees(
            sighting, self._config.drift_percent / 100 * (self._ends.odometer_m - self._matched[1])
        ):
            self._track.take_in(sighting)
            self._rival = None
            self._matched = stamp_ns, self._ends.odometer_m, match.place_index
        else:
            self._dispute(sighting, stamp_ns, match.place_index)

    def forget(self) -> None:
        """Nothing that was seen so far counts any more (after a blindness)."""
        self._track = self._rival = None

    def at_exposure(self) -> TrackedPosition | None:
        """The position at the last match's exposure; None while the vehicle is lost."""
        stamp_ns, odometer_m, _ = self._matched
        return self._position(stamp_ns, odometer_m, 0.0)

    def at(self, stamp_ns: int, driven_m: float | None) -> TrackedPosition | None:
        """The position at another moment, moved on by what has been driven since; None while that is not known."""
        odometer_m = self._ends.odometer_at(driven_m)
        if odometer_m is None:
            return None
        self._lose_if_due(stamp_ns)
        carried_m = odometer_m - self._matched[1]
        return self._position(stamp_ns, odometer_m, carried_m) if carried_m <= self._config.lost_after_m else None

    def _lose_if_due(self, stamp_ns: int) -> None:
        matched_ns, odometer_m, _ = self._matched
        silent = not 0 <= stamp_ns - matched_ns <= self._config.lost_after_s * 1e9
        if silent or self._ends.odometer_m - odometer_m > self._config.lost_after_m:
            self._track = None

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

    def _follow(self, track: _Track, stamp_ns: int, place: int) -> None:
        self._track, self._rival = track, None
        self._matched = stamp_ns, self._ends.odometer_m, place

    def _dispute(self, sighting: _Track, stamp_ns: int, place: int) -> None:
        """A match that disagrees with the track: an error, unless more of its kind follow."""
        if self._rival is not None and self._rival.agrees(sighting, 0.0):
            self._rival.take_in(sighting)
        else:
            self._rival = sighting
        if self._rival.matches >= TAKEN_OVER_BY:
            self._follow(self._rival, stamp_ns, place)

    def _position(self, stamp_ns: int, odometer_m: float, carried_m: float) -> TrackedPosition | None:
        track = self._track
        if track is None:
            return None
        place = self._matched[2]
        along_m = track.offset_m + track.sign * odometer_m
        found = self._route.position(place, along_m - self._route.route_m(place))
        if found is None or not self._route.reaches(place, along_m):
            return None
        reverse = track.direction == "reverse"
        heading_deg = None if found.heading_deg is None else (found.heading_deg + 180 * reverse) % 360
        lat_deg, lon_deg = found.lat_deg, found.lon_deg
        if heading_deg is not None:
            left_m = self._rig.left_reverse_m if reverse else self._rig.left_forward_m
            lat_deg, lon_deg = moved_left(lat_deg, lon_deg, heading_deg, left_m)
        return TrackedPosition(
            stamp_ns,
            place,
            track.direction,
            lat_deg,
            lon_deg,
            heading_deg,
            math.hypot(track.sigma_m, self._config.drift_percent / 100 * carried_m),
            self._rig.sigma_across_m,
            track.matches,
        )
