"""The journal: what happened, one record of `records` per line as a JSON object, only ever appended.

A crash can tear the last line and no other: each line goes out in a single write, and a file that ends in half a
line gets a new line started at the next opening. A disk that is full or read-only costs the lines that it does not
take, and is reported; the daemon runs on. A file that has grown to its share of the journal's space is renamed: PATH
is the one that is written, and PATH.1, PATH.2, ... are those before it, the newest first. `sim.journal` reads them.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import queue
import stat
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

import edge
from edge.errors import ConfigError, reason
from edge.files import DISK_ERRORS
from edge.journal.records import RENAMED, SCHEMA, JournalOpened, JournalResumed, Record, as_written

log = logging.getLogger(__name__)
FILES = 10
"""How many files share the space that a journal may take."""
QUEUE_RECORDS = 1000
"""Of the daemon's journal: about 20 s of a drive with [telemetry] journal_frames, minutes without."""
FLUSH_S = 3.0
"""How long the end waits for a disk that does not answer; see `END_S` of `edge.commands.run`."""


class Journal:
    """An open journal, which begins with `JournalOpened`; the folder it lies in is created."""

    def __init__(
        self, path: Path, *, max_bytes: float = math.inf, unix_time_s: Callable[[], float] = time.time
    ) -> None:
        """ConfigError where the path can be no journal. A disk that cannot be written is tried again with each line.

        max_bytes: of all files of the journal.
        """
        self._path = path
        self._file_bytes = self._rotate_at = max_bytes / FILES
        self._unix_time_s = unix_time_s
        self.lost = 0
        """Lines that could not be written."""
        self.why_lost = ""
        self._fd, self._is_closed, self._size, self._torn = -1, False, 0, False
        try:
            self._open()
        except OSError as error:
            if error.errno not in DISK_ERRORS:  # with those of a disk, navigation goes on without a journal
                raise ConfigError(f"[telemetry] journal: {path}: cannot append to it: {error.strerror}") from None
            self._report_lost(reason(error))
        else:
            self.write(JournalOpened(SCHEMA, edge.__version__, RENAMED))

    def _open(self) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._fd = os.open(self._path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
        self._torn = _ends_torn(self._fd)
        _give_to_owner_of(self._path.parent, self._fd)
        self._size = os.fstat(self._fd).st_size

    def _rotate_if_due(self) -> None:
        """Begin the next file. Where that fails, this one goes on, and the next try is a file's length later."""
        if self._size < self._rotate_at or not stat.S_ISREG(os.fstat(self._fd).st_mode):
            return
        self._rotate_at = self._size + self._file_bytes
        full = self._fd
        try:
            rotate(self._path)
            self._open()
        except OSError as error:
            log.warning("%s: cannot begin a new file: %s", self._path, error.strerror)
            return
        os.close(full)
        self._rotate_at = self._file_bytes
        self.write(JournalOpened(SCHEMA, edge.__version__, RENAMED))

    @property
    def now_s(self) -> float:
        """The wall clock in Unix seconds, as records have it."""
        return round(self._unix_time_s(), 3)

    def encoded(self, record: Record) -> bytes:
        """A record of this moment as a line. TypeError or ValueError, of msgspec, where a field of it has none."""
        return msgspec.json.encode({"unix_s": self.now_s, **as_written(record)}) + b"\n"

    def write(self, record: Record) -> bool:
        """Append a record of this moment; False, and reported, when it does not fit on the disk."""
        return self.append(self.encoded(record))

    def append(self, line: bytes) -> bool:
        """Append a line; False, and reported, when it does not fit on the disk."""
        if self._fd < 0 and (self._is_closed or not self._is_open_again()):
            return False
        self._rotate_if_due()
        line = b"\n" * self._torn + line
        try:
            written = os.write(self._fd, line)
            self._size += written
        except OSError as error:
            self._report_lost(reason(error))
            return False
        if written < len(line):
            self._torn = True
            self._report_lost("no space left on device")
            return False
        if self.lost:
            log.warning("%s: writing again; %d lines were lost", self._path, self.lost)
        self._torn, self.lost = False, 0
        return True

    def _is_open_again(self) -> bool:
        """Open the file that could not be opened before; False while it still cannot."""
        try:
            self._open()
        except OSError as error:
            self._report_lost(reason(error))
            return False
        return self.write(JournalOpened(SCHEMA, edge.__version__, RENAMED))

    def _report_lost(self, why: str) -> None:
        if not self.lost:
            log.error("%s: cannot write the journal: %s", self._path, why)
        self.why_lost = why
        self.lost += 1

    def close(self) -> None:
        """Close the file, to which nothing is written any more; more than once is harmless."""
        self._is_closed = True
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class QueuedJournal:
    """A journal that another thread writes, so that a disk that hangs costs records and not the vehicle's position."""

    def __init__(self, journal: Journal, room: int = QUEUE_RECORDS) -> None:
        """`journal` is closed at the end. room: how many records may wait; further ones are dropped."""
        self._journal = journal
        self._queue: queue.Queue[bytes | None] = queue.Queue(room)
        self._dropped = 0
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name="journal", daemon=True)
        self._thread.start()

    @property
    def lost(self) -> int:
        """Records that the disk did not take, or that were dropped while it hung."""
        return self._dropped + self._journal.lost

    @property
    def why_lost(self) -> str:
        """Why records are lost, "" while none is."""
        return "the disk hangs" if self._dropped else self._journal.why_lost

    def write(self, record: Record) -> bool:
        """Queue a record of this moment; False where it is dropped. A `JournalResumed` that is queued ends the loss.

        It is encoded here: what cannot be is the mistake of whoever calls this, and not the end of the journal.
        """
        if self._is_closed:
            return False
        line = self._journal.encoded(record)
        try:
            self._queue.put_nowait(line)
        except queue.Full:
            if not self._dropped:
                log.error("the journal's disk hangs: records are dropped")
            self._dropped += not isinstance(record, JournalResumed)
            return False
        if isinstance(record, JournalResumed):
            self._dropped = 0
        return True

    def close(self) -> None:
        """Write what waits, in order; a disk that hangs is given up. More than once is harmless."""
        if self._is_closed:
            return
        self._is_closed = True
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=FLUSH_S)
            self._thread.join(FLUSH_S)
        if self._thread.is_alive():
            log.error("the journal's disk hangs: %d records at the end are lost", self._queue.qsize())

    def _run(self) -> None:
        while (one := self._queue.get()) is not None:
            self._journal.append(one)
        self._journal.close()


