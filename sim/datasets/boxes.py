"""The outermost boxes of an ISO base media file (MP4, MOV), whose bytes show what it holds; needs no package."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

MOST_BYTES = 1 << 26
"""Of a box that is read: an index (moov) has a few MB, the video itself (mdat) is passed over."""


def contents(file: Path) -> Iterator[tuple[bytes, bytes]]:
    """Kind and content of each box but the video itself; nothing of a file that cannot be read."""
    with suppress(OSError), file.open("rb") as stream:
        for start, kind, length in _boxes(stream, file.stat().st_size):
            if kind != b"mdat":
                stream.seek(start)
                yield kind, stream.read(min(length, MOST_BYTES))


def content_of(file: Path, wanted: bytes) -> bytes:
    """The content of the first box of a kind; empty where there is none."""
    return next((content for kind, content in contents(file) if kind == wanted), b"")


def _boxes(stream: BinaryIO, size: int) -> Iterator[tuple[int, bytes, int]]:
    """Start, kind and length in bytes of the boxes (ISO/IEC 14496-12, 4.2)."""
    at = 0
    while at + 8 <= size:
        stream.seek(at)
        head = stream.read(16)
        length = int.from_bytes(head[:4], "big")
        length = int.from_bytes(head[8:16], "big") if length == 1 else length or size - at
        if length < 8:
            return
        yield at, head[4:8], length
        at += length
