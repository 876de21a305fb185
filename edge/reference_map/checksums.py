"""Checksums of maps' files, a piece at a time, so that a daemon can compute them while no frame waits."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec

from edge.errors import MapError

CHECKED_BYTES = 1 << 20


class FileKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Size and checksum of one file of the map."""

    bytes: int
    sha256: str


def pieces_checked(
    path: Path, files: Mapping[str, FileKey], names: Iterable[str], piece_bytes: int = CHECKED_BYTES
) -> Iterator[int]:
    """Check some of the files that the header of the map at `path` lists: after each piece, how many bytes it had.

    MapError names a file that cannot be read, or whose checksum does not hold.
    """
    for name in names:
        file, digest = path / name, hashlib.sha256()
        try:
            with file.open("rb", buffering=0) as stream:
                buffer = memoryview(bytearray(min(piece_bytes, file.stat().st_size + 1)))
                while size := stream.readinto(buffer):
                    digest.update(buffer[:size])
                    yield size
        except OSError as error:
            raise MapError(f"{file}: cannot read it: {error.strerror}") from None
        if digest.hexdigest() != files[name].sha256:
            raise MapError(f"{file}: damaged (checksum mismatch); build or copy the map again")


def check_files(path: Path, files: Mapping[str, FileKey], names: Iterable[str]) -> None:
    """Check all of them now, see `pieces_checked`."""
    for _ in pieces_checked(path, files, names):
        pass


class ChecksumSchedule:
    """What is left to be checked of some maps, those in use first."""

    def __init__(self, maps: Mapping[Path, tuple[dict[str, FileKey], Sequence[str]]]) -> None:
        """maps: of each map's folder, the files of its header and the names of those to check."""
        self._left = {path: pieces_checked(path, files, names) for path, (files, names) in maps.items()}
        self._damaged: set[Path] = set()

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to check."""
        return not self._left

    def is_verified(self, maps: Collection[Path]) -> bool:
        """Whether every checksum of these maps holds."""
        return not any(path in self._left or path in self._damaged for path in maps)

    def step(self, max_bytes: int, first: Sequence[Path] = ()) -> dict[Path, str]:
        """Read on by about that much, of the maps in `first` before others; a map that is damaged, and why.

        It is not checked again.
        """
        path = next((path for path in (*first, *self._left) if path in self._left), None)
        if path is None:
            return {}
        try:
            while max_bytes > 0:
                max_bytes -= next(self._left[path])
        except StopIteration:
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
            while block := stream.read(CHECKED_BYTES):
                digest.update(block)
    except OSError as error:
        raise MapError(f"{file}: cannot read it: {error.strerror}") from None
    return digest.hexdigest()
