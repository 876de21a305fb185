"""A link that is opened, and opened again with growing pauses when it is lost. Nothing blocks.

Not even the lookup of a host's name, which takes many seconds while the network is down: it has a thread of its own.
"""

from __future__ import annotations

import dataclasses
import logging
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future

from edge.backoff import BackOff
from edge.errors import LinkLost, reason
from edge.telemetry.codec import MavlinkCodec, Message
from edge.telemetry.link import Connection, Link, UdpLink, is_address

RETRY_FIRST_NS = 500_000_000
RETRY_LAST_NS = dict.fromkeys(("udp", "udpin", "tcp", "tcpin"), 8_000_000_000) | {"serial": 1_000_000_000}
"""Trying a device costs nothing; looking up the name of a host is a packet on the network."""
SIGNED_SILENCE_NS = 3_000_000_000
"""With signing, receive first: the peer's timestamp may be ahead of our clock, and it drops what is older."""

MOST_READS = 1000
POLL_NS, PIECE_BYTES = 50_000_000, 2048
"""In one call: a flood must not keep the daemon from everything else. A piece of noise takes 2.4 ms to decode on a busy
computer, and one datagram may have 64 KB of it."""

LookUp = Callable[[str], str]
log = logging.getLogger(__name__)


def look_up(name: str) -> str:
    """The first address of a host; may block for seconds. OSError when it has none."""
    return str(socket.getaddrinfo(name, None, type=socket.SOCK_DGRAM)[0][4][0])


def in_a_thread(look_up: LookUp, name: str) -> Future[str]:
    """What a lookup gives, or why it gives nothing, once a thread of its own is done."""
    found: Future[str] = Future()

    def run() -> None:
        try:
            found.set_result(look_up(name))
        except (OSError, UnicodeError) as error:  # the latter: no name, as "a..b"
            found.set_exception(error)

    threading.Thread(target=run, name="lookup", daemon=True).start()
    return found


class Port:
    """Messages in and out over a link that may come and go; LinkLost never leaves this class."""

    def __init__(
        self, connection: Connection, codec: MavlinkCodec, clock_ns: Callable[[], int], look_up: LookUp = look_up
    ) -> None:
        self._look_up = look_up
        self._lookup: Future[str] | None = None
        self.connection = connection
        self.codec = codec
        self.why_closed = ""
        self._clock_ns = clock_ns
        self._link: Link | None = None
        self._opened_ns = 0
        self._unread = b""
        self._back_off = BackOff(RETRY_FIRST_NS, RETRY_LAST_NS[connection.kind])
        self.sent: dict[str, tuple[int, int]] = {}
        """How many messages of a name have left, and when the newest did (CLOCK_MONOTONIC, ns)."""

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
        """A link, or None while its host is being looked up; LinkLost."""
        connection = self.connection
        if connection.kind == "serial" or is_address(connection.target):
            return connection.open()
        lookup = self._lookup = self._lookup or in_a_thread(self._look_up, connection.target)
        if not lookup.done():
            return None
        self._lookup = None
        try:
            return dataclasses.replace(connection, target=lookup.result()).open()
        except (OSError, UnicodeError) as error:
            raise LinkLost(f"{connection.target}: cannot find this host: {reason(error)}") from None

    def receive(self) -> Iterator[Message]:
        """The messages that have arrived since the last call; after 50 ms the rest waits for the next."""
        until_ns = self._clock_ns() + POLL_NS
        for _ in range(MOST_READS):
            try:
                self._unread = self._unread or (self._link.receive() if self._link is not None else b"")
            except LinkLost as error:
                self._lose(str(error))
                return
            if not self._unread or self._clock_ns() > until_ns:
                return
            piece, self._unread = self._unread[:PIECE_BYTES], self._unread[PIECE_BYTES:]
            yield from self.codec.decode(piece)

    def send(self, message: Message) -> bool:
        """Send one message; False when it was dropped: no port, no room, or signing and still listening."""
        is_listening = self.codec.awaits_signed and self._clock_ns() - self._opened_ns < SIGNED_SILENCE_NS
        if self._link is None or is_listening:
            return False
        try:
            if not self._link.send(self.codec.encode(message)):
                return False
        except LinkLost as error:
            self._lose(str(error))
            return False
        name = message.get_type()
        self.sent[name] = self.sent.get(name, (0, 0))[0] + 1, self._clock_ns()
        return True

    def peer_answered(self) -> None:
        """The sender of the message that `receive` gave last is the peer, and others are ignored until it is silent.

        The next loss starts with short pauses again, and is logged again.
        """
        self.why_closed = ""
        self._back_off.reset()
        if isinstance(self._link, UdpLink):
            self._link.keeps_peer = True

    def peer_silent(self) -> None:
        """The peer has gone; whoever sends next may be the new one."""
        if isinstance(self._link, UdpLink):
            self._link.keeps_peer = False

    def close(self) -> None:
        """Release the port; more than once is harmless, and `open_if_due` would open it again."""
        if self._link is not None:
            self._link.close()
            self._link, self._unread = None, b""
            self.codec.store_timestamps()

    def _lose(self, why: str) -> None:
        self.close()
        self._back_off.failed(self._clock_ns())
        if why != self.why_closed:  # one line for each new reason, not one for each try
            self.why_closed = why
            log.warning("%s; trying again", why)
