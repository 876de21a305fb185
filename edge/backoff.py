"""Pauses between attempts that double while the attempts fail; and exchanges of questions and answers. No clock."""

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


class Exchange:
    """One question: asked, and asked again while it is not answered, until it is given up."""

    def __init__(self, wait_ns: int, pause: BackOff | None = None, *, most: int = 0, refusals_most: int = 1) -> None:
        """wait_ns: for the answer. pause: after a failure. most: how often it is asked; 0: without end.

        refusals_most: after so many it is refused for good.
        """
        self._wait_ns, self.pause = wait_ns, pause or BackOff(0, 0)
        self.most, self._refusals_most = most, refusals_most
        self.times, self.refusals = 0, 0
        self._asked_ns: int | None = None

    @property
    def is_waiting(self) -> bool:
        """Whether an answer may come."""
        return self._asked_ns is not None

    @property
    def is_refused(self) -> bool:
        """Whether for good."""
        return self.refusals >= self._refusals_most

    @property
    def is_given_up(self) -> bool:
        """Whether it was asked too often."""
        return 0 < self.most <= self.times

    def is_overdue(self, now_ns: int, more_ns: int = 0) -> bool:
        """Whether the answer has not come in time, and so much more."""
        return self._asked_ns is not None and now_ns - self._asked_ns >= self._wait_ns + more_ns

    def is_due(self, now_ns: int) -> bool:
        """Whether it may be asked, the first time or again."""
        is_open = self.is_waiting and not self.is_overdue(now_ns)
        return not (is_open or self.is_refused or self.is_given_up) and self.pause.is_over(now_ns)

    def ask(self, now_ns: int) -> None:
        """It is asked now."""
        self._asked_ns, self.times = now_ns, self.times + 1

    def answered(self) -> None:
        """The answer has come, or is not awaited any more."""
        self._asked_ns = None
