"""The records of the file of a map that is being made.

A record is 4 bytes of mark, the length and CRC-32 of what follows, and that: a tagged union in MessagePack. The first
is the header. Where one is damaged, the next is found by its mark.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

import edge
from edge.config import SamplingConfig
from edge.keypoints import Keypoints
from edge.keypoints.mount import Mount
from edge.reference_map import ModelKey, RegionsKey
from edge.reference_map.keypoint_file import KEYPOINT, KeypointsKey
from edge_plugins.mapping.builder import Place

FORMAT = "lookback-places"
VERSION, VERSION_WITH_KEYPOINTS = 1, 2
MARK = b"LBPL"
HEAD = struct.Struct("<4sII")
MAX_BODY_BYTES = 4 << 20
SEARCHED_BYTES = 1 << 20
"""At once, for the next mark."""


class LogHeader(msgspec.Struct, frozen=True, tag="header"):
    """How the places were made; a map is made of places that were made alike. keypoints: None where they have none."""

    model: ModelKey
    regions: RegionsKey
    sampling: SamplingConfig
    lookback: str = edge.__version__
    format: str = FORMAT
    version: int = VERSION
    keypoints: KeypointsKey | None = None

    def with_keypoints(self, key: KeypointsKey) -> LogHeader:
        """Of a file whose places have keypoints."""
        return msgspec.structs.replace(self, version=VERSION_WITH_KEYPOINTS, keypoints=key)


class DriveBegun(msgspec.Struct, frozen=True, tag="drive"):
    """The places that follow were passed one after another, by a camera that looked that way."""

    view: Literal["front", "rear"]


class PlacePassed(msgspec.Struct, frozen=True, tag="place"):
    """A place, and its raw descriptor (R, D) as little-endian float16.

    unix_s: when it was written, 0 in files of earlier versions. view: of the camera, as in its DriveBegun, which may be
    damaged; None in such files. is_vouched: whether all of its drive moved as what GPS has no part in, see `OwnMotion`.
    """

    place: Place
    raw: bytes
    unix_s: float = 0.0
    view: Literal["front", "rear"] | None = None
    is_vouched: bool = False


class PointsMade(msgspec.Struct, frozen=True, tag="points"):
    """The keypoints of a place, written once the drive has gone on, so that their distances are known.

    place_at: where in the file the place is. points: records of KEYPOINT, in the frame of the camera as it is mounted.
    radians: how it is mounted by this place. information: of these, (2, 2) row by row.
    """

    place_at: int
    points: bytes
    radians: tuple[float, float]
    information: tuple[float, float, float, float]

    @property
    def mount(self) -> Mount:
        """How the camera is mounted by this place."""
        return Mount(np.array(self.radians), np.reshape(self.information, (2, 2)))

    @property
    def record(self) -> NDArray[np.void]:
        """The records (K,)."""
        return np.frombuffer(self.points, KEYPOINT)

    @classmethod
    def of(cls, record: NDArray[np.void], mount: Mount, place_at: int = -1) -> PointsMade:
        """Of a place that may not be written yet."""
        a, b, c, d = mount.information.ravel().tolist()
        return cls(place_at, record.tobytes(), tuple(mount.radians.tolist()), (a, b, c, d))


LogRecord = LogHeader | DriveBegun | PlacePassed | PointsMade
_decoder = msgspec.msgpack.Decoder(LogRecord)


def encoded(record: LogRecord) -> bytes:
    """The bytes of a record."""
    body = msgspec.msgpack.encode(record)
    return HEAD.pack(MARK, len(body), zlib.crc32(body)) + body


def whole_records(descriptor: int) -> Iterator[tuple[int, int, LogRecord]]:
    """The whole records of an open file: where each begins and ends."""
    at: int | None = 0
    while at is not None:
        record = record_at(descriptor, at)
        if record is None:
            at = _next_mark(descriptor, at + 1)
            continue
        end = at + HEAD.size + HEAD.unpack(os.pread(descriptor, HEAD.size, at))[1]
        yield at, end, record
        at = end


def _next_mark(descriptor: int, at: int) -> int | None:
    """Where the next mark of a record is, from a byte on."""
    while piece := os.pread(descriptor, SEARCHED_BYTES, at):
        found = piece.find(MARK)
        if found >= 0:
            return at + found
        if len(piece) < len(MARK):
            return None
        at += len(piece) - len(MARK) + 1
    return None


def record_at(descriptor: int, at: int) -> LogRecord | None:
    """The record that begins at a byte, None if none does, or it is damaged."""
    head = os.pread(descriptor, HEAD.size, at)
    if len(head) < HEAD.size:
        return None
    mark, size, checksum = HEAD.unpack(head)
    if mark != MARK or size > MAX_BODY_BYTES:
        return None
    body = os.pread(descriptor, size, at + HEAD.size)
    if len(body) < size or zlib.crc32(body) != checksum:
        return None
    try:
        record: LogRecord = _decoder.decode(body)
    except msgspec.DecodeError:
        return None
    return record


@dataclass(frozen=True)
class MappedPlace:
    """A place, its raw descriptor (R, D), and its keypoints once they are found, None for a place without."""

    raw: NDArray[np.float32]
    place: Place
    keypoints: Future[Keypoints] | None = None
