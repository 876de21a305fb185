"""What the daemon keeps from one run to the next: the normalisation's statistics, and how it was last seen.

One file beside the journal: a line of JSON, then mean and deviation (2, R, D) float64, little-endian. It is replaced
by one rename, so that after a crash there is the old one or the new one. What is damaged, too old, or made with
another model, cut or map is refused in one line, and the run then starts from nothing.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import time
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

FORMAT, VERSION = "lookback-state", 1
MAX_HEADER_BYTES = 4096
WRITTEN_EACH_S = 60.0
log = logging.getLogger(__name__)


class StateKey(msgspec.Struct, frozen=True):
    """What statistics depend on, and the map, or the folder of maps, in which `place` is counted."""

    model_sha256: str
    tap: str
    regions: str
    region_width: float
    map_sha256: str


class Moment(msgspec.Struct, frozen=True):
    """A time that can be compared across restarts: by the boot's own clock, and across boots by the wall clock."""

    unix_s: float
    boot_id: str
    boot_s: float

    @classmethod
    def now(cls) -> Moment:
        """This moment."""
        boot_id = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return cls(time.time(), boot_id, time.clock_gettime(time.CLOCK_BOOTTIME))

    def since(self, earlier: Moment) -> float:
        """Seconds; negative when the wall clock was set back between two boots."""
        return self.boot_s - earlier.boot_s if self.boot_id == earlier.boot_id else self.unix_s - earlier.unix_s


class _Header(msgspec.Struct, frozen=True):
    format: str
    version: int
    key: StateKey
    moment: Moment
    shape: tuple[int, int]
    count: int
    state: str
    place: int | None
    sha256: str = ""


@dataclass(frozen=True)
class KeptState:
    """Mean and deviation (R, D) float64 of `count` raw descriptors; the state, and the last place believed."""

    count: int
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    state: str
    place: int | None
    age_s: float = 0.0


class StateFile:
    """The file of one daemon."""

    def __init__(self, path: Path, key: StateKey, shape: tuple[int, int]) -> None:
        """shape: regions and dimensions of a descriptor."""
        self._path, self._key, self._shape = path, key, shape
        self._told = False

    def read(self, now: Moment, max_age_s: float) -> KeptState | None:
        """What was kept; None, and one line in the log that says why, when it is not there to be used."""
        if not self._path.exists():
            return None
        try:
            return self._read(now, max_age_s)
        except (OSError, ValueError) as error:  # msgspec's errors are ValueErrors
            why = error.strerror if isinstance(error, OSError) else str(error)
            log.warning("%s: not used: %s", self._path, why)
            return None

    def _read(self, now: Moment, max_age_s: float) -> KeptState:
        size = 2 * self._shape[0] * self._shape[1] * 8
        if self._path.stat().st_size > MAX_HEADER_BYTES + size:
            raise ValueError("too large")
        line, _, body = self._path.read_bytes().partition(b"\n")
        header = msgspec.json.decode(line, type=_Header)
        if (header.format, header.version) != (FORMAT, VERSION):
            raise ValueError(f"format {header.format!r} version {header.version}; this program reads {VERSION}")
        if _encode(msgspec.structs.replace(header, sha256=""), body) != line:
            raise ValueError("damaged (its checksum does not hold)")
        if header.key != self._key or header.shape != self._shape or len(body) != size:
            raise ValueError("made with another model, other regions or another map")
        values = np.frombuffer(body, "<f8").reshape(2, *self._shape)
        if header.count < 1 or not np.isfinite(values).all() or (values[1] < 0).any():
            raise ValueError("not statistics")
        age_s = now.since(header.moment)
        if not 0 <= age_s <= max_age_s:
            raise ValueError(f"{age_s / 60:.0f} minutes old, and the light changes")
        return KeptState(header.count, values[0], values[1], header.state, header.place, age_s)

    def write(self, kept: KeptState, now: Moment) -> None:
        """Replace the file; a disk that does not take it costs the next run's good start, and is reported once."""
        body = np.stack([kept.mean, kept.deviation]).astype("<f8").tobytes()
        header = _Header(FORMAT, VERSION, self._key, now, self._shape, kept.count, kept.state, kept.place)
        new = self._path.with_name(f"{self._path.name}.new")
        try:
            with new.open("wb") as file:
                file.write(_encode(header, body) + b"\n" + body)
                file.flush()
                os.fsync(file.fileno())
            new.replace(self._path)
            self._told = False
        except OSError as error:
            if not self._told:
                log.warning("%s: cannot keep the state: %s", self._path, error.strerror)
            self._told = True
            with contextlib.suppress(OSError):
                new.unlink(missing_ok=True)


def _encode(header: _Header, body: bytes) -> bytes:
    """The file's line: the header, with a checksum over itself without one and over the body."""
    digest = hashlib.sha256(msgspec.json.encode(header) + body).hexdigest()
    return msgspec.json.encode(msgspec.structs.replace(header, sha256=digest))
