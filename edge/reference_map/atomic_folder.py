"""A folder that is put in its place whole: after a crash there is the old one or the new one, and never a half."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import glob
import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType

from edge.atomic_file import flush_to_disk
from edge.errors import MapError

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
            self._lock = _locked(self.path)
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # After `put_in_place` this is what was replaced, or nothing.
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self._lock)
        if isinstance(error, OSError) and error.errno in DISK_ERRORS:
            raise MapError(f"{self._place}: cannot write the map: {error.strerror}") from None


def _locked(folder: Path) -> int:
    """A descriptor of a folder that is being built; the lock goes with it, or with the process."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return descriptor


def _clear_leftovers(place: Path) -> None:
    """Remove what builders of this map have left that were killed, and nothing that is being built."""
    for folder in place.parent.glob(f".{glob.escape(place.name)}.*.building"):
        with contextlib.suppress(OSError):
            lock = _locked(folder)
            shutil.rmtree(folder, ignore_errors=True)
            os.close(lock)


def _exchange(new: Path, old: Path) -> None:
    """Swap two folders in one step (renameat2 with RENAME_EXCHANGE): at no moment is there no map."""
    at_fdcwd, rename_exchange = -100, 2
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.renameat2(at_fdcwd, os.fsencode(new), at_fdcwd, os.fsencode(old), rename_exchange) != 0:
        reason = os.strerror(ctypes.get_errno())
        raise MapError(f"{old}: this file system cannot replace a map atomically ({reason}); remove the old map first")
