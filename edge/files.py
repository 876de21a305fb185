"""Files and folders that are replaced whole, and whether this user, in its sandbox, can reach the paths of a config.

After a crash or a power cut there is the old file or folder, or the new one, and never a part.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import glob
import hashlib
import logging
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from datetime import datetime, timezone
from functools import partial
from itertools import count
from pathlib import Path
from typing import BinaryIO, Generic, TypeVar

import msgspec

from edge.errors import ConfigError, MapError, reason

BEHIND = "files"
"""The name of threads that write."""
KEY_BYTES = 32
"""Of MAVLink's signing, and of Ed25519."""
MOST_KEPT_BYTES = 16_000_000
"""Of what a run keeps for the next: many times what the largest of networks needs."""
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
T = TypeVar("T")
log = logging.getLogger(__name__)


@contextlib.contextmanager
def replacing(path: Path, *, is_flushed: bool = True) -> Iterator[BinaryIO]:
    """A stream for the new content of the file `path`, which is put in place by one rename when the block ends.

    is_flushed: both the file and its folder, to the disk. An exception in the block, or an OSError of the disk, leaves
    the old file as it was and is raised.
    """
    new = path.with_name(f"{path.name}.new")
    try:
        with new.open("wb") as stream:
            yield stream
            stream.flush()
            if is_flushed:
                os.fsync(stream.fileno())
        new.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)
        raise
    if is_flushed:
        flush_to_disk(path.parent)


def flush_to_disk(path: Path) -> None:
    """Have a file, or the names in a folder, written to the disk. OSError."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class BackgroundWorker:
    """One task at a time in a thread of its own: a disk that hangs must not hold up what drives the vehicle."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._next: Callable[[], object] | None = None
        self._lock = threading.Lock()

    def start(self, task: Callable[[], object]) -> None:
        """Run a task, which handles its own errors, after the one that runs; of those that wait, only the newest."""
        with self._lock:
            self._next = task
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=BEHIND, daemon=True)
                self._thread.start()

    @property
    def is_busy(self) -> bool:
        """Whether a task runs, or waits."""
        return self._thread is not None

    def _run(self) -> None:
        while True:
            with self._lock:
                task, self._next = self._next, None
                if task is None:
                    self._thread = None
                    return
            task()

    def wait(self, seconds: float = 2.0) -> bool:
        """Whether all tasks have ended, after so long at most."""
        thread = self._thread
        if thread is not None:
            thread.join(timeout=seconds)
        return thread is None or not thread.is_alive()


def wait_for_writes(seconds: float = 2.0) -> None:
    """Wait for the tasks of every `BackgroundWorker`, side by side, so long at most."""
    end_s = time.monotonic() + seconds
    for thread in threading.enumerate():
        if thread.name == BEHIND:
            thread.join(max(0.0, end_s - time.monotonic()))


class PersistentFile(Generic[T]):
    """One record that outlives this program, in a file of JSON after its SHA-256: the store for what a next run needs.

    A disk that is full or hangs, and a file that is damaged, cost only that. Version 0.3.0 wrote some without SHA-256.
    """

    def __init__(self, path: Path | None, kind: type[T], lost: str, *, is_flushed: bool = True) -> None:
        """path: None keeps nothing. lost: what it costs, for people. is_flushed: it outlives a power cut as well."""
        self._path, self._kind, self._lost, self._is_flushed = path, kind, lost, is_flushed
        self._behind, self._logged = BackgroundWorker(), ""

    def read(self) -> T | None:
        """What an earlier run has kept; None for nothing, with a line in the log where it cannot be used."""
        try:
            if self._path is None or not self._path.exists():
                return None
            if self._path.stat().st_size > MOST_KEPT_BYTES:
                raise ValueError("too large")
            data = self._path.read_bytes()
            digest, _, body = data.partition(b"\n")
            if data[:1] != b"{" and hashlib.sha256(body).hexdigest().encode() != digest:
                raise ValueError("damaged, or of another version")
            return msgspec.json.decode(data if data[:1] == b"{" else body, type=self._kind)
        except (OSError, ValueError) as error:  # msgspec's errors are ValueErrors
            log.warning("%s: ignored: %s; %s", self._path, reason(error), self._lost)
            return None

    def write(self, record: T | None) -> str:
        """Replace the file, or remove it for None; why that failed, "" where it did not: logged once."""
        path, why = self._path, ""
        if path is None:
            return why
        try:
            if record is None:
                path.unlink(missing_ok=True)
            else:
                body = msgspec.json.encode(record)
                with replacing(path, is_flushed=self._is_flushed) as stream:
                    stream.write(hashlib.sha256(body).hexdigest().encode() + b"\n" + body)
        except OSError as error:
            why = reason(error)
        if why not in ("", self._logged):
            log.warning("%s: cannot write it: %s; %s", path, why, self._lost)
        self._logged = why
        return why

    def write_behind(self, record: T | None) -> None:
        """The same in a thread of its own; see `wait_for_writes`."""
        if self._path is not None:
            self._behind.start(partial(self.write, record))


DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


