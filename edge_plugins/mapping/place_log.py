"""The file of a map that is being made: opened after any crash, and written by a thread of its own.

A process that is killed leaves whole records and at most one that is cut off, which is removed when the file is opened
again. What is damaged elsewhere is skipped, and stays. Bytes are handed to the kernel with every record, and flushed
to the disk once a second: a power cut costs the places of the last moments, and a slow disk costs no frame.
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
import threading
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.errors import MapError, reason
from edge.files import replacing
from edge.keypoints.mount import Mount, mount_of_drive
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.place_log_records import (
    FORMAT,
    HEAD,
    VERSION,
    VERSION_WITH_KEYPOINTS,
    DriveBegun,
    LogHeader,
    LogRecord,
    PlacePassed,
    PointsMade,
    encoded,
    record_at,
    whole_records,
)

QUEUE_PLACES = 256
"""That may wait to be written: those of an outage of GPS (`outage.MOST_PLACES`) are handed over at once."""
RECENT = QUEUE_PLACES + 32
"""Raw descriptors that are kept in memory: more than can be waiting to be written."""
FLUSHED_EACH_S = 1.0
RETRY_S = 5.0  # as the journal
FLOATS = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)
"""Every float16: looked up, a descriptor becomes float32 eight times faster than NumPy converts it."""
DISK_FULL = "the disk is nearly full"
SUFFIX = ".growing"
log = logging.getLogger(__name__)


def log_of(map_path: Path) -> Path:
    """The file in which a map is made; hidden, so that it is no map of its folder yet."""
    return map_path.with_name(f".{map_path.name}{SUFFIX}")


def map_of(file: Path) -> Path:
    """The map that a file of places will become."""
    return file.with_name(file.name[1 : -len(SUFFIX)])


def logs_in(folder: Path) -> list[Path]:
    """Files of places of all drives that are not maps yet, the oldest first."""
    return sorted(folder.glob(f".*{SUFFIX}"))


class OpenLog:
    """A file of places that this process alone has open: the records that were in it, and where to write on.

    places_at: where each place is. points_at: where the keypoints of some are, by their rows. drives: with which place
    each drive begins. mounts: how the camera is mounted by these keypoints, by the first places of their drives.
    written_unix_s: when the last place was written.
    """

    def __init__(self, path: Path) -> None:
        """Open it, and cut off what is not whole. MapError if it is no such file, or another process has it."""
        self.path = path
        self.is_read_only = not os.access(path, os.W_OK)  # as on a disk that became so
        try:
            self.descriptor = os.open(path, (os.O_RDONLY if self.is_read_only else os.O_RDWR) | os.O_CLOEXEC)
        except OSError as error:
            raise MapError(f"{path}: cannot open it: {error.strerror}") from None
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.places_at: list[int] = []
            self.points_at: dict[int, int] = {}
            self.mounts: dict[int, Mount] = {}
            self.drives: list[tuple[int, DriveBegun]] = []
            self.written_unix_s = os.fstat(self.descriptor).st_mtime
            self.header, self.end = self._read()
            self._remove_what_was_cut_off()
        except OSError as error:
            os.close(self.descriptor)
            why = "another process is writing it" if isinstance(error, BlockingIOError) else error.strerror
            raise MapError(f"{path}: cannot open it: {why}") from None

    def _read(self) -> tuple[LogHeader, int]:
        """Its header, and where the last whole record ends. Keeps where each place is, and which begins a drive."""
        records = whole_records(self.descriptor)
        start, end, header = next(records, (0, 0, None))
        known = (VERSION, VERSION_WITH_KEYPOINTS)
        if start or not isinstance(header, LogHeader) or header.format != FORMAT or header.version not in known:
            raise OSError(
                errno.EINVAL, f"damaged, or not a file of places of version {known[0]} or {known[1]}; remove it"
            )
        damaged, is_gap = 0, False
        for start, stop, record in records:
            is_gap |= start > end
            if isinstance(record, DriveBegun):
                is_gap = False
                self.drives.append((len(self.places_at), record))
            elif isinstance(record, PlacePassed):
                if is_gap and (record.view or self.drives):
                    # What was lost may have been more than one place: no line runs over it.
                    begun = DriveBegun(record.view) if record.view else self.drives[-1][1]
                    if not self.drives or self.drives[-1][0] < len(self.places_at):
                        self.drives.append((len(self.places_at), begun))
                is_gap = False
                if self.drives:
                    self.places_at.append(start)
                    self.written_unix_s = record.unix_s or self.written_unix_s
            elif isinstance(record, PointsMade):
                self._add_points(record, start)
            damaged, end = damaged + start - end, stop
        if damaged:
            log.warning("%s: %d damaged bytes were skipped, %d places kept", self.path, damaged, len(self.places_at))
        return header, end

    def _add_points(self, points: PointsMade, start: int) -> None:
        row = bisect_left(self.places_at, points.place_at)
        if self.places_at[row : row + 1] == [points.place_at]:  # else its place is damaged
            self.points_at[row] = start
            drive = max(first for first, _ in self.drives if first <= row)
            self.mounts[drive] = mount_of_drive([points.mount], self.mounts.get(drive))

    def _remove_what_was_cut_off(self) -> None:
        """Remove the last record if the file ends within it; one that is damaged otherwise stays."""
        size = os.fstat(self.descriptor).st_size
        head = os.pread(self.descriptor, HEAD.size, self.end)
        if self.is_read_only or size == self.end:
            return
        if len(head) < HEAD.size or self.end + HEAD.size + HEAD.unpack(head)[1] > size:
            os.ftruncate(self.descriptor, self.end)
            log.warning("%s: %d bytes of a place that was not written whole were removed", self.path, size - self.end)
        else:
            log.warning("%s: the last %d bytes are damaged and were skipped", self.path, size - self.end)
            self.end = size

    def segments(self) -> Iterator[tuple[int, int, DriveBegun]]:
        """Places [start, end) of each drive."""
        starts = [*(first for first, _ in self.drives), len(self.places_at)]
        yield from ((*rows, drive) for rows, (_, drive) in zip(pairwise(starts), self.drives, strict=True))

    def place(self, row: int) -> PlacePassed:
        """One of the places; OSError if it cannot be read any more."""
        record = record_at(self.descriptor, self.places_at[row])
        if not isinstance(record, PlacePassed):
            raise OSError(errno.EIO, f"{self.path}: place {row} is damaged")
        return record

    def points(self, row: int) -> PointsMade | None:
        """The keypoints of one of the places, None where it has none, or they cannot be read any more."""
        with contextlib.suppress(OSError):
            record = record_at(self.descriptor, self.points_at[row]) if row in self.points_at else None
            key = self.header.keypoints
            if isinstance(record, PointsMade) and key is not None and len(record.points) == key.place_bytes:
                return record
        return None

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
    """Writes places to an open file by a thread; `stopped` says why the disk takes none now."""

    def __init__(self, file: OpenLog, min_free_bytes: float = 0.0, retry_s: float = RETRY_S) -> None:
        """min_free_bytes: nothing is written while the disk has less than this left. retry_s: pause between tries."""
        self.file = file
        self.min_free_bytes, self._retry_s = min_free_bytes, retry_s
        self._end = file.end
        self._recent: deque[NDArray[np.float32]] = deque(maxlen=RECENT)
        self._points: dict[int, PointsMade] = {}  # by the rows of their places, until they are written
        self._queue: queue.Queue[LogRecord | int | None] = queue.Queue(QUEUE_PLACES)  # an int: of these
        self.count = len(file.places_at)
        """Places that were handed over, or were there."""
        self.stopped = os.strerror(errno.EROFS) if file.is_read_only else ""
        self._closing = threading.Event()
        self._view = file.drives[-1][1].view if file.drives else None
        self._thread = threading.Thread(target=self._run, name="mapping", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """How many records are not written yet."""
        return self._queue.unfinished_tasks

    def begin_drive(self, drive: DriveBegun) -> bool:
        """Hand over the beginning of a drive; False if the disk is too far behind."""
        self._view = drive.view
        return self._put(drive)

    def add(self, raw: NDArray[np.float32], place: Place, unix_s: float = 0.0, *, is_vouched: bool = False) -> bool:
        """Hand a place over without waiting; False if the disk is too far behind, and the place is not in the map.

        unix_s: the time now. is_vouched: see `PlacePassed`.
        """
        values = raw.astype("<f2")
        if not self._put(PlacePassed(place, values.tobytes(), unix_s, self._view, is_vouched)):
            return False
        self._recent.append(values.astype(np.float32))
        self.count += 1
        return True

    def add_points(self, row: int, record: NDArray[np.void], mount: Mount) -> None:
        """Hand the keypoints of a place over, from any thread; where the disk is too far behind, it has none."""
        self._points[row] = PointsMade.of(record, mount)
        if not self._put(row):
            del self._points[row]

    def points(self, row: int) -> PointsMade | None:
        """The keypoints of a place; None where it has none, or none yet."""
        return self._points.get(row) or self.file.points(row)

    def raw_rows(self, rows: Sequence[int]) -> NDArray[np.float32]:
        """Raw descriptors (n, R, D) of some places, the older ones from the disk. OSError."""
        first = self.count - len(self._recent)
        return np.stack([self._recent[row - first] if row >= first else self.file.raw(row) for row in rows])

    def thumbnail(self, row: int) -> bytes:
        """The small JPEG of a place, b"" if it is not on the disk yet. OSError."""
        return self.file.place(row).place.thumbnail if row < len(self.file.places_at) else b""

    def end(self) -> None:
        """Begin to write and flush the last of what was handed over."""
        self._closing.set()
        with contextlib.suppress(queue.Full):  # then the thread looks whether it is closing
            self._queue.put_nowait(None)

    def close(self, timeout_s: float = 1.0) -> None:
        """Write what has been handed over, for at most `timeout_s`, and flush it; once."""
        self.end()
        self._thread.join(timeout_s)
        if not self._thread.is_alive():  # else the disk hangs, and the file goes with the process
            self.file.close()

    def _put(self, record: LogRecord | int) -> bool:
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
        while not (self._closing.is_set() and self._queue.empty()):
            with contextlib.suppress(queue.Empty):
                record = self._queue.get(timeout=FLUSHED_EACH_S)
                if record is not None and not self._write(record):
                    break  # what follows would be taken for what is missing
                self._queue.task_done()
                is_flushed = is_flushed and record is None
            if not is_flushed and time.monotonic() - flushed_s >= FLUSHED_EACH_S:
                self._flush()
                flushed_s, is_flushed = time.monotonic(), True
        self._flush()

    def _write(self, handed: LogRecord | int) -> bool:
        """Append a record whole, as soon as the disk takes it; False at the end, where it does not."""
        row = handed if isinstance(handed, int) else -1
        record = replace(self._points[row], place_at=self.file.places_at[row]) if row >= 0 else handed
        assert not isinstance(record, int)
        data = encoded(record)
        while not self._append(data):
            if self._closing.wait(self._retry_s):
                return False
        if self.stopped:
            self.stopped = ""
            log.warning("%s: mapping goes on, with a new drive", self.file.path)
        if isinstance(record, PlacePassed):
            self.file.places_at.append(self._end)
        if row >= 0:
            self.file.points_at[row] = self._end
            del self._points[row]
        self._end += len(data)
        return True

    def _append(self, data: bytes) -> bool:
        """Whether the disk took all of it; a part is removed."""
        try:
            if shutil.disk_usage(self.file.path.parent).free - len(data) < self.min_free_bytes:
                raise OSError(errno.ENOSPC, DISK_FULL)
            if os.pwrite(self.file.descriptor, data, self._end) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self.file.descriptor, self._end)
            self._stop(error)
            return False
        return True

    def _flush(self) -> None:
        try:
            os.fdatasync(self.file.descriptor)
        except OSError as error:
            self._stop(error)

    def _stop(self, error: OSError) -> None:
        if not self.stopped:
            self.stopped = reason(error)
            count = len(self.file.places_at)
            log.warning("%s: mapping waits after %d places: %s", self.file.path, count, self.stopped)
