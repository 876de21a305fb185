"""A drive of a course, and the rules that it must pass, from truth, positions and the same drive without Lookback."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.trial.records import ARRIVED_M, LANE_M, MOST_SIGMAS, Array, TrialRun, lane_off_m, lost_s

FALSE_M, WRONG_M = 40.0, 20.0
"""Of a position from the truth, and of the place that a frame is believed to show."""
LINE_M, AT_REST_M = 80.0, 0.5
FIRST_M, AGAIN_M = 350.0, 200.0
SENT_WITHIN_S = 3.0
LEVEL_FOLLOWS_S = 0.15
SENT_SHARE = 0.4
FAILSAFE_S = 6.0
WARNING, WARNED_S = 4, 30.0
CALLED_M, USUAL_M = 50.0, 10.0
UNRECOGNIZED = "not recognized where GPS"
TOLD = "GPS faulty", "GPS inconsistent", "map faulty", UNRECOGNIZED
TOLD_M = 60.0
"""Within which the pilot must read of a difference, after the LINE_M that recognizing a place takes."""


class Failure(NamedTuple):
    """A rule that was not kept, and by how much."""

    rule: str
    found: str


@dataclass(frozen=True, kw_only=True)
class CourseRun(TrialRun):
    """A run of a course.

    expected: when positions may be expected, since the road is on a right map and GPS is lost (N,), as in `track`.
    after_m: the autopilot's error after each position that moved it. texts: STATUSTEXT, with its time and severity.
    source_set: of ArduPilot's filter, at the end. lane_m: how far positions (n, 2) are along the way and across it from
    where the map, with its errors, would have the vehicle: from the lane that was taught. Of none on several drives.
    turned_deg: how far the headings of places (n,) are off that rest on poses. used, believed, wrong: frames, see
    WRONG_M. known: (n, 2), when places were believed, at rest as well, and by how many meters they are off. set_down_m:
    where the vehicle was carried to, along the way, or began.
    """

    expected: NDArray[np.bool_]
    after_m: Array
    texts: tuple[tuple[float, int, str], ...] = ()
    source_set: int = 1
    lane_m: Array = field(default_factory=lambda: np.empty((0, 2)))
    turned_deg: Array = field(default_factory=lambda: np.empty(0))
    used: int = 0
    believed: int = 0
    wrong: int = 0
    known: Array = field(default_factory=lambda: np.empty((0, 2)))
    set_down_m: float = 0.0
    failures: tuple[Failure, ...] = ()

    @property
    def share_sent(self) -> float:
        """Share of the time in which positions were expected and the last one was no older than SENT_WITHIN_S."""
        times_s = self.track.time_s[self.expected]
        if not len(times_s):
            return math.nan
        before = np.searchsorted(self.sent.time_s, times_s, side="right")
        last_s = np.concatenate([[-math.inf], self.sent.time_s])[before]
        return float(np.mean(times_s - last_s <= SENT_WITHIN_S))

    @property
    def known_after_m(self) -> float:
        """Meters from where the vehicle was set down to the first right place; NaN without any."""
        track = self.track
        row = np.searchsorted(track.along_m, self.set_down_m).clip(0, len(track.along_m) - 1)
        since = self.known[:, 0] >= track.time_s[row]
        right_s = self.known[since & (self.known[:, 1] <= WRONG_M), 0]
        if not len(right_s):
            return math.nan
        return float(np.interp(right_s.min(), track.time_s, track.along_m)) - self.set_down_m


Rule = Callable[[CourseRun], str]
"""What was found instead, in a few words; "" if the rule is kept."""


def failures(run: CourseRun, rules: Sequence[Rule]) -> tuple[Failure, ...]:
    """The rules that a drive does not keep."""
    found = ((rule.__name__.replace("_", " "), rule(run)) for rule in rules)
    return tuple(Failure(name, what) for name, what in found if what)


def within_sigmas(run: CourseRun) -> str:
    """No position is beyond 4 of its sigmas."""
    worst = run.sent.sigmas.max(initial=0.0)
    return f"{worst:.1f} sigma" if not worst <= MOST_SIGMAS else ""


def within_protection_level(run: CourseRun) -> str:
    """No position is further off along the way, or across it, than its protection level there."""
    row = np.searchsorted(run.levels[:, 0], run.sent.time_s)  # they follow the position
    has_one = row < len(run.levels)
    at_s, *levels_m = run.levels[row[has_one]].T
    is_its_own = at_s - run.sent.time_s[has_one] < LEVEL_FOLLOWS_S
    beyond = (np.abs(run.sent.off_m[has_one]) > np.transpose(levels_m)).any(axis=1) & is_its_own
    return f"{beyond.sum()} positions" if beyond.any() else ""


def no_false_place(run: CourseRun) -> str:
    """No position is of a false place."""
    false = int((run.sent.error_m > FALSE_M).sum())
    return f"{false} false, up to {run.sent.error_m.max():.0f} m" if false else ""


def not_worse(run: CourseRun) -> str:
    """Position and cross-track are no worse than without Lookback, but for a meter and a tenth."""
    for name, ours, alone in (
        ("error", run.track.error_m, run.alone.error_m),
        ("cross-track", np.abs(run.track.cross_track_m), np.abs(run.alone.cross_track_m)),
    ):
        with_m, without_m = np.percentile(ours, 95), np.percentile(alone, 95)
        if with_m > 1.1 * without_m + 1.0:
            return f"{name} {with_m:.1f} m, alone {without_m:.1f} m"
    return ""


HONEST: tuple[Rule, ...] = (within_sigmas, no_false_place)
USUAL: tuple[Rule, ...] = (*HONEST, not_worse)


def never_wrong(run: CourseRun) -> str:
    """No place is believed that is over 20 m off."""
    wrong = run.known[run.known[:, 1] > WRONG_M, 1]
    return f"{len(wrong)} places wrong, up to {wrong.max():.0f} m" if len(wrong) else ""


def known_at_rest(run: CourseRun) -> str:
    """A place is believed before the vehicle sets off."""
    return "" if run.known_after_m < AT_REST_M else f"accepted after {run.known_after_m:.0f} m"


def known_again(run: CourseRun) -> str:
    """A place is believed within 80 m of where the vehicle was set down."""
    return "" if run.known_after_m <= LINE_M else f"accepted after {run.known_after_m:.0f} m"


def resumes(run: CourseRun) -> str:
    """Where positions may be expected, the first comes within 350 m, and each next one within 200 m."""
    track = run.track
    gap_m, most_m, last_m = 0.0, FIRST_M, track.along_m[0]
    sent = np.searchsorted(track.time_s, run.sent.time_s)
    is_sent = np.bincount(sent.clip(0, len(track.time_s) - 1), minlength=len(track.time_s)) > 0
    for along_m, expected, here in zip(track.along_m, run.expected, is_sent, strict=True):
        if here:
            gap_m, most_m = 0.0, AGAIN_M
        elif expected:
            gap_m += abs(along_m - last_m)
        if gap_m > most_m:
            return f"none for {most_m:.0f} m at {along_m:.0f} m"
        last_m = along_m
    return ""


def arrives(run: CourseRun) -> str:
    """The vehicle ends within 10 m of where it should."""
    return f"{run.track.end_off_m:.0f} m off" if run.track.end_off_m > ARRIVED_M else ""


def on_its_lane(run: CourseRun) -> str:
    """Without GPS, the cross-track error is at most 5 m (95 %)."""
    left_m = lane_off_m(run.track)
    return f"cross-track {left_m:.1f} m" if left_m > LANE_M else ""


def close(run: CourseRun) -> str:
    """After a position that moved it, the autopilot is right within 3 m (median) and 6 m (95 %), and on its lane within
    5 m (95 %)."""
    # One that needed no reset is judged as it was.
    after_m = np.percentile(run.after_m if len(run.after_m) else run.track.error_m[~run.track.gps], [50, 95])
    found = *after_m, np.percentile(np.abs(run.track.cross_track_m), 95)
    names = ("median after", "95 % after", "cross-track")
    return next((f"{n} {v:.1f} m" for n, v, most in zip(names, found, (3, 6, 5), strict=True) if v > most), "")


def sends(run: CourseRun) -> str:
    """Positions are sent for a good share of the time in which they may be expected."""
    return f"share sent {run.share_sent:.2f}" if run.share_sent < SENT_SHARE else ""


def never_sent(run: CourseRun) -> str:
    """No position is sent."""
    return f"{len(run.sent.time_s)} sent" if len(run.sent.time_s) else ""


def not_with_gps(run: CourseRun) -> str:
    """No position arrives once GPS has been back for 2 s."""
    lost_s = run.track.time_s[~run.track.gps]
    late = int((run.sent.time_s > lost_s[-1] + 2.0).sum()) if len(lost_s) else len(run.sent.time_s)
    return f"{late} sent with GPS" if late else ""


def sources_restored(run: CourseRun) -> str:
    """Positions are used, and with GPS the filter ends on its first set of sources."""
    if not len(run.after_m):
        return "no position used"
    return f"ends on source set {run.source_set}" if run.source_set != 1 else ""


def warns(run: CourseRun) -> str:
    """Within 30 s of the first position, a warning about positions says that the autopilot does not follow."""
    if not len(run.sent.time_s):
        return "no position sent"
    first_s = run.sent.time_s[0]
    warned = [
        text
        for time_s, severity, text in run.texts
        if severity <= WARNING and first_s <= time_s <= first_s + WARNED_S and "position" in text.lower()
    ]
    return "" if warned else "no warning"


def first_in_time(run: CourseRun) -> str:
    """The first position comes within 6 s of the loss of GPS."""
    gps_lost_s = lost_s(run)
    first_s = min((time_s for time_s in run.sent.time_s if time_s >= gps_lost_s), default=math.inf) - gps_lost_s
    return f"first after {first_s:.1f} s" if first_s > FAILSAFE_S else ""


def called_before_50_m(run: CourseRun) -> str:
    """GPS is declared faulty before the autopilot, which follows it, is 50 m wrong."""
    called_s = _called_s(run)
    worst_m = run.track.error_m[run.track.time_s <= called_s].max()
    return f"{worst_m:.0f} m before a call" if worst_m >= CALLED_M else ""


def called_soon(run: CourseRun) -> str:
    """GPS is declared faulty within 200 m of the moment at which the autopilot is 20 m wrong."""
    wrong = np.flatnonzero(run.track.error_m > CALLED_M * 0.4)
    if not len(wrong):
        return ""
    until = np.searchsorted(run.track.time_s, _called_s(run)).clip(0, len(run.track.time_s) - 1)
    driven_m = abs(run.track.along_m[until] - run.track.along_m[wrong[0]])
    return f"not called for {driven_m:.0f} m" if driven_m > AGAIN_M else ""


def called_on_map(run: CourseRun) -> str:
    """Once GPS is wrong, it is declared faulty by the end of the drive."""
    return "not called" if math.isinf(_called_s(run)) else ""


def never_called(run: CourseRun) -> str:
    """GPS is not declared faulty, nor the vehicle said to be unrecognized where GPS has it."""
    for what, at_s in (("called", _called_s(run)), ("warned", _called_s(run, UNRECOGNIZED))):
        if not math.isinf(at_s):
            return f"{what} at {at_s:.0f} s"
    return ""


def warned_before_50_m(run: CourseRun) -> str:
    """GPS is declared faulty, or the pilot warned, before the autopilot, which steers by it, is 50 m wrong."""
    warned_s = min(_called_s(run), _called_s(run, UNRECOGNIZED))
    worst_m = run.track.error_m[run.track.time_s <= warned_s].max()
    return "no warning" if math.isinf(warned_s) else f"{worst_m:.0f} m before it" if worst_m >= CALLED_M else ""


def told_after(from_m: float, off_from_s: float = math.inf) -> Rule:
    """The rule that the pilot reads of GPS or the map soon after the two begin to disagree, at a meter of the way.

    off_from_s: when GPS jumps; own motion may show that before a place does.
    """

    def told_soon(run: CourseRun) -> str:
        warnings = [(at_s, text) for at_s, severity, text in run.texts if severity <= WARNING]
        told_s = [at_s for at_s, text in warnings if any(one in text for one in TOLD)]
        after_m = np.interp(told_s, run.track.time_s, run.track.along_m) - from_m
        told_m = min(after_m[(after_m >= 0) | (np.array(told_s) >= off_from_s)], default=math.inf)
        return f"told after {told_m:.0f} m" if told_m > LINE_M + TOLD_M else ""

    return told_soon


def back_to_usual(run: CourseRun) -> str:
    """From 200 m after the call on, the autopilot's error is at most 10 m (95 %)."""
    track, called_s = run.track, _called_s(run)
    if math.isinf(called_s):
        return ""
    at_m = np.interp(called_s, track.time_s, track.along_m)
    errors_m = track.error_m[(track.time_s > called_s) & (track.along_m > at_m + AGAIN_M)]
    if not len(errors_m):
        return ""
    error_m = np.percentile(errors_m, 95)
    return f"error {error_m:.0f} m after the call" if error_m > USUAL_M else ""


def _called_s(run: CourseRun, text: str = "GPS faulty") -> float:
    return min((time_s for time_s, severity, one in run.texts if text in one and severity <= WARNING), default=math.inf)
