"""The files of a journal: the one that is written, and PATH.1, PATH.2, ... before it, the newest first."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

FILES = 10
"""How many files share the space that a journal may take."""


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


def open_all(path: Path, parts: ExitStack) -> list[BinaryIO]:
    """All files of a journal for reading, the oldest first; `parts` closes them.

    PATH is opened first: if it is renamed while the others are opened, it is met again, and not opened twice.
    """
    streams: dict[tuple[int, int], BinaryIO] = {}
    for file in (path, *earlier_files(path)):
        try:
            stream = parts.enter_context(file.open("rb"))
        except FileNotFoundError:
            if file == path and not earlier_files(path):
                raise
            continue  # a crash between two renames, or the oldest file, which was deleted meanwhile
        status = os.fstat(stream.fileno())
        streams.setdefault((status.st_dev, status.st_ino), stream)
    return list(reversed(streams.values()))
