"""The file of a delta: a compressed tar file, whose bytes depend on nothing but its members.

It may come from anyone. A compressed file can unpack to a thousand times its size, so no more is read than drives of
vehicles give: their descriptors and pictures hardly compress.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import os
import re
import shutil
import tarfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import IO

import msgspec

from edge.errors import MapError
from edge.files import replacing
from edge_plugins.layers.tally import TALLIES
from sim.output import refusing

INVENTORY = "inventory.json"
NAME = re.compile(r"[^./\x00-\x1f\x7f][^/\x00-\x1f\x7f]*")
"""Of a map or a file: no folder, not hidden, and nothing that moves a terminal's cursor."""
MOST_GROWTH, LEAST_ROOM_BYTES = 10, 16 << 20
"""How many times its size a delta may unpack to, beside so much in any case, for counts. One of a drive of 1,000 places
unpacks to 1.5 times its size."""
Member = tuple[tarfile.TarInfo, IO[bytes] | None]
"""What is known of a member, and its content, None where it is no plain file."""


class _Limited:
    """The bytes of a compressed file, up to a limit."""

    def __init__(self, file: Path, packed: gzip.GzipFile) -> None:
        self._file, self._packed = file, packed
        self._left = LEAST_ROOM_BYTES + MOST_GROWTH * file.stat().st_size

    def read(self, size: int = -1) -> bytes:
        """As a stream has it. MapError beyond the limit, before more than a byte of that is in memory."""
        data = self._packed.read(self._left + 1 if size < 0 else min(size, self._left + 1))
        self._left -= len(data)
        if self._left < 0:
            raise MapError(f"{self._file}: unpacks to over {MOST_GROWTH} times its size, as no delta does")
        return data


@contextlib.contextmanager
def writing(output: Path) -> Iterator[tarfile.TarFile]:
    """A delta to which members are added by `add`; MapError where it cannot be written."""
    with (
        refusing(MapError, f"{output}: cannot write it"),
        replacing(output) as stream,
        gzip.GzipFile("", "wb", fileobj=stream, mtime=0) as packed,
        tarfile.open(fileobj=packed, mode="w") as tar,
    ):
        yield tar


def add(tar: tarfile.TarFile, name: str, content: Path | bytes) -> None:
    """A member: the content of a file, or some bytes."""
    member = tarfile.TarInfo(name)
    if isinstance(content, bytes):
        member.size = len(content)
        tar.addfile(member, io.BytesIO(content))
        return
    with content.open("rb") as stream:
        status = os.fstat(stream.fileno())
        member.size, member.mtime = status.st_size, int(status.st_mtime)
        tar.addfile(member, stream)


@contextlib.contextmanager
def reading(delta: Path) -> Iterator[Iterable[Member]]:
    """The members in their order, each to be read before the next. MapError for all that is wrong with the file."""
    try:
        with gzip.open(delta, "rb") as packed:
            limited = _Limited(delta, packed)
            with tarfile.open(fileobj=limited, mode="r|") as tar:  # type: ignore[call-overload]  # it needs `read` alone
                yield ((member, tar.extractfile(member) if member.isreg() else None) for member in tar)
    except (tarfile.TarError, EOFError, gzip.BadGzipFile, msgspec.DecodeError) as error:
        raise MapError(f"{delta}: cut off, or not a delta ({error}); copy it again") from None
    except OSError as error:
        raise MapError(f"{delta}: cannot read it: {error.strerror or error}") from None


def unpack(delta: Path, place: Path, is_wanted: Callable[[str, str], bool]) -> dict[str, dict[str, int]]:
    """Unpack some of the files into the folders of their maps or tallies; of each folder all its files and their bytes.

    is_wanted: of the names of a folder and of a file. Read to its end, so that its checksum holds. MapError.
    """
    sizes: defaultdict[str, dict[str, int]] = defaultdict(dict)
    with reading(delta) as members:
        for member, stream in members:
            if member.name == INVENTORY:
                continue
            parts = PurePosixPath(member.name).parts
            is_named = (
                len(parts) == 2 and (NAME.fullmatch(parts[0]) or parts[0] == TALLIES) and NAME.fullmatch(parts[1])
            )
            if stream is None or not is_named or parts[1] in sizes[parts[0]]:
                raise MapError(f"{delta}: {member.name!r} is no file of a map; this is not a delta")
            folder, name = parts
            sizes[folder][name] = member.size
            if is_wanted(folder, name):
                file = place / folder / name
                file.parent.mkdir(exist_ok=True)
                with file.open("wb") as out:
                    shutil.copyfileobj(stream, out)
                os.utime(file, (member.mtime % 2**32,) * 2)  # when the drive was made
    return dict(sizes)
