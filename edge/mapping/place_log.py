"""The file of a map that is being made: one record after another, each with its checksum, never written twice.

A record is 4 bytes of mark, the length and CRC-32 of what follows, and that: a tagged union in MessagePack. The first
is the header. A process that is killed leaves whole records and at most one that is cut off, which is removed when the
file is opened again. Bytes are handed to the kernel with every record, and flushed to the disk once a second by a
thread of their own: a power cut costs the places of the last moments, and a slow disk costs no frame.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import logging
import os
import queue
import shutil
import signal
import struct
import threading
import time
import zlib
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.atomic_file import replacing
from edge.config import SamplingConfig
from edge.errors import MapError
from edge.reference_map import ModelKey, Place, RegionsKey

FORMAT, VERSION = "lookback-places", 1
MARK = b"LBPL"
HEAD = struct.Struct("<4sII")
MAX_BODY_BYTES = 4 << 20
QUEUE_PLACES = 32
RECENT = 2 * QUEUE_PLACES
"""Raw descriptors that are kept in memory: more than can be waiting to be written."""
FLUSHED_EACH_S = 1.0
FLOATS = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)
"""Every float16: looked up, a descriptor becomes float32 eight times faster than NumPy converts it."""
DISK_FULL = "the disk is nearly full"
log = logging.getLogger(__name__)


class LogHeader(msgspec.Struct, frozen=True, tag="header"):
    """How the places were made; a map is made of places that were made alike."""

    model: ModelKey
    regions: RegionsKey
    sampling: SamplingConfig
    lookback: str
    format: str = FORMAT
    version: int = VERSION


class DriveBegun(msgspec.Struct, frozen=True, tag="drive"):
    """The places that follow were passed one after another, by a camera that looked that way."""

    view: Literal["front", "rear"]


class PlacePassed(msgspec.Struct, frozen=True, tag="place"):
    """A place, and its raw descriptor (R, D) as little-endian float16."""

    place: Place
    raw: bytes


LogRecord = LogHeader | DriveBegun | PlacePassed
_decoder = msgspec.msgpack.Decoder(LogRecord)


def encoded(record: LogRecord) -> bytes:
    """The bytes of a record."""
    body = msgspec.msgpack.encode(record)
    return HEAD.pack(MARK, len(body), zlib.crc32(body)) + body


def whole_records(descriptor: int) -> Iterator[tuple[int, int, LogRecord]]:
    """The records of an open file up to the first that is not whole: where each begins and ends."""
    at = 0
    while (record := _record_at(descriptor, at)) is not None:
        size = HEAD.unpack(os.pread(descriptor, HEAD.size, at))[1]
        yield at, at + HEAD.size + size, record
        at += HEAD.size + size


def _record_at(descriptor: int, at: int) -> LogRecord | None:
    head = os.pread(descriptor, HEAD.size, at)
    if len(head) < HEAD.size:
        return None
    mark, size, checksum = HEAD.unpack(head)
    if mark != MARK or size > MAX_BODY_BYTES:
        return None
    body = os.pread(descriptor, size, at + HEAD.size)
    if len(body) < size or zlib.crc32(body) != checksum:
        return None
    try:
        record: LogRecord = _decoder.decode(body)
    except msgspec.DecodeError:
        return None
    return record


class OpenLog:
    """A file of places that this process alone has open: the records that were in it, and where to write on."""

    def __init__(self, path: Path) -> None:
        """Open it, and cut off what is not whole. MapError if it is no such file, or another process has it."""
        self.path = path
        try:
            self.descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            raise MapError(f"{path}: cannot open it: {error.strerror}") from None
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.header, self.places_at, self.drives, self.end = self._read()
            cut_bytes = os.fstat(self.descriptor).st_size - self.end
            if cut_bytes:
                os.ftruncate(self.descriptor, self.end)
                log.warning("%s: %d bytes of a place that was not written whole were removed", path, cut_bytes)
        except OSError as error:
            os.close(self.descriptor)
            why = "another process is writing it" if isinstance(error, BlockingIOError) else error.strerror
            raise MapError(f"{path}: cannot open it: {why}") from None

    def _read(self) -> tuple[LogHeader, list[int], list[tuple[int, DriveBegun]], int]:
        """Its header, where each place is, with which place each drive begins, and where the last record ends."""
        records = whole_records(self.descriptor)
        _, end, header = next(records, (0, 0, None))
        if not isinstance(header, LogHeader) or (header.format, header.version) != (FORMAT, VERSION):
            raise OSError(errno.EINVAL, f"damaged, or not a file of places of version {VERSION}; remove it")
        places_at: list[int] = []
        drives: list[tuple[int, DriveBegun]] = []
        for start, stop, record in records:
            if isinstance(record, PlacePassed) and drives:
                places_at.append(start)
            elif isinstance(record, DriveBegun):
                drives.append((len(places_at), record))
            end = stop
        return header, places_at, drives, end

    def place(self, row: int) -> PlacePassed:
        """One of the places; OSError if it cannot be read any more."""
        record = _record_at(self.descriptor, self.places_at[row])
        if not isinstance(record, PlacePassed):
            raise OSError(errno.EIO, f"{self.path}: place {row} is damaged")
        return record

    def raw(self, row: int) -> NDArray[np.float32]:
        """The raw descriptor (R, D) of one of the places."""
        return self.raw_of(self.place(row))

    def raw_of(self, passed: PlacePassed) -> NDArray[np.float32]:
        """The raw descriptor (R, D) of a record."""
        values = FLOATS.take(np.frombuffer(passed.raw, "<u2"))
        return values.reshape(self.header.regions.count, self.header.model.dimensions)

    def close(self) -> None:
        """Close it; more than once is harmless."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
        self.descriptor = -1


