"""Whether a place is believed: the matches of the last few sequences vote along the odometer. Pure: no link, no clock.

A vehicle that is where its best match says moves along the map's drive as its odometer does, frame after frame; a
chance resemblance does not for long. Every match is moved on by what was driven since, and votes for the place where
the vehicle then is:

    offset = along - sign * driven          (sign: 1 forward, -1 reverse; constant on one drive)
    weight = min(uniqueness - 1, 0.2) * sharpness * sqrt(row support)
    live = sum of agreeing weights * (share of the recent weights that agree)^2
    agreement = (live - others) / (live + others + prior)
                * (1 - overrun / slack) * min(1, 2 * pace) * min(1, support / 0.4) * unlike
    odds of confidence = RIGHT_AT_HALF * odds of agreement

Two votes agree if they lie in one drive, run in one direction, and their offsets differ by at most the slack and the
drift of the odometer between them; votes in two drives, or on two passes of one, if they put the vehicle on one spot of
the ground. Overrun is how far the place lies beyond its drive's end; where the drive is closed, it goes on at its
beginning. Pace is the share of the odometer's motion that the agreeing votes went along with: the variance of driven
less that of offset, over the variance of driven plus (slack / 4)^2; 0 of a match that stays where it is, and little of
a few meters; without an odometer also 0 of places that advance slower or faster than the lines that are searched.
Support is the share of the newest frames (half a sequence) that are like the place of their match, and whose match is
where the others are: a vehicle that turned off the mapped road must not be believed on it for as long as the old votes
count.
Unlike is 0 where lines elsewhere fit as well as those of the agreeing votes, 1 where they do not, by the mean of
min(uniqueness - 1, 0.2), each as its vote weighs: many votes that are each hardly unique must not add up to a belief,
as on a street that repeats, where they err alike. It is 1 where dead reckoning tells these places apart.
Confidence is the probability that the place is right, for a vehicle that is as often off the map as on it. With a dead
reckoning position (`prior`), each place has odds of its own: they multiply those of its votes, and what speaks
for another place counts by that place's odds. Votes count less if the vehicle was less likely on the map's roads over
their line than it is now: those from before it came onto the map do not speak against a place.
Lines of half a sequence vote among themselves in the same way. Their belief counts where it is the more certain one,
and only with dead reckoning: it comes sooner after the map begins, but by their votes alone a car park was believed (18
of 2,904 frames, at most .942; none with dead reckoning).
Uniqueness says how much worse the best line elsewhere is; sharpness, how much worse the lines a little before and after
are, which a segment that only resembles this kind of road does not show; row support, how often the place was among the
most similar ones by the newest frame alone.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.config import Config, RigConfig
from edge.reference_map import NO_LAP_M, Drives
from edge.sequence import Direction, PlaceMatch
from edge.sequence.prior import Prior

MOST_VOTES = 256
"""Votes that are kept at most; 320 m at one place each 2 m are 160, and 80 of structure."""
FULL_SUPPORT = 0.4
"""Share of the newest matches at a place from which it is as well supported as it can be: some are always wrong."""
LIKE_NEWEST = 0.04
"""A place is among the most similar to the newest frame if at most this share of the places is more similar."""
FEWER_LINES = 1.4
"""By how much more evidence is held against every place where lines against the course are not searched: fewer are left
to be as good by chance. In 10 km of foreign road the highest agreement was .49 with all lines, .56 without those
against the course, and .48 so; on the map .76 of the frames were believed, .82, and .79."""
SLACK_M = 30.0
"""Meters by which two votes may differ at most: right ones scatter by what is seen from afar, from 8 m back to 25 m
ahead at dusk, whether places and frames are 1 m or 6 m apart. With frames 4 and 6 m apart and an odometer that is 8 %
wrong, the mean recall at dusk is .70 with 20 m, .90 with 30 m, and .91 with 40 m."""
MOST_UNIQUE = 0.2
"""Uniqueness over 1 that counts at most: the one night drive in a map of day drives differs from all the others by much
more, and that says nothing about where in it the vehicle is. With 0.15, recall where a third of the road is not mapped
was .747 instead of .757 (two roads, 8 drives), and as many of 7,000 frames off the map were believed: none."""
ALIKE, UNLIKE = 0.05, 0.09
"""Mean uniqueness over 1 of agreeing votes up to which nothing is believed, and from which all that they say counts. Of
2,000 frames on four streets whose houses repeat after 54 or 27 m, 266 were believed without, all wrong, by votes of
0.028 to 0.049; none now. Of those believed on two roads and two recordings the lowest had 0.089, and none is lost."""
STILL_LIKE = 0.1
"""The same, for a frame that shows what the place shows."""
RIGHT_AT_HALF = 11.5
"""Odds that a place is right where its agreement is a half. Logistic regressions, with as many frames off the map as on
it, gave 17.1 on four simulated roads and 13.5 on two others, 11.7 where the power of the odds was free: the most
cautious one. docs/evaluation.md has how far it holds on two more roads and on real streets."""
_FLOATS = ("at_m", "uncertain_m", "offset_m", "start_m", "end_m", "lap_m", "ahead_m", "unique")
_KINDS = {"drive": "i8", "sign": "f8", "weight": "f4", "row_share": "f8", "was_believed": "?", "road": "f4"}
_VOTE = np.dtype([*((name, "f8") for name in _FLOATS), *_KINDS.items()], align=True)
"""A vote as it is kept. at_m, uncertain_m: driven, and how uncertain that was; offset_m, start_m, end_m, lap_m and
ahead_m: along the drive; unique: over 1, at most MOST_UNIQUE; sign: 1 forward, -1 reverse. road: mean of `Prior.road`
over the frames of its line, 1 without dead reckoning."""
Floats = NDArray[np.float64]
PositionsOf = Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.float64]]
"""Meters east and north (n, 2) of points along some drives: their numbers (n,), and along_m (n,); NaN where unknown."""
AwayOf = Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.float64]]
"""Meters (n,) of such points from the dead reckoning position."""


@dataclass(frozen=True)
class ConsensusSettings:
    """Lengths in the unit of `PlaceVote.along_m`: meters, or places of a map that knows no meters.

    length: frames of a sequence. spacing_m: from one place to the next. step: places from one frame to the next.
    slopes: places a step of the flattest and the steepest line that is searched without an odometer.
    reach_lines, recent_lines: how far back votes count, and matches are recent, in lengths of a sequence. slack_m,
    drift: by how much two agreeing votes may differ, in all and per meter of odometer. blind_drift: the same per meter
    that was not measured. prior: evidence, in weight per frame of a sequence, that is held against every place.
    confidence_from: confidence from which the place is believed.
    """

    length: int = 40
    spacing_m: float = 2.0
    step: float = 1.0
    slopes: tuple[float, float] = (0.66, 1.51)
    reach_lines: float = 4.0
    recent_lines: float = 3.0
    slack_m: float = 20.0
    drift: float = 0.05
    blind_drift: float = 0.2
    prior: float = 0.003
    confidence_from: float = 0.92

    @classmethod
    def of(cls, config: Config, drives: Drives, step: float = 1.0, *, some_excluded: bool = False) -> ConsensusSettings:
        """For sequences of that length on those drives; two votes may differ by a quarter of a sequence, or SLACK_M.

        some_excluded: whether lines against the vehicle's course were not searched.
        """
        length, limit_rad, spacing_m = config.sequence_frames, config.sequence.slope_limit_rad, drives.spacing_m
        slack_m = min(length * spacing_m * step / 4, SLACK_M if drives.is_metric else math.inf)
        slopes = math.tan(math.pi / 4 - limit_rad), math.tan(math.pi / 4 + limit_rad)
        prior = cls.prior * (FEWER_LINES if some_excluded else 1.0)
        confidence_from = config.acceptance.confidence_from
        return cls(length, spacing_m, step, slopes, slack_m=slack_m, prior=prior, confidence_from=confidence_from)

    def of_halves(self) -> ConsensusSettings:
        """For lines of half as many frames; their places scatter as much."""
        return replace(self, length=max(1, self.length // 2))

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
    newest frame than the best within an eighth of a window of the place. spacing_m: from one place of the drive to the
    next, None for that of all drives. ahead_m: of the place from the vehicle, along the drive.
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
    spacing_m: float | None = None
    ahead_m: float = 0.0

    @classmethod
    def of(cls, match: PlaceMatch, drives: Drives, rig: RigConfig) -> PlaceVote:
        """The vote of a match on those drives."""
        drive, along_m = drives.drive_of(match.place_index), drives.along_m(match.place_index)
        evidence = match.uniqueness, match.sharpness, match.row_share
        start_m, end_m = drives.extent_m(drive)
        lap_m, spacing_m = drives.lap_m(drive), drives.spacing_of(drive)
        ahead_m = rig.ahead_m(match.direction, match.order) * (1 if match.direction == "forward" else -1)
        return cls(drive, along_m, start_m, end_m, match.direction, *evidence, lap_m, spacing_m, ahead_m)


@dataclass(frozen=True)
class PlaceBelief:
    """Where the vehicle is by the votes' weighted mean, moved on to the newest frame.

    along_m may lie up to `slack_m` beyond the drive's end. confidence: probability that it is there.
    """

    drive: int
    along_m: float
    direction: Direction
    confidence: float
    is_believed: bool


class _Evidence(NamedTuple):
    """Of each vote (MOST_VOTES,): whether it counts, where it puts the vehicle now, how far beyond its drive that is,
    what it weighs, and how much speaks for its place.
    """

    in_reach: NDArray[np.bool_]
    now_m: Floats
    overrun_m: Floats
    weights: Floats
    live: Floats


class _Case(NamedTuple):
    """A place, by the vote that leads to it: the votes that agree with it and those against it (MOST_VOTES,).

    moves: how well it lies in its drive, keeps pace and is supported, 0 to 1. unlike: by how much places elsewhere are
    worse, 0 to 1.
    """

    leader: int
    along_m: float
    group: NDArray[np.bool_]
    others: NDArray[np.bool_]
    moves: float
    unlike: float


class PlaceConsensus:
    """The votes of the recent matches, and the belief that they add up to."""

    def __init__(self, settings: ConsensusSettings, positions_of: PositionsOf | None = None) -> None:
        """positions_of: where the drives lie, without which votes in two drives never agree."""
        self.settings = settings
        self._positions_of = positions_of
        self._was_measured = False
        self.by_votes: PlaceBelief | None = None
        """The newest belief without dead reckoning."""
        self.reset()

    def reset(self) -> None:
        """Start again without votes, as after a gap in which nothing is known of the motion."""
        self._count = 0
        self.driven_m, self.uncertain_m = 0.0, 0.0
        """Driven by the newest frame, and how uncertain that is."""
        self._odometer_m: float | None = None
        self._slots = deque[list[int]](maxlen=max(1, self.settings.length // 2))  # of each of the newest frames
        self._newest = np.zeros(0, np.intp)
        """Slots of the newest votes, of half a sequence."""
        self._roads = deque[float](maxlen=self.settings.length)  # of the newest frames, see _VOTE
        self._votes = np.zeros(MOST_VOTES, dtype=_VOTE)
        self._votes["at_m"], self._votes["lap_m"] = -np.inf, NO_LAP_M  # an empty slot is out of reach
        self._agree = np.zeros((len(self._votes), len(self._votes)), dtype=np.float32)

    def update(
        self,
        vote: PlaceVote | None,
        odometer_m: float | None,
        places: float = 1.0,
        prior: Prior | None = None,
        away_of: AwayOf | None = None,
        *,
        structure: PlaceVote | None = None,
    ) -> PlaceBelief | None:
        """Move on by one used frame, whose match is `vote`; None as long as nothing speaks for any place.

        vote: None if the frame has no match. odometer_m: meters driven at the frame, None where not known. places: that
        were passed since the last frame, as far as it is known without the odometer. prior, away_of: where the vehicle
        is reckoned now, None where that is not known. structure: the vote by what stands along the last meters.
        """
        self._was_measured |= odometer_m is not None
        self._move(odometer_m, places, None if vote is None or self._was_measured else vote.spacing_m)
        self._roads.append(prior.road if prior else 1.0)
        votes = [one for one in (vote, structure) if one is not None]
        if votes:
            self._slots.append([])
        slots = [self._place(one) for one in votes]
        self._now_m = self._moved_m()
        for slot in slots:
            self._agree[slot] = self._agree[:, slot] = self._on_one_pass(slot) | self._on_one_spot(slot)
        evidence = self._evidence()
        leader = int(evidence.live.argmax())
        case = self._case(evidence, leader)
        self.by_votes = self._believe(case, evidence)
        if prior is None or away_of is None:
            return self.by_votes
        joined = np.minimum(1.0, self._votes["road"] / max(prior.road, 1e-9))
        if joined.min(where=evidence.in_reach, initial=1.0) < 1.0:
            evidence = self._evidence(joined)
            case = self._case(evidence, leader)
        odds = self._odds(prior, away_of, evidence)
        both = self._believe(case, evidence, odds, excludes=prior.excludes_elsewhere)
        # Of what the votes say and what is more likely there, the more probable: dead reckoning may be far off.
        chosen = int((evidence.live * odds).argmax())
        if self._agree[leader, chosen]:  # the same place
            return both
        other = self._believe(self._case(evidence, chosen), evidence, odds, excludes=prior.excludes_elsewhere)
        return max((one for one in (both, other) if one), key=lambda one: one.confidence, default=None)

    def _move(self, odometer_m: float | None, places: float, spacing_m: float | None) -> None:
        """Distance since the last frame; by places where the odometer is not known, or was counted anew.

        spacing_m: of these, None for the mean of all drives: a vehicle that was never measured drives as one of them.
        """
        last_m, self._odometer_m = self._odometer_m, odometer_m
        if odometer_m is not None and last_m is not None and odometer_m >= last_m:
            step_m, drift = odometer_m - last_m, self.settings.drift
        else:
            step_m, drift = places * (spacing_m or self.settings.spacing_m), self.settings.blind_drift
        self.driven_m += step_m
        self.uncertain_m += drift * step_m

    def _place(self, vote: PlaceVote) -> int:
        """Put a vote into its slot."""
        votes, slot = self._votes, self._count % len(self._votes)
        self._count += 1
        self._slots[-1].append(slot)
        self._newest = np.concatenate([*self._slots])
        sign = 1.0 if vote.direction == "forward" else -1.0
        offset_m = vote.along_m - sign * self.driven_m
        lengths_m = self.driven_m, self.uncertain_m, offset_m, vote.start_m, vote.end_m, vote.lap_m, vote.ahead_m
        road = sum(self._roads) / len(self._roads)
        unique = min(max(0.0, vote.uniqueness - 1), MOST_UNIQUE)
        votes[slot] = (*lengths_m, unique, vote.drive, sign, 0.0, vote.row_share, False, road)
        support = float((votes["row_share"][self._newest] < LIKE_NEWEST).mean())
        votes["weight"][slot] = unique * max(0.0, vote.sharpness) * math.sqrt(support)
        return slot

    def _apart_m(self, slot: int) -> Floats:
        """By how much each vote may differ from one."""
        uncertain_m = self._votes["uncertain_m"]
        return np.asarray(self.settings.slack_m + np.abs(uncertain_m[slot] - uncertain_m))

    def _on_one_pass(self, slot: int) -> NDArray[np.bool_]:
        """Which votes agree with one by the odometer alone: on its drive, in its direction, and at its offset."""
        votes, own = self._votes, self._votes[slot]
        along = (votes["drive"] == own["drive"]) & (votes["sign"] == own["sign"])
        apart_m = np.abs(_within_lap(votes["offset_m"] - own["offset_m"], own["lap_m"]))
        return np.asarray(along & (apart_m <= self._apart_m(slot)))

    def _on_one_spot(self, slot: int) -> NDArray[np.bool_]:
        """Which votes put the vehicle where the newest one does: by another drive, or by another pass of the same."""
        near = np.zeros(len(self._votes), dtype=bool)
        if self._positions_of is None:
            return near
        own, now_m, most_m = self._votes[slot], self._now_m, self._apart_m(slot)
        apart_m = np.abs(_within_lap(now_m - now_m[slot], own["lap_m"]))
        # Twice, since a bend brings what disagrees on one pass together: it did on a recorded street.
        others = (self._votes["drive"] != own["drive"]) | (apart_m > 2 * most_m)
        others &= self._within(self.settings.reach_lines)
        if others.any():
            at = np.append(np.flatnonzero(others & (self._overrun_m(now_m) == 0)), slot)
            spots_m = self._positions_of(self._votes["drive"][at], now_m[at])
            near[at[:-1]] = np.hypot(*(spots_m[:-1] - spots_m[-1]).T) <= most_m[at[:-1]]
        return near

    def _moved_m(self) -> Floats:
        """Where each vote puts the vehicle now, along its drive."""
        votes = self._votes
        middle_m = (votes["start_m"] + votes["end_m"]) / 2
        now_m = votes["offset_m"] + votes["sign"] * self.driven_m
        return np.asarray(middle_m + _within_lap(now_m - middle_m, votes["lap_m"]))

    def _within(self, lines: float) -> NDArray[np.bool_]:
        """Which votes were cast within so many lengths of a sequence."""
        return np.asarray(self.driven_m - self._votes["at_m"] <= lines * self.settings.line_m)

    def _evidence(self, joined: NDArray[np.floating] | None = None) -> _Evidence:
        """What the votes add up to; joined: by what each of them counts less."""
        settings, votes = self.settings, self._votes
        in_reach, now_m = self._within(settings.reach_lines), self._now_m
        counted = votes["weight"] if joined is None else votes["weight"] * joined
        weights, recent = counted * in_reach, counted * self._within(settings.recent_lines)
        overrun_m = self._overrun_m(now_m)
        live = self._agree @ weights * np.square(self._agree @ recent / max(1e-9, float(recent.sum())))
        live *= (weights > 0) & (overrun_m <= settings.slack_m)  # one that says nothing leads nowhere
        return _Evidence(in_reach, now_m, overrun_m, weights, live)

    def _case(self, evidence: _Evidence, leader: int) -> _Case | None:
        """What speaks for the place of a vote, None if nothing does."""
        settings, votes = self.settings, self._votes
        in_reach, now_m, overrun_m, weights, live = evidence
        if live[leader] <= 0:
            return None
        # Of drives that agree and go on, that with most to say is followed: its votes tell best how fast places pass.
        ways = 2 * votes["drive"] + (votes["sign"] > 0)
        heaviest = np.bincount(ways, weights * self._agree[leader] * (live > 0)).argmax()
        leader = int(np.where(ways == heaviest, live * self._agree[leader], -1.0).argmax())
        group, own = in_reach & (self._agree[leader] > 0), votes[leader]
        one_pass = self._on_one_pass(leader)
        same = group & one_pass
        ahead_m = _within_lap(now_m[same] - now_m[leader], own["lap_m"])
        middle_m = (own["start_m"] + own["end_m"]) / 2
        along_m = now_m[leader] + weights[same] @ ahead_m / weights[same].sum()
        along_m = float(middle_m + math.remainder(along_m - middle_m, own["lap_m"]))
        # A drive that was believed and has been driven to its end says nothing against the one that follows.
        others = in_reach & ~group & ~(votes["was_believed"] & (overrun_m > settings.slack_m))
        beyond_m = max(0.0, float(own["start_m"]) - along_m, along_m - float(own["end_m"]))
        moves = max(0.0, 1 - beyond_m / settings.slack_m)
        moves *= min(1.0, 2 * self._pace(np.flatnonzero(same)))
        moves *= min(1.0, self._support(leader, one_pass, along_m, now_m) / FULL_SUPPORT)
        unlike = (float(weights[group] @ votes["unique"][group] / weights[group].sum()) - ALIKE) / (UNLIKE - ALIKE)
        return _Case(leader, along_m, group, others, moves, min(1.0, max(0.0, unlike)))

    def _believe(
        self, case: _Case | None, evidence: _Evidence, odds: Floats | None = None, *, excludes: bool = False
    ) -> PlaceBelief | None:
        """Whether a place is believed; excludes: whether dead reckoning excludes places elsewhere that are as good."""
        if case is None:
            return None
        settings, own = self.settings, self._votes[case.leader]
        opposed, own_odds = evidence.weights[case.others], 1.0
        if odds is not None:
            own_odds = float(odds[case.leader])
            opposed = opposed * np.minimum(1.0, odds[case.others] / own_odds)
        agreeing, against = float(evidence.live[case.leader]), float(opposed.sum())
        held = settings.prior * settings.length
        agreement = max(0.0, (agreeing - against) / (agreeing + against + held)) * case.moves
        agreement *= 1.0 if excludes else case.unlike
        confidence = probability(agreement, own_odds)
        is_believed = confidence >= settings.confidence_from
        self._votes["was_believed"] |= case.group & is_believed
        direction: Direction = "forward" if own["sign"] > 0 else "reverse"
        return PlaceBelief(int(own["drive"]), case.along_m, direction, confidence, is_believed)

    def _odds(self, prior: Prior, away_of: AwayOf, evidence: _Evidence) -> Floats:
        """By what the odds of each vote's place are multiplied, as far as it says something."""
        odds = np.ones(len(self._votes))
        at = np.flatnonzero(evidence.weights > 0)
        if at.size:
            drives, ahead_m = self._votes["drive"][at], self._votes["ahead_m"][at]
            odds[at] = prior.odds(away_of(drives, evidence.now_m[at] - ahead_m))
        return odds

    def _support(self, leader: int, one_pass: NDArray[np.bool_], along_m: float, now_m: Floats) -> float:
        """Share of the newest votes, of half a sequence, at the place, and of frames that are like it."""
        slots = self._newest
        votes, own = self._votes[slots], self._votes[leader]
        in_drive = votes["drive"] == own["drive"]
        is_near = np.abs(_within_lap(now_m[slots] - along_m, own["lap_m"])) <= self.settings.slack_m
        there = in_drive & (votes["sign"] == own["sign"]) & is_near
        there |= (self._agree[leader, slots] > 0) & ~one_pass[slots]
        return float(np.count_nonzero(there & (votes["row_share"] < STILL_LIKE))) / max(1, len(slots))

    def _pace(self, slots: NDArray[np.int64]) -> float:
        """Share of what was driven between some votes of one drive that their places went along with.

        0 where nobody measured it, and the places went along slower or faster than any line that was searched.
        """
        votes = self._votes[slots]
        shares = votes["weight"] / votes["weight"].sum()
        offsets_m = _within_lap(votes["offset_m"] - votes["offset_m"][0], votes["lap_m"])
        at_m, offsets_m = votes["at_m"] - shares @ votes["at_m"], offsets_m - shares @ offsets_m
        driven, strayed = float(shares @ np.square(at_m)), float(shares @ np.square(offsets_m))
        went = driven + float(votes["sign"][0] * (shares @ (at_m * offsets_m)))
        flattest, steepest = self.settings.slopes
        if self._odometer_m is None and not flattest * driven <= went <= steepest * driven:
            return 0.0
        return max(0.0, driven - strayed) / (driven + (self.settings.slack_m / 4) ** 2)

    def _overrun_m(self, now_m: Floats) -> Floats:
        """How far each vote's place, moved on to now, lies outside its drive."""
        return np.asarray(np.maximum(0.0, np.maximum(self._votes["start_m"] - now_m, now_m - self._votes["end_m"])))


def probability(agreement: float, odds: float = 1.0) -> float:
    """That a place is right whose votes agree so far, 0 to 1; odds: of the vehicle being there, without them."""
    right = odds * RIGHT_AT_HALF * agreement
    return right / (right + 1 - agreement)


def _within_lap(apart_m: Floats, lap_m: Floats | float) -> Floats:
    """Meters between places, the shorter way round where the drive is a closed lap."""
    return apart_m - np.rint(apart_m / lap_m) * lap_m
