"""What a drive of a course was worth, by the truth that only the simulator knows, and the rules that it must pass."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.vehicle.protection import availability

Array = NDArray[np.float64]
MOST_SIGMAS, FALSE_M = 4.0, 40.0
FIRST_M, AGAIN_M = 350.0, 200.0
SENT_WITHIN_S = 3.0
LEVEL_FOLLOWS_S = 0.15
ARRIVED_M, LANE_M = 10.0, 5.0


class Failure(NamedTuple):
    """A rule that was not kept, and by how much."""

    rule: str
    found: str


@dataclass(frozen=True)
class Track:
    """Truth and belief of a drive, ten times a second: arrays (N,).

    along_m, left_m: true place on the way. error_m: of the autopilot's own position. gps: whether its filter fuses GPS.
    expected: whether positions may be expected here, since the road is on a right map and GPS is lost. end_off_m: from
    where the vehicle stops to where it should.
    """

    time_s: Array
    along_m: Array
    left_m: Array
    error_m: Array
    gps: NDArray[np.bool_]
    expected: NDArray[np.bool_]
    end_off_m: float = 0.0


@dataclass(frozen=True)
class Sent:
    """Positions as they arrived: when, and for the moment of each its error and its sigma.

    sigma_m: what is known of the position, or what its message says if that is less.
    """

    time_s: Array
    error_m: Array
    sigma_m: Array

    @property
    def sigmas(self) -> Array:
        """Errors over sigmas."""
        return self.error_m / self.sigma_m


@dataclass(frozen=True)
class Run:
    """One drive, and what it would have been without Lookback.

    after_m: the autopilot's error after each position that moved it. texts: STATUSTEXT, with its time and severity.
    source_set: of ArduPilot's filter, at the end. levels: protection levels (n, 3), see `protection_levels`.
    """

    seed: int
    world: int
    track: Track
    alone: Track
    sent: Sent
    after_m: Array
    texts: tuple[tuple[float, int, str], ...] = ()
    source_set: int = 1
    levels: Array = field(default_factory=lambda: np.zeros((0, 3)))
    failures: tuple[Failure, ...] = ()

    @property
    def available(self) -> float:
        """Share of the time without GPS in which a position had protection levels below 15 m."""
        return availability(self.levels, self.track.time_s[~self.track.gps])

    @property
    def share_sent(self) -> float:
        """Share of the time in which positions were expected and the last one was no older than SENT_WITHIN_S."""
        times_s = self.track.time_s[self.track.expected]
        if not len(times_s):
            return math.nan
        before = np.searchsorted(self.sent.time_s, times_s, side="right")
        last_s = np.concatenate([[-math.inf], self.sent.time_s])[before]
        return float(np.mean(times_s - last_s <= SENT_WITHIN_S))

    @property
    def first_after_m(self) -> float:
        """Meters from the loss of GPS to the first position; NaN without either."""
        sent_s = self.sent.time_s[self.sent.time_s >= lost_s(self)]
        along_m = np.interp([lost_s(self), *sent_s[:1]], self.track.time_s, self.track.along_m)
        return float(along_m[1] - along_m[0]) if len(along_m) > 1 else math.nan


Rule = Callable[[Run], str]
"""What was found instead, in a few words; "" if the rule is kept."""


def failures(run: Run, rules: Sequence[Rule]) -> tuple[Failure, ...]:
    """The rules that a drive does not keep."""
    found = ((rule.__name__.replace("_", " "), rule(run)) for rule in rules)
    return tuple(Failure(name, what) for name, what in found if what)


def within_sigmas(run: Run) -> str:
    """No position is beyond 4 of its sigmas."""
    worst = run.sent.sigmas.max(initial=0.0)
    return f"{worst:.1f} sigma" if not worst <= MOST_SIGMAS else ""


def within_protection_level(run: Run) -> str:
    """No position is further off than its protection levels."""
    row = np.searchsorted(run.levels[:, 0], run.sent.time_s)  # they follow the position
    has_one = row < len(run.levels)
    at_s, along_m, across_m = run.levels[row[has_one]].T
    is_its_own = at_s - run.sent.time_s[has_one] < LEVEL_FOLLOWS_S
    beyond = (run.sent.error_m[has_one] > np.hypot(along_m, across_m)) & is_its_own
    return f"{beyond.sum()} positions" if beyond.any() else ""


def no_false_place(run: Run) -> str:
    """No position is of a false place."""
    false = int((run.sent.error_m > FALSE_M).sum())
    return f"{false} false, up to {run.sent.error_m.max():.0f} m" if false else ""


def not_worse(run: Run) -> str:
    """Position and cross-track are no worse than without Lookback, but for a meter and a tenth."""
    for name, ours, alone in (
        ("error", run.track.error_m, run.alone.error_m),
        ("cross-track", np.abs(run.track.left_m), np.abs(run.alone.left_m)),
    ):
        with_m, without_m = np.percentile(ours, 95), np.percentile(alone, 95)
        if with_m > 1.1 * without_m + 1.0:
            return f"{name} {with_m:.1f} m, alone {without_m:.1f} m"
    return ""


def resumes(run: Run) -> str:
    """Where positions may be expected, the first comes within 350 m, and each next one within 200 m."""
    track = run.track
    gap_m, most_m, last_m = 0.0, FIRST_M, track.along_m[0]
    sent = np.searchsorted(track.time_s, run.sent.time_s)
    is_sent = np.bincount(sent.clip(0, len(track.time_s) - 1), minlength=len(track.time_s)) > 0
    for along_m, expected, here in zip(track.along_m, track.expected, is_sent, strict=True):
        if here:
            gap_m, most_m = 0.0, AGAIN_M
        elif expected:
            gap_m += abs(along_m - last_m)
        if gap_m > most_m:
            return f"none for {most_m:.0f} m at {along_m:.0f} m"
        last_m = along_m
    return ""


def arrives(run: Run) -> str:
    """The vehicle ends within 10 m of where it should."""
    return f"{run.track.end_off_m:.0f} m off" if run.track.end_off_m > ARRIVED_M else ""


def on_its_lane(run: Run) -> str:
    """Without GPS, the cross-track error is at most 5 m (95 %)."""
    left_m = lane_off_m(run.track)
    return f"cross-track {left_m:.1f} m" if left_m > LANE_M else ""


def lane_off_m(track: Track) -> float:
    """95 % of the cross-track error without GPS, m."""
    return float(np.percentile(np.abs(track.left_m[~track.gps]), 95)) if not track.gps.all() else 0.0


def lost_s(run: Run) -> float:
    """When GPS was fused last; 0 where it never was."""
    with_gps = np.flatnonzero(run.track.gps)
    return float(run.track.time_s[with_gps[-1]]) if len(with_gps) else 0.0