def _give_to_owner_of(folder: Path, fd: int) -> None:
    """What root has begun in a service's folder, with a first `lookback run`, must not be closed to the service."""
    owner, file = folder.stat(), os.fstat(fd)
    if os.geteuid() == 0 and file.st_uid == 0 and owner.st_uid != 0 and stat.S_ISREG(file.st_mode):
        os.fchown(fd, owner.st_uid, owner.st_gid)


def _ends_torn(fd: int) -> bool:
    """Whether a regular file ends in the middle of a line."""
    status = os.fstat(fd)
    return stat.S_ISREG(status.st_mode) and status.st_size > 0 and os.pread(fd, 1, status.st_size - 1) != b"\n"


def earlier_files(path: Path) -> list[Path]:
    """PATH.1, PATH.2, ...: those that exist, the newest first; a crash while they were renamed leaves a gap."""
    if not path.parent.is_dir():
        return []
    suffixes = (file.name.removeprefix(f"{path.name}.") for file in path.parent.iterdir())
    numbers = sorted(int(suffix) for suffix in suffixes if suffix.isdecimal() and suffix[0] != "0")
    return [path.with_name(f"{path.name}.{number}") for number in numbers]


def rotate(path: Path) -> None:
    """Make PATH free: it becomes PATH.1, PATH.1 becomes PATH.2, and so on. Beyond FILES the oldest are deleted."""
    if not path.exists():  # the last time, the next file could not be begun
        return
    existing = set(earlier_files(path))
    number = 1
    while path.with_name(f"{path.name}.{number}") in existing:
        number += 1
    for earlier in range(number, 1, -1):
        path.with_name(f"{path.name}.{earlier - 1}").rename(path.with_name(f"{path.name}.{earlier}"))
    path.rename(path.with_name(f"{path.name}.1"))
    for file in earlier_files(path)[FILES - 1 :]:
        file.unlink()
