"""A drive that was recorded on a real autopilot: its truth, its journal, and all bytes of its link."""

from __future__ import annotations

import csv
import gzip
import json
import math
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import Config, parse_config
from edge.errors import FeedError
from edge.journal.records import SCHEMA, FixSent, FrameUsed, JournalOpened, Record, StateChanged
from edge.telemetry.boot_clock import JUMP_MS
from edge.telemetry.codec import MavlinkCodec, Message
from edge.toml_file import read_toml
from edge_plugins.mapping import MappingConfig
from sim import ORIGIN_ALT_M, geodetic
from sim.datasets.flight_logs import tlog_frames
from sim.journal import UnknownRecord, read_journal
from sim.trial.records import Array
from sim.trial.way import along
from sim.vehicle.autopilot_messages import version_of
from sim.vehicle.firmware import FIRMWARES, parameters_of
from sim.world.scenario import Scenario, View

Columns = dict[str, NDArray[np.float64]]
TRUTH, OWN, LINK, JOURNAL = "truth.csv.gz", "autopilot_position.csv.gz", "telem2.tlog.gz", "journal.jsonl.gz"
SCENARIO, LANE = "scenario.toml", "lane.csv.gz"
GONE = "parallax", "socket", "token"
"""Keys of [rig], [home] and [page] that recorded drives have from earlier versions."""
LATENCY_S = 0.04
"""From an exposure to when the daemon is done with it, where no journal shows it: as in the other drives."""
STARTING_MS = 10_000
"""Time since boot up to which a step back is no reboot."""
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

    scenarios: from when on which one was seen, the first from the start. lane_m: (n, 2) east and north, which it was to
    follow. latency_s: from an exposure to when the daemon was done with the frame.
    """

    name: str
    map_name: str
    config: Config
    scenarios: list[tuple[float, Scenario]]
    lane_m: Array
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

    def own_m(self, time_s: float) -> Array:
        """Meters east and north (2,) of the simulation's origin, as the autopilot had it."""
        return np.array([np.interp(time_s, self.own["mono_s"], self.own[name]) for name in ("east_m", "north_m")])

    def heading_deg(self, time_s: float) -> float:
        """Of the vehicle, clockwise from north."""
        return float(np.interp(time_s, self.truth["mono_s"], self.truth["heading_deg"])) % 360.0

    def driven_m(self, time_s: float) -> float:
        """How far it has come since the truth began."""
        steps_m = np.hypot(np.diff(self.truth["east_m"]), np.diff(self.truth["north_m"]))
        return float(np.interp(time_s, self.truth["mono_s"], np.r_[0.0, np.cumsum(steps_m)]))

    @property
    def lost_m(self) -> float:
        """Driven since GPS was lost, see `gps_lost_s`."""
        return self.driven_m(self.moves_s[1]) - self.driven_m(self.gps_lost_s)

    @property
    def scenario(self) -> Scenario:
        """Of its road, in the light and the direction of its last part."""
        return self.scenarios[-1][1]

    def seen(self, time_s: float, view: View) -> Scenario:
        """The scenario of a camera at a time."""
        scenario = next(one for from_s, one in reversed(self.scenarios) if from_s <= time_s)
        return msgspec.structs.replace(scenario, view=view, epoch_ns=None)

    @cached_property
    def origin_deg(self) -> tuple[float, float] | None:
        """Latitude and longitude of the autopilot's origin, None where it did not report it."""
        reports = [one.message for one in self.link if one.message.get_type() == "GPS_GLOBAL_ORIGIN"]
        return (reports[-1].latitude / 1e7, reports[-1].longitude / 1e7) if reports else None

    @property
    def is_learned(self) -> bool:
        """Whether its map was a folder of maps, made before; no drive records what those were made of."""
        return not self.config.of(MappingConfig).folder and any(one.map for one in self.used)

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


def _of_today(config: str) -> str:
    """A recorded configuration without the keys that only earlier versions had; [motion] fov_deg became [camera]'s."""
    kept = re.sub(rf"^({'|'.join(GONE)}) = .*\n", "", config, flags=re.MULTILINE)
    of_motion = re.search(r"^\[motion\]\n(?:[^\[].*\n)*?(fov_deg = .*\n)", kept, flags=re.MULTILINE)
    if of_motion is None:
        return kept
    kept = kept[: of_motion.start(1)] + kept[of_motion.end(1) :]
    return kept if "\nfov_deg = " in kept else kept.replace("[camera]\n", f"[camera]\n{of_motion[1]}", 1)


