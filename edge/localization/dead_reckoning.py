"""Metres east and north by the autopilot's own reckoning: its velocity integrated, whatever its position jumps to."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

BRIDGE_NS = 2_000_000_000  # the longest silence that two velocities are believed to span
KEPT = 1024
FASTEST_MPS = 350.0  # beyond it is damage, or not a number


@dataclass(frozen=True)
class Reckoned:
    """Metres east and north since the beginning of a leg; those of different legs say nothing about each other."""

    leg: int
    east_m: float
    north_m: float


@dataclass(frozen=True)
class _Moment:
    stamp_ns: int
    reckoned: Reckoned
    east_mps: float
    north_mps: float


class DeadReckoning:
    """Integrates velocity by the trapezoid rule; a silence begins a new leg."""

    def __init__(self) -> None:
        self._past: deque[_Moment] = deque(maxlen=KEPT)
        self._legs = 0

    def add(self, stamp_ns: int, east_mps: float, north_mps: float) -> None:
        """A velocity; one that is older than the last is ignored."""
        if not math.hypot(east_mps, north_mps) <= FASTEST_MPS:
            return
        last = self._past[-1] if self._past else None
        if last is not None and stamp_ns <= last.stamp_ns:
            return
        if last is None or stamp_ns - last.stamp_ns > BRIDGE_NS:
            self.begin_leg()
            reckoned = Reckoned(self._legs, 0.0, 0.0)
        else:
            half_s = (stamp_ns - last.stamp_ns) / 2e9
            reckoned = Reckoned(
                self._legs,
                last.reckoned.east_m + half_s * (east_mps + last.east_mps),
                last.reckoned.north_m + half_s * (north_mps + last.north_mps),
            )
        self._past.append(_Moment(stamp_ns, reckoned, east_mps, north_mps))

    def begin_leg(self) -> None:
        """Nothing before has to do with what follows."""
        self._past.clear()
        self._legs += 1

    def at(self, stamp_ns: int) -> Reckoned | None:
        """Where the vehicle was at that moment; None when it is not within the leg, or too long ago."""
        index = bisect_right(self._past, stamp_ns, key=lambda moment: moment.stamp_ns)
        if index == 0:
            return None
        last = self._past[index - 1]
        since_s = (stamp_ns - last.stamp_ns) / 1e9
        if since_s > BRIDGE_NS / 1e9:
            return None
        return Reckoned(
            last.reckoned.leg,
            last.reckoned.east_m + since_s * last.east_mps,
            last.reckoned.north_m + since_s * last.north_mps,
        )
