"""Whether a place is believed: the matches of the last few sequences vote along the odometer. Pure: no link, no clock.

A vehicle that is where its best match says moves along the map's drive as its odometer does, frame after frame; a
chance resemblance does not for long. Every match is moved on by what was driven since, and votes for the place where
the vehicle then is:

    offset = along - sign * driven          (sign: 1 forward, -1 reverse; constant on one drive)
    weight = min(uniqueness - 1, 0.15) * sharpness * sqrt(row support)
    live = sum of agreeing weights * (share of the recent weights that agree)^2
    confidence = (live - others) / (live + others + prior)
                 * (1 - overrun / slack) * min(1, 2 * pace) * min(1, support / 0.4)

Two votes agree if they lie in one drive, run in one direction, and their offsets differ by at most the slack and the
drift of the odometer between them; votes in two drives, if they put the vehicle on one spot of the ground. Overrun is
how far the place lies beyond its drive's end; where the drive is closed, it goes on at its beginning. Pace is the share
of the odometer's motion that the agreeing votes went along with: the variance of driven less that of offset, over the
variance of driven plus (slack / 4)^2; 0 of a match that stays where it is, and little of a few meters. Support is the
share of the newest frames (half a sequence) that are like the place of their match, and whose match is where the others
are: a vehicle that turned off the mapped road must not be believed on it for as long as the old votes count. Of two
cameras, the frames of the first one count here, by whose lines the vehicle is followed, and its own votes must weigh a
tenth of the prior: what only the second one recognizes is not believed. The weight of a second camera's vote is
multiplied by the square of the share of its recent votes that agree with it.
Uniqueness says how much worse the best line elsewhere is; sharpness, how much worse the lines a little before and after
are, which a stretch that only resembles this kind of road does not show; row support, how often the place was among the
most similar ones by the newest frame alone.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.reference_map import NO_LAP_M, Drives
from edge.sequence import Direction, PlaceMatch

CAPACITY = 256
"""Votes of one camera that are kept at most; 320 m at one place each 2 m are 160."""
FULL_SUPPORT = 0.4
"""Share of the newest matches at a place from which it is as well supported as it can be: some are always wrong."""
LEAST_OWN = 0.1
"""Evidence of the first camera's own matches, as a share of the prior, below which a belief is less certain: where it
sees nothing of the road at all, its matches agree with the second camera's by chance with a share of 0.02 at most."""
FEWEST_OF_CAMERA = 5
"""Votes that a second camera counts as having had at least, when it is asked how many of them agree."""
LIKE_NEWEST = 0.04
"""A place is among the most similar to the newest frame if at most this share of the places is more similar."""
MOST_UNIQUE = 0.15
"""Uniqueness over 1 that counts at most: the one night drive in a map of day drives differs from all the others by much
more, and that says nothing about where in it the vehicle is."""
STILL_LIKE = 0.1
"""The same, for a frame that shows what the place shows."""


Floats = NDArray[np.float64]
PositionsOf = Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.float64]]
"""Meters east and north (n, 2) of points along some drives: their numbers (n,), and along_m (n,); NaN where unknown."""


@dataclass(frozen=True)
class ConsensusSettings:
    """Lengths in the unit of `PlaceVote.along_m`: meters, or places of a map that knows no meters.

    length: frames of a sequence. spacing_m: from one place to the next. step: places from one frame to the next.
    reach_lines, recent_lines: how far back votes count, and matches are recent, in lengths of a sequence. slack_m,
    drift: by how much two agreeing votes may differ, in all and per meter of odometer. blind_drift: the same per meter
    that was not measured. prior: evidence, in weight per frame of a sequence, that is held against every place.
    threshold: confidence from which the place is believed.
    """

    length: int = 40
    spacing_m: float = 2.0
    step: float = 1.0
    reach_lines: float = 4.0
    recent_lines: float = 3.0
    slack_m: float = 20.0
    drift: float = 0.05
    blind_drift: float = 0.2
    prior: float = 0.003
    threshold: float = 0.5

    @classmethod
    def of(cls, config: Config, drives: Drives, step: float = 1.0) -> ConsensusSettings:
        """For sequences of that length on those drives; two votes may differ by a quarter of a sequence.

        Frames farther apart than places leave it at a quarter of so many places: in simulated drives with a frame every
        4 and 6 m on a map of 1 m, 5 of 1,652 believed places were wrong with a quarter of what was driven, else none.
        """
        length, spacing_m = config.sequence.length, drives.spacing_m
        slack_m = length * spacing_m * min(1.0, step) / 4
        return cls(length, spacing_m, step, slack_m=slack_m, threshold=config.acceptance.confidence_min)

    @property
    def line_m(self) -> float:
        """Length of a sequence."""
        return self.length * self.spacing_m * self.step


