"""Lines for the pilot, few enough for a slow link that the pilot's telemetry needs as well."""

from __future__ import annotations

from collections import deque

from edge.localization import PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import Message

TEXT_NS = 500_000_000
PLACE_NS = 5_000_000_000
KEPT = 8


class StatusTexts:
    """A queue of which at most two lines a second come out, and of a flood only the newest."""

    def __init__(self) -> None:
        self._waiting: deque[list[Message]] = deque(maxlen=KEPT)
        self._id = 0
        self._next_ns = 0
        self._next_place_ns = 0

    def put(self, text: str, severity: int) -> None:
        """Queue a line of any length."""
        self._id = self._id % 65535 + 1
        self._waiting.append(encoders.status_text(text, severity, self._id))

    def put_place(self, fix: PlaceFix, now_ns: int, severity: int) -> None:
        """Queue a line about a place, but not more than one each five seconds: places come by the second."""
        if now_ns >= self._next_place_ns:
            self._next_place_ns = now_ns + PLACE_NS
            self.put(encoders.describe(fix), severity)

    def due(self, now_ns: int) -> list[Message]:
        """The messages of the next line, if it is time for one."""
        if not self._waiting or now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + TEXT_NS
        return self._waiting.popleft()
