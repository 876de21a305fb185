"""Positions in the logs that autopilots and ground stations write; tracks of other receivers are in `track_files`.

Each position has the accuracy that the receiver reported last, and its kind of fix: GPS_RAW_INT, GPS and GPA, or
vehicle_gps_position. While it had no fix, the position is dead reckoning, or rests on positions from Lookback.

.tlog   MAVLink as a ground station received it: 8 bytes of microseconds since 1970, big-endian, before each frame
        (https://ardupilot.org/planner/docs/mission-planner-telemetry-logs.html); GLOBAL_POSITION_INT is used
.bin    ArduPilot DataFlash, which describes itself (https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-
        message.html); POS is used
.ulg    PX4 ULog (https://docs.px4.io/main/en/dev_log/ulog_file_format.html); vehicle_global_position is used
"""

from __future__ import annotations

import contextlib
import io
import math
import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import FeedError
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.gps import FIXES, SOURCES
from sim.datasets.track import Track, TrackFix
from sim.datasets.track_files import TRACKS
from sim.output import refusing

MAVLINK_1, MAVLINK_2 = 0xFE, 0xFD
STAMP_BYTES = 8
TLOG_MESSAGES = (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT)
FRESH_US = 3_000_000
DATAFLASH_BEGINS = b"\xa3\x95"


def read_log(file: Path) -> Track:
    """The positions in a log. FeedError names the file, and says what it lacks."""
    suffix = file.suffix.lower()
    readers = LOGS | TRACKS
    if suffix not in readers:
        raise FeedError(
            f"{file}: not a known kind of log; it is one of {', '.join(readers)}; gpsbabel converts many others:"
            f" gpsbabel -i KIND -f {file.name} -o gpx -F {file.stem}.gpx"
        )
    with refusing(FeedError, f"{file}: cannot read it"):
        data = file.read_bytes()
    if not data:
        raise FeedError(f"{file}: empty")
    return Track(str(file), readers[suffix](file, data))


@dataclass
class _Receiver:
    """What a GPS receiver reported last; fix_type as in MAVLink, None before the first report."""

    stamp_us: int = 0
    fix_type: int | None = None
    accuracy_m: float = 0.0

    def report(self, stamp_us: int, fix_type: int, accuracy_m: float | None = None) -> None:
        self.stamp_us, self.fix_type = stamp_us, fix_type
        self.accuracy_m = self.accuracy_m if accuracy_m is None else accuracy_m

    def behind(self, fix: TrackFix) -> TrackFix:
        """A position with the accuracy and the source of that moment."""
        if self.fix_type is None:
            return fix
        if self.fix_type not in FIXES or fix.stamp_ns / 1000 - self.stamp_us > FRESH_US:
            return replace(fix, source="dead_reckoning")
        return replace(fix, sigma_m=self.accuracy_m or math.nan, source=SOURCES.get(self.fix_type, "gps"))


def _tlog_fixes(_: Path, data: bytes) -> Iterator[TrackFix]:
    codec = MavlinkCodec(255, 0)
    system, receiver = None, _Receiver()
    for stamp_us, message_id, frame in tlog_frames(data):
        if message_id not in TLOG_MESSAGES:
            continue
        for message in codec.decode(frame):
            if message.get_msgId() not in TLOG_MESSAGES:
                continue
            system = system or message.get_srcSystem()
            if message.get_srcSystem() != system:  # of several vehicles the first
                continue
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_GPS_RAW_INT:
                receiver.report(stamp_us, message.fix_type, message.h_acc / 1000)
                continue
            yield receiver.behind(
                TrackFix(
                    stamp_us * 1000,
                    message.lat / 1e7,
                    message.lon / 1e7,
                    message.alt / 1e3,
                    message.hdg / 100 if message.hdg < 36000 else math.nan,  # 65535 is unknown
                    math.hypot(message.vx, message.vy) / 100,
                )
            )


def tlog_frames(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Microseconds since 1970, message id and bytes of each frame of a .tlog.

    A byte that begins no frame is skipped, as after a log that was cut.
    """
    at = 0
    while at + STAMP_BYTES + 12 <= len(data):
        start = at + STAMP_BYTES
        if data[start] == MAVLINK_2:
            signature = 13 if data[start + 2] & mavlink.MAVLINK_IFLAG_SIGNED else 0
            end = start + data[start + 1] + 12 + signature
            message_id = int.from_bytes(data[start + 7 : start + 10], "little")
        elif data[start] == MAVLINK_1:
            end, message_id = start + data[start + 1] + 8, data[start + 5]
        else:
            at += 1
            continue
        yield struct.unpack_from(">Q", data, at)[0], message_id, data[start:end]
        at = end


def _dataflash_fixes(file: Path, data: bytes) -> list[TrackFix]:
    if not data.startswith(DATAFLASH_BEGINS):
        raise FeedError(f"{file}: not a DataFlash log")
    # DFReader is under the GPL, unlike the dialects: imported only here, for such a log.
    from pymavlink.DFReader import DFReader_binary

    fixes, receiver = [], _Receiver()
    # It prints warnings about damaged logs; what could be read is used.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            with DFReader_binary(str(file)) as log:
                while (message := log.recv_match(type=["POS", "GPS", "GPA"])) is not None:
                    if message.get_type() == "POS":
                        fix = TrackFix(message.TimeUS * 1000, message.Lat, message.Lng, message.Alt)
                        fixes.append(receiver.behind(fix))
                    elif getattr(message, "I", 0) == 0 and message.get_type() == "GPS":
                        receiver.report(message.TimeUS, message.Status)
                    elif getattr(message, "I", 0) == 0:
                        receiver.accuracy_m = message.HAcc
        except Exception as error:  # the library raises any exception for a damaged file
            raise FeedError(f"{file}: not a whole DataFlash log: {error}") from None
    return fixes


def _ulog_fixes(file: Path, data: bytes) -> list[TrackFix]:
    from pyulog import ULog

    topic, of_receiver = "vehicle_global_position", "vehicle_gps_position"
    try:
        log = ULog(io.BytesIO(data), [topic, of_receiver])
        found = {item.name: item.data for item in log.data_list if item.multi_id == 0}
    except Exception as error:  # the library raises any exception for a damaged file
        raise FeedError(f"{file}: not a whole ULog: {error}") from None
    if topic not in found:
        raise FeedError(f"{file}: no {topic} in it; log it, or give another log")
    reports = deque(_columns(found.get(of_receiver, {}), "timestamp", "fix_type", "eph"))
    fixes, receiver = [], _Receiver()
    for stamp_us, lat, lon, alt in _columns(found[topic], "timestamp", "lat", "lon", "alt"):
        while reports and reports[0][0] <= stamp_us:
            receiver.report(*reports.popleft())
        fixes.append(receiver.behind(TrackFix(stamp_us * 1000, lat, lon, alt)))
    return fixes


def _columns(data: Mapping[str, NDArray[Any]], *names: str) -> Iterator[tuple[Any, ...]]:
    """The rows of some columns; none where the topic is not in the log."""
    return zip(*(data[name].tolist() for name in names), strict=True) if data else iter(())


LOGS: dict[str, Callable[[Path, bytes], Iterable[TrackFix]]] = {
    ".tlog": _tlog_fixes,
    ".bin": _dataflash_fixes,
    ".ulg": _ulog_fixes,
}
