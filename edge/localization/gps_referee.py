"""Whether GPS agrees with the places that are recognized: a sequential test. Pure: no link, no clock.

Two hypotheses explain the difference between GPS and a recognized place (a `Comparison`):

    honest   the usual errors of GPS, map and match, and bursts of multipath
    wrong    GPS is anywhere else, at one of the scales OFFSETS_M, or anywhere on Earth

    score(now) = log(wrong / honest) + max(0, score one correlation length ago)

is Page's CUSUM over sightings that are CORRELATION_M apart. GPS is called wrong at log((1 - missed) / false_call), and
agrees when the same sum, with min in the place of max, falls to log(missed / (1 - false_call)): Wald's boundaries.
docs/integrity.md has the derivation.

A place may be another one, or a recording of the map may be shifted. So GPS is called wrong only on a track (places
that follow each other on the ground) that has agreed with GPS before; or where the places moved as the vehicle did by
its own velocity since GPS last agreed, or was lost unjudged, and GPS did not; or after SHIFT_SIGHTINGS on a recording
that has agreed within SAME_GROUND_M. Another offset that has been the same since the first sighting on a recording
counts as a fault of that recording, and is subtracted from then on.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north_of
from edge.localization.bound import Anchor
from edge.localization.dead_reckoning import Displacement
from edge.localization.route_estimate import CORRELATION_M

GpsVerdictState: TypeAlias = Literal["cannot say", "agrees", "doubtful", "wrong", "map shifted", "not recognized"]
OFFSETS_M = (20.0, 50.0, 300.0)
"""Scales of the offset of a wrong GPS: what first shows beside the errors of places, and what a spoofer ends with."""
ANYWHERE = 2e-15
"""Per square meter: anywhere on Earth. No honest offset is less likely than a thousandth of that."""
BURST_SHARE, BURST_M = 0.05, 5.0
"""Share of the sightings in a burst of multipath, and one standard deviation of it east and north: 10 m are two."""
DOUBTFUL = 3.0
"""Score (20 to 1) from which GPS is doubtful."""
NEWEST = 3
"""Of so many comparisons in a row the one counts that says least."""
SAME_M, SAME_SIGMAS, FASTEST, LONGEST_GAP_M = 20.0, 4.0, 1.6, 240.0
"""A track goes on if its place moved as the vehicle did by its own velocity, within SAME_M or SAME_SIGMAS of a match;
where that is not known, by at most as much and FASTEST times the spacing of the frames since. Up to LONGEST_GAP_M
without a place. Without the velocity, a false place 100 m after the last one had an honest GPS called wrong."""
SAME_GROUND_M = 500.0
"""From an agreeing place of a recording, up to which its other places are as right: as for positions (`claims`)."""
SHIFT_SIGHTINGS, SHIFT_CHI2 = 4, 2.0
"""Sightings in one recording, and mean square of their deviations in sigmas, from which an offset is constant."""
COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


@dataclass(frozen=True)
class Comparison:
    """GPS less place, at one exposure: meters along the road and to its left, with one standard deviation of each.

    recording: that the place comes from. lat_deg, lon_deg: where the match says that the vehicle is. spacing_m: between
    places of the map, of which a frame passes about one. heading_rad: of travel. off_*_m: None without GPS.
    match_sigma_m: the match's own part of along_sigma_m. displacement: by the vehicle's own velocity, None if unknown.
    """

    recording: str
    lat_deg: float
    lon_deg: float
    spacing_m: float
    heading_rad: float
    off_along_m: float | None
    off_left_m: float | None
    along_sigma_m: float
    left_sigma_m: float
    match_sigma_m: float
    displacement: Displacement | None = None

    @property
    def axes(self) -> NDArray[np.float64]:
        """Unit vectors, east and north, along the road and to its left: (2, 2)."""
        sin, cos = math.sin(self.heading_rad), math.cos(self.heading_rad)
        return np.array([[sin, cos], [-cos, sin]])


@dataclass(frozen=True)
class GpsVerdict:
    """What the places say of GPS now.

    east_m, north_m: GPS less places, by the newest sightings; None where there are none. doubt: evidence that GPS is
    wrong, as a share of what it takes to call it so: 0 to 1, None where nothing is known.
    """

    state: GpsVerdictState = "cannot say"
    east_m: float | None = None
    north_m: float | None = None
    doubt: float | None = None

    @property
    def distance_m(self) -> float | None:
        """Length of the offset."""
        return None if self.east_m is None or self.north_m is None else math.hypot(self.east_m, self.north_m)

    @property
    def where(self) -> str:
        """The offset in words, "" where it is not known."""
        if self.east_m is None or self.north_m is None:
            return ""
        point = COMPASS[round(math.degrees(math.atan2(self.east_m, self.north_m)) / 45) % 8]
        return f"{math.hypot(self.east_m, self.north_m):.0f} m to the {point}"


@dataclass(frozen=True)
class _Sample:
    """A comparison, the meters of its track, the evidence in it, and the two sums; off_m: along, left, unshifted."""

    comparison: Comparison
    at_m: float
    evidence: float
    high: float
    low: float


@dataclass
class _Track:
    """Places that follow each other, and their comparisons; at_m: meters, by the number of frames."""

    newest: Comparison
    samples: deque[_Sample] = field(default_factory=lambda: deque(maxlen=512))
    at_m: float = 0.0
    gap_m: float = 0.0
    has_agreed: bool = False

    def goes_on_at(self, comparison: Comparison) -> bool:
        """Whether a vehicle on this track may be there now."""
        before, moved_m = self.newest, _between(self.newest, comparison)
        most_m = max(SAME_M, SAME_SIGMAS * comparison.match_sigma_m)
        now, then = comparison.displacement, before.displacement
        if now is None or then is None:
            return math.hypot(*moved_m) <= most_m + FASTEST * self.gap_m
        return math.dist(moved_m, now.since(then)) <= most_m + now.unknown_since(then)

    @property
    def independent(self) -> list[Comparison]:
        """Comparisons a correlation length apart, the newest first."""
        found: list[_Sample] = []
        for sample in reversed(self.samples):
            if not found or found[-1].at_m - sample.at_m >= CORRELATION_M:
                found.append(sample)
        return [sample.comparison for sample in found]


def evidence_of(comparison: Comparison, off_along_m: float, off_left_m: float) -> float:
    """Logarithm of how much more likely an offset is if GPS is wrong than if it is honest."""
    along, left = comparison.along_sigma_m, comparison.left_sigma_m
    honest = (1 - BURST_SHARE) * _normal(off_along_m, along) * _normal(off_left_m, left)
    honest += (
        BURST_SHARE * _normal(off_along_m, math.hypot(along, BURST_M)) * _normal(off_left_m, math.hypot(left, BURST_M))
    )
    wrong = sum(
        _normal(off_along_m, math.hypot(along, scale_m)) * _normal(off_left_m, math.hypot(left, scale_m))
        for scale_m in OFFSETS_M
    ) / len(OFFSETS_M)
    return math.log((wrong + ANYWHERE) / max(honest, ANYWHERE / 1000))


class GpsReferee:
    """Judges GPS by one comparison after another."""

    def __init__(self, false_call: float, missed: float, drift: float = 0.05) -> None:
        """Probabilities of calling an honest GPS wrong, and of finding that a wrong one agrees, at each sighting.

        drift: one standard deviation of the vehicle's own motion, as a share of the distance.
        """
        self._drift = drift
        self._call, self._agree = math.log((1 - missed) / false_call), math.log(missed / (1 - false_call))
        self._shifts_m: dict[str, NDArray[np.float64]] = {}
        self._agreed: dict[str, Comparison] = {}  # the newest of each recording
        self._last_agreed: Comparison | None = None
        self._track: _Track | None = None
        self._is_wrong = False
        self.verdict = GpsVerdict()

    def update(self, comparison: Comparison | None, missed: int = 0) -> GpsVerdict:
        """The verdict after one more used frame; None: its place is not known. missed: places passed before it."""
        track = self._track
        if track is not None:
            track.gap_m += (1 + missed) * track.newest.spacing_m
            if track.gap_m > LONGEST_GAP_M or (comparison is not None and not track.goes_on_at(comparison)):
                track = self._track = None
        if comparison is not None:
            track = self._track = track or _Track(comparison)
            track.at_m, track.gap_m, track.newest = track.at_m + track.gap_m, 0.0, comparison
            if comparison.off_along_m is not None:
                self._add(track, comparison)
                self.verdict = self._judged(track)
                return self.verdict
        if track is None or comparison is not None:
            self.verdict = GpsVerdict("wrong", doubt=1.0) if self._is_wrong else GpsVerdict()
        return self.verdict

    def keep_until_lost(self, anchor: Anchor) -> None:
        """GPS was lost there: if no place was compared with it before, it counts as right until then.

        Had it been wrong, places would contradict that as well as GPS that is back, and nothing would be called.
        """
        if self._last_agreed is None:
            lat_deg, lon_deg, sigma_m = anchor.lat_deg, anchor.lon_deg, anchor.sigma_m
            self._last_agreed = Comparison(
                "", lat_deg, lon_deg, 0.0, 0.0, 0.0, 0.0, sigma_m, sigma_m, sigma_m, anchor.displacement
            )

    def _add(self, track: _Track, comparison: Comparison) -> None:
        self._score(track, comparison, track.at_m)
        newest = track.samples[-1]
        if len(track.samples) < NEWEST:
            return
        if newest.low <= self._agree:
            track.has_agreed, self._is_wrong = True, False
            self._agreed[comparison.recording] = self._last_agreed = comparison
        elif newest.high >= self._call and self._may_be_called(track):
            self._is_wrong = True
        elif newest.high >= self._call and not self._is_wrong:
            self._find_shift(track)

    def _may_be_called(self, track: _Track) -> bool:
        newest = track.newest
        is_known = self._has_agreed_near(newest) and len(track.independent) >= SHIFT_SIGHTINGS
        return track.has_agreed or is_known or self._moved_without_gps(newest) >= DOUBTFUL

    def _has_agreed_near(self, comparison: Comparison) -> bool:
        agreed = self._agreed.get(comparison.recording)
        return agreed is not None and math.hypot(*_between(agreed, comparison)) <= SAME_GROUND_M

    def _moved_without_gps(self, comparison: Comparison) -> float:
        """Logarithm of how much more likely since GPS last agreed the places moved as the vehicle did than GPS."""
        before = self._last_agreed
        now, then = comparison.displacement, None if before is None else before.displacement
        if before is None or now is None or then is None:
            return -math.inf
        moved_m = np.array(now.since(then))
        places_off_m = _between(before, comparison) - moved_m
        gps_off_m = places_off_m + _offset(comparison) - _offset(before)
        drift_m = self._drift * float(np.hypot(*moved_m))
        unknown_m = now.unknown_sigma_since(then)
        variance = before.along_sigma_m**2 + comparison.along_sigma_m**2 + drift_m**2 + unknown_m**2
        return float(gps_off_m @ gps_off_m - places_off_m @ places_off_m) / (2 * variance)

    def _score(self, track: _Track, comparison: Comparison, at_m: float) -> None:
        off_along_m, off_left_m = comparison.axes @ (_offset(comparison) - self._shift(comparison))
        evidence = evidence_of(comparison, float(off_along_m), float(off_left_m))
        recent = [sample.evidence for sample in list(track.samples)[1 - NEWEST :]] + [evidence]
        before = next((one for one in reversed(track.samples) if at_m - one.at_m >= CORRELATION_M), None)
        # A sum far beyond a boundary would hide a change for long.
        high = min(min(recent) + max(0.0, before.high if before else 0.0), 2 * self._call)
        low = max(max(recent) + min(0.0, before.low if before else 0.0), 2 * self._agree)
        track.samples.append(_Sample(comparison, at_m, evidence, high, low))

    def _shift(self, comparison: Comparison) -> NDArray[np.float64]:
        return self._shifts_m.get(comparison.recording, np.zeros(2))

    def _judged(self, track: _Track) -> GpsVerdict:
        newest = track.samples[-1]
        recent = [sample.comparison for sample in list(track.samples)[-NEWEST:]]
        east_m, north_m = np.mean([_offset(one) - self._shift(one) for one in recent], axis=0)
        if newest.comparison.recording in self._shifts_m and not self._is_wrong:
            east_m, north_m = self._shift(newest.comparison)
        doubt = 1.0 if self._is_wrong else min(max(newest.high / self._call, 0.0), 1.0)
        return GpsVerdict(self._state(track), float(east_m), float(north_m), doubt)

    def _state(self, track: _Track) -> GpsVerdictState:
        newest = track.samples[-1]
        if self._is_wrong:
            return "wrong"
        if newest.high >= DOUBTFUL:
            return "doubtful"
        if newest.comparison.recording in self._shifts_m:
            return "map shifted"
        return "agrees" if track.has_agreed else "cannot say"

    def _find_shift(self, track: _Track) -> None:
        """Keep an offset that has been the same since a track began on one recording, and judge without it."""
        sightings, recording = track.independent, track.newest.recording
        is_one = all(one.recording == recording for one in sightings)
        is_known = recording in self._shifts_m or self._has_agreed_near(track.newest)
        if len(sightings) < SHIFT_SIGHTINGS or not is_one or is_known:
            return
        shift_m, chi2 = _fitted(sightings)
        if chi2 > SHIFT_CHI2:
            return
        self._shifts_m[recording] = shift_m
        samples = list(track.samples)
        track.samples.clear()
        for sample in samples:
            self._score(track, sample.comparison, sample.at_m)
        track.has_agreed = track.samples[-1].low <= self._agree


def _offset(comparison: Comparison) -> NDArray[np.float64]:
    """Meters east and north (2,)."""
    assert comparison.off_along_m is not None and comparison.off_left_m is not None
    offset: NDArray[np.float64] = np.array([comparison.off_along_m, comparison.off_left_m]) @ comparison.axes
    return offset


def _between(before: Comparison, after: Comparison) -> NDArray[np.float64]:
    """Meters east and north (2,) from one place to another."""
    return np.array(east_north_of(after.lat_deg, after.lon_deg, (before.lat_deg, before.lon_deg)))


def _fitted(sightings: list[Comparison]) -> tuple[NDArray[np.float64], float]:
    """The offset, east and north, that fits all sightings best, and their mean squared deviation from it in sigmas."""
    sigmas_m = np.array([(one.along_sigma_m, one.left_sigma_m) for one in sightings])
    rows = np.array([one.axes for one in sightings]) / sigmas_m[:, :, None]
    values = np.array([(one.off_along_m, one.off_left_m) for one in sightings]) / sigmas_m
    matrix, target = rows.reshape(-1, 2), values.reshape(-1)
    offset, *_ = np.linalg.lstsq(matrix, target, rcond=None)
    return offset, float(np.square(matrix @ offset - target).sum() / (len(target) - 2))


def _normal(value: float, sigma: float) -> float:
    return math.exp(-((value / sigma) ** 2) / 2) / (sigma * math.sqrt(math.tau))
