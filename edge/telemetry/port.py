"""A link that is kept: opened, and when it is lost opened again, with growing pauses. Nothing blocks."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable

from edge.backoff import BackOff
from edge.errors import LinkLost
from edge.telemetry.codec import MavlinkCodec, Message
from edge.telemetry.host_lookup import LookUp, Lookup, is_address, look_up
from edge.telemetry.link import Connection, Link

RETRY_FIRST_NS = 500_000_000
RETRY_LAST_NS = {"serial": 1_000_000_000, "udp": 8_000_000_000, "udpin": 8_000_000_000}
"""Looking for a device costs nothing; asking for the name of a host is a packet on the network."""
SIGNED_SILENCE_NS = 3_000_000_000
"""With signing, listen first: the peer's timestamp may be ahead of our clock, and it drops what is older."""

log = logging.getLogger(__name__)


class Port:
    """Messages in and out over a link that may come and go; LinkLost never leaves this class."""

    def __init__(
        self, connection: Connection, codec: MavlinkCodec, clock_ns: Callable[[], int], look_up: LookUp = look_up
    ) -> None:
        self._look_up = look_up
        self._lookup: Lookup | None = None
        self.connection = connection
        self.codec = codec
        self.why_closed = ""
        self._clock_ns = clock_ns
        self._link: Link | None = None
        self._opened_ns = 0
        self._back_off = BackOff(RETRY_FIRST_NS, RETRY_LAST_NS[connection.kind])
        self._logged = ""

    @property
    def is_open(self) -> bool:
        """Whether there is a link; it may still be silent."""
        return self._link is not None

    def open_if_due(self, now_ns: int) -> bool:
        """Open a closed port once its pause is over; True when it is open."""
        if self._link is None and self._back_off.is_over(now_ns):
            log.debug("opening %s", self.connection)
            try:
                self._link, self._opened_ns = self._open(), now_ns
            except LinkLost as error:
                self._lose(str(error))
        return self._link is not None

    def _open(self) -> Link | None:
        """A link, or None while its host is still looked up; LinkLost."""
        connection = self.connection
        if connection.kind == "serial" or is_address(connection.target):
            return connection.open()
        self._lookup, lookup = None, self._lookup or Lookup(connection.target, self._look_up)
        address = lookup.address()
        if address is None:
            self._lookup = lookup
            return None
        return dataclasses.replace(connection, target=address).open()

    def receive(self) -> list[Message]:
        """The messages that have arrived since the last call."""
        if self._link is None:
            return []
        try:
            return self.codec.decode(self._link.receive())
        except LinkLost as error:
            self._lose(str(error))
            return []

    def send(self, message: Message) -> bool:
        """Send one message; False when it was dropped: no port, no room, or signing and still listening."""
        if self._link is None or self._still_listening():
            return False
        try:
            return self._link.send(self.codec.encode(message))
        except LinkLost as error:
            self._lose(str(error))
            return False

    def proved(self) -> None:
        """A peer has answered: the next loss begins with short pauses again, and is told again."""
        self._logged = ""
        self._back_off.reset()

    def close(self) -> None:
        """Release the port; more than once is harmless, and `open_if_due` would open it again."""
        if self._link is not None:
            self._link.close()
            self._link = None
            self.codec.rest()

    def _still_listening(self) -> bool:
        codec = self.codec
        return codec.signs and not codec.has_heard_signed and self._clock_ns() - self._opened_ns < SIGNED_SILENCE_NS

    def _lose(self, why: str) -> None:
        self.close()
        self.why_closed = why
        self._back_off.failed(self._clock_ns())
        if why != self._logged:  # one line for each new reason, not one for each try
            self._logged = why
            log.warning("%s; trying again", why)
