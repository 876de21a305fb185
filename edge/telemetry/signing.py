"""MAVLink 2 signing: the key, the timestamp that only grows, and the check of what arrives.

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
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import ConfigError
from edge.files import read_kept, read_key, replacing
from edge.telemetry.codec import Stream, Unsigned

TICKS_PER_S = 100_000
"""Timestamps are in units of 10 us since the beginning of 2015."""
MINUTE_TICKS = 60 * TICKS_PER_S
MINUTE_NS = 60_000_000_000
AHEAD_FOR_TICKS = 3 * TICKS_PER_S


class ReplayGuard:
    """Rejects replayed frames: those that are signed with our key but are not new, also after a restart.

    In MAVLink signing, a stream is one link of one component of one system, and its timestamps must increase. A stream
    that the receiver has not heard before may be up to a minute behind the receiver's clock. After a restart every
    stream is new, so frames recorded in the minute before could be replayed. So the newest timestamps are stored:

    - The first frame of a stream, since the start or after a minute of silence, must be newer than every frame of the
      same component on any link, and at most a minute behind our clock.
    - No frame may be more than a minute ahead of our clock. If it is our clock that is wrong, frames whose timestamps
      run on evenly for three seconds, with no other frame in between, are accepted after that.
    """

    def __init__(self, stored: Mapping[Stream, int], clock_ns: Callable[[], int]) -> None:
        """stored: what `timestamps` returned in the previous run."""
        self._newest = dict(stored)
        self._clock_ns = clock_ns
        self._heard_ns: dict[Stream, int] = {}
        self._ahead: tuple[int, int] | None = None  # the first timestamp of those too far ahead, and when it came

    def accept(self, stream: Stream, timestamp: int, now: int) -> bool:
        """Whether a frame is new; if so, no frame up to it is from now on. `now` is our own timestamp."""
        now_ns = self._clock_ns()
        if stream in self._heard_ns and now_ns - self._heard_ns[stream] <= MINUTE_NS:
            is_new = timestamp > self._newest[stream]
        else:
            is_new = timestamp > self._newest_of(stream) and timestamp >= now - MINUTE_TICKS
        if not is_new or self._is_too_far_ahead(timestamp, now, now_ns):
            return False
        self._newest[stream], self._heard_ns[stream] = timestamp, now_ns
        return True

    def timestamps(self, ahead: int) -> dict[Stream, int]:
        """What to store so that no frame is accepted twice until some stream is `ahead` of where it is now."""
        return {stream: newest + ahead * (stream in self._heard_ns) for stream, newest in self._newest.items()}

    def _newest_of(self, stream: Stream) -> int:
        return max((newest for other, newest in self._newest.items() if other[1:] == stream[1:]), default=-1)

    def _is_too_far_ahead(self, timestamp: int, now: int, now_ns: int) -> bool:
        if timestamp <= now + MINUTE_TICKS:
            self._ahead = None
            return False
        first, first_ns = self._ahead or (timestamp, now_ns)
        elapsed = (now_ns - first_ns) * TICKS_PER_S // 10**9
        if abs(timestamp - first - elapsed) > TICKS_PER_S:
            first, first_ns, elapsed = timestamp, now_ns, 0
        self._ahead = first, first_ns
        return elapsed < AHEAD_FOR_TICKS


EPOCH_S = 1_420_070_400  # 2015-01-01, where MAVLink's timestamps of 10 us begin
STORED_AHEAD = 10 * TICKS_PER_S
"""How far ahead of use the file is written: autopilots accept timestamps up to a minute ahead."""
CREDENTIAL = "credential:"

log = logging.getLogger(__name__)


class SigningClock(msgspec.Struct, frozen=True):
    """The file: the lowest timestamps that may be used from now on, for our frames and in each stream of others."""

    ours: int = 0
    heard: tuple[tuple[Stream, int], ...] = ()


class Signer(Unsigned):
    """Signs what one codec sends, and has it drop what arrives unsigned, altered or replayed."""

    def __init__(
        self,
        key: bytes,
        timestamp_file: Path,
        link_id: int,
        unix_time_s: Callable[[], float] = time.time,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """link_id: 0 to 255, different for each link of one system."""
        self._key = key
        self._file = timestamp_file
        self._link_id = link_id
        self._unix_time_s = unix_time_s
        lost = "ignored, so replayed signed frames of the last minute may be accepted"
        self._stored = read_kept(timestamp_file, SigningClock, lost) or SigningClock()
        self._heard_stored = dict(self._stored.heard)
        self._guard = ReplayGuard(self._heard_stored, clock_ns)
        self._logged: set[object] = set()

    is_signing = True

    def attach(self, codec: mavlink.MAVLink) -> None:
        """Have the codec sign, and drop what is not signed."""
        self._signing = codec.signing
        self._signing.secret_key, self._signing.sign_outgoing = self._key, True
        self._signing.link_id = self._link_id
        self._signing.timestamp = max(self._now(), self._stored.ours)
        codec.accepts = self._accepts

    def advance(self) -> None:
        """Before each frame: the timestamp follows the clock, but never back, and is on disk before it is used."""
        self._signing.timestamp = max(self._signing.timestamp, self._now())
        if self._signing.timestamp >= self._stored.ours:
            self.store(STORED_AHEAD)

    def _accepts(self, stream: Stream, timestamp: int) -> bool:
        if not self._guard.accept(stream, timestamp, max(self._signing.timestamp, self._now())):
            self._log_once(
                stream,
                "link %d, system %d, component %d: signed frame rejected: timestamp replayed or more than 60 s off",
                *stream,
            )
            return False
        if timestamp > self._heard_stored.get(stream, 0):
            self.store(STORED_AHEAD)
        return True

    def _now(self) -> int:
        return int((self._unix_time_s() - EPOCH_S) * TICKS_PER_S)

    def store(self, ahead: int = 0) -> None:
        """Replace the file, with timestamps so far ahead; without a writable disk the link still works, unprotected."""
        self._heard_stored = self._guard.timestamps(ahead)
        stored = SigningClock(self._signing.timestamp + ahead, tuple(self._heard_stored.items()))
        if stored == self._stored:
            return
        self._stored = stored
        try:
            with replacing(self._file) as stream:
                stream.write(msgspec.json.encode(stored))
        except OSError as error:
            self._log_once("file", "%s: cannot store the signing timestamps: %s", self._file, error.strerror)

    def _log_once(self, key: object, words: str, *arguments: object) -> None:
        if key not in self._logged:
            self._logged.add(key)
            log.warning(words, *arguments)


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