@dataclass(frozen=True)
class PlaceVote:
    """What the best match of one frame says, in map coordinates.

    drive: number of the map's drive. along_m: of the place, along it; start_m, end_m: of the drive. lap_m: after how
    much of the drive it goes on at its start, NO_LAP_M where it does not. uniqueness: cost of the best line elsewhere
    over the best. sharpness: cost of the cheaper of the two lines that end 0.3 windows
    before and after the place, over the best, less 1. row_share: share of the places that are more similar to the
    newest frame than the best within an eighth of a window of the place. camera: number of the one that votes.
    """

    drive: int
    along_m: float
    start_m: float
    end_m: float
    direction: Direction
    uniqueness: float
    sharpness: float
    row_share: float
    lap_m: float = NO_LAP_M
    camera: int = 0

    @classmethod
    def of(cls, match: PlaceMatch, drives: Drives) -> PlaceVote:
        """The vote of a match on those drives."""
        drive, along_m = drives.drive_of(match.place_index), drives.along_m(match.place_index)
        evidence = match.uniqueness, match.sharpness, match.row_share
        return cls(drive, along_m, *drives.extent_m(drive), match.direction, *evidence, drives.lap_m(drive))


@dataclass(frozen=True)
class PlaceBelief:
    """Where the vehicle is by the votes' weighted mean, moved on to the newest frame.

    along_m may lie up to `slack_m` beyond the drive's end. confidence: 0 to 1.
    """

    drive: int
    along_m: float
    direction: Direction
    confidence: float
    is_believed: bool


