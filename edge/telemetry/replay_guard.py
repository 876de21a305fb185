"""Rejects replayed frames: those that are signed with our key but are not new, also after a restart.

In MAVLink signing, a stream is one link of one component of one system, and its timestamps must increase. A stream
that the receiver has not heard before may be up to a minute behind the receiver's clock. After a restart every stream
is new, so frames recorded in the minute before could be replayed. Therefore the newest timestamps are stored (see
`signing`), and these rules are added:

- The first frame of a stream, since the start or after a minute of silence, must be newer than every frame of the same
  component on any link, and at most a minute behind our clock.
- No frame may be more than a minute ahead of our clock. If it is our clock that is wrong, frames whose timestamps run
  on evenly for three seconds, with no other frame in between, are accepted after that.

Timestamps are in units of 10 us since the beginning of 2015.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

TICKS_PER_S = 100_000
MINUTE_TICKS = 60 * TICKS_PER_S
MINUTE_NS = 60_000_000_000
AHEAD_FOR_TICKS = 3 * TICKS_PER_S

Stream: TypeAlias = tuple[int, int, int]
"""Link, system, component: all three are covered by the signature."""


class ReplayGuard:
    """The newest accepted timestamp of each stream."""

    def __init__(self, stored: Mapping[Stream, int], clock_ns: Callable[[], int]) -> None:
        """stored: what `timestamps` returned in the previous run."""
        self._newest = dict(stored)
        self._clock_ns = clock_ns
        self._heard_ns: dict[Stream, int] = {}
        self._ahead: tuple[int, int] | None = None  # the first timestamp of those too far ahead, and when it came

    def accept(self, stream: Stream, timestamp: int, now: int) -> bool:
        """Whether a frame is new; if so, no frame up to it is from now on. `now` is our own timestamp."""
        now_ns = self._clock_ns()
        if stream in self._heard_ns and now_ns - self._heard_ns[stream] <= MINUTE_NS:
            is_new = timestamp > self._newest[stream]
        else:
            is_new = timestamp > self._newest_of(stream) and timestamp >= now - MINUTE_TICKS
        if not is_new or self._is_too_far_ahead(timestamp, now, now_ns):
            return False
        self._newest[stream], self._heard_ns[stream] = timestamp, now_ns
        return True

    def timestamps(self, ahead: int) -> dict[Stream, int]:
        """What to store so that no frame is accepted twice until some stream is `ahead` of where it is now."""
        return {stream: newest + ahead * (stream in self._heard_ns) for stream, newest in self._newest.items()}

    def _newest_of(self, stream: Stream) -> int:
        return max((newest for other, newest in self._newest.items() if other[1:] == stream[1:]), default=-1)

    def _is_too_far_ahead(self, timestamp: int, now: int, now_ns: int) -> bool:
        if timestamp <= now + MINUTE_TICKS:
            self._ahead = None
            return False
        first, first_ns = self._ahead or (timestamp, now_ns)
        elapsed = (now_ns - first_ns) * TICKS_PER_S // 10**9
        if abs(timestamp - first - elapsed) > TICKS_PER_S:
            first, first_ns, elapsed = timestamp, now_ns, 0
        self._ahead = first, first_ns
        return elapsed < AHEAD_FOR_TICKS
