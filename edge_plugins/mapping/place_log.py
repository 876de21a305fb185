"""The file of a map that is being made: a SQLite database, opened after any crash, and written by a thread of its own.

Each record is a row with its CRC-32: one that is damaged costs its place. A record is handed to the kernel at once, in
SQLite's write-ahead log, and brought to the disk once a second: a kill costs the places that were being written, a
power cut those of the last second, and a slow disk no frame.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import queue
import shutil
import signal
import sqlite3
import threading
import time
import zlib
from collections import deque
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError, reason
from edge.files import flush_to_disk
from edge.keypoints.mount import Mount, mount_of_drive
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.place_log_records import LogHeader, PlacePassed, PointsMade, View

TABLES = "CREATE TABLE {} (row INTEGER PRIMARY KEY, crc INTEGER, record BLOB);"
"""`places` has the header in row 0, and `points` the keypoints of the place in the same row."""
BEFORE_SQLITE = b"LBPL"
LEAST_BYTES = 512
"""Of a place, by the smallest network and without picture."""
QUEUE_PLACES = 256
"""That may wait to be written: those of an outage of GPS (`outage.MOST_WAITING`) are handed over at once."""
RECENT = QUEUE_PLACES + 32
"""Raw descriptors that are kept in memory: more than can be waiting to be written."""
FLUSHED_EACH_S = 1.0
RETRY_S = 5.0  # as the journal
LOCKED_S = 60.0
"""That somebody who looks into the file with a tool of SQLite may hold it up."""
FLOATS = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)
"""Every float16: looked up, a descriptor becomes float32 eight times faster than NumPy converts it."""
DISK_FULL = "the disk is nearly full"
DAMAGED = "damaged, or not a file of places; remove it"
SUFFIX = ".growing"
Record = TypeVar("Record", LogHeader, PlacePassed, PointsMade)
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


def files_of(path: Path) -> list[Path]:
    """A file of places, after those that SQLite keeps beside it."""
    return [path.with_name(f"{path.name}{suffix}") for suffix in ("-wal", "-shm", "")]


@contextlib.contextmanager
def _disk_errors() -> Iterator[None]:
    """Turn SQLite's errors into an OSError of the disk, in the words that the system has for it."""
    try:
        yield
    except sqlite3.OperationalError as error:
        number = errno.ENOSPC if "is full" in str(error) else errno.EROFS if "readonly" in str(error) else errno.EIO
        raise OSError(number, str(error) if number == errno.EIO else os.strerror(number)) from None
    except (sqlite3.Error, UnicodeDecodeError):
        raise OSError(errno.EIO, DAMAGED) from None


def _crc(row: int, record: bytes) -> int:
    return zlib.crc32(record, row)


