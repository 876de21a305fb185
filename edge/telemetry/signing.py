"""MAVLink 2 signing: the key, the timestamp that only ever grows, and the check of what arrives.

A frame whose timestamp is not above the last one of its stream is dropped by the receiver, so a restart, or a clock
that was set back, must not lead to a lower one: the timestamp is kept in a file, ahead of what has been used.
"""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Callable
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from edge.errors import ConfigError

EPOCH_S = 1_420_070_400  # 2015-01-01, where MAVLink's timestamps of 10 us begin
TICKS_PER_S = 100_000
AHEAD_TICKS = 60 * TICKS_PER_S
AHEAD_FOR_TICKS = 3 * TICKS_PER_S
KEPT_AHEAD = 20 * TICKS_PER_S
"""How far ahead of use the file is written, and so how seldom: autopilots take frames dated up to a minute ahead."""
KEY_BYTES = 32
CREDENTIAL = "credential:"

log = logging.getLogger(__name__)


class MavlinkCodecState(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's codec, but a frame that is refused leaves no trace, and one from the future is refused.

    pymavlink notes a frame's timestamp before it checks the signature, and believes any timestamp with a good one, so
    that one frame dated far ahead would lock the real sender out, for ever. But it may be our clock that is wrong: who
    goes on sending in a time of his own for a while is believed.
    """

    clock_ns: Callable[[], int] = staticmethod(time.monotonic_ns)
    wall_clock: Callable[[], int] | None = None
    """Now, as a timestamp; with it, frames from the future are refused."""
    _ahead: tuple[int, int] | None = None  # the first timestamp of those that were too far ahead, and when it came

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803  # its names
        """Whether the frame is signed with our key and newer than the last of its stream."""
        streams, newest = dict(self.signing.stream_timestamps), self.signing.timestamp
        good = bool(super().check_signature(msgbuf, srcSystem, srcComponent))
        # 48 bits, before the 6 bytes of the signature.
        if good and self._is_from_the_future(int.from_bytes(msgbuf[-12:-6], "little"), newest):
            good = False
        if not good:
            self.signing.stream_timestamps, self.signing.timestamp = streams, newest
        return good

    def _is_from_the_future(self, timestamp: int, newest: int) -> bool:
        """Whether a timestamp is over a minute ahead, and not of a sender that has been so for a while."""
        if self.wall_clock is None or timestamp <= max(newest, self.wall_clock()) + AHEAD_TICKS:
            self._ahead = None
            return False
        now_ns = self.clock_ns()
        first, first_ns = self._ahead or (timestamp, now_ns)
        elapsed = (now_ns - first_ns) * TICKS_PER_S // 10**9
        if abs(timestamp - first - elapsed) > TICKS_PER_S:
            first, first_ns, elapsed = timestamp, now_ns, 0
        self._ahead = first, first_ns
        return elapsed < AHEAD_FOR_TICKS


class Signer:
    """Signs what one codec sends; what arrives unsigned, altered, replayed or old is dropped by the codec."""

    def __init__(
        self,
        key: bytes,
        timestamp_file: Path,
        link_id: int,
        unix_time_s: Callable[[], float] = time.time,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`link_id` tells the links of one system apart, 0 to 255."""
        self._clock_ns = clock_ns
        self._key = key
        self._file = timestamp_file
        self._link_id = link_id
        self._unix_time_s = unix_time_s
        self._kept = _read_timestamp(timestamp_file)
        self._first = self._kept

    def attach(self, codec: mavlink.MAVLink) -> None:
        """Have the codec sign, and refuse what is not signed."""
        codec.wall_clock, codec.clock_ns = self._now, self._clock_ns
        signing = codec.signing
        signing.secret_key, signing.sign_outgoing, signing.link_id = self._key, True, self._link_id
        signing.timestamp = max(self._now(), self._first)

    def advance(self, codec: mavlink.MAVLink) -> None:
        """Before each frame: the timestamp follows the clock, but never back, and is on disk before it is used."""
        signing = codec.signing
        signing.timestamp = max(signing.timestamp, self._now())
        if signing.timestamp >= self._kept:
            self._kept = signing.timestamp + KEPT_AHEAD
            self._write()

    def _now(self) -> int:
        return int((self._unix_time_s() - EPOCH_S) * TICKS_PER_S)

    def _write(self) -> None:
        """Replace the file by one rename; a disk that does not take it costs the guarantee, not the link."""
        new = self._file.with_suffix(".new")
        try:
            new.write_text(f"{self._kept}\n", encoding="ascii")
            new.replace(self._file)
        except OSError as error:
            log.warning("%s: cannot keep the signing timestamp: %s", self._file, error.strerror)


def load_key(name: str) -> bytes:
    """The 32 bytes of `name`: a file (raw, or 64 hexadecimal digits), or `credential:NAME` of systemd's.

    Raises ConfigError when it is missing, of another size, or a file that others may read.
    """
    where = f"[telemetry] signing_key: {name}"
    path = Path(name)
    if name.startswith(CREDENTIAL):
        folder = os.environ.get("CREDENTIALS_DIRECTORY")
        if not folder:
            raise ConfigError(f"{where}: systemd has given no credentials; use LoadCredential= in the unit, or a file")
        if "/" in name:
            raise ConfigError(f"{where}: the name of a credential has no / in it")
        path = Path(folder) / name.removeprefix(CREDENTIAL)
    try:
        data, mode = path.read_bytes(), path.stat().st_mode
    except OSError as error:
        raise ConfigError(f"{where}: cannot read it: {error.strerror}") from None
    if mode & 0o077 and not name.startswith(CREDENTIAL):
        raise ConfigError(f"{where}: others may read this key; chmod 600 {path}")
    with contextlib.suppress(ValueError):
        data = bytes.fromhex(data.decode("ascii")) if len(data) != KEY_BYTES else data
    if len(data) != KEY_BYTES:
        raise ConfigError(f"{where}: not a key of {KEY_BYTES} bytes, or of {2 * KEY_BYTES} hexadecimal digits")
    return data


def _read_timestamp(file: Path) -> int:
    """What was kept, 0 when nothing was; a damaged file counts as nothing."""
    try:
        return max(0, int(file.read_text(encoding="ascii")))
    except (OSError, ValueError):
        return 0
