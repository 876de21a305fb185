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
KEPT_AHEAD = 20 * TICKS_PER_S
"""How far ahead of use the file is written, and so how seldom: autopilots take frames dated up to a minute ahead."""
KEY_BYTES = 32
CREDENTIAL = "credential:"

log = logging.getLogger(__name__)


class MavlinkCodecState(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's codec, but a frame with a wrong signature leaves no trace.

    pymavlink notes a frame's timestamp before it checks the signature, so that one forged frame dated far ahead would
    lock the real sender out.
    """

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803  # its names
        """Whether the frame is signed with our key and newer than the last of its stream."""
        before = dict(self.signing.stream_timestamps)
        good = bool(super().check_signature(msgbuf, srcSystem, srcComponent))
        if not good:
            self.signing.stream_timestamps = before
        return good


class Signer:
    """Signs what one codec sends; what arrives unsigned, altered, replayed or old is dropped by the codec."""

    def __init__(
        self, key: bytes, timestamp_file: Path, link_id: int, unix_time_s: Callable[[], float] = time.time
    ) -> None:
        """`link_id` tells the links of one system apart, 0 to 255."""
        self._key = key
        self._file = timestamp_file
        self._link_id = link_id
        self._unix_time_s = unix_time_s
        self._kept = _read_timestamp(timestamp_file)
        self._first = self._kept

    def attach(self, codec: mavlink.MAVLink) -> None:
        """Have the codec sign, and refuse what is not signed."""
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
