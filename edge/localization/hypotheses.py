"""What may be wrong: one filter for each hypothesis, and how likely each is by what was measured. Pure.

    right          all is as it seems
    burst          right, but multipath displaces GPS for a while
    gyros          right, but the gyros have another bias
    gps dragged    spoofing: GPS drifts away at an unknown speed
    gps elsewhere  GPS is somewhere else, and stays so
    map elsewhere  the drive of the map that is matched is somewhere else
    lost           the vehicle is somewhere else: it was carried (kidnapped), or followed a false place
    beside         the vehicle is where a second solution of keypoint poses has it
    slips          the scale of the velocity is another one

A hypothesis begins as a copy of the right filter in which one thing is unknown. One that jumps begins anew whenever it
is less likely than the right one: Page's rule, with the innovations of Kalman filters. One that creeps begins every few
seconds, and the likeliest beginning counts: a generalized likelihood ratio (Willsky and Jones 1976). What GPS and
places contradict each other by is alike for both; the vehicle's own motion, which all share, tells them apart. What
nobody asks for is not run: a vehicle that has GPS is not lost, and without GPS no burst displaces it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import chain
from typing import Literal, TypeAlias

from edge.localization.evidence import SPREAD_M, STRETCH_WRONG
from edge.localization.filter import DRAG, GPS, GYRO, POSITION, Filter
from edge.localization.measurements import SECOND_M

Name: TypeAlias = Literal["burst", "gyros", "gps dragged", "gps elsewhere", "map elsewhere", "lost", "beside", "slips"]
DRAG_MPS = 1.0
"""One standard deviation of a spoofing drift, in each direction."""
ELSEWHERE_M = 100.0
"""The same of how far off GPS, a drive of the map or all of it is, if it is elsewhere: a judgment. With 60 m in place
of it for drives of the map, not one of eight recorded drives is another."""
BURST_SHARE, BURST_M = 0.05, 7.0
"""Share of the fixes in a burst of multipath, and one standard deviation of it in each direction: 10 m are two."""
GYROS_SHARE, GYROS_RADPS = 1e-5, math.radians(1.0)
"""Probability that gyros have another bias from some moment on, and one standard deviation of it. With 1e-4 this
explains the spoofing drift of one of two recorded drives: GPS is then declared faulty at 12 m instead of 10, and
positions are up to 5.1 sigma off instead of 2.9."""
HONEST: dict[Name, float] = {"burst": math.log(BURST_SHARE), "gyros": math.log(GYROS_SHARE)}
"""Hypotheses by which nothing is wrong that concerns the pilot, and the logarithm of how often they are true."""
ASKED: dict[Name, bool] = {"burst": True, "gyros": True, "lost": False, "beside": False, "slips": False}
"""Whether a hypothesis is asked for only with GPS, or only without it. It is run for as long after that as beginnings
are kept; the others are run always."""
COSTS: dict[Name, float] = {"map elsewhere": math.log(STRETCH_WRONG)}
"""Logarithm of how probable hypotheses are beside the others, where that is known."""
BEGINS_S, BEGUN = 5.0, 4
"""Seconds after which what creeps may have begun again, and how many beginnings are kept: a spoofing drift of 1 m/s is
declared within 15 s."""
SLIP = 0.15
"""One standard deviation of the scale of wheels that slip."""


class FilterBank:
    """The filter bank: the right filter, and those of the other hypotheses."""

    def __init__(self, right: Filter) -> None:
        self._last_s = dict.fromkeys((True, False), -math.inf)  # with GPS, and without it
        self.begin(right)

    def begin(self, right: Filter, before: Filter | None = None) -> None:
        """All hypotheses begin with this filter. before: the one that was right until the vehicle was lost."""
        self.right, self.before = right, before
        self._jumped: dict[Name, Filter] = {}
        self._crept: dict[Name, list[Filter]] = {}
        self._began_s = -math.inf

    def each(self, use: Callable[[Filter], bool | None]) -> bool:
        """Predict or correct all of them; what the right one returned."""
        kept = () if self.before is None else (self.before,)
        for one in (*kept, *self._jumped.values(), *chain.from_iterable(self._crept.values())):
            use(one)
        return bool(use(self.right))

    def of(self, name: Name) -> Filter:
        """The likeliest filter of a hypothesis; the right one where it is none."""
        if name in self._crept:
            # One that has found nothing to be otherwise is only less certain.
            begun = [one for one in self._crept[name] if name != "gps dragged" or one.is_found(DRAG)]
            return max(begun, key=lambda one: one.likelihood, default=self.right)
        return self._jumped.get(name, self.right)

    def evidence(self, *names: Name) -> float:
        """Logarithm of how much likelier the likeliest of some hypotheses is than that all is right; 0 at least."""
        right = self.right.likelihood
        return max(0.0, *(self.of(name).likelihood + COSTS.get(name, 0.0) - right for name in names))

    def judge(self, now_s: float, *, has_gps: bool) -> None:
        """After all that was measured by a time in seconds; has_gps: whether GPS counts."""
        self._last_s[has_gps] = now_s
        unasked = [name for name, asks in ASKED.items() if now_s - self._last_s[asks] > BEGINS_S * BEGUN]
        for name in unasked:
            self._jumped.pop(name, None)
            self._crept.pop(name, None)
        for name, cost in HONEST.items():
            honest = self.of(name)
            if honest.likelihood + cost <= self.right.likelihood:
                continue
            honest.likelihood += cost
            self.right = honest
            self._jumped.pop(name, None)
            self._crept.pop(name, None)
        for name in JUMPS.keys() - unasked:
            other = self._jumped.get(name)
            if other is None or other.likelihood <= self.right.likelihood:
                other = self._jumped[name] = self.right.copy()
                JUMPS[name](other)
        if now_s - self._began_s < BEGINS_S:
            return
        self._began_s = now_s
        for name in CREEPS.keys() - unasked:
            begun = self._crept.setdefault(name, [])
            if len(begun) == BEGUN:  # the oldest that is not the likeliest
                likeliest = max(begun, key=lambda one: one.likelihood)
                begun.remove(next(one for one in begun if one is not likeliest))
            begun.append(self.right.copy())
            CREEPS[name](begun[-1])


def _gps_elsewhere(state: Filter) -> None:
    state.widen(GPS, ELSEWHERE_M)
    state.keeps_gps = True


def _map_elsewhere(state: Filter) -> None:
    if state.newest is not None:
        state.widen(state.newest.whole, ELSEWHERE_M)


JUMPS: dict[Name, Callable[[Filter], None]] = {
    "burst": lambda state: state.widen(GPS, BURST_M),
    "gps elsewhere": _gps_elsewhere,
    "map elsewhere": _map_elsewhere,
    "lost": lambda state: state.widen(POSITION, SPREAD_M),
    "beside": lambda state: state.widen(POSITION, SECOND_M),
}
CREEPS: dict[Name, Callable[[Filter], None]] = {
    "gps dragged": lambda state: state.widen(DRAG, DRAG_MPS),
    "gyros": lambda state: state.widen(slice(GYRO, GYRO + 1), GYROS_RADPS),
    "slips": lambda state: state.doubt_scale(SLIP),
}