class AtomicFolder:
    """A temporary folder beside the place that it is for; as a context manager, what is not put there is removed."""

    def __init__(self, place: Path) -> None:
        """MapError if nothing can be written there."""
        self._place = place
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            _clear_leftovers(place)
            # Beside its place, since a rename cannot cross file systems.
            self.path = Path(tempfile.mkdtemp(prefix=f".{place.name}.", suffix=".building", dir=place.parent))
            self.path.chmod(0o755)
            self._lock = locked(self.path)
        except OSError as error:
            raise MapError(f"{place}: cannot write a map here: {error.strerror}") from None

    def put_in_place(self) -> None:
        """Sync everything in it and rename it, or swap it with what is there. MapError where that cannot be."""
        for path in (*self.path.rglob("*"), self.path):
            flush_to_disk(path)
        if self._place.exists():
            _exchange(self.path, self._place)
        else:
            self.path.rename(self._place)
        flush_to_disk(self._place.parent)

    def __enter__(self) -> AtomicFolder:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        # After `put_in_place` this is what was replaced, or nothing.
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self._lock)
        if isinstance(error, OSError) and error.errno in DISK_ERRORS:
            raise MapError(f"{self._place}: cannot write the map: {error.strerror}") from None


def locked(folder: Path) -> int:
    """A descriptor of a folder that is this process's alone; the lock goes with it, or with the process. OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _clear_leftovers(place: Path) -> None:
    """Remove what builders of this map have left that were killed, and nothing that is being built."""
    for folder in place.parent.glob(f".{glob.escape(place.name)}.*.building"):
        with contextlib.suppress(OSError):
            lock = locked(folder)
            shutil.rmtree(folder, ignore_errors=True)
            os.close(lock)


def _exchange(new: Path, old: Path) -> None:
    """Swap two folders in one step (renameat2 with RENAME_EXCHANGE): at no moment is there no map."""
    at_fdcwd, rename_exchange = -100, 2
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.renameat2(at_fdcwd, os.fsencode(new), at_fdcwd, os.fsencode(old), rename_exchange) != 0:
        reason = os.strerror(ctypes.get_errno())
        raise MapError(f"{old}: this file system cannot replace a map atomically ({reason}); remove the old map first")


def named_by_time(folder: Path, unix_s: float, is_taken: Callable[[Path], bool] = Path.exists) -> Path:
    """A new path in a folder, named by the time; two runs may begin in the same second."""
    started = datetime.fromtimestamp(unix_s, tz=timezone.utc).strftime("%Y%m%dT%H%M%SZ")
    names = (started if number == 1 else f"{started}-{number}" for number in count(1))
    return next(path for path in (folder / name for name in names) if not is_taken(path))


HOME_FOLDERS = ("/home", "/root", "/run/user")
"""What ProtectHome=yes in the service's unit closes."""


def check_access(where: str, path: str) -> str:
    """The path. ConfigError if this user may not enter a folder on the way to it, where nothing can be seen at all.

    Nor may it lead to what is neither file nor folder: a named pipe would be read without end.
    """
    # The link at [nmea] pty is ours; a run that was killed leaves it, and its terminal may be another program's by now.
    followed = os.path.dirname(path) if where == "[nmea] pty" else path  # noqa: PTH120
    real = Path(os.path.realpath(followed))  # Path.resolve raises at a loop of links
    for folder in (*reversed(real.parents), real):
        if os.path.isdir(folder) and not os.access(folder, os.X_OK):  # noqa: PTH112  # Path.is_dir raises
            raise ConfigError(f"{where}: {path}: this user may not enter {folder}; {_what_to_do(folder)}")
    if real.exists() and not os.access(real, os.R_OK):
        raise ConfigError(f"{where}: {path}: this user may not read it; {_what_to_do(real)}")
    is_expected = where == "[telemetry] journal"
    if real.exists() and not (real.is_file() or real.is_dir() or is_expected):
        raise ConfigError(f"{where}: {path}: neither a file nor a folder")
    return path


def _what_to_do(closed: Path) -> str:
    if str(closed) not in HOME_FOLDERS:
        return "change its owner or its mode"
    return "the service sees no home folders (ProtectHome=): put data in /var/lib/lookback and keys in /etc/lookback"


def read_key(file: Path, where: str, *, is_secret: bool = True, remedy: str = "") -> bytes:
    """The KEY_BYTES of a key's file, raw or as hexadecimal digits. ConfigError, which begins with `where`.

    is_secret: it must not be a file that other users can read.
    """
    try:
        with file.open("rb") as stream:
            data, mode = stream.read(4 * KEY_BYTES), file.stat().st_mode
    except OSError as error:
        raise ConfigError(f"{where}: cannot read this key: {error.strerror}") from None
    if is_secret and mode & 0o077:
        raise ConfigError(f"{where}: other users can read this key; chmod 600 {file}")
    with contextlib.suppress(ValueError):
        data = bytes.fromhex(data.decode("ascii")) if len(data) != KEY_BYTES else data
    if len(data) != KEY_BYTES:
        raise ConfigError(f"{where}: not a key of {KEY_BYTES} bytes, or of {2 * KEY_BYTES} hexadecimal digits{remedy}")
    return data
