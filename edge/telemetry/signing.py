"""MAVLink 2 signing: the key, the timestamp that only ever grows, and the check of what arrives.

A frame whose timestamp is not above the last one of its stream is dropped by the receiver. A restart, or a clock that
was set back, must neither lead to a lower one of ours, nor to one being taken a second time from others: all are kept
in a file, ahead of what has been used, and as they are at the end. After a crash, then, nobody is heard who is not
past what was kept ahead, which costs less time than a restart takes.
"""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
from pymavlink.dialects.v20 import common as mavlink

from edge.atomic_file import replacing
from edge.errors import ConfigError
from edge.telemetry.replay_guard import TICKS_PER_S, ReplayGuard, Stream

EPOCH_S = 1_420_070_400  # 2015-01-01, where MAVLink's timestamps of 10 us begin
KEPT_AHEAD = 10 * TICKS_PER_S
"""How far ahead of use the file is written, and so how seldom: autopilots take frames dated up to a minute ahead."""
KEY_BYTES = 32
CREDENTIAL = "credential:"

log = logging.getLogger(__name__)


class MavlinkCodecState(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's codec, which checks signatures; whether a frame is new is left to `takes`.

    pymavlink notes a frame's timestamp before it checks the signature, and believes any timestamp with a good one, so
    that one frame dated far ahead would lock the real sender out, for ever.
    """

    takes: Callable[[Stream, int], bool]

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803  # its names
        """Whether the frame is signed with our key, and new."""
        signing = self.signing
        ours, signing.timestamp = signing.timestamp, 0  # so that nothing is too old for pymavlink
        signing.stream_timestamps.clear()
        is_signed = super().check_signature(msgbuf, srcSystem, srcComponent)
        signing.timestamp = ours
        # 1 byte of link id and 6 of timestamp, before the 6 of the signature.
        timestamp = int.from_bytes(msgbuf[-12:-6], "little")
        if not is_signed or not self.takes((msgbuf[-13], srcSystem, srcComponent), timestamp):
            return False
        signing.timestamp = max(ours, timestamp)
        return True


class SigningClock(msgspec.Struct, frozen=True):
    """The file: what nothing of ours, and nothing in a stream of others, may be below from now on."""

    ours: int = 0
    heard: tuple[tuple[Stream, int], ...] = ()


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
        self._key = key
        self._file = timestamp_file
        self._link_id = link_id
        self._unix_time_s = unix_time_s
        self._kept = _read(timestamp_file)
        self._heard_kept = dict(self._kept.heard)
        self._freshness = ReplayGuard(self._heard_kept, clock_ns)
        self._told: set[object] = set()

    def attach(self, codec: mavlink.MAVLink) -> None:
        """Have the codec sign, and refuse what is not signed."""
        self._signing = codec.signing
        self._signing.secret_key, self._signing.sign_outgoing = self._key, True
        self._signing.link_id = self._link_id
        self._signing.timestamp = max(self._now(), self._kept.ours)
        codec.takes = self._takes

    def advance(self) -> None:
        """Before each frame: the timestamp follows the clock, but never back, and is on disk before it is used."""
        self._signing.timestamp = max(self._signing.timestamp, self._now())
        if self._signing.timestamp >= self._kept.ours:
            self._keep(KEPT_AHEAD)

    def rest(self) -> None:
        """Nothing will be sent or taken for a while: keep what was used, and no more."""
        self._keep(0)

    def _takes(self, stream: Stream, timestamp: int) -> bool:
        if not self._freshness.take(stream, timestamp, max(self._signing.timestamp, self._now())):
            self._tell(
                stream,
                "link %d, system %d, component %d: signed frame rejected: timestamp replayed or more than 60 s off",
                *stream,
            )
            return False
        if timestamp > self._heard_kept.get(stream, 0):
            self._keep(KEPT_AHEAD)
        return True

    def _now(self) -> int:
        return int((self._unix_time_s() - EPOCH_S) * TICKS_PER_S)

    def _keep(self, ahead: int) -> None:
        """Replace the file; a disk that does not take it costs the guarantee, not the link."""
        self._heard_kept = self._freshness.at_least(ahead)
        kept = SigningClock(self._signing.timestamp + ahead, tuple(self._heard_kept.items()))
        if kept == self._kept:
            return
        self._kept = kept
        try:
            with replacing(self._file) as stream:
                stream.write(msgspec.json.encode(kept))
        except OSError as error:
            self._tell("file", "%s: cannot save the signing timestamps: %s", self._file, error.strerror)

    def _tell(self, once: object, words: str, *arguments: object) -> None:
        if once not in self._told:
            self._told.add(once)
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
            raise ConfigError(f"{where}: systemd has given no credentials; use LoadCredential= in the unit, or a file")
        if "/" in name:
            raise ConfigError(f"{where}: the name of a credential has no / in it")
        path = Path(folder) / name.removeprefix(CREDENTIAL)
    try:
        data, mode = path.read_bytes(), path.stat().st_mode
    except OSError as error:
        raise ConfigError(f"{where}: cannot read it: {error.strerror}") from None
    if mode & 0o077 and not name.startswith(CREDENTIAL):
        raise ConfigError(f"{where}: this key is readable by other users; chmod 600 {path}")
    with contextlib.suppress(ValueError):
        data = bytes.fromhex(data.decode("ascii")) if len(data) != KEY_BYTES else data
    if len(data) != KEY_BYTES:
        raise ConfigError(f"{where}: not a key of {KEY_BYTES} bytes, or of {2 * KEY_BYTES} hexadecimal digits")
    return data


def _read(file: Path) -> SigningClock:
    """What was kept, nothing when nothing was; a damaged file counts as nothing."""
    try:
        return msgspec.json.decode(file.read_bytes(), type=SigningClock)
    except FileNotFoundError:
        return SigningClock()
    except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
        log.warning("%s: ignored, so signed frames of the last minute may be accepted again: %s", file, error)
        return SigningClock()
