"""From matches to a position that follows the vehicle on the ground. Pure: no link, no clock.

A believed match says how far along the map's drive the vehicle is. How far it is beside it, a look says; else the
road's width is all that is known. Between matches the vehicle moves as the autopilot's velocity says, whose heading and
scale are wrong by a little; `RouteEstimate` finds by how much. While GPS bounds the autopilot's position, it bounds the
estimate as well, so that the first matches without it correct a position that is known. A match is used only if its
line leads the way that the vehicle went, and if it agrees with the estimate, whose positions are disputed where several
in a row do not. An estimate that is lost, since no match agreed with it for [tracking] lost_after_m, goes on by
reckoning alone, and the next one begins where it is if it agrees with the match. If it does not, the positions of the
next one are disputed for a correlation length.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from edge.config import Config
from edge.geodesy import VehiclePosition, moved
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Displacement
from edge.localization.look import FIRST, OUTVOTES, SAME_PLACE_M, Look, RecentLooks, Vector
from edge.localization.odometer import Scale
from edge.localization.place_fix import LEAST_SHARPNESS, map_error_m
from edge.localization.route_estimate import MatchErrors, RouteEstimate, VelocityErrors, left_of
from edge.localization.sighting import KNOWN_SCALE, Sighting, Sightings
from edge.localization.track import ReckonedTrack, Track
from edge.sequence import PlaceMatch

STOOD_NS = 10_000_000_000
"""A vehicle without a new frame for so long may have been carried away: no line may have a frame from before that.
Without it, vehicles that reversed for long or were ferried were up to 5 and 501 standard deviations off. After 30 s
instead, one that was towed 100 m in 12 s was sent positions 102 m off."""
FAR_M = 1000.0
"""Distance from the origin of local meters at which a new origin is chosen."""
LOOKED_NS = 1_000_000_000
"""After a look, in which a position that is moved on still counts as what it showed."""
GOES_M = 0.3
"""Meters driven from which on a displacement since the newest frame shows where the vehicle goes."""
USUAL = 0.03
"""One standard deviation of the scale of wheels that GPS does not contradict: those of recorded drives are 0.3 to 3 %
wrong, and of 50 m GPS shows it to 3 %. At dusk four recorded drives are 7.0 / 14.1 / 15.4 m off (median, 95 %, most),
and 7.3 / 14.8 / 17.3 with 6 % in place of it and what was shown lost within 700 m."""
UNEXPECTED_SIGMAS = 2.0
"""How far a match may be from where it is expected, before the velocity's scale is not what GPS has shown any more; and
how far GPS may be from what wheels usually are."""
DISAGREE = 3
"""Matches in a row that disagree with the estimate before its positions are disputed: one false match is none."""


class RouteFilter:
    """Follows the vehicle over the ground along the drives of a map."""

    def __init__(self, sightings: Sightings, config: Config) -> None:
        self._config, self._rig = config.tracking, config.rig
        self._is_bound = self._is_shown = False  # by GPS: the position, and the scale of the velocity without it
        self._shown = Scale(0.0, self._config.scale_error_percent / 100)
        self._sightings = sightings
        self.reset()

    def reset(self) -> None:
        """Begin anew (after a blindness, or where the motion is not known): nothing that was matched so far counts."""
        self._sightings.clear()
        self._looks = RecentLooks()
        self._at: Displacement | None = None
        self._bridged_m = 0.0  # the most by which a speed that was bridged may have moved it wrongly by then
        self._course_rad: float | None = None  # in which the vehicle reckoned to go then
        self._last_ns = 0
        self._exposure: PlaceFix | None = None
        self._track: Track | None = None
        self._since_gps: ReckonedTrack | None = None
        self._since_lost: ReckonedTrack | None = None
        """Where the vehicle is by reckoning alone, since GPS, and since the last track that was lost."""

    def bind(self, position: VehiclePosition, sigma_m: float) -> None:
        """The autopilot's position is bounded by GPS: the newest frame was there, to one standard deviation."""
        self._is_bound = True
        if self._at is None:
            return
        apart_s = (self._last_ns - position.stamp_ns) / 1e9
        moved_m = apart_s * np.array([position.east_mps, position.north_mps])
        position_m = self._sightings.local(position) + moved_m
        if self._since_gps is None:
            errors = self._velocity_errors(MatchErrors(self._rig.sigma_along_m))
            self._since_gps = ReckonedTrack(RouteEstimate(position_m, sigma_m**2 * np.eye(2), errors))
        for estimate in self._estimates():
            estimate.bound(position_m, sigma_m)
        for one in self._reckoned:
            one.aside = None
        self._choose_origin()

    def lose_gps(self, shown: Scale | None) -> None:
        """GPS is lost. shown: what it has shown of the velocity that counts from now on."""
        if self._is_bound and shown is not None:
            assumed = self._config.scale_error_percent / 100
            usual = min(USUAL, assumed)
            is_usual = abs(shown.mean) <= UNEXPECTED_SIGMAS * math.hypot(usual, shown.sigma)
            self._shown = Scale(0.0, usual if is_usual else assumed).and_also(shown)
            self._is_shown = self._shown.later < assumed
            for estimate in self._estimates() if self._is_shown else []:
                estimate.expect(self._shown)
        self._is_bound = False

    @property
    def velocity_errors(self) -> tuple[float, float] | None:
        """See `RouteEstimate`; None where GPS has shown nothing of them, or does not any more."""
        estimates = self._estimates() if self._is_shown and not self._is_bound else []
        return estimates[0].velocity_errors if estimates else None

    def _doubt_scale(self) -> None:
        """The velocity's scale is not what GPS has shown."""
        if self._is_shown:
            self._is_shown = False
            for estimate in self._estimates():
                estimate.doubt_scale()

    def _contradicts_scale(self, sighting: Sighting, stamp_ns: int) -> bool:
        """Whether a match is not where it is expected, and would be if GPS had shown nothing of the scale."""
        track = self._track
        for estimate in self._estimates() if track is None else [track.estimate]:
            doubted = estimate.copy()
            doubted.doubt_scale()
            newest = sighting if track is None else track.newest
            off, off_then = (abs(Track(one, newest, stamp_ns).innovation(sighting)) for one in (estimate, doubted))
            if off > UNEXPECTED_SIGMAS >= off_then:
                return True
        return False

    @property
    def heading_error(self) -> tuple[float, float] | None:
        """Radians by which the vehicle heads further clockwise than its displacement says, and one standard deviation.

        None where no look has shown it lately.
        """
        track = self._track
        return track.estimate.heading_error if track is not None and track.is_looked else None

    def reject_gps(self) -> None:
        """GPS was wrong when it bounded the estimates: only places count from now on."""
        self._is_shown = False
        self._exposure = self._track = self._since_gps = self._since_lost = None

    def _estimates(self) -> list[RouteEstimate]:
        return [one.estimate for one in (self._track, *self._reckoned) if one is not None]

    @property
    def _reckoned(self) -> list[ReckonedTrack]:
        return [one for one in (self._since_lost, self._since_gps) if one is not None]

    def update(
        self,
        match: PlaceMatch | None,
        looked: Sighting | None,
        stamp_ns: int,
        displacement: Displacement | None,
        missed: int = 0,
        *,
        in_line: bool = True,
        undated_m: float = 0.0,
    ) -> None:
        """Use the answer to one frame; displacement: by the autopilot's velocity at its exposure, None where unknown.

        looked: what its picture says. missed: as `observe` got it. undated_m: see `Sighting`. in_line: whether a line
        may lead through the frame. Four that counted though none did, beside gaps of 8 to 15 m, put lines 12 m off.
        Without a displacement there is no position.
        """
        if displacement is None or (self._at is not None and displacement.leg != self._at.leg):
            self.reset()
        if displacement is None:
            return
        if stamp_ns - self._last_ns > STOOD_NS or missed > self._sightings.length // 2:
            self._sightings.clear()
        self._last_ns = stamp_ns
        self._move(displacement)
        if in_line:
            self._sightings.add(_vector(displacement))
        course = self._sightings.course(_vector(displacement))
        self._course_rad = course and course[0]
        track = self._track
        if track is not None and self._is_lost(track, stamp_ns, 0.0):
            self._track, self._exposure = None, None
            if track.is_confirmed and self.aside is None:
                self._since_lost = ReckonedTrack(track.estimate)
        if match is None or not match.accepted:
            return
        looked = looked and looked.on_course(course)
        sighting = self._sighting(match, looked, _vector(displacement), undated_m)
        if sighting is not None:
            self._use(sighting, stamp_ns)
            self._choose_origin()

    def _sighting(
        self, match: PlaceMatch, looked: Sighting | None, displacement_m: Vector, undated_m: float
    ) -> Sighting | None:
        """What a match says of where the vehicle is: by one look, or else by its line."""
        track = self._track
        if looked is not None and looked.look is not None:
            self._looks.add(looked.look, displacement_m)
            if (track is not None and track.is_looked) or self._agree(looked.look) >= FIRST:
                return looked
        # Where another place fits this frame better, the votes know the place, but no line says where it ends.
        if match.uniqueness < 1 or match.sharpness < LEAST_SHARPNESS:
            return None
        return self._sightings.of(match, undated_m)

    @property
    def aside(self) -> tuple[float, float] | None:
        """See `ReckonedTrack`."""
        return next((one.aside for one in self._reckoned if one.aside is not None), None)

    def at_exposure(self) -> PlaceFix | None:
        """The position at the exposure of the last match that agreed; None while the vehicle is lost."""
        exposure = self._exposure
        return exposure if exposure is None else replace(exposure, disputed=self._is_disputed)

    @property
    def _is_disputed(self) -> bool:
        """Whether reckoning or matches disagree with the estimate."""
        track = self._track
        if track is None:
            return False
        return not track.is_confirmed or track.disagreeing >= DISAGREE

    def at(self, stamp_ns: int, displacement: Displacement | None) -> PlaceFix | None:
        """The position at another moment, moved on by the autopilot's velocity; None while that is not known."""
        track, before = self._track, self._at
        if track is None or before is None or displacement is None or displacement.leg != before.leg:
            return None
        since_m = _vector(displacement) - _vector(before)
        driven_m = float(np.hypot(*since_m[:2]))
        if self._is_lost(track, stamp_ns, driven_m):
            return None
        estimate = track.estimate.copy()
        estimate.predict(since_m, self._bridged_m2(displacement.unknown_since(before)))
        course_rad = math.atan2(since_m[0], since_m[1]) if driven_m >= GOES_M else self._course_rad
        return self._fix(track, estimate, stamp_ns, track.since_m + driven_m, course_rad)

    def _is_lost(self, track: Track, stamp_ns: int, driven_m: float) -> bool:
        is_silent = not 0 <= stamp_ns - track.stamp_ns <= self._config.lost_after_s * 1e9
        return is_silent or track.since_m + driven_m > self._config.lost_after_m

    def _move(self, displacement: Displacement) -> None:
        now_m = _vector(displacement)
        if self._at is not None:
            moved_m, unknown_m = now_m - _vector(self._at), displacement.unknown_since(self._at)
            bridged_m2 = self._bridged_m2(unknown_m)
            self._bridged_m = self._bridged_m + unknown_m if unknown_m > 0 else 0.0
            if self._track is not None:
                self._track.move(moved_m, bridged_m2)
            for one in self._reckoned:
                one.estimate.predict(moved_m, bridged_m2)
            if moved_m[2:].any():  # wheels that spin or lock
                self._doubt_scale()
        self._at = displacement

    def _bridged_m2(self, unknown_m: float) -> float:
        """What meters by a speed that was bridged add to the variance: from first to last it is off in one way."""
        return ((self._bridged_m + unknown_m) ** 2 - self._bridged_m**2) / 3

    def _agree(self, look: Look) -> int:
        return self._looks.agree(look.position_m, look.covariance, self._config.scale_error_percent / 100)

    def _is_outvoted(self, track: Track, look: Look) -> bool:
        """Whether the looks of late are rather where the newest is than where the vehicle is estimated."""
        position_m, covariance = track.estimate.position_m, track.estimate.covariance[:2, :2]
        agree = self._looks.agree(position_m, covariance, self._config.scale_error_percent / 100)
        return track.away_m(look) <= SAME_PLACE_M and self._agree(look) >= max(OUTVOTES, agree + 1)

    def _use(self, sighting: Sighting, stamp_ns: int) -> None:
        if self._is_shown and self._contradicts_scale(sighting, stamp_ns):
            self._doubt_scale()
        for one in self._reckoned:
            one.compare_across(sighting, sighting.across_sigma_m(self._rig.sigma_across_m))
        track, look = self._track, sighting.look
        if track is None:
            track = self._track = self._begin(sighting, stamp_ns)
        elif track.agrees(sighting, self._rig.sigma_across_m):
            track.add(sighting, self._rig.sigma_across_m, stamp_ns)
        elif look is not None and self._is_outvoted(track, look):
            track.begin_at_look(sighting, look, stamp_ns)
        else:
            track.disagreeing += 1
            return
        self._exposure = self._fix(track, track.estimate, stamp_ns, 0.0, self._course_rad)

    def _begin(self, sighting: Sighting, stamp_ns: int) -> Track:
        road_sigma_m = self._rig.sigma_across_m
        errors = self._velocity_errors(sighting.errors)
        estimate = RouteEstimate.on_road(sighting.passed, road_sigma_m, errors)
        if self._is_shown and not self._reckoned:  # else what is reckoned has it, and it may be wrong by that
            estimate.expect(self._shown)
        tracks = [Track(one.estimate.copy(), sighting, stamp_ns) for one in self._reckoned]
        for one in tracks:
            one.estimate.begin_drive(sighting.errors)
        known = next((one for one in tracks if one.agrees(sighting, road_sigma_m)), None)
        track = known or Track(estimate, sighting, stamp_ns)
        if tracks:
            track.by_chance = track.agrees_by_chance(sighting) if track is tracks[0] else math.inf
        if known is None and sighting.look is not None:
            track.begin_at_look(sighting, sighting.look, stamp_ns)
        else:
            track.add(sighting, road_sigma_m, stamp_ns)
        return track

    def _velocity_errors(self, match: MatchErrors) -> VelocityErrors:
        config = self._config
        return VelocityErrors(math.radians(config.heading_error_deg), config.scale_error_percent / 100, match)

    def _choose_origin(self) -> None:
        """A new origin for local meters where the last one is far away."""
        estimates, origin = self._estimates(), self._sightings.origin
        if origin is None or not estimates or float(np.hypot(*estimates[0].position_m)) < FAR_M:
            return
        shift_m = estimates[0].position_m.copy()
        self._sightings.origin = moved(*origin, float(shift_m[0]), float(shift_m[1]))
        for estimate in estimates:
            estimate.mean[:2] -= shift_m
        self._looks.clear()

    def _fix(
        self, track: Track, estimate: RouteEstimate, stamp_ns: int, since_m: float, course_rad: float | None
    ) -> PlaceFix | None:
        newest, match = track.newest, track.newest.match
        sign = 1 if match.direction == "forward" else -1
        found = self._sightings.position(match, newest.along_m + sign * since_m)
        origin = self._sightings.origin
        if found is None or found.heading_deg is None or origin is None:
            return None
        lat_deg, lon_deg = moved(*origin, float(estimate.position_m[0]), float(estimate.position_m[1]))
        heading_rad = math.radians(found.heading_deg)
        if track.is_looked and course_rad is not None:
            heading_rad = course_rad + estimate.turned_rad + math.pi * track.goes_back
        along = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        covariance = estimate.covariance[:2, :2].copy()
        # No number of a drive's own places shows by how much all of them are off.
        for direction, whole_m in zip((along, left_of(along)), newest.whole_sigma_m, strict=True):
            lacks = max(0.0, whole_m**2 - float(direction @ covariance @ direction))
            covariance += lacks * np.outer(direction, direction)
        covariance += map_error_m(found) ** 2 * np.eye(2)
        covariance += (_line_variance(estimate, newest) + newest.undated_m**2) * np.outer(along, along)
        along_var = float(along @ covariance @ along)
        return PlaceFix(
            stamp_ns=stamp_ns,
            place=match.place,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            heading_deg=math.degrees(heading_rad) % 360,
            sigma_along_m=math.sqrt(along_var),
            sigma_across_m=math.sqrt(float(np.trace(covariance)) - along_var),
            direction=match.direction,
            order=match.order,
            uniqueness=match.uniqueness,
            matches=track.matches,
            segment=newest.segment,
            recording=newest.recording,
            checked_m=newest.checked_m or UNSET,
            confidence=match.confidence,
            velocity_error=estimate.velocity_error,
            disputed=self._is_disputed,
            by_lane=not estimate.is_measured,
            points=(track.points or UNSET) if stamp_ns - track.stamp_ns < LOOKED_NS else UNSET,
            map=UNSET if match.map is None else match.map,
        )


def _line_variance(estimate: RouteEstimate, sighting: Sighting) -> float:
    """Square meters along the road that the covariance lacks: an odometer that is wrong moves a line's middle as well.

    The displacement since the middle is in the covariance; half of the line, which is as long, has the same error.
    """
    scale_variance = max(0.0, estimate.scale.sigma**2 - KNOWN_SCALE**2)
    since_m = sighting.passed.since_m[:2]
    return (2**2 - 1**2) * scale_variance * float(since_m @ since_m)


def _vector(displacement: Displacement) -> Vector:
    doubtful_m = displacement.doubtful_east_m, displacement.doubtful_north_m
    return np.array([displacement.east_m, displacement.north_m, *doubtful_m])
