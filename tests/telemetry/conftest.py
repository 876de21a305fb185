"""Recorded telemetry of real autopilots, frame by frame."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

TlogReader = Callable[[str], Iterator[tuple[int, bytes]]]


@pytest.fixture(scope="session")
def read_tlog(shared: Path) -> TlogReader:
    """Yields (arrival in ns, one MAVLink 2 frame) of a recording, named without its suffix."""

    def read(name: str) -> Iterator[tuple[int, bytes]]:
        data = (shared / "autopilot" / f"{name}.tlog").read_bytes()
        at = 0
        while at + 20 <= len(data):
            (stamp_us,) = struct.unpack_from(">Q", data, at)
            size = 12 + data[at + 9] + 13 * (data[at + 10] & 1)
            yield stamp_us * 1000, data[at + 8 : at + 8 + size]
            at += 8 + size

    return read
