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
from typing import Literal, TypeAlias

from edge.localization.evidence import SPREAD_M, STRETCH_WRONG
from edge.localization.filter import Filter
from edge.localization.measurements import SECOND_M
from edge.localization.state import DRAG, GPS, GYRO, POSITION

Name: TypeAlias = Literal["burst", "gyros", "gps dragged", "gps elsewhere", "map elsewhere", "lost", "beside", "slips"]
Row: TypeAlias = Name | Literal["right", "before"]
DRAG_MPS = 1.0
"""One standard deviation of a spoofing drift, in each direction."""
ELSEWHERE_M = 100.0
"""The same of how far off GPS, a drive of the map or all of it is, if it is elsewhere: a judgment. With 60 m in place
of it for drives of the map, not one of eight recorded drives is another."""
BURST_SHARE, BURST_M = 0.05, 7.0
"""Share of the fixes in a burst of multipath, and one standard deviation of it in each direction: 10 m are two."""
GYROS_SHARE, GYROS_RADPS = 1e-5, math.radians(1.0)
"""Probability that gyros have another bias from some moment on, and one standard deviation of it. With 1e-4 this
explains the spoofing drift of one of two recorded drives."""
HONEST: dict[Name, float] = {"burst": math.log(BURST_SHARE), "gyros": math.log(GYROS_SHARE)}
"""Hypotheses by which nothing is wrong that concerns the pilot, and the logarithm of how often they are true."""
ASKED: dict[Name, bool] = {"burst": True, "gyros": True, "lost": False, "beside": False, "slips": False}
"""Whether a hypothesis is asked for only with GPS, or only without it. It is run for as long after that as beginnings
are kept; the others are run always."""
COSTS: dict[Row, float] = {"map elsewhere": math.log(STRETCH_WRONG)}
"""Logarithm of how probable hypotheses are beside the others, where that is known."""
BEGINS_S, BEGUN = 5.0, 4
"""Seconds after which what creeps may have begun again, and how many beginnings are kept: a spoofing drift of 1 m/s is
declared within 15 s."""
SLIP = 0.15
"""One standard deviation of the scale of wheels that slip."""


class FilterBank:
    """The filter bank: one array of the right filter and of those of the other hypotheses.

    The right one is its first, and that which was right until the vehicle was lost its second, if there is one.
    """

    def __init__(self, right: Filter) -> None:
        self._last_s = dict.fromkeys((True, False), -math.inf)  # with GPS, and without it
        self._began_s = -math.inf
        self.all, self.names = right.take(None), list[Row](["right"])

    def begin(self, right: Row = "right", before: Row | None = None) -> None:
        """All hypotheses begin with one filter. before: the one that was right until the vehicle was lost."""
        self._keep([self._row(right), *self._rows(before)])
        self.names[1:] = ["before"] * (len(self.names) - 1)
        self.names[0], self._began_s = "right", -math.inf

    def drop_before(self) -> None:
        """The vehicle was lost."""
        self._keep([row for row, name in enumerate(self.names) if name != "before"])

    def _keep(self, rows: list[int]) -> None:
        self.all, self.names = self.all.take(rows), [self.names[row] for row in rows]

    def _rows(self, name: Row | None) -> list[int]:
        return [row for row, one in enumerate(self.names) if one == name]

    def _row(self, name: Row) -> int:
        rows = self._rows(name)
        if name == "gps dragged":  # one that has found nothing to be otherwise is only less certain
            rows = [row for row, found in zip(rows, self.all.are_found(rows, DRAG), strict=True) if found]
        return max(rows, key=self.all.likelihood.item, default=0)

    @property
    def right(self) -> Filter:
        """The right filter."""
        return self.all.take(0)

    @property
    def before(self) -> Filter | None:
        """The one that was right until the vehicle was lost."""
        return self.of("before") if "before" in self.names else None

    def of(self, name: Row) -> Filter:
        """The likeliest filter of a hypothesis; the right one where it has none."""
        return self.all.take(self._row(name))

    def evidence(self, *names: Row) -> float:
        """Logarithm of how much likelier the likeliest of some hypotheses is than that all is right; 0 at least."""
        likelihood: list[float] = self.all.likelihood.tolist()
        return max(0.0, *(likelihood[self._row(name)] + COSTS.get(name, 0.0) - likelihood[0] for name in names))

    def judge(self, now_s: float, *, has_gps: bool) -> None:
        """After all that was measured by a time in seconds; has_gps: whether GPS counts."""
        self._last_s[has_gps] = now_s
        unasked = {name for name, asks in ASKED.items() if now_s - self._last_s[asks] > BEGINS_S * BEGUN}
        likelihood, right, gone = self.all.likelihood, 0, set[Row](unasked)
        for name, cost in HONEST.items():
            row = self._row(name)
            if name not in unasked and likelihood[row] + cost > likelihood[right]:
                likelihood[row] += cost
                right = row
                gone.add(name)
        begin = [name for name in JUMPS if name not in unasked and likelihood[self._row(name)] <= likelihood[right]]
        gone.update(begin)
        kept = [row for row, name in enumerate(self.names) if row and name not in gone]
        if now_s - self._began_s >= BEGINS_S:
            self._began_s = now_s
            for name in [name for name in CREEPS if name not in unasked]:
                begun = [row for row in self._rows(name) if row in kept]
                if len(begun) == BEGUN:  # the oldest that is not the likeliest
                    likeliest = max(begun, key=likelihood.item)
                    kept.remove(next(row for row in begun if row != likeliest))
                begin.append(name)
        self._keep([right, *kept, *[right] * len(begin)])
        self.names = ["right", *self.names[1 : len(kept) + 1], *begin]
        for row, name in enumerate(begin, len(kept) + 1):
            (JUMPS | CREEPS)[name](self.all.take(row))


def _gps_elsewhere(state: Filter) -> None:
    state.widen(GPS, ELSEWHERE_M)
    state.keeps_gps[...] = True


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
    "gyros": lambda state: state.widen(GYRO, GYROS_RADPS),
    "slips": lambda state: state.doubt_scale(SLIP),
}
