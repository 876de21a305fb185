"""The list of a drive in a file: what the estimator was told and what it answered, in order, with the maps it needs.

The file is complete: `replay` gives the same answers again without maps, camera or autopilot, so that a drive that
went wrong in the field is one file, and becomes a test by being copied. gzip of MessagePack: each entry is its length
(4 bytes, little-endian) and [t_ns, entry]; the first is the header. A file that was cut off ends with its last whole
second.
"""

from __future__ import annotations

import gzip
import logging
import struct
import zlib
from collections.abc import Iterator
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge import __version__
from edge.config import CameraConfig, Config, GatesConfig, RigConfig, SamplingConfig, SequenceConfig, TrackingConfig
from edge.errors import ConfigError, FeedError, reason
from edge.files import BackgroundWorker
from edge.journal.records import with_todays_keys
from edge.localization.decide import NoFix
from edge.localization.events import (
    AutopilotState,
    Discontinuity,
    ExternalPosition,
    Fix,
    FixFeedback,
    ImageProcessed,
    MapUpdate,
    OdometryUpdate,
)
from edge.localization.position_estimator import Entry, FixResult, PositionEstimator
from edge.reference_map import MapHeader, MapPlaces, PlaceIndex

FORMAT = 2  # of the file
FLUSH_NS = 1_000_000_000  # what a loss of power costs
MOST_PENDING = 64_000_000
"""Bytes that wait for a disk at most."""
log = logging.getLogger(__name__)
LENGTH = struct.Struct("<I")


GONE = {"sequence": ("slopes", "region_order")}
"""Keys of lists that earlier versions wrote, by which no position was ever estimated."""


class Format(msgspec.Struct, frozen=True):
    """Of the file, and the version of Lookback that wrote it."""

    format: int
    lookback: str


class Header(Format, frozen=True):
    """What the estimator was opened with: the sections of the config that it reads."""

    camera: CameraConfig
    sampling: SamplingConfig
    sequence: SequenceConfig
    rig: RigConfig
    tracking: TrackingConfig
    gates: GatesConfig

    @property
    def config(self) -> Config:
        """With these sections, all others by default."""
        return Config(
            camera=self.camera,
            sampling=self.sampling,
            sequence=self.sequence,
            rig=self.rig,
            tracking=self.tracking,
            gates=self.gates,
        )


class PlaceTable(msgspec.Struct, frozen=True, dict=True):
    """The places of a set of maps without their descriptors, as `Route` reads them."""

    places: NDArray[np.void]
    headers: tuple[MapHeader, ...]

    @cached_property
    def index(self) -> PlaceIndex:
        """Which map, row and segment a place belongs to."""
        return PlaceIndex(self.headers)


class _Restored(msgspec.Struct, frozen=True, tag="Restored"):
    """What earlier versions kept over a restart, by which no position is estimated any more."""


class _ListEntry(msgspec.Struct, frozen=True, array_like=True):
    t_ns: int
    entry: (
        ImageProcessed
        | AutopilotState
        | OdometryUpdate
        | FixFeedback
        | Discontinuity
        | ExternalPosition
        | MapUpdate
        | FixResult
        | _Restored
    )


