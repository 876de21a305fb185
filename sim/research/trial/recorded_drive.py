"""A drive that was recorded on a real autopilot: its truth, its journal, and all bytes of its link."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import Config
from edge.errors import FeedError
from edge.journal.records import FixSent, FrameUsed, JournalOpened
from edge.telemetry.boot_clock import JUMP_MS
from edge.telemetry.codec import MavlinkCodec, Message
from edge.toml_file import parse_toml, read_toml
from sim.datasets.flight_logs import tlog_frames
from sim.journal import read_journal
from sim.trial.records import Array
from sim.world.scenario import Scenario

Columns = dict[str, NDArray[np.float64]]
TRUTH, OWN, LINK, JOURNAL = "truth.csv.gz", "autopilot_position.csv.gz", "telem2.tlog.gz", "journal.jsonl.gz"
WE = 191
"""Component of Lookback on the link."""


class LinkFrame(NamedTuple):
    """One MAVLink frame of the link, in either direction; time_s: CLOCK_MONOTONIC of the vehicle's computer."""

    time_s: float
    data: bytes
    message: Message


class DaemonRun(NamedTuple):
    """From when to when the daemon ran, and the exposures (n,) of its camera, all in seconds."""

    from_s: float
    to_s: float
    exposures_s: Array


@dataclass(frozen=True)
class RecordedDrive:
    """One folder of recorded drives; all times in seconds of CLOCK_MONOTONIC. own: by the autopilot's own position.

    latency_s: from an exposure to when the daemon was done with the frame.
    """

    name: str
    config: Config
    scenario: Scenario
    truth: Columns
    own: Columns
    link: list[LinkFrame]
    runs: list[DaemonRun]
    used: list[FrameUsed]
    sent: list[FixSent]
    latency_s: float

    def true_m(self, time_s: Array | float) -> Array:
        """Meters east and north (2, ...) of the simulation's origin."""
        return np.array([np.interp(time_s, self.truth["mono_s"], self.truth[name]) for name in ("east_m", "north_m")])

    @property
    def moves_s(self) -> tuple[float, float]:
        """When the vehicle sets off, and when it stops for good."""
        off_m, left_m = (
            np.hypot(self.truth["east_m"] - self.truth["east_m"][at], self.truth["north_m"] - self.truth["north_m"][at])
            for at in (0, -1)
        )
        time_s = self.truth["mono_s"]
        return float(time_s[np.argmax(off_m > 1.0)]), float(time_s[len(left_m) - 1 - np.argmax(left_m[::-1] > 1.0)])

    @property
    def gps_lost_s(self) -> float:
        """When GPS was lost for good while the vehicle moved; where there was none, or it stayed, when it set off."""
        sets_off_s, stops_s = self.moves_s
        fixes_s = [
            one.time_s
            for one in self.link
            if one.message.get_type() == "GPS_RAW_INT" and one.message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX
        ]
        last_s = max(fixes_s, default=sets_off_s)
        return last_s if sets_off_s < last_s < stops_s - 1.0 else sets_off_s


def read_columns(path: Path) -> Columns:
    """A compressed CSV file of numbers, by name; rows whose first column does not grow are dropped."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        rows = csv.reader(file)
        names = next(rows)
        values = np.array([[float(value or "nan") for value in row] for row in rows])
    values = values[np.r_[True, np.diff(values[:, 0]) > 0]]
    return {name: values[:, column] for column, name in enumerate(names)}


def read_messages(path: Path) -> Iterator[tuple[float, bytes, Message]]:
    """Unix time in seconds, bytes and message of each frame of a compressed .tlog."""
    codec = MavlinkCodec(1, WE)
    for stamp_us, _, data in tlog_frames(gzip.decompress(path.read_bytes())):
        for message in codec.decode(data):
            yield stamp_us / 1e6, data, message


def read_drive(folder: Path) -> RecordedDrive:
    """FeedError where the folder is no recorded drive with a journal; ConfigError for its settings."""
    missing = [name for name in (TRUTH, OWN, LINK, JOURNAL, "lookback.toml") if not (folder / name).exists()]
    if missing:
        raise FeedError(f"{folder}: no recorded drive of the daemon, it has no {' and no '.join(missing)}")
    own = read_columns(folder / OWN)
    messages = list(read_messages(folder / LINK))
    epoch_s = _epoch_s(messages, own)
    with TemporaryDirectory() as scratch:
        journal = Path(scratch, "journal.jsonl")
        journal.write_bytes(gzip.decompress((folder / JOURNAL).read_bytes()))
        lines = [(line.unix_s or 0.0, line.record) for line in read_journal(journal)]
    frames = [(unix_s - epoch_s, record) for unix_s, record in lines if isinstance(record, FrameUsed)]
    config_path = folder / "lookback.toml"
    return RecordedDrive(
        name=folder.name,
        config=parse_toml(config_path.read_text(encoding="utf-8"), config_path, Config),
        scenario=read_toml(folder / "scenario.toml", Scenario),
        truth=read_columns(folder / TRUTH),
        own=own,
        link=[LinkFrame(unix_s - epoch_s, data, message) for unix_s, data, message in messages],
        runs=_runs([(unix_s - epoch_s, record) for unix_s, record in lines]),
        used=[record for _, record in frames],
        sent=[record for _, record in lines if isinstance(record, FixSent)],
        latency_s=float(np.median([written_s - frame.stamp_ns / 1e9 for written_s, frame in frames])),
    )


def _epoch_s(messages: list[tuple[float, bytes, Message]], own: Columns) -> float:
    """Unix time less CLOCK_MONOTONIC, by the autopilot's time since its first boot."""
    reports = [(at_s, one.time_boot_ms) for at_s, _, one in messages if one.get_type() == "GLOBAL_POSITION_INT"]
    unix_s, boot_ms = np.array(reports)[: _reboots_at(np.array(reports)[:, 1])].T
    known = slice(_reboots_at(own["boot_ms"]))
    mono_s = np.interp(boot_ms, own["boot_ms"][known], own["mono_s"][known], left=np.nan, right=np.nan)
    return float(np.nanmedian(unix_s - mono_s))


def _reboots_at(boot_ms: Array) -> int:
    """How many of some times since boot are from before the clock went back."""
    back = np.flatnonzero(np.diff(boot_ms) < -JUMP_MS)
    return int(back[0]) + 1 if len(back) else len(boot_ms)


def _runs(lines: list[tuple[float, object]]) -> list[DaemonRun]:
    opened = [row for row, (_, record) in enumerate(lines) if isinstance(record, JournalOpened)]
    runs = []
    for first, after in zip(opened, [*opened[1:], len(lines)], strict=True):
        used = [record for _, record in lines[first:after] if isinstance(record, FrameUsed)]
        from_s, to_s = lines[first][0], lines[after - 1][0]
        if len(used) < 2:
            continue
        index = np.array([frame.frame for frame in used])
        stamp_s = np.array([frame.stamp_ns for frame in used]) / 1e9
        period_s = float(np.median(np.diff(stamp_s) / np.diff(index)))
        later = np.arange(stamp_s[-1] + period_s, to_s, period_s)
        runs.append(DaemonRun(from_s, to_s, np.r_[np.interp(np.arange(index[-1] + 1), index, stamp_s), later]))
    return runs
