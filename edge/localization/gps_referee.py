"""Whether GPS agrees with the places that are recognized, and where not, which of the two is wrong. Pure.

Two hypotheses explain the difference between GPS and a recognized place (a `Comparison`):

    honest   the usual errors of GPS, map and match, and bursts of multipath
    wrong    GPS is anywhere else, at one of the scales OFFSETS_M, or anywhere on Earth

    score(now) = log(wrong / honest) + max(0, score one correlation length ago)

is Page's CUSUM over sightings that are CORRELATION_M apart. Where looks say that GPS is dragged (`drag_evidence`), that
counts if it is more. They disagree at log((1 - missed) / false_call), and agree
when the same sum, with min in the place of max, falls to log(missed / (1 - false_call)): Wald's boundaries. An honest
GPS disagrees after 1 / false_call sightings or more on average (Lorden).

Where they disagree, a place may be another one and a recording of the map may lie elsewhere, just as GPS may be wrong.
The third witness decides: the vehicle's own motion, in which GPS has no part, since the two last agreed (or since GPS
was lost before any place judged it). GPS is wrong where the places moved as the vehicle did and GPS did not; the map is
wrong where it is the other way round. Where own motion cannot say, or is not known, GPS is wrong as well that departs
steadily from a recording with which it agreed, and which keeps its shape; and else they disagree, and that is all.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from edge.localization.anchor import Anchor
from edge.localization.dead_reckoning import Displacement
from edge.localization.events import GpsFix
from edge.localization.gps_agreed import Agreed
from edge.localization.gps_comparison import Comparison, evidence_of, offset_m
from edge.localization.gps_drag import Drag
from edge.localization.route_estimate import CORRELATION_M

GpsVerdictState: TypeAlias = Literal[
    "cannot say", "agrees", "doubtful", "disagrees", "wrong", "map wrong", "not recognized"
]
DOUBTFUL = 3.0
"""Score (20 to 1) from which GPS is doubtful, and from which own motion speaks for one of two witnesses."""
NEWEST = 3
"""Of so many comparisons in a row the one counts that says least."""
DEPARTS_M, DEPARTS, UNSTEADY = 20.0, 1.5, 0.25
"""How far GPS departs over three stretches of a recording that keeps its shape, at least, and for each meter that it
was off in the first: on another street that looks the same, it is that far off all along. By which share of that it may
be elsewhere than half of it in their middle: one that jumps may have been right."""
LONGEST_GAP_M = 240.0
"""Without a place or without GPS, after which comparisons do not add up any more."""
SAMPLES = 512  # comparisons that count at most
COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


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
    """A comparison, the meters driven by then, the evidence in it, the most in the newest ones, and the two sums.

    drag: evidence in the looks by then. high: the more of that and of Page's sum.
    """

    comparison: Comparison
    at_m: float
    evidence: float
    most: float
    summed: float
    low: float
    drag: float

    @property
    def high(self) -> float:
        return max(self.summed, self.drag)


@dataclass(frozen=True)
class _Lost:
    """Where GPS had the vehicle last, the meters driven by then, and the samples, those since then among them."""

    anchor: Anchor
    at_m: float
    samples: deque[_Sample]


class GpsReferee:
    """Judges GPS by one comparison after another."""

    def __init__(self, false_call: float, missed: float, drift: float = 0.05) -> None:
        """Probabilities that an honest GPS disagrees, and that a wrong one agrees, at each sighting.

        drift: one standard deviation of the vehicle's own motion, as a share of the distance.
        """
        self._disagree, self._agree = math.log((1 - missed) / false_call), math.log(missed / (1 - false_call))
        self._agreed = Agreed(drift)
        self._samples: deque[_Sample] = deque(maxlen=SAMPLES)
        self._drag = Drag()
        self._lost: _Lost | None = None
        self._at_m = self._gap_m = 0.0
        self._looked_m = -math.inf
        self._settled: GpsVerdictState = "cannot say"
        self.verdict = GpsVerdict()
        self.unsettled_m: float | None = None
        """How far GPS was from the places when it was lost, where own motion rather speaks for a recording that GPS had
        agreed with, and that keeps its shape: GPS bounds nothing better than that."""

    def update(self, comparison: Comparison | None, missed: int = 0) -> GpsVerdict:
        """The verdict after one more used frame; None: its place is not known. missed: places passed before it."""
        spacing_m = self._samples[-1].comparison.spacing_m if comparison is None and self._samples else 0.0
        self._gap_m += (1 + missed) * (spacing_m if comparison is None else comparison.spacing_m)
        if self._gap_m > LONGEST_GAP_M:
            self._begin_anew()
        if comparison is not None:
            self._at_m, self._gap_m = self._at_m + self._gap_m, 0.0
            if comparison.look_sigma_m is not None:
                self._looked_m = self._at_m
            if comparison.off_along_m is not None:
                self._lost = self.unsettled_m = None
                self._add(comparison)
            else:
                self.verdict = self._since_lost(comparison)
        return self.verdict

    def call(self, east_m: float, north_m: float) -> None:
        """GPS is wrong by so much, as something else has shown: see `GpsTrack`."""
        self._settled, self.verdict = "wrong", GpsVerdict("wrong", east_m, north_m, 1.0)
        self._samples.clear()  # what agreed before does not count for it
        self._drag.clear()

    def go_on(self, gps: GpsFix, motion: Displacement, stamp_s: float) -> None:
        """No look here: GPS is held against where the last ones lead by own motion, unless they spoke against a drag.

        A vehicle that steers by GPS leaves the road that it sees before it is far off.
        """
        if self._settled == "wrong" or not self._drag.is_due(stamp_s):
            return
        led = self._agreed.led_by(self._drag.looks, motion)
        if led is None:
            return
        evidence, off_m = self._drag.go_on(gps, led, stamp_s)
        if evidence >= self._disagree and self._drag.evidence > -DOUBTFUL:
            self.call(float(off_m[0]), float(off_m[1]))

    def keep_until_lost(self, anchor: Anchor) -> None:
        """GPS was lost there: if no place was compared with it before, it counts as right until then.

        Had it been wrong, places would contradict that as well as GPS that is back, and nothing would be called.
        """
        if self._lost is None:
            self._lost = _Lost(anchor, self._at_m, deque(self._samples, SAMPLES))
        self._agreed.begin(anchor)

    def _since_lost(self, comparison: Comparison) -> GpsVerdict:
        """GPS was lost before it was called: the place against where it had the vehicle, moved on by own motion.

        That can show that it was wrong, or that nobody knows, and nothing else. Two witnesses that make it doubtful are
        enough, since it will not be heard again.
        """
        lost = self._lost
        is_over = self._settled == "wrong" or self.unsettled_m is not None
        if lost is None or is_over or self._at_m - lost.at_m > LONGEST_GAP_M:
            return self._without_gps
        goes_on, samples = self._agreed.moved_on(lost.anchor, comparison), lost.samples
        high = -math.inf if goes_on is None else self._sums(goes_on, samples)[0]
        if high < DOUBTFUL or len(samples) < NEWEST:
            return self._without_gps
        state, leans = self._wrong_one(samples)
        if state == "wrong":
            self.call(*_mean_offset(samples))
            return self.verdict
        shapes = {one.shape for one in self._agreed.before(math.inf)}
        if state == "disagrees" and leans and high >= self._disagree and comparison.shape in shapes - {""}:
            self.unsettled_m = math.hypot(*_mean_offset(samples))
        return self._without_gps

    def _begin_anew(self) -> None:
        self._samples.clear()
        self._drag.clear()
        self._lost = self.unsettled_m = None
        if self._settled != "wrong":
            self._settled = "cannot say"
        self.verdict = self._without_gps

    @property
    def _without_gps(self) -> GpsVerdict:
        return GpsVerdict("wrong", doubt=1.0) if self._settled == "wrong" else GpsVerdict()

    def _add(self, comparison: Comparison) -> None:
        high, low = self._sums(comparison, self._samples)
        if len(self._samples) >= NEWEST:
            # The sum lags: places that are displaced since have agreed for up to 120 m.
            is_look = comparison.look_sigma_m is not None or self._at_m - self._looked_m > LONGEST_GAP_M
            is_right = low <= self._agree and self._samples[-1].most < 0 and self._samples[-1].drag <= 0
            if is_right and (is_look or self._settled != "wrong"):
                self._settled = "agrees"
                self._agreed.add(comparison, self._at_m)
            elif high >= self._disagree and self._settled != "wrong":
                self._settled, _ = self._wrong_one(self._samples)
        self.verdict = self._judged(high)

    def _sums(self, comparison: Comparison, samples: deque[_Sample]) -> tuple[float, float]:
        """Add a comparison; the two sums by then."""
        evidence = evidence_of(comparison)
        recent = [sample.evidence for sample in list(samples)[1 - NEWEST :]] + [evidence]
        before = next((one for one in reversed(samples) if self._at_m - one.at_m >= CORRELATION_M), None)
        # A sum far beyond a boundary would hide a change for long.
        summed = min(min(recent) + max(0.0, before.summed if before else 0.0), 2 * self._disagree)
        low = max(max(recent) + min(0.0, before.low if before else 0.0), 2 * self._agree)
        if comparison.look_sigma_m is not None:
            self._drag.add(comparison, self._agreed.led_by(self._drag.looks, comparison.motion))
        drag = self._drag.at(comparison.stamp_s)  # a line adds nothing
        samples.append(_Sample(comparison, self._at_m, evidence, max(recent), summed, low, drag))
        return samples[-1].high, low

    def _wrong_one(self, among: Sequence[_Sample]) -> tuple[GpsVerdictState, bool]:
        """Which of both moved otherwise than the vehicle, since any time at which they agreed; whether rather GPS did.

        Only until the sum began to grow: it lags, and what has moved since then agreed with nothing. Slow drags are
        well under way before they show, so that the newest time is not the best one.
        """
        samples = list(among)
        grows = len(samples)
        while grows > 1 and samples[grows - 1].high > 0.0:
            grows -= 1
        began_m = samples[max(0, grows - NEWEST)].at_m  # as many, until it shows
        newest = samples[-NEWEST:]
        agreed, lost = self._agreed.before(began_m), None if self._lost is None else self._lost.anchor
        is_gps = is_map = leans = False
        for row in range(len(agreed)):
            least, most = math.inf, -math.inf
            for sample in newest:
                says = self._agreed.says(row, sample.comparison, lost)
                least, most = min(least, says), max(most, says)
                if least <= 0 and most > -DOUBTFUL:  # it can be none of the three
                    break
            is_gps, is_map, leans = is_gps or least >= DOUBTFUL, is_map or most <= -DOUBTFUL, leans or least > 0
        is_gps |= not is_map and self._has_departed(samples[grows:], {one.shape for one in agreed})
        return "disagrees" if is_gps == is_map else "wrong" if is_gps else "map wrong", leans

    def _has_departed(self, grows: Sequence[_Sample], agreed: Set[str]) -> bool:
        """Whether GPS moved away steadily from a recording that keeps its shape, and with which it agreed before.

        A street beside that looks the same keeps its distance, and one that leads away is not recognized so far aside.
        By looks, GPS that keeps its distance is not dragged, and a vehicle on a road that leads away is seen aside.
        """
        if not grows:
            return False
        if grows[-1].drag >= self._disagree:
            return grows[-1].comparison.shape in agreed - {""}
        if self._at_m - grows[0].at_m < 2 * CORRELATION_M:
            return False
        middle = min(grows, key=lambda one: abs(2 * one.at_m - grows[0].at_m - self._at_m))
        first, half, last = (one.comparison for one in (grows[0], middle, grows[-1]))
        if not first.shape or first.shape not in agreed or not first.shape == half.shape == last.shape:
            return False
        grown_m, half_m = offset_m(last) - offset_m(first), offset_m(half) - offset_m(first)
        square = float(grown_m @ grown_m)
        departs_m = max(DEPARTS_M, DEPARTS * float(np.hypot(*offset_m(first))))
        return square >= departs_m**2 and abs(float(half_m @ grown_m) / square - 0.5) <= UNSTEADY

    def _judged(self, high: float) -> GpsVerdict:
        state, doubt = self._settled, min(max(high / self._disagree, 0.0), 1.0)
        if state == "wrong":
            doubt = 1.0
        elif state in ("agrees", "cannot say") and high >= DOUBTFUL:
            state = "doubtful"
        return GpsVerdict(state, *_mean_offset(self._samples), doubt)


def _mean_offset(samples: Sequence[_Sample]) -> tuple[float, float]:
    """Meters east and north, by the newest."""
    east_m, north_m = np.mean([offset_m(one.comparison) for one in list(samples)[-NEWEST:]], axis=0)
    return float(east_m), float(north_m)