def read_drive(folder: Path) -> RecordedDrive:
    """FeedError where the folder is no recorded drive; ConfigError for its settings. Without a journal none ran."""
    try:
        return _read_drive(folder)
    except (OSError, EOFError, zlib.error, ValueError, LookupError) as error:
        raise FeedError(f"{folder}: a file of it is damaged: {type(error).__name__}: {error}") from error


def _read_drive(folder: Path) -> RecordedDrive:
    missing = [name for name in (TRUTH, OWN, LINK, "lookback.toml") if not (folder / name).exists()]
    if missing:
        raise FeedError(f"{folder}: no recorded drive, it has no {' and no '.join(missing)}")
    own, truth = read_columns(folder / OWN), read_columns(folder / TRUTH)
    truth["heading_deg"] = np.degrees(np.unwrap(np.radians(truth["heading_deg"])))
    messages = list(read_messages(folder / LINK))
    epoch_s = _epoch_s(messages, own, folder / LINK)
    lines = [(unix_s - epoch_s, record) for unix_s, record in _journal(folder / JOURNAL)]
    frames = [(at_s, record) for at_s, record in lines if isinstance(record, FrameUsed)]
    config_path = folder / "lookback.toml"
    config = parse_config(_of_today(config_path.read_text(encoding="utf-8")), config_path)
    scenarios = read_scenarios(folder)
    first_s, last_s = float(truth["mono_s"][0]), float(truth["mono_s"][-1])
    alone: list[tuple[float, object]] = [(first_s, JournalOpened(SCHEMA, "")), (last_s, None)]
    return RecordedDrive(
        name=folder.name,
        map_name=f"{folder.parent.name}/{Path(config.map.path).name}",
        config=config,
        scenarios=scenarios,
        lane_m=_lane_m(folder / LANE, scenarios[-1][1]),
        truth=truth,
        own=own,
        link=_link([LinkFrame(unix_s - epoch_s, data, message) for unix_s, data, message in messages], own),
        runs=_runs(lines or alone, 1 / config.camera.fps),
        used=[record for _, record in frames],
        sent=[record for _, record in lines if isinstance(record, FixSent)],
        latency_s=float(np.median([at_s - frame.stamp_ns / 1e9 for at_s, frame in frames] or [LATENCY_S])),
    )


def _link(frames: list[LinkFrame], own: Columns) -> list[LinkFrame]:
    """The frames of the link; where nobody asked for anything, the autopilot's motion as often as its file has it.

    Version and parameters then are of the simulated autopilot with wheels, from before the drive.
    """
    if 2 * sum(one.message.get_type() == "GLOBAL_POSITION_INT" for one in frames) > len(own["mono_s"]):
        return frames
    codec = MavlinkCodec(1, mavlink.MAV_COMP_ID_AUTOPILOT1)
    yaws_rad = np.unwrap(np.radians(own["heading_deg"]))
    yaw_rates = np.gradient(yaws_rad, own["boot_ms"] / 1e3)
    made = []
    for row, at_s in enumerate(own["mono_s"].tolist()):
        one = {name: float(values[row]) for name, values in own.items()}
        lat_deg, lon_deg = geodetic(one["east_m"], one["north_m"])
        boot_ms, east_mps, north_mps = round(one["boot_ms"]), one["east_mps"], one["north_mps"]
        alt_mm, yaw_rad = round(ORIGIN_ALT_M * 1e3), math.remainder(yaws_rad[row], math.tau)
        speeds = round(100 * north_mps), round(100 * east_mps), 0
        at = round(lat_deg * 1e7), round(lon_deg * 1e7), alt_mm, 0
        made += [
            (at_s, message)
            for message in (
                mavlink.MAVLink_global_position_int_message(boot_ms, *at, *speeds, round(100 * one["heading_deg"])),
                mavlink.MAVLink_local_position_ned_message(
                    boot_ms, one["north_m"], one["east_m"], 0.0, north_mps, east_mps, 0.0
                ),
                mavlink.MAVLink_attitude_message(boot_ms, 0.0, 0.0, yaw_rad, 0.0, 0.0, float(yaw_rates[row])),
            )
        ]
    makers = [one.message.autopilot for one in frames if one.message.get_type() == "HEARTBEAT"]
    firmware = next(one for one in FIRMWARES.values() if one.autopilot in makers)
    made.append((0.0, version_of(firmware)))
    made += [
        (0.0, mavlink.MAVLink_param_value_message(name.encode(), *value, 1, 0))
        for name, value in parameters_of(firmware, "wheels").items()
    ]
    kinds = {message.get_msgId() for _, message in made}
    sent = [(at_s, codec.encode(message)) for at_s, message in made]
    streams = [LinkFrame(at_s, data, one) for at_s, data in sent for one in MavlinkCodec(1, WE).decode(data)]
    return sorted(
        [*(one for one in frames if one.message.get_msgId() not in kinds), *streams], key=lambda one: one.time_s
    )


