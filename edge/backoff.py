"""Pauses between attempts that double while the attempts fail."""

from __future__ import annotations


class BackOff:
    """The pause after the latest failure; none before the first. No clock: the time comes in as an argument."""

    def __init__(self, first_ns: int, longest_ns: int) -> None:
        self._first_ns, self._longest_ns = first_ns, longest_ns
        self._pause_ns = first_ns
        self._until_ns = 0

    def failed(self, now_ns: int) -> int:
        """Start the next pause at `now_ns`; returns its length in ns."""
        pause_ns = self._pause_ns
        self._until_ns = now_ns + pause_ns
        self._pause_ns = min(2 * pause_ns, self._longest_ns)
        return pause_ns

    def reset(self) -> None:
        """An attempt succeeded: no pause now, and a short one after the next failure."""
        self._pause_ns, self._until_ns = self._first_ns, 0

    def is_over(self, now_ns: int) -> bool:
        """Whether the next attempt may be made."""
        return now_ns >= self._until_ns
