"""Telemetry as ground stations keep it: recordings of MAVLink with the arrival of each frame."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edge.telemetry.codec import MavlinkCodec


def frames_of(tlog: Path) -> Iterator[tuple[int, bytes]]:
    """The arrival in ns and the bytes of each MAVLink 2 frame in a recording, which may be a .gz."""
    data, at = tlog.read_bytes(), 0
    data = gzip.decompress(data) if tlog.suffix == ".gz" else data
    while at + 20 <= len(data):
        end = at + 20 + data[at + 9] + 13 * (data[at + 10] & 1)
        yield 1000 * int.from_bytes(data[at : at + 8], "big"), data[at + 8 : end]
        at = end


def messages_of(tlog: Path) -> Iterator[tuple[int, list[Any]]]:
    """The arrival in ns and the messages that each frame completes."""
    codec = MavlinkCodec(1, 191)
    for now_ns, frame in frames_of(tlog):
        yield now_ns, codec.decode(frame)