def _journal(path: Path) -> list[tuple[float, Record | UnknownRecord]]:
    """Unix time in seconds, and record of each line of a compressed journal; none where there is no file."""
    if not path.exists():
        return []
    with TemporaryDirectory() as scratch:
        journal = Path(scratch, "journal.jsonl")
        journal.write_bytes(gzip.decompress(path.read_bytes()))
        return [(line.unix_s or 0.0, line.record) for line in read_journal(journal)]


def read_scenarios(folder: Path) -> list[tuple[float, Scenario]]:
    """From when on which one was seen: one, or that of the way out and, from when it began, that of the way home."""
    if (folder / SCENARIO).exists():
        return [(-math.inf, read_toml(folder / SCENARIO, Scenario))]
    out, home = (read_toml(folder / name, Scenario) for name in ("out.toml", "home.toml"))
    home_s = json.loads((folder / "clock.json").read_text(encoding="utf-8"))["t_go_mono_s"]
    return [(-math.inf, out), (float(home_s), home)]


def _lane_m(path: Path, scenario: Scenario) -> Array:
    """As it was written down, else that of the scenario's road."""
    if path.exists():
        with gzip.open(path, "rt", encoding="utf-8") as file:
            lane_m: Array = np.loadtxt(file, skiprows=1)
        return lane_m
    ends_m = (0.0, scenario.length_m) if scenario.direction == "forward" else (scenario.length_m, 0.0)
    way = along(scenario, *ends_m)
    return np.stack([way.east_m, way.north_m], axis=1)


def _epoch_s(messages: list[tuple[float, bytes, Message]], own: Columns, link: Path) -> float:
    """Unix time less CLOCK_MONOTONIC, by the autopilot's time since its first boot."""
    reports = [(at_s, one.time_boot_ms) for at_s, _, one in messages if one.get_type() == "GLOBAL_POSITION_INT"]
    if not reports:
        raise FeedError(f"{link}: no GLOBAL_POSITION_INT in it, by whose stamps its times are known")
    unix_s, boot_ms = np.array(reports)[first_boot(np.array(reports)[:, 1])].T
    known = first_boot(own["boot_ms"])
    mono_s = np.interp(boot_ms, own["boot_ms"][known], own["mono_s"][known], left=np.nan, right=np.nan)
    if np.isnan(mono_s).all():
        raise FeedError(f"{link}: no GLOBAL_POSITION_INT of its first boot is from the time that {OWN} has")
    return float(np.nanmedian(unix_s - mono_s))


def first_boot(boot_ms: Array) -> slice:
    """Which of some times since boot are of the first, on one clock: a clock that starts anew early is still starting.

    Of one in 53 recorded drives it went from 5.0 s back to 3.0 s.
    """
    back = np.flatnonzero(np.diff(boot_ms) < -JUMP_MS)
    is_early = boot_ms[back] < STARTING_MS
    ends = back[~is_early]
    end = int(ends[0]) + 1 if len(ends) else len(boot_ms)
    return slice(max((int(row) + 1 for row in back[is_early] if row < end), default=0), end)


def _runs(lines: Sequence[tuple[float, object]], period_s: float) -> list[DaemonRun]:
    """period_s: from one exposure to the next, where the journal has too few frames to show it."""
    opened = [row for row, (_, record) in enumerate(lines) if isinstance(record, JournalOpened)]
    if not opened:  # of schema 1, which has no such line
        starts = enumerate(record for _, record in lines)
        opened = [row for row, record in starts if isinstance(record, StateChanged) and record.state == "starting"]
    runs = []
    for first, after in zip(opened, [*opened[1:], len(lines)], strict=True):
        used = [record for _, record in lines[first:after] if isinstance(record, FrameUsed)]
        from_s, to_s = lines[first][0], lines[after - 1][0]
        index, stamp_s = np.array([0]), np.array([from_s + period_s])
        if len(used) >= 2:
            index = np.array([frame.frame for frame in used])
            stamp_s = np.array([frame.stamp_ns for frame in used]) / 1e9
            period_s = float(np.median(np.diff(stamp_s) / np.diff(index)))
        earlier = stamp_s[0] - period_s * np.arange(index[0], 0, -1)
        later = np.arange(stamp_s[-1] + period_s, to_s, period_s)
        between = np.interp(np.arange(index[0], index[-1] + 1), index, stamp_s)
        exposures_s = np.r_[earlier, between, later]
        runs.append(DaemonRun(from_s, to_s, exposures_s[exposures_s > from_s]))
    return runs