class DriveFile:
    """Writes the list of one drive, for `PositionEstimator`. A disk that fails ends the list, not the drive."""

    def __init__(self, path: Path, config: Config) -> None:
        """ConfigError where the file cannot be written; one of an earlier drive is replaced."""
        self._path, self._behind = path, BackgroundWorker()
        self._encoder, self._pending = msgspec.msgpack.Encoder(enc_hook=_encoded), bytearray()
        self._is_over, self._due_ns = False, 0
        try:
            path.write_bytes(b"")
        except OSError as error:
            raise ConfigError(f"[telemetry] drive = {path}: {error.strerror}") from None
        sections = config.camera, config.sampling, config.sequence, config.rig, config.tracking, config.gates
        self._put(Header(FORMAT, __version__, *sections))

    def write(self, t_ns: int, entry: Entry) -> None:
        """Append an entry; a thread puts it on the disk within a second."""
        if self._is_over:
            return
        if isinstance(entry, MapUpdate):
            table = PlaceTable(entry.map_set.places, entry.map_set.headers)
            entry = MapUpdate(table, entry.has_grown)
        self._put(_ListEntry(t_ns, entry))
        if t_ns >= self._due_ns and self._behind.wait(0.0):
            self._due_ns = t_ns + FLUSH_NS
            self._flush()
        elif len(self._pending) > MOST_PENDING:
            self._end("its disk hangs")

    def _put(self, value: Any) -> None:
        data = self._encoder.encode(value)
        self._pending += LENGTH.pack(len(data)) + data

    def _flush(self) -> None:
        self._behind.start(partial(self._append, bytes(self._pending)))
        self._pending.clear()

    def _append(self, data: bytes) -> None:
        try:
            with self._path.open("ab") as file:
                file.write(gzip.compress(data, compresslevel=1))
        except OSError as error:
            self._end(error.strerror or str(error))

    def _end(self, why: str) -> None:
        self._is_over = True
        log.error("%s: the list of this drive ends here: %s", self._path, why)

    def close(self) -> None:
        """The end of the drive; more than once is harmless."""
        self._behind.wait()
        if self._pending and not self._is_over:
            self._append(bytes(self._pending))
        self._is_over = True


def read_drive(path: Path) -> tuple[Config, list[tuple[int, Entry]]]:
    """The config and the list of a drive; FeedError for what is none, or of another format."""
    chunks = _chunks(path)
    try:
        first = next(chunks)
        if (found := msgspec.msgpack.decode(first, type=Format).format) != FORMAT:
            raise FeedError(f"{path}: format {found}, this version of Lookback reads {FORMAT}")
        sections = msgspec.msgpack.decode(first)
        for section, keys in GONE.items():
            sections[section] = {key: value for key, value in sections[section].items() if key not in keys}
        header = msgspec.convert(with_todays_keys(sections), Header)
        read = (
            _read_old if b"sigma_across_m" in first else msgspec.msgpack.Decoder(_ListEntry, dec_hook=_decoded).decode
        )
        written = list(map(read, chunks))
    except (StopIteration, msgspec.MsgspecError, ValueError) as error:
        raise FeedError(f"{path}: no list of a drive: {error}") from None
    return header.config, [(one.t_ns, one.entry) for one in written if not isinstance(one.entry, _Restored)]


def replay(config: Config, entries: list[tuple[int, Entry]]) -> Iterator[tuple[int, FixResult, Fix | NoFix]]:
    """Each position that was asked for, and what a bare estimator answers now."""
    drive = PositionEstimator(config)
    for t_ns, entry in entries:
        if isinstance(entry, FixResult):
            yield t_ns, entry, drive.fix(t_ns, entry.request)
        else:
            drive.update(t_ns, entry)


def _read_old(chunk: bytes) -> _ListEntry:
    """An entry of a list whose positions have the keys of schema 2 of the journal."""
    return msgspec.convert(with_todays_keys(msgspec.msgpack.decode(chunk)), _ListEntry, dec_hook=_decoded)


def _chunks(path: Path) -> Iterator[bytes]:
    """Up to where the file was cut off, if it was."""
    try:
        with gzip.open(path, "rb") as file:
            while len(length := file.read(LENGTH.size)) == LENGTH.size:
                size = LENGTH.unpack(length)[0]
                data = file.read(size)
                if len(data) < size:
                    return
                yield data
    except (EOFError, zlib.error):
        return
    except OSError as error:
        raise FeedError(f"{path}: {reason(error)}") from None


def _encoded(value: Any) -> Any:
    """What MessagePack has no type for."""
    if isinstance(value, np.ndarray):
        return [np.lib.format.dtype_to_descr(value.dtype), value.shape, value.tobytes()]
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"no MessagePack for {type(value)}")


def _decoded(kind: Any, value: Any) -> Any:
    if kind is MapPlaces:
        return PlaceTable(_array(value["places"]), msgspec.convert(value["headers"], tuple[MapHeader, ...]))
    return _array(value)


def _array(value: Any) -> NDArray[Any]:
    descr, shape, data = value
    dtype = np.dtype([tuple(one) for one in descr] if isinstance(descr, list) else descr)
    return np.frombuffer(data, dtype).reshape(shape).copy()
