"""How many connections the live page keeps, and how long each may take: nobody shuts it for others.

uvicorn's own limits count requests, not connections, and a head has no limit in time (uvicorn 0.54).
"""

from __future__ import annotations

import asyncio
import ipaddress
from collections import Counter

from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS = 128
"""A browser opens 6. With what is being accepted and closed, 200 files at most of the 1,024 that a service has."""
BACKLOG = 16
"""Accepted at once: so few that who has sent a request is read before as many others as there is room for come."""
QUEUE = 1024
"""Connections that the kernel holds until they are accepted; it lets others wait for a second."""
REQUESTS_TAKE = 6
"""The time for the rest of a request and its answer, in times of that for its head: 50 KB by a telemetry radio."""


class LimitedConnection(H11Protocol):
    """One connection. uvicorn's `timeout_keep_alive`, seconds, limits each head too, from the end of what was before.

    Where there are too many, one has to go: the oldest of the address that has most, first of those without a request,
    and one of this computer only where all are.
    """

    _limit: asyncio.TimerHandle | None = None
    _has_ended = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin, in place of another one if there are too many."""
        super().connection_made(transport)
        self._since_s = self.loop.time()
        self._address = self.client[0] if self.client else ""
        self._is_ours = bool(self._address) and ipaddress.ip_address(self._address).is_loopback
        self._end_after(self.timeout_keep_alive)
        kept = [one for one in self.connections if isinstance(one, LimitedConnection) and not one._has_ended]
        if len(kept) > CONNECTIONS:
            some = [one for one in kept if not one._is_ours] or kept
            counts = Counter(one._address for one in some)
            min(some, key=lambda one: (-counts[one._address], one._is_busy, one._since_s))._end()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        if self._limit is not None:
            self._limit.cancel()
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """Read what has come; a whole head is given the time of a request, once."""
        before = self.cycle
        super().handle_events()
        if self.cycle is not before and self._is_busy:
            self._end_after(REQUESTS_TAKE * self.timeout_keep_alive)

    def on_response_complete(self) -> None:
        """Wait for what is left of this request, and for the next one; longer while the answer is on its way."""
        self._end_after(self.timeout_keep_alive * (REQUESTS_TAKE if self.transport.get_write_buffer_size() else 1))
        super().on_response_complete()

    @property
    def _is_busy(self) -> bool:
        """Whether a whole head came, and its answer is not on its way yet."""
        return self.cycle is not None and not self.cycle.response_complete

    def _end(self) -> None:
        self._has_ended = True
        self.transport.abort()

    def _end_after(self, seconds: float) -> None:
        if self._limit is not None:
            self._limit.cancel()
        self._limit = self.loop.call_later(seconds, self._end)
