"""Metres driven, at any moment: ground speed integrated, looked up at the stamp of a frame."""

from __future__ import annotations

from bisect import bisect_right

FRESH_NS = 1_000_000_000  # how long a speed holds beyond its stamp
BRIDGE_NS = 2_000_000_000  # the longest silence that two speeds are believed to span
STANDING_MPS = 0.1  # a standing EKF still reports 0.04 m/s (recorded Rover 4.6.3)
KEPT = 1024
FASTEST_MPS = 350.0  # a speed beyond it is damage, or not a number


class Odometer:
    """Integrates ground speed by the trapezoid rule, from the best source that still speaks."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._distances_m: list[float] = []
        self._speed_mps = 0.0
        self._source = 0
        self._answered = (0, 0.0)

    def add(self, stamp_ns: int, speed_mps: float, source: int) -> None:
        """A ground speed; `source` ranks its origin, 0 the best, and a worse one counts only after silence."""
        if not 0 <= speed_mps <= FASTEST_MPS:
            return
        if not self._stamps_ns:
            self._append(stamp_ns, 0.0, speed_mps, source)
            return
        gap_ns = stamp_ns - self._stamps_ns[-1]
        if gap_ns <= 0 or (source > self._source and gap_ns < FRESH_NS):
            return
        mean_mps = (_moving(speed_mps) + _moving(self._speed_mps)) / 2
        driven_m = mean_mps * gap_ns / 1e9 if gap_ns <= BRIDGE_NS else 0.0
        self._append(stamp_ns, self._distances_m[-1] + driven_m, speed_mps, source)

    def _append(self, stamp_ns: int, distance_m: float, speed_mps: float, source: int) -> None:
        self._stamps_ns.append(stamp_ns)
        self._distances_m.append(distance_m)
        self._speed_mps, self._source = speed_mps, source
        if len(self._stamps_ns) > 2 * KEPT:
            del self._stamps_ns[:KEPT], self._distances_m[:KEPT]

    @property
    def total_m(self) -> float | None:
        """All metres driven up to the newest report, None before the first."""
        return self._distances_m[-1] if self._distances_m else None

    def distance_m(self, stamp_ns: int) -> float | None:
        """Metres driven at `stamp_ns`; None when no speed was known around then. Never less than it was before."""
        index = bisect_right(self._stamps_ns, stamp_ns)
        if index == 0:
            return None
        if index == len(self._stamps_ns):
            ahead_ns = stamp_ns - self._stamps_ns[-1]
            if ahead_ns > FRESH_NS:
                return None
            distance_m = self._distances_m[-1] + _moving(self._speed_mps) * ahead_ns / 1e9
        else:
            before_ns, after_ns = self._stamps_ns[index - 1], self._stamps_ns[index]
            share = (stamp_ns - before_ns) / (after_ns - before_ns)
            before_m = self._distances_m[index - 1]
            distance_m = before_m + share * (self._distances_m[index] - before_m)
        return self._not_back(stamp_ns, distance_m)

    def _not_back(self, stamp_ns: int, distance_m: float) -> float:
        """Hold a distance that was told while braking, until the vehicle has really driven it."""
        told_ns, told_m = self._answered
        if stamp_ns < told_ns:
            return distance_m
        self._answered = (stamp_ns, max(distance_m, told_m))
        return self._answered[1]

    def speed_mps(self, now_ns: int) -> float | None:
        """The newest ground speed, None when it is older than a second."""
        if not self._stamps_ns or now_ns - self._stamps_ns[-1] > FRESH_NS:
            return None
        return self._speed_mps


def _moving(speed_mps: float) -> float:
    return speed_mps if speed_mps >= STANDING_MPS else 0.0
