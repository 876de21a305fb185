"""Which of the frames that are signed with our key are new, over restarts as well.

MAVLink counts time along each stream, which is a link of a system's component, and takes a new stream that is at most
a minute behind. A receiver that starts has only new streams: what was recorded in the minute before could be played to
it again. So what was heard is kept, ahead of what is used (see `signing`), and three more things are asked for:

- of a stream that is new, or was kept, or silent for a minute: not older than anything heard from the same component,
  over whichever link, and at most a minute behind;
- of every frame: at most a minute ahead. But it may be our clock that is wrong: who goes on in a time of his own for
  three seconds, with nothing else heard, is believed.

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
"""Link, system, component: whoever signs names all three, and none can be changed by others."""


class ReplayGuard:
    """The newest timestamp of each stream that was taken."""

    def __init__(self, kept: Mapping[Stream, int], clock_ns: Callable[[], int]) -> None:
        """kept: what `at_least` has said in the run before."""
        self._newest = dict(kept)
        self._clock_ns = clock_ns
        self._heard_ns: dict[Stream, int] = {}
        self._ahead: tuple[int, int] | None = None  # of those too far ahead: the first timestamp, and when it came

    def take(self, stream: Stream, timestamp: int, now: int) -> bool:
        """Whether a frame is new; if so, nothing up to it is from now on. `now` is our own timestamp."""
        now_ns = self._clock_ns()
        if stream in self._heard_ns and now_ns - self._heard_ns[stream] <= MINUTE_NS:
            is_new = timestamp > self._newest[stream]
        else:
            is_new = timestamp > self._newest_of(stream) and timestamp >= now - MINUTE_TICKS
        if not is_new or self._is_from_the_future(timestamp, now, now_ns):
            return False
        self._newest[stream], self._heard_ns[stream] = timestamp, now_ns
        return True

    def at_least(self, ahead: int) -> dict[Stream, int]:
        """What is to be kept so that nothing is taken twice until some stream is `ahead` of where it is now."""
        return {stream: newest + ahead * (stream in self._heard_ns) for stream, newest in self._newest.items()}

    def _newest_of(self, stream: Stream) -> int:
        return max((newest for other, newest in self._newest.items() if other[1:] == stream[1:]), default=-1)

    def _is_from_the_future(self, timestamp: int, now: int, now_ns: int) -> bool:
        if timestamp <= now + MINUTE_TICKS:
            self._ahead = None
            return False
        first, first_ns = self._ahead or (timestamp, now_ns)
        elapsed = (now_ns - first_ns) * TICKS_PER_S // 10**9
        if abs(timestamp - first - elapsed) > TICKS_PER_S:
            first, first_ns, elapsed = timestamp, now_ns, 0
        self._ahead = first, first_ns
        return elapsed < AHEAD_FOR_TICKS
