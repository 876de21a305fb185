"""Positions in the logs that autopilots and ground stations write.

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
from collections.abc import Iterator
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from edge.errors import FeedError
from edge.telemetry.codec import MavlinkCodec
from sim.datasets.track import Fix, Track

MAVLINK_1, MAVLINK_2 = 0xFE, 0xFD
STAMP_BYTES = 8
DATAFLASH_BEGINS = b"\xa3\x95"


def read_log(file: Path) -> Track:
    """The positions in a log. FeedError names the file, and says what it lacks."""
    readers = {".tlog": _tlog_fixes, ".bin": _dataflash_fixes, ".ulg": _ulog_fixes}
    if file.suffix.lower() not in readers:
        raise FeedError(f"{file}: not a known kind of log; it is one of {', '.join(readers)}")
    try:
        data = file.read_bytes()
    except OSError as error:
        raise FeedError(f"{file}: cannot read it: {error.strerror}") from None
    if not data:
        raise FeedError(f"{file}: empty")
    return Track(str(file), readers[file.suffix.lower()](file, data))


def _tlog_fixes(_: Path, data: bytes) -> Iterator[Fix]:
    codec = MavlinkCodec(255, 0)
    system = None
    for stamp_us, frame in _tlog_frames(data):
        for message in codec.decode(frame):
            if message.get_type() != "GLOBAL_POSITION_INT":
                continue
            system = system or message.get_srcSystem()
            if message.get_srcSystem() == system:  # of several vehicles the first
                yield Fix(
                    stamp_us * 1000,
                    message.lat / 1e7,
                    message.lon / 1e7,
                    message.alt / 1e3,
                    message.hdg / 100 if message.hdg < 36000 else math.nan,  # 65535 is unknown
                    math.hypot(message.vx, message.vy) / 100,
                )


def _tlog_frames(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The frames that carry positions; a byte that begins no frame is skipped, as after a log that was cut."""
    at = 0
    while at + STAMP_BYTES + 12 <= len(data):
        start = at + STAMP_BYTES
        if data[start] == MAVLINK_2:
            signature = 13 if data[start + 2] & mavlink.MAVLINK_IFLAG_SIGNED else 0
            end, message_id = (
                start + data[start + 1] + 12 + signature,
                int.from_bytes(data[start + 7 : start + 10], "little"),
            )
        elif data[start] == MAVLINK_1:
            end, message_id = start + data[start + 1] + 8, data[start + 5]
        else:
            at += 1
            continue
        if message_id == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            yield struct.unpack_from(">Q", data, at)[0], data[start:end]
        at = end


def _dataflash_fixes(file: Path, data: bytes) -> list[Fix]:
    if not data.startswith(DATAFLASH_BEGINS):
        raise FeedError(f"{file}: not a DataFlash log")
    # DFReader is under the GPL, unlike the dialects: imported only here, for such a log.
    from pymavlink.DFReader import DFReader_binary

    fixes = []
    # It prints warnings about damaged logs; what could be read is used.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            with DFReader_binary(str(file)) as log:
                while (message := log.recv_match(type="POS")) is not None:
                    fixes.append(Fix(message.TimeUS * 1000, message.Lat, message.Lng, message.Alt))
        except Exception as error:  # the library raises any exception for a damaged file
            raise FeedError(f"{file}: not a whole DataFlash log: {error}") from None
    return fixes


def _ulog_fixes(file: Path, data: bytes) -> list[Fix]:
    from pyulog import ULog

    topic = "vehicle_global_position"
    try:
        found = [item.data for item in ULog(io.BytesIO(data), [topic]).data_list if item.multi_id == 0]
    except Exception as error:  # the library raises any exception for a damaged file
        raise FeedError(f"{file}: not a whole ULog: {error}") from None
    if not found:
        raise FeedError(f"{file}: no {topic} in it; log it, or give another log")
    columns = (found[0][name].tolist() for name in ("timestamp", "lat", "lon", "alt"))
    return [Fix(stamp_us * 1000, lat, lon, alt) for stamp_us, lat, lon, alt in zip(*columns, strict=True)]
