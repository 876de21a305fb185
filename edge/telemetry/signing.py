"""MAVLink 2 signing: the key, and the timestamps that only grow, over restarts as well. pymavlink signs and checks.

A receiver drops a frame whose timestamp is not above the last one of its stream. After a restart, or when the clock is
set back, our timestamp must not become lower, and a frame of others must not be accepted a second time. So the
timestamps are stored in a file: while running, some seconds ahead of those in use, so that it is written seldom; at the
end, exactly. After a crash, frames of others are rejected until they are past the stored timestamps, which takes less
time than a restart.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import ConfigError
from edge.files import PersistentFile, read_key

Stream: TypeAlias = tuple[int, int, int]
"""Link, system, component: all three are covered by a signature."""
TICKS_PER_S = 100_000
"""Timestamps are in units of 10 us since the beginning of 2015."""
EPOCH_S = 1_420_070_400  # 2015-01-01, where MAVLink's timestamps of 10 us begin
STORED_AHEAD = 10 * TICKS_PER_S
"""How far ahead of use the file is written: autopilots accept timestamps up to a minute ahead."""
CREDENTIAL = "credential:"

log = logging.getLogger(__name__)


class SigningClock(msgspec.Struct, frozen=True):
    """The file: the lowest timestamps that may be used from now on, for our frames and in each stream of others."""

    ours: int = 0
    heard: tuple[tuple[Stream, int], ...] = ()


class Signer:
    """Has one codec sign what it sends, and drop what arrives unsigned, altered or replayed."""

    def __init__(
        self, key: bytes, timestamp_file: Path, link_id: int, unix_time_s: Callable[[], float] = time.time
    ) -> None:
        """link_id: 0 to 255, different for each link of one system."""
        self._key = key
        self._link_id = link_id
        self._unix_time_s = unix_time_s
        lost = "replayed signed frames of the last minute may be accepted"
        self._file = PersistentFile(timestamp_file, SigningClock, lost)
        self._stored = self._file.read() or SigningClock()
        self._heard_stored = dict(self._stored.heard)
        self._heard: set[Stream] = set()  # since the start
        self._logged: set[Stream] = set()

    def attach(self, codec: mavlink.MAVLink) -> None:
        """Have the codec sign, and drop what is not signed."""
        self._signing = codec.signing
        self._signing.secret_key, self._signing.sign_outgoing = self._key, True
        self._signing.link_id = self._link_id
        self._signing.timestamp = max(self._now(), self._stored.ours)
        self._signing.stream_timestamps.update(self._heard_stored)
        codec.checked = self._checked

    def follow_clock(self) -> None:
        """The timestamp follows the clock, but never back."""
        self._signing.timestamp = max(self._signing.timestamp, self._now())

    def advance(self) -> None:
        """Before each frame: the timestamp is on disk before it is used."""
        self.follow_clock()
        if self._signing.timestamp >= self._stored.ours:
            self.store(STORED_AHEAD)

    def _checked(self, stream: Stream, *, is_signed: bool) -> None:
        if not is_signed:
            if stream not in self._logged:
                self._logged.add(stream)
                words = "signed frame rejected: another key, or its timestamp is not new"
                log.warning("link %d, system %d, component %d: %s", *stream, words)
            return
        self._heard.add(stream)
        if self._signing.stream_timestamps[stream] > self._heard_stored.get(stream, 0):
            self.store(STORED_AHEAD)

    def _now(self) -> int:
        return int((self._unix_time_s() - EPOCH_S) * TICKS_PER_S)

    def store(self, ahead: int = 0) -> None:
        """Replace the file, with timestamps so far ahead; without a writable disk the link still works, unprotected."""
        newest = self._signing.stream_timestamps
        self._heard_stored = {stream: at + ahead * (stream in self._heard) for stream, at in newest.items()}
        stored = SigningClock(self._signing.timestamp + ahead, tuple(self._heard_stored.items()))
        if stored == self._stored:
            return
        self._stored = stored
        self._file.write(stored)


def load_key(name: str) -> bytes:
    """The 32 bytes of `name`: a file (raw, or 64 hexadecimal digits), or `credential:NAME` of systemd's.

    Raises ConfigError when it is missing, of another size, or a file that others may read.
    """
    where = f"[telemetry] signing_key: {name}"
    path = Path(name)
    if name.startswith(CREDENTIAL):
        folder = os.environ.get("CREDENTIALS_DIRECTORY")
        if not folder:
            raise ConfigError(f"{where}: systemd gave no credentials; use LoadCredential= in the unit, or a file")
        if "/" in name:
            raise ConfigError(f"{where}: the name of a credential must not contain /")
        path = Path(folder) / name.removeprefix(CREDENTIAL)
    return read_key(path, where, is_secret=not name.startswith(CREDENTIAL))