class PlaceConsensus:
    """The votes of the recent matches, and the belief that they add up to."""

    def __init__(
        self, settings: ConsensusSettings, positions_of: PositionsOf | None = None, *, cameras: int = 1
    ) -> None:
        """positions_of: where the drives lie, without which votes in two drives never agree. cameras: how many vote."""
        self.settings = settings
        self._positions_of = positions_of
        self._cameras = cameras
        self.reset()

    def reset(self) -> None:
        """Start again without votes, as after a gap in which nothing is known of the motion."""
        self._count = 0
        self._driven_m = self._uncertain_m = 0.0
        self._odometer_m: float | None = None
        self._capacity = capacity = self._cameras * CAPACITY
        half = max(1, self.settings.length // 2)
        self._rows = [deque[bool](maxlen=half) for _ in range(self._cameras)]
        self._newest = [deque[int](maxlen=half) for _ in range(self._cameras)]  # slots of each camera's votes
        self._agree = np.zeros((capacity, capacity), dtype=np.float32)
        self._weights = np.zeros(capacity, dtype=np.float32)
        self._at_m = np.full(capacity, -np.inf)  # driven at the vote; an empty slot is out of reach
        self._uncertain_at_m = np.zeros(capacity)
        self._offsets_m = np.zeros(capacity)
        self._signs = np.zeros(capacity)
        self._of_camera = np.zeros(capacity, dtype=np.int8)
        self._are_like = np.zeros(capacity, dtype=bool)
        self._drives = np.zeros(capacity, dtype=np.int64)
        self._bounds_m = np.zeros((2, capacity))
        self._laps_m = np.full(capacity, NO_LAP_M)
        self._was_believed = np.zeros(capacity, dtype=bool)

    def update(self, vote: PlaceVote | None, odometer_m: float | None, places: float = 1.0) -> PlaceBelief | None:
        """Move on by one used frame, whose match is `vote`; None as long as nothing speaks for any place.

        vote: None if the frame has no match. odometer_m: meters driven at the frame, None where not known. places: that
        were passed since the last frame, as far as it is known without the odometer.
        """
        self._move(odometer_m, places)
        if vote is not None:
            self._add(vote, 0.0)
        return self._believe()

    def add(self, vote: PlaceVote, odometer_m: float) -> None:
        """A vote of another camera than the one whose frames `update` follows, exposed between two of those frames.

        It counts from the next update on; not at all where the odometer was not known at the last one.
        """
        if self._odometer_m is not None and abs(odometer_m - self._odometer_m) <= self.settings.slack_m:
            self._add(vote, odometer_m - self._odometer_m)

    def _move(self, odometer_m: float | None, places: float) -> None:
        """Distance since the last frame; by places where the odometer is not known, or was counted anew."""
        last_m, self._odometer_m = self._odometer_m, odometer_m
        if odometer_m is not None and last_m is not None and odometer_m >= last_m:
            step_m, drift = odometer_m - last_m, self.settings.drift
        else:
            step_m, drift = places * self.settings.spacing_m, self.settings.blind_drift
        self._driven_m += step_m
        self._uncertain_m += drift * step_m

    def _add(self, vote: PlaceVote, ahead_m: float) -> None:
        """ahead_m: driven from the newest update to the vote."""
        slot = self._count % self._capacity
        self._count += 1
        self._newest[vote.camera].append(slot)
        self._of_camera[slot] = vote.camera
        at_m = self._driven_m + ahead_m
        sign = 1.0 if vote.direction == "forward" else -1.0
        self._weights[slot] = self._weight(vote)
        self._at_m[slot], self._uncertain_at_m[slot] = at_m, self._uncertain_m
        self._offsets_m[slot] = vote.along_m - sign * at_m
        self._signs[slot], self._drives[slot] = sign, vote.drive
        self._bounds_m[:, slot], self._laps_m[slot] = (vote.start_m, vote.end_m), vote.lap_m
        self._are_like[slot] = vote.row_share < STILL_LIKE
        self._was_believed[slot] = False
        allowed_m = self.settings.slack_m + self._uncertain_m - self._uncertain_at_m
        agree = (self._drives == vote.drive) & (self._signs == sign)
        agree &= np.abs(_within_lap(self._offsets_m - self._offsets_m[slot], vote.lap_m)) <= allowed_m
        self._agree[slot] = self._agree[:, slot] = agree | self._on_one_spot(slot, allowed_m)
        if vote.camera:
            self._weights[slot] *= self._coherence(slot) ** 2

    def _coherence(self, slot: int) -> float:
        """Share of the recent votes of one camera that agree with the newest one.

        Where a camera cannot recognize anything, its matches are scattered. The other one's are not to be outvoted.
        """
        own = self._is_recent() & (self._of_camera == self._of_camera[slot])
        return float(self._agree[slot, own].sum()) / max(FEWEST_OF_CAMERA, int(own.sum()))

    def _on_one_spot(self, slot: int, allowed_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which votes in other drives put the vehicle within `allowed_m` of where the newest one does."""
        near = np.zeros(self._capacity, dtype=bool)
        others = (self._drives != self._drives[slot]) & self._in_reach()
        if self._positions_of is not None and others.any():
            now_m = self._now_m()
            at = np.append(np.flatnonzero(others & (self._overrun_m(now_m) == 0)), slot)
            spots_m = self._positions_of(self._drives[at], now_m[at])
            near[at[:-1]] = np.hypot(*(spots_m[:-1] - spots_m[-1]).T) <= allowed_m[at[:-1]]
        return near

    def _now_m(self) -> NDArray[np.float64]:
        """Where each vote puts the vehicle now, along its drive."""
        start_m, end_m = self._bounds_m
        middle_m = (start_m + end_m) / 2
        return middle_m + _within_lap(self._offsets_m + self._signs * self._driven_m - middle_m, self._laps_m)

    def _in_lap_m(self, along_m: float, slot: int) -> float:
        middle_m = float(self._bounds_m[:, slot].mean())
        return middle_m + float(_within_lap(np.array(along_m - middle_m), self._laps_m[slot]))

    def _in_reach(self) -> NDArray[np.bool_]:
        return self._driven_m - self._at_m <= self.settings.reach_lines * self.settings.line_m

    def _is_recent(self) -> NDArray[np.bool_]:
        return self._driven_m - self._at_m <= self.settings.recent_lines * self.settings.line_m

    def _weight(self, vote: PlaceVote) -> float:
        rows = self._rows[vote.camera]
        rows.append(vote.row_share < LIKE_NEWEST)
        support = sum(rows) / len(rows)
        uniqueness = min(max(0.0, vote.uniqueness - 1), MOST_UNIQUE)
        return uniqueness * max(0.0, vote.sharpness) * math.sqrt(support)

    def _believe(self) -> PlaceBelief | None:
        settings = self.settings
        in_reach = self._in_reach()
        weights = self._weights * in_reach
        recent = self._weights * self._is_recent()
        live = self._agree @ weights * np.square(self._agree @ recent / max(1e-9, float(recent.sum())))
        now_m = self._now_m()
        overrun_m = self._overrun_m(now_m)
        leader = int(np.where(in_reach & (overrun_m <= settings.slack_m), live, 0.0).argmax())
        if not (in_reach[leader] and live[leader] > 0 and overrun_m[leader] <= settings.slack_m):
            return None
        group = in_reach & (self._agree[leader] > 0)
        same = group & (self._drives == self._drives[leader]) & (self._signs == self._signs[leader])
        ahead_m = _within_lap(now_m[same] - now_m[leader], self._laps_m[leader])
        along_m = self._in_lap_m(float(now_m[leader] + weights[same] @ ahead_m / weights[same].sum()), leader)
        # A drive that was believed and has been driven to its end says nothing against the one that follows.
        against = in_reach & ~group & ~(self._was_believed & (overrun_m > settings.slack_m))
        confidence = self._confidence(float(live[leader]), float(weights[against].sum()))
        confidence *= max(0.0, 1 - self._overrun_m_at(along_m, leader) / settings.slack_m)
        confidence *= min(1.0, 2 * self._pace(np.flatnonzero(same), weights))
        if self._cameras > 1:
            own = float(weights[group & (self._of_camera == 0)].sum())
            confidence *= min(1.0, own / (LEAST_OWN * settings.prior * settings.length))
        confidence *= min(1.0, self._support(leader, along_m, now_m) / FULL_SUPPORT)
        is_believed = confidence >= settings.threshold
        if is_believed:
            self._was_believed |= group
        direction: Direction = "forward" if self._signs[leader] > 0 else "reverse"
        return PlaceBelief(int(self._drives[leader]), along_m, direction, confidence, is_believed)

    def _confidence(self, live: float, others: float) -> float:
        return max(0.0, (live - others) / (live + others + self.settings.prior * self.settings.length))

    def _support(self, leader: int, along_m: float, now_m: NDArray[np.float64]) -> float:
        """Share of the newest votes, of half a sequence, at the place, and of frames that are like it."""
        there = (self._drives == self._drives[leader]) & (self._signs == self._signs[leader])
        there &= np.abs(_within_lap(now_m - along_m, self._laps_m[leader])) <= self.settings.slack_m
        there |= (self._agree[leader] > 0) & (self._drives != self._drives[leader])
        there &= self._are_like
        slots = np.array(self._newest[0], dtype=np.intp)
        return float(there[slots].mean()) if slots.size else 0.0

    def _pace(self, slots: NDArray[np.int64], weights: NDArray[np.float32]) -> float:
        """Share of what was driven between some votes of one drive that their places went along with."""
        shares = weights[slots] / weights[slots].sum()
        at_m, offsets_m = self._at_m[slots], self._offsets_m[slots]
        offsets_m = _within_lap(offsets_m - offsets_m[0], self._laps_m[slots])
        driven, strayed = (float(shares @ np.square(of - shares @ of)) for of in (at_m, offsets_m))
        return max(0.0, driven - strayed) / (driven + (self.settings.slack_m / 4) ** 2)

    def _overrun_m(self, now_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far each vote's place, moved on to now, lies outside its drive."""
        start_m, end_m = self._bounds_m
        return np.maximum(0.0, np.maximum(start_m - now_m, now_m - end_m))

    def _overrun_m_at(self, along_m: float, slot: int) -> float:
        start_m, end_m = self._bounds_m[:, slot]
        return max(0.0, float(start_m) - along_m, along_m - float(end_m))


def _within_lap(apart_m: Floats, lap_m: Floats | float) -> Floats:
    """Meters between places, the shorter way round where the drive is a closed lap."""
    return apart_m - np.round(apart_m / lap_m) * lap_m
