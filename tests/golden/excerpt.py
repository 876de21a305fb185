"""Cuts a golden of `drives/` out of a recorded drive: `python -m tests.golden.excerpt FOLDER NAME FROM_S TO_S`.

FROM_S, TO_S: since GPS was lost. Only what a replay reads is kept: of the messages those that the daemon listens to,
and of the journal the frames, which show how wrong the map was.
"""

from __future__ import annotations

import gzip
import shutil
import struct
import sys
from pathlib import Path

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import SCHEMA, FrameUsed, JournalOpened, Record, Stopped
from edge.telemetry.link_protocol import STREAMS_HZ
from sim.research.trial.recorded_drive import JOURNAL, LANE, LINK, OWN, SCENARIO, TRUTH, WE, RecordedDrive, read_drive
from tests.golden.harness import HERE, SETTINGS

STREAMED = {
    *STREAMS_HZ,
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD,
    mavlink.MAVLINK_MSG_ID_TIMESYNC,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
}
ONCE = {
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
}
"""Kept from before the excerpt as well: the daemon requests them when it starts."""
BEFORE_S = 0.1
"""The autopilot's own position is kept a little longer, so that its clock is known at both ends."""


def cut(folder: Path, name: str, from_s: float, to_s: float) -> Path:
    """Write the excerpt; its folder."""
    drive, output = read_drive(folder), HERE / "drives" / name
    from_s, to_s = from_s + drive.gps_lost_s, to_s + drive.gps_lost_s
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir(parents=True)
    for copied in (SETTINGS, SCENARIO, LANE):
        if (folder / copied).exists():
            shutil.copy(folder / copied, output / copied)
    for table in (TRUTH, OWN):
        _cut_table(folder / table, output / table, from_s - BEFORE_S, to_s + BEFORE_S)
    _write(output / LINK, b"".join(_frames(drive, from_s, to_s)))
    _write(output / JOURNAL, b"".join(_lines(drive, from_s, to_s)))
    return output


def _cut_table(source: Path, output: Path, from_s: float, to_s: float) -> None:
    header, *rows = gzip.decompress(source.read_bytes()).splitlines(keepends=True)
    _write(output, header + b"".join(row for row in rows if from_s <= float(row.split(b",")[0]) <= to_s))


def _frames(drive: RecordedDrive, from_s: float, to_s: float) -> list[bytes]:
    """Of a .tlog, with times of CLOCK_MONOTONIC."""
    return [
        struct.pack(">Q", round(one.time_s * 1e6)) + one.data
        for one in drive.link
        if one.message.get_srcComponent() != WE
        and one.time_s < to_s
        and one.message.get_msgId() in (STREAMED if one.time_s >= from_s else ONCE)
    ]


def _lines(drive: RecordedDrive, from_s: float, to_s: float) -> list[bytes]:
    frames = [one for one in drive.used if from_s <= one.stamp_ns / 1e9 + drive.latency_s < to_s]
    records: list[tuple[float, Record]] = [(from_s, JournalOpened(SCHEMA, ""))]
    records += [(one.stamp_ns / 1e9 + drive.latency_s, one) for one in frames if isinstance(one, FrameUsed)]
    records += [(to_s, Stopped(len(frames), 0, {}, {}))]
    return [
        msgspec.json.encode({"unix_s": round(at_s, 6), **msgspec.to_builtins(record)}) + b"\n"
        for at_s, record in records
    ]


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(gzip.compress(data, 9, mtime=0))


if __name__ == "__main__":
    given, called, *ends = sys.argv[1:]
    written = cut(Path(given), called, *map(float, ends))
    print(f"{written}: {sum(file.stat().st_size for file in written.iterdir())} bytes")
