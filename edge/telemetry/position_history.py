"""The autopilot's position at the exposure of a frame, with its accuracy and what it rests on. No I/O.

A position comes 0.1 s before or after a frame, in which a car drives 3 m. So it is interpolated between the one before
and the one after, which a frame has to wait for.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Generic, TypeVar

from edge.geodesy import VehiclePosition, east_north_of, heading_between, moved, worse_source

T = TypeVar("T")
KEPT_POSITIONS = 64
LONGEST_GAP_NS = 2_000_000_000  # between two positions
AHEAD_NS = 500_000_000  # how far the newest position is moved on by its velocity, where none follows
AWAITED_NS = 1_000_000_000  # how long a frame waits for the position after it
JUMP_M, JUMP_SHARE = 3.0, 0.5
"""Two positions that differ by so many meters and that share of the distance more than by velocity: a reset."""


class PositionHistory:
    """The newest positions, each with `sigma_m` and `source`."""

    def __init__(self, clock_ns: Callable[[], int]) -> None:
        self._clock_ns = clock_ns
        self._positions: deque[VehiclePosition] = deque(maxlen=KEPT_POSITIONS)

    def add(self, position: VehiclePosition) -> None:
        """A position; ignored where it is not after the newest."""
        if not self._positions or position.stamp_ns > self._positions[-1].stamp_ns:
            self._positions.append(position)

    @property
    def newest(self) -> VehiclePosition | None:
        """None before the first."""
        return self._positions[-1] if self._positions else None

    def clear(self) -> None:
        """The positions before cannot be compared with what follows: the autopilot has rebooted, or is another one."""
        self._positions.clear()

    def is_awaited(self, stamp_ns: int) -> bool:
        """Whether a position after that moment has not come yet, and still may."""
        newest_ns = self._positions[-1].stamp_ns if self._positions else None
        return newest_ns is not None and newest_ns < stamp_ns and self._clock_ns() - stamp_ns < AWAITED_NS

    def at(self, stamp_ns: int) -> VehiclePosition | None:
        """The position at a moment; None where it is not known, also within a jump."""
        after = next((one for one in self._positions if one.stamp_ns >= stamp_ns), None)
        before = next((one for one in reversed(self._positions) if one.stamp_ns <= stamp_ns), None)
        if before is None:
            return None
        if after is None:
            return _moved_on(before, stamp_ns) if stamp_ns - before.stamp_ns <= AHEAD_NS else None
        return _between(before, after, stamp_ns)


class ExposureQueue(Generic[T]):
    """What waits for the position at its exposure, in order: whoever owns it asks now and then what waits no more."""

    def __init__(self, history: PositionHistory) -> None:
        self._history = history
        self._waiting: deque[tuple[int, T]] = deque()

    def add(self, stamp_ns: int, what: T) -> None:
        """Have it wait for the position at a moment."""
        self._waiting.append((stamp_ns, what))

    def known(self, *, all_of_them: bool = False) -> Iterator[tuple[T, VehiclePosition | None]]:
        """Those whose position is interpolated by now, each once, or never will be; all_of_them: at the end."""
        while self._waiting and (all_of_them or not self._history.is_awaited(self._waiting[0][0])):
            stamp_ns, what = self._waiting.popleft()
            yield what, self._history.at(stamp_ns)


def _moved_on(before: VehiclePosition, stamp_ns: int) -> VehiclePosition:
    lat_deg, lon_deg = before.at(stamp_ns)
    return replace(before, stamp_ns=stamp_ns, lat_deg=lat_deg, lon_deg=lon_deg)


def _between(before: VehiclePosition, after: VehiclePosition, stamp_ns: int) -> VehiclePosition | None:
    gap_ns = after.stamp_ns - before.stamp_ns
    if gap_ns == 0:
        return before
    if gap_ns > LONGEST_GAP_NS or jumped(before, after):
        return None
    share = (stamp_ns - before.stamp_ns) / gap_ns
    east_m, north_m = east_north_of(after.lat_deg, after.lon_deg, (before.lat_deg, before.lon_deg))
    lat_deg, lon_deg = moved(before.lat_deg, before.lon_deg, share * east_m, share * north_m)
    return replace(
        before,
        stamp_ns=stamp_ns,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_m=before.alt_m + share * (after.alt_m - before.alt_m),
        heading_deg=None
        if before.heading_deg is None or after.heading_deg is None
        else heading_between(before.heading_deg, after.heading_deg, share),
        speed_mps=before.speed_mps + share * (after.speed_mps - before.speed_mps),
        north_mps=before.north_mps + share * (after.north_mps - before.north_mps),
        east_mps=before.east_mps + share * (after.east_mps - before.east_mps),
        sigma_m=None if before.sigma_m is None or after.sigma_m is None else max(before.sigma_m, after.sigma_m),
        source=worse_source(before.source, after.source),
    )


def jumped(before: VehiclePosition, after: VehiclePosition) -> bool:
    """Whether two positions cannot be of one vehicle that moves by its velocity."""
    gap_s = (after.stamp_ns - before.stamp_ns) / 1e9
    east_m, north_m = east_north_of(after.lat_deg, after.lon_deg, (before.lat_deg, before.lon_deg))
    by_velocity_m = [
        (first + second) / 2 * gap_s
        for first, second in ((before.east_mps, after.east_mps), (before.north_mps, after.north_mps))
    ]
    allowed_m = JUMP_M + JUMP_SHARE * math.hypot(*by_velocity_m)
    return math.hypot(east_m - by_velocity_m[0], north_m - by_velocity_m[1]) > allowed_m
