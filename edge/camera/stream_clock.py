"""From a stream's own time stamps to CLOCK_MONOTONIC."""

from __future__ import annotations

FORGETTING = 0.01
"""The smallest delay grows by this share of the time since it was seen, so that a clock that runs slow is followed."""


class StreamClock:
    """Takes the smallest delay between a stream's time and the arrival as the transport's; what is more is waiting.

    A picture's exposure is then its stream time plus that delay, however long the network held it back.
    """

    def __init__(self) -> None:
        self._delay_ns = 0.0
        self._arrived_ns: int | None = None

    def arrived(self, stream_ns: int, arrived_ns: int) -> None:
        """Learn from one packet: its time in the stream, and when it arrived on CLOCK_MONOTONIC."""
        delay_ns = float(arrived_ns - stream_ns)
        if self._arrived_ns is not None:
            delay_ns = min(delay_ns, self._delay_ns + FORGETTING * (arrived_ns - self._arrived_ns))
        self._delay_ns, self._arrived_ns = delay_ns, arrived_ns

    def monotonic_ns(self, stream_ns: int) -> int:
        """A stream time on CLOCK_MONOTONIC; only after the first packet has arrived."""
        return stream_ns + round(self._delay_ns)
