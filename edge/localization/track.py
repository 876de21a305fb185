"""A hypothesis of where the vehicle is: an estimate, and the matches that agreed. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from edge.localization.claims import SPREAD_M, STRETCH_WRONG
from edge.localization.look import HOLDS_M, LOOK_CHI2, Look, Vector
from edge.localization.route_estimate import AGREE_SIGMAS, CORRELATION_M, RouteEstimate
from edge.localization.sighting import Sighting

BY_CHANCE = STRETCH_WRONG  # probability of agreeing with reckoning by chance, up to which a first match is certain


@dataclass
class Track:
    """An estimate, the newest match that agreed with it, when, and what was driven in all and since that match.

    disagreeing: matches since then. confidence: the greatest of its matches. by_chance: see `agrees_by_chance`; 0 where
    nothing was reckoned, and endless where the first match was not where reckoning had the vehicle. points, goes_back:
    of the newest match, 0 where that is a line, and of the newest look.
    """

    estimate: RouteEstimate
    newest: Sighting
    stamp_ns: int
    matches: int = 0
    since_m: float = 0.0
    driven_m: float = 0.0
    disagreeing: int = 0
    confidence: float = 0.0
    by_chance: float = 0.0
    points: int = 0
    goes_back: bool = False

    @property
    def is_looked(self) -> bool:
        """Whether a look said within CORRELATION_M where the vehicle is, and heads."""
        return self.estimate.is_measured

    @property
    def is_confirmed(self) -> bool:
        """Whether reckoning makes its first match as certain as any stretch of a map is assumed to be, or matches have
        agreed with it for a correlation length.

        After a long way without places, reckoning agrees with false ones too: at dusk, the first one in 500 m moved a
        recorded drive from 20 m off to 41 (fc6, confidence 0.92). 52 recorded drives on maps with keypoints, with lines
        from a sharpness of 2 % on, have 7,987 positions with it and 7,933 without, none beyond three sigma.
        """
        is_likely = not self.by_chance or (1 - self.confidence) * self.by_chance <= BY_CHANCE
        return is_likely or self.driven_m - self.since_m >= CORRELATION_M

    def move(self, displacement_m: Vector, bridged_m2: float) -> None:
        """Move on by a displacement (4,) of the autopilot's velocity; see `RouteEstimate.predict`."""
        self.estimate.predict(displacement_m, bridged_m2)
        driven_m = float(np.hypot(*displacement_m[:2]))
        self.since_m += driven_m
        self.driven_m += driven_m

    def agrees(self, sighting: Sighting, road_sigma_m: float) -> bool:
        """Whether the vehicle may be where the match is; road_sigma_m: one standard deviation across the road."""
        if sighting.look is not None:
            return self._disagrees(sighting.look) <= LOOK_CHI2
        off_m, sigma_m = self.estimate.aside(sighting.passed, road_sigma_m)
        return off_m <= AGREE_SIGMAS * sigma_m and abs(self.innovation(sighting)) <= AGREE_SIGMAS

    def _disagrees(self, look: Look) -> float:
        return look.disagrees(self.estimate.position_m, self.estimate.at_look(look))

    def innovation(self, sighting: Sighting) -> float:
        """How far along the road a match is from where it is expected, in standard deviations of that.

        Of a look, in each direction.
        """
        if sighting.look is not None:
            return math.sqrt(self._disagrees(sighting.look) / 2)
        off_m, sigma_m = self._expects(sighting)
        return off_m / sigma_m

    def agrees_by_chance(self, sighting: Sighting) -> float:
        """Probability that a match anywhere along the road would be where it is expected.

        None while reckoning says which place within a correlation length it is.
        """
        reach_m = AGREE_SIGMAS * self._expects(sighting)[1]
        return 0.0 if reach_m <= CORRELATION_M else min(1.0, 2 * reach_m / SPREAD_M)

    def _expects(self, sighting: Sighting) -> tuple[float, float]:
        """Meters along the road from where a match is expected, and their standard deviation."""
        if sighting.look is not None:
            along, off_m = sighting.passed.along, sighting.look.position_m - self.estimate.position_m
            spread = self.estimate.at_look(sighting.look) + sighting.look.covariance
            return float(along @ off_m), math.sqrt(float(along @ spread @ along))
        sigma_m = math.hypot(sighting.sigma_m, self._new_drive_m(sighting))
        return self.estimate.innovation(sighting.passed, sigma_m, sighting.faint)

    def _new_drive_m(self, sighting: Sighting) -> float:
        if not self._begins_drive(sighting):
            return 0.0
        errors = sighting.errors
        return math.hypot(errors.line_m, errors.whole_m, sighting.map_sigma_m, self.newest.map_sigma_m)

    def _begins_drive(self, sighting: Sighting) -> bool:
        now, before = sighting.match, self.newest.match
        return (sighting.segment, now.direction) != (self.newest.segment, before.direction)

    def add(self, sighting: Sighting, road_sigma_m: float, stamp_ns: int) -> None:
        """Correct the estimate by a match; road_sigma_m: one standard deviation of the position across the road."""
        begins = self._begins_drive(sighting)
        if sighting.look is None and self.estimate.since_looks_m < HOLDS_M:  # it only shows that the vehicle is there
            kept = self.newest if begins else replace(sighting, whole_sigma_m=self.newest.whole_sigma_m)
            self._added(sighting, stamp_ns, kept)
            return
        if begins:
            self.estimate.begin_drive(sighting.errors)
        if sighting.look is not None:
            self.estimate.correct_by_look(sighting.look)
            self._added(sighting, stamp_ns)
            return
        self.estimate.keep_on_road(sighting.passed, road_sigma_m)
        self.estimate.correct(sighting.passed, sighting.sigma_m, sighting.faint)
        self._added(sighting, stamp_ns)

    def away_m(self, look: Look) -> float:
        """How far a look is from the estimate."""
        return float(np.hypot(*(look.position_m - self.estimate.position_m)))

    def begin_at_look(self, sighting: Sighting, look: Look, stamp_ns: int) -> None:
        """Be where a look is, the first one, or one of those that outvoted the estimate."""
        if self._begins_drive(sighting):
            self.estimate.begin_drive(sighting.errors)
        self.estimate.begin_at_look(look)
        self._added(sighting, stamp_ns)

    def _added(self, sighting: Sighting, stamp_ns: int, kept: Sighting | None = None) -> None:
        self.points = 0 if sighting.look is None else sighting.look.points
        if sighting.look is not None:
            self.goes_back = sighting.look.goes_back
        self.since_m = self.since_m if kept is self.newest else 0.0
        self.newest, self.stamp_ns, self.disagreeing = kept or sighting, stamp_ns, 0
        self.matches += 1
        self.confidence = max(self.confidence, sighting.match.confidence)


@dataclass
class ReckonedTrack:
    """Where the vehicle is by reckoning alone, since GPS or since no match agreed.

    aside: how far beside the road of matches since then, and one standard deviation, meters; None where they agree.
    """

    estimate: RouteEstimate
    aside: tuple[float, float] | None = None

    def compare_across(self, sighting: Sighting, road_sigma_m: float) -> None:
        """A vehicle that went aside is there until reckoning contradicts that: else no position follows a false one."""
        off_m, sigma_m = self.estimate.aside(sighting.passed, road_sigma_m)
        if off_m > AGREE_SIGMAS * sigma_m:
            self.aside = off_m, sigma_m
        elif self.aside is not None and self.aside[0] - off_m > AGREE_SIGMAS * sigma_m:
            self.aside = None