def create_log(path: Path, header: LogHeader) -> OpenLog:
    """A new file without places. OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream:
        stream.write(encoded(header))
    return OpenLog(path)


class PlaceLog:
    """Writes places to an open file by a thread; `stopped` says why none is written any more."""

    def __init__(self, file: OpenLog, min_free_bytes: float = 0.0, flushed_each_s: float = FLUSHED_EACH_S) -> None:
        """min_free_bytes: writing stops when the disk has less than this left."""
        self.file = file
        self._min_free_bytes, self._flushed_each_s = min_free_bytes, flushed_each_s
        self._end = file.end
        self._recent: deque[NDArray[np.float32]] = deque(maxlen=RECENT)
        self._queue: queue.Queue[LogRecord | None] = queue.Queue(QUEUE_PLACES)
        self.count = len(file.places_at)
        """Places that were handed over, or were there."""
        self.stopped = ""
        self._thread = threading.Thread(target=self._run, name="mapping", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """How many records are not written yet."""
        return self._queue.qsize()

    def begin_drive(self, drive: DriveBegun) -> bool:
        """Hand over the beginning of a drive; False if the disk is too far behind."""
        return self._put(drive)

    def add(self, raw: NDArray[np.float32], place: Place) -> bool:
        """Hand a place over without waiting; False if the disk is too far behind, and the place is not in the map."""
        values = raw.astype("<f2")
        if not self._put(PlacePassed(place, values.tobytes())):
            return False
        self._recent.append(values.astype(np.float32))
        self.count += 1
        return True

    def raw_rows(self, rows: Sequence[int]) -> NDArray[np.float32]:
        """Raw descriptors (n, R, D) of some places, the older ones from the disk. OSError."""
        first = self.count - len(self._recent)
        return np.stack([self._recent[row - first] if row >= first else self.file.raw(row) for row in rows])

    def thumbnail(self, row: int) -> bytes:
        """The small JPEG of a place, b"" if it is not on the disk yet. OSError."""
        return self.file.place(row).place.thumbnail if row < len(self.file.places_at) else b""

    def close(self, timeout_s: float = 1.0) -> None:
        """Write what has been handed over, for at most `timeout_s` twice, and flush it; once."""
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=timeout_s)
        self._thread.join(timeout_s)
        if not self._thread.is_alive():  # else the disk hangs, and the file goes with the process
            self.file.close()

    def _put(self, record: LogRecord) -> bool:
        if self.stopped:
            return False
        try:
            self._queue.put_nowait(record)
        except queue.Full:
            return False
        return True

    def _run(self) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        flushed_s, is_flushed = time.monotonic(), True
        while True:
            with contextlib.suppress(queue.Empty):
                record = self._queue.get(timeout=self._flushed_each_s)
                if record is None:
                    break
                is_flushed = not self._write(record) and is_flushed
            if not is_flushed and time.monotonic() - flushed_s >= self._flushed_each_s:
                self._flush()
                flushed_s, is_flushed = time.monotonic(), True
        self._flush()

    def _write(self, record: LogRecord) -> bool:
        """Append a record whole, or not at all."""
        if self.stopped:
            return False
        data, descriptor = encoded(record), self.file.descriptor
        try:
            if shutil.disk_usage(self.file.path.parent).free - len(data) < self._min_free_bytes:
                raise OSError(errno.ENOSPC, DISK_FULL)
            if os.pwrite(descriptor, data, self._end) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(descriptor, self._end)
            self._stop(error)
            return False
        if isinstance(record, PlacePassed):
            self.file.places_at.append(self._end)
        self._end += len(data)
        return True

    def _flush(self) -> None:
        try:
            os.fdatasync(self.file.descriptor)
        except OSError as error:
            self._stop(error)

    def _stop(self, error: OSError) -> None:
        if not self.stopped:
            self.stopped = error.strerror or str(error)
            log.warning("%s: mapping stopped after %d places: %s", self.file.path, len(self.file.places_at), error)