class OpenLog:
    """A file of places of an earlier run: what was in it, and where to write on.

    rows: in which row of the table each place is. drives: with which place each drive begins, and its view. mounts: how
    the camera is mounted by the keypoints, by the first places of their drives. newest: the last place that is whole.
    last_row: of the table. is_sound: whether SQLite reads all pages; else nothing is appended to it.
    """

    def __init__(self, path: Path) -> None:
        """MapError if it is no such file."""
        self.path = path
        self.is_read_only = not os.access(path, os.W_OK)  # as on a disk that became so
        self.is_sound = True
        self.rows: list[int] = []
        self.drives: list[tuple[int, View]] = []
        self.mounts: dict[int, Mount] = {}
        self.newest: PlacePassed | None = None
        self._reading = threading.Lock()
        try:
            with path.open("rb") as stream:
                is_older = stream.read(len(BEFORE_SQLITE)) == BEFORE_SQLITE
            if is_older:
                raise OSError(
                    errno.EINVAL, "an earlier version began this drive: start that version once, or remove it"
                )
            self._db = self.connect()
            header = self._record("places", 0, LogHeader)
            if header is None:
                self.close()
                raise OSError(errno.EIO, DAMAGED)
        except OSError as error:
            raise MapError(f"{path}: cannot open it: {error.strerror}") from None
        self.header, self.last_row = header, 0
        self._read()

    def connect(self) -> sqlite3.Connection:
        """A connection for one more thread. OSError."""
        how = "mode=rw"
        if self.is_read_only:  # no file can be made beside it, in which connections would agree
            how = "mode=ro&vfs=unix-none" if files_of(self.path)[0].exists() else "immutable=1"
        uri = f"{self.path.absolute().as_uri()}?{how}"
        with _disk_errors(), contextlib.ExitStack() as opened:
            db = sqlite3.connect(uri, timeout=LOCKED_S, isolation_level=None, check_same_thread=False, uri=True)
            opened.callback(db.close)
            # What is written is flushed by checkpoints.
            db.execute("PRAGMA locking_mode = exclusive" if self.is_read_only else "PRAGMA synchronous = normal")
            opened.pop_all()
            return db

    def _read(self) -> None:
        """Which places are whole, and which begins a drive."""
        try:
            ((last,),) = self._db.execute("SELECT max(row) FROM places")
        except (sqlite3.Error, ValueError):
            self.is_sound = False
            last = self.path.stat().st_size // LEAST_BYTES
        self.last_row = last
        for row in range(1, last + 1):
            passed, before = self._record("places", row, PlacePassed), self.newest
            if passed is None:
                continue
            # No line runs over what was lost, which may have been a beginning.
            if before is None or passed.drive != before.drive or row > self.rows[-1] + 1:
                self.drives.append((len(self.rows), passed.view))
            self.rows.append(row)
            self.newest = passed
            points = self.points(len(self.rows) - 1)
            if points is not None:
                first, _ = self.drives[-1]
                self.mounts[first] = mount_of_drive([points.mount], self.mounts.get(first))
        if len(self.rows) < last:
            log.warning("%s: %d damaged places were skipped, %d kept", self.path, last - len(self.rows), len(self.rows))

    def _record(self, table: str, row: int, kind: type[Record]) -> Record | None:
        """The record in a row, None if there is none, or it is damaged."""
        try:
            with self._reading:
                found = self._db.execute(f"SELECT crc, record FROM {table} WHERE row = ?", (row,)).fetchone()
            crc, record = found or (None, None)
            if isinstance(record, bytes) and _crc(row, record) == crc:
                return msgspec.msgpack.decode(record, type=kind)
        except (sqlite3.Error, ValueError):  # as of msgspec, and of text that is damaged
            self.is_sound = False
        return None

    def segments(self) -> Iterator[tuple[int, int, View]]:
        """Places [start, end) of each drive."""
        starts = [*(first for first, _ in self.drives), len(self.rows)]
        yield from ((*rows, view) for rows, (_, view) in zip(pairwise(starts), self.drives, strict=True))

    def place(self, row: int) -> PlacePassed:
        """One of the places; OSError if it cannot be read any more."""
        record = self._record("places", self.rows[row], PlacePassed)
        if record is None:
            raise OSError(errno.EIO, f"{self.path}: place {row} is damaged")
        return record

    def points(self, row: int) -> PointsMade | None:
        """The keypoints of one of the places, None where it has none, or they cannot be read any more."""
        key = self.header.keypoints
        record = self._record("points", self.rows[row], PointsMade) if key is not None else None
        return record if record and key and len(record.points) == key.place_bytes else None

    def raw_of(self, passed: PlacePassed) -> NDArray[np.float32]:
        """The raw descriptor (R, D) of a record."""
        values = FLOATS.take(np.frombuffer(passed.raw, "<u2"))
        return values.reshape(self.header.regions.count, self.header.model.dimensions)

    def close(self) -> None:
        """Close it; more than once is harmless."""
        with contextlib.suppress(sqlite3.Error):
            self._db.close()


def create_log(path: Path, header: LogHeader) -> OpenLog:
    """A new file without places. OSError."""
    new, record = path.with_name(f"{path.name}.new"), msgspec.msgpack.encode(header)
    path.parent.mkdir(parents=True, exist_ok=True)
    new.unlink(missing_ok=True)
    with _disk_errors(), contextlib.closing(sqlite3.connect(new, isolation_level=None)) as db:
        db.executescript("BEGIN;" + TABLES.format("places") + TABLES.format("points"))
        db.execute("INSERT INTO places VALUES (0, ?, ?)", (_crc(0, record), record))
        db.execute("COMMIT")
        db.execute("PRAGMA journal_mode = wal")
    new.replace(path)
    flush_to_disk(path.parent)
    return OpenLog(path)


