"""Checksums of maps' files, a piece at a time, so that a daemon can compute them while no frame waits."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from io import FileIO
from pathlib import Path

import msgspec

from edge.errors import MapError

PIECE_BYTES = 1 << 20


class FileKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Size and checksum of one file of the map."""

    bytes: int
    sha256: str


class Checksums:
    """What is left to be checked of some files of a map."""

    def __init__(self, path: Path, files: dict[str, FileKey], names: Sequence[str]) -> None:
        """`names` of the `files` that the header of the map at `path` lists."""
        self._path, self._files = path, files
        self._names = list(names)
        self._stream: FileIO | None = None
        self._buffer = memoryview(b"")
        self._digest = hashlib.sha256()

    @property
    def is_done(self) -> bool:
        """Whether every checksum has been seen to hold."""
        return not self._names

    def step(self, max_bytes: int) -> bool:
        """Read on by at most that much; True when all is done. MapError names a file whose checksum does not hold."""
        while self._names and max_bytes > 0:
            size = self._read(max_bytes)
            if size:
                self._digest.update(self._buffer[:size])
                max_bytes -= size
            else:
                self._compare()
        return self.is_done

    def finish(self) -> None:
        """Check all that is left, now."""
        while not self.step(PIECE_BYTES):
            pass

    def close(self) -> None:
        """Give the file that is being read back; what is left stays unchecked."""
        if self._stream is not None:
            self._stream.close()
        self._stream, self._buffer = None, memoryview(b"")

    def _read(self, max_bytes: int) -> int:
        """Read a piece into the buffer, which is no larger than the file; how much it was, 0 at the end."""
        file = self._path / self._names[0]
        try:
            if self._stream is None:
                self._stream = FileIO(file)
                self._buffer = memoryview(bytearray(min(PIECE_BYTES, file.stat().st_size + 1)))
                self._digest = hashlib.sha256()
            return self._stream.readinto(self._buffer[:max_bytes]) or 0
        except OSError as error:
            self.close()
            raise MapError(f"{file}: cannot read it: {error.strerror}") from None

    def _compare(self) -> None:
        self.close()
        name = self._names.pop(0)
        if self._digest.hexdigest() != self._files[name].sha256:
            raise MapError(f"{self._path / name}: damaged (checksum mismatch); build or copy the map again")


class ChecksumSchedule:
    """What is left to be checked of some maps, those in use first."""

    def __init__(self, maps: Mapping[Path, tuple[dict[str, FileKey], Sequence[str]]]) -> None:
        """maps: of each map's folder, the files of its header and the names of those to check."""
        self._left = {path: Checksums(path, files, names) for path, (files, names) in maps.items()}
        self._damaged: set[Path] = set()

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to check."""
        return not self._left

    def is_verified(self, maps: Collection[Path]) -> bool:
        """Whether every checksum of these maps holds."""
        return not any(path in self._left or path in self._damaged for path in maps)

    def step(self, max_bytes: int, first: Sequence[Path] = ()) -> dict[Path, str]:
        """Read on by at most that much, of the maps in `first` before others; a map that is damaged, and why.

        It is not checked again.
        """
        path = next((path for path in (*first, *self._left) if path in self._left), None)
        if path is None:
            return {}
        try:
            if self._left[path].step(max_bytes):
                del self._left[path]
        except MapError as error:
            del self._left[path]
            self._damaged.add(path)
            return {path: str(error)}
        return {}


def sha256_of(file: Path) -> str:
    """Checksum of a file, read in pieces. MapError if it cannot be read."""
    try:
        with file.open("rb") as stream:
            digest = hashlib.sha256()
            while block := stream.read(PIECE_BYTES):
                digest.update(block)
    except OSError as error:
        raise MapError(f"{file}: cannot read it: {error.strerror}") from None
    return digest.hexdigest()
