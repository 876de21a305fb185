"""The autopilot's boot clock, estimated from ours; and which stamps are not of it.

With boot = monotonic + offset, each message gives a bound on the offset, because no message arrives before it is
sent: a boot stamp in a message received at t says offset >= stamp - t, and an answer stamped `boot` to our request
of time t says offset <= boot - t. Over many messages the tightest bounds close in on the true offset. When this
computer reads its port late, bounds become looser but never wrong (half of the round trip, as usual, becomes wrong).

A stamp of another clock is of the next boot, of a stranger, or of a second autopilot. A stranger cannot keep the
autopilot's own messages from coming: so it is of the next boot where nothing contradicts it for a while.
"""

from __future__ import annotations

# Short, since the clock of a simulated autopilot was seen to run 0.75 % slow: 7.5 ms for every second of memory.
WINDOW_NS = 250_000_000
TURN_MS, NEAR_MS = 2**32, 60_000  # a message counts milliseconds in 32 bits; by how much it may differ
JUMP_MS = 1000
"""Further back than the newest stamp, or ahead of the clock: less may be messages that changed places on the way."""
UNDISPUTED_NS = 500_000_000
"""How long no message may be of the old clock or origin. Autopilots send positions at 10 Hz, as was requested."""


class _Tightest:
    """The largest of the bounds of the current window and the one before."""

    def __init__(self) -> None:
        self._start_ns = 0
        self._now: int | None = None
        self._before: int | None = None

    def add(self, bound_ns: int, at_ns: int) -> None:
        if self._now is None or at_ns - self._start_ns > WINDOW_NS:
            self._before, self._now, self._start_ns = self._now, bound_ns, at_ns
        else:
            self._now = max(self._now, bound_ns)

    @property
    def best_ns(self) -> int | None:
        if self._now is None or self._before is None:
            return self._now
        return max(self._now, self._before)


class BootClock:
    """Estimates the autopilot's time since boot; unknown until the first stamp arrived."""

    def __init__(self) -> None:
        self._at_least = _Tightest()
        self._at_most = _Tightest()  # holds negated bounds, so that its largest is the smallest
        self._newest_ms = -1
        self._requested_ns = 0
        self._another_ns: int | None = None  # since when stamps of another clock come, which nothing contradicts
        self._another_has_position = False
        self.took_turns = False
        """Whether the newest stamp contradicts those of another clock, and a position of that came between."""

    def read_stamp(self, boot_ms: int, now_ns: int, *, has_position: bool = False) -> int | None:
        """Add the stamp of a message, which may have a position; returns the same moment on CLOCK_MONOTONIC.

        None, and the message must not be used, where the stamp is of another clock (`has_ended`).
        """
        if self._is_of_another(boot_ms, now_ns):
            self._another_has_position |= has_position
            return None
        self.took_turns, self._another_ns, self._another_has_position = self._another_has_position, None, False
        self._newest_ms = max(boot_ms, self._newest_ms)
        self.add_stamp(boot_ms * 1_000_000, now_ns)
        return min(self.monotonic_ns(boot_ms * 1_000_000) or now_ns, now_ns)

    def has_ended(self, now_ns: int) -> bool:
        """Whether there was no stamp of it between those of another one for long enough: the autopilot has rebooted."""
        return self._another_ns is not None and now_ns - self._another_ns >= UNDISPUTED_NS

    @property
    def is_known(self) -> bool:
        """Whether a stamp of it came, and none of another clock since."""
        return self.offset_ns is not None and self._another_ns is None

    def _is_of_another(self, boot_ms: int, now_ns: int) -> bool:
        """Whether it is before the newest stamp, or ahead of the clock, by more than messages overtake each other."""
        boot_ns = self.boot_ns(now_ns)
        is_ahead = boot_ns is not None and boot_ms > boot_ns / 1e6 + JUMP_MS
        is_another = is_ahead or boot_ms < self._newest_ms - JUMP_MS
        if is_another and self._another_ns is None:
            self._another_ns = now_ns
        return is_another

    def requested(self, now_ns: int) -> None:
        """Our TIMESYNC request, stamped `now_ns`, was sent."""
        self._requested_ns = now_ns

    def read_timesync(self, tc1_ns: int, ts1_ns: int, now_ns: int) -> None:
        """TIMESYNC: the answer `tc1_ns` to the request of `ts1_ns`; or, with 0, its own request, stamped `ts1_ns`.

        Only after a stamp of a message, which shows whether it is of the same clock: an answer that came first and was
        3 s ahead put this clock off by half of that for a whole drive.
        """
        if self._newest_ms < 0 or self._is_of_another((tc1_ns or ts1_ns) // 1_000_000, now_ns):
            return
        if tc1_ns == 0:
            self.add_stamp(ts1_ns, now_ns)
        elif ts1_ns == self._requested_ns:
            self.add_answer(ts1_ns, tc1_ns, now_ns)

    def add_stamp(self, boot_ns: int, received_ns: int) -> None:
        """A boot stamp in any message that was received at `received_ns` (CLOCK_MONOTONIC)."""
        self._at_least.add(boot_ns - received_ns, received_ns)

    def add_answer(self, sent_ns: int, boot_ns: int, received_ns: int) -> None:
        """TIMESYNC's answer, stamped `boot_ns`, to a request that we sent at `sent_ns`."""
        self._at_most.add(sent_ns - boot_ns, received_ns)
        self.add_stamp(boot_ns, received_ns)

    @property
    def offset_ns(self) -> int | None:
        """Boot clock minus CLOCK_MONOTONIC."""
        at_least, negated = self._at_least.best_ns, self._at_most.best_ns
        if at_least is None or negated is None or -negated < at_least:
            return at_least  # crossed bounds: the clock drifts faster than the requests come
        return (at_least - negated) // 2

    def unwrapped_ms(self, boot_ms: int, received_ns: int) -> int:
        """Milliseconds since boot, which messages count in 32 bits: again from 0 after 49.7 days.

        The nearest to what this clock says; a stamp that is near to it with no number of turns is of another boot.
        """
        expected_ns = self.boot_ns(received_ns)
        if expected_ns is None:
            return boot_ms
        expected_ms = expected_ns // 1_000_000
        unwrapped_ms = boot_ms + round((expected_ms - boot_ms) / TURN_MS) * TURN_MS
        return unwrapped_ms if abs(unwrapped_ms - expected_ms) <= NEAR_MS else boot_ms

    def boot_ns(self, monotonic_ns: int) -> int | None:
        """The autopilot's time since boot at that moment of CLOCK_MONOTONIC."""
        offset_ns = self.offset_ns
        return None if offset_ns is None else monotonic_ns + offset_ns

    def monotonic_ns(self, boot_ns: int) -> int | None:
        """CLOCK_MONOTONIC at that time of the autopilot."""
        offset_ns = self.offset_ns
        return None if offset_ns is None else boot_ns - offset_ns