class PlaceLog:
    """Writes places to an open file by a thread; `stopped` says why the disk takes none now."""

    def __init__(self, file: OpenLog, min_free_bytes: float = 0.0, retry_s: float = RETRY_S) -> None:
        """min_free_bytes: nothing is written while the disk has less than this left. retry_s: pause between tries."""
        self.file = file
        self.min_free_bytes, self._retry_s = min_free_bytes, retry_s
        self._recent: deque[NDArray[np.float32]] = deque(maxlen=RECENT)
        self._points: dict[int, PointsMade] = {}  # by the table's rows, until they are written
        self._queue: queue.Queue[tuple[str, int, PlacePassed | PointsMade] | None] = queue.Queue(QUEUE_PLACES)
        self.stopped = os.strerror(errno.EROFS) if file.is_read_only else ""
        self._closing = threading.Event()
        self._last_row = file.last_row
        self._drive, self._view = (file.newest.drive, file.newest.view) if file.newest else (0, "rear")
        self._db = file.connect()
        self._thread = threading.Thread(target=self._run, name="mapping", daemon=True)
        self._thread.start()

    @property
    def count(self) -> int:
        """Places that were handed over, or were there."""
        return len(self.file.rows)

    @property
    def waiting(self) -> int:
        """How many records are not written yet."""
        return self._queue.unfinished_tasks

    def begin_drive(self, view: View) -> bool:
        """The places that follow are of another drive; False if the disk is too far behind."""
        self._drive, self._view = self._last_row + 1, view
        return not self.stopped and not self._queue.full()

    def add(self, raw: NDArray[np.float32], place: Place, unix_s: float, *, is_vouched: bool = False) -> bool:
        """Hand a place over without waiting; False if the disk is too far behind, and the place is not in the map.

        unix_s: the time now. is_vouched: see `PlacePassed`.
        """
        values, row = raw.astype("<f2"), self._last_row + 1
        passed = PlacePassed(place, values.tobytes(), self._drive, self._view, unix_s, is_vouched)
        if not self._put("places", row, passed):
            return False
        self._last_row = row
        self.file.rows.append(row)
        self._recent.append(values.astype(np.float32))
        return True

    def add_points(self, row: int, record: NDArray[np.void], mount: Mount) -> None:
        """Hand the keypoints of a place over, from any thread; where the disk is too far behind, it has none."""
        row, points = self.file.rows[row], PointsMade.of(record, mount)
        self._points[row] = points
        if not self._put("points", row, points):
            del self._points[row]

    def points(self, row: int) -> PointsMade | None:
        """The keypoints of a place; None where it has none, or none yet."""
        return self._points.get(self.file.rows[row]) or self.file.points(row)

    def raw_rows(self, rows: Sequence[int]) -> NDArray[np.float32]:
        """Raw descriptors (n, R, D) of some places, the older ones from the disk. OSError."""
        first, file = self.count - len(self._recent), self.file
        return np.stack([self._recent[row - first] if row >= first else file.raw_of(file.place(row)) for row in rows])

    def thumbnail(self, row: int) -> bytes:
        """The small JPEG of a place, b"" if it is not on the disk yet."""
        with contextlib.suppress(OSError):
            return self.file.place(row).place.thumbnail
        return b""

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

    def _put(self, table: str, row: int, record: PlacePassed | PointsMade) -> bool:
        if self.stopped:
            return False
        try:
            self._queue.put_nowait((table, row, record))
        except queue.Full:
            return False
        return True

    def _run(self) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        flushed_s, is_flushed = time.monotonic(), True
        while not (self._closing.is_set() and self._queue.empty()):
            with contextlib.suppress(queue.Empty):
                handed = self._queue.get(timeout=FLUSHED_EACH_S)
                if handed is not None and not self._write(*handed):
                    break  # what follows would be taken for what is missing
                self._queue.task_done()
                is_flushed = is_flushed and handed is None
            if not is_flushed and time.monotonic() - flushed_s >= FLUSHED_EACH_S:
                flushed_s, is_flushed = time.monotonic(), self._flush()
        self._flush()
        with contextlib.suppress(sqlite3.Error):
            self._db.close()

    def _write(self, table: str, row: int, handed: PlacePassed | PointsMade) -> bool:
        """Write a record as soon as the disk takes it; False at the end, where it does not."""
        record = msgspec.msgpack.encode(handed)
        values = row, _crc(row, record), record
        while not self._does(f"INSERT OR REPLACE INTO {table} VALUES (?, ?, ?)", values):
            if self._closing.wait(self._retry_s):
                return False
        if isinstance(handed, PointsMade):
            del self._points[row]
        return True

    def _flush(self) -> bool:
        """Bring what was written to the disk, and empty SQLite's log: what is damaged there costs all that follows."""
        return self._does("PRAGMA wal_checkpoint(truncate)")

    def _does(self, statement: str, values: tuple[int, int, bytes] | tuple[()] = ()) -> bool:
        """Whether the disk took what a statement writes; sets `stopped`."""
        try:
            if values and shutil.disk_usage(self.file.path.parent).free - len(values[2]) < self.min_free_bytes:
                raise OSError(errno.ENOSPC, DISK_FULL)
            with _disk_errors():
                is_held_up = self._db.execute(statement, values).fetchone()
        except OSError as error:
            if not self.stopped:
                self.stopped = reason(error)
                log.warning("%s: mapping waits after %d places: %s", self.file.path, self.count, self.stopped)
            return False
        if self.stopped and not self._closing.is_set():
            self.stopped = ""
            log.warning("%s: mapping goes on, with a new drive", self.file.path)
        return not (is_held_up and is_held_up[0])
