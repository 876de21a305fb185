"""Positions of a recorded drive computed anew: the daemon of today on the bytes that a real autopilot sent.

The daemon's parts are those of `sim.trial.run`, in the recorded time. The pictures are rendered again where the vehicle
truly was, and the map is made again with the positions that its places had, so that frames that the recorded daemon did
not use can be recognized as well. Further than MOST_LEFT_M from the road there are none.

It is open loop: nothing that is sent now moves the recorded autopilot. What the positions of then did to it is in its
messages; the daemon learns of them as if it had sent them. What follows a better or a worse position cannot be seen
here, and where the positions of now differ much from those of then, neither is what a drive would have been. Every
43003 is accepted.
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.camera import CameraHealth, Frame
from edge.config import CameraConfig, Config, DescriptorConfig, MapConfig, SamplingConfig
from edge.daemon import Daemon
from edge.geodesy import moved
from edge.journal.records import FixSent, FrameUsed
from edge.opened_parts import OpenedParts
from edge.telemetry.codec import MavlinkCodec, Message
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE, acknowledgement
from edge.telemetry.vehicle import Vehicle
from edge_plugins.mapping import MappingConfig
from edge_plugins.page import PageConfig
from sim.journal import records_of
from sim.research.trial.course_map import open_builder, place_at
from sim.research.trial.course_rules import SENT_WITHIN_S
from sim.research.trial.recorded_drive import WE, DaemonRun, RecordedDrive
from sim.trial.cameras import PlacedNetwork, TrialCamera, View
from sim.trial.records import Array
from sim.trial.run import JOURNAL, map_scenario, read_position
from sim.trial.simulation import STEP_S
from sim.trial.views import MOST_LEFT_M, RoadLibrary
from sim.trial.way import along
from sim.vehicle.position_inputs import east_north_m
from sim.vehicle.pty_link import PtyLink, open_pty

ANSWERS_S = 0.02
"""After which a position is accepted."""


@dataclass(frozen=True)
class Positions:
    """Positions that were sent, each with its error in meters (n,); own_sigma_m: NaN where the journal has none.

    share: of the time without GPS, with a position at most SENT_WITHIN_S old. first_m: driven
    without GPS before the first one.
    """

    time_s: Array
    error_m: Array
    own_sigma_m: Array
    share: float
    first_m: float


@dataclass(frozen=True)
class Frames:
    """Used frames, how many of them are believed, and how many of those are of another place than the truth.

    apart_m: (n,) driven in truth from one used frame to the next, without GPS.
    """

    used: int
    believed: int
    false: int
    apart_m: Array


@dataclass(frozen=True)
class Replayed:
    """A drive as it was recorded, and as the daemon of today would have done."""

    name: str
    recorded: Positions
    replayed: Positions
    recorded_frames: Frames
    replayed_frames: Frames


def replay(drive: RecordedDrive, folder: Path, library: RoadLibrary) -> Replayed:
    """Replay a recorded drive; the journal of its last run stays in `folder`."""
    network = PlacedNetwork(library)
    received: list[tuple[float, Message]] = []
    journal = (folder / JOURNAL).resolve()
    with TemporaryDirectory(dir=folder) as scratch:
        map_path = Path(scratch) / "map"
        _build_map(drive, map_path, network, library)
        for suffix in (".jsonl", ".bound"):
            journal.with_suffix(suffix).unlink(missing_ok=True)
        for run in drive.runs:
            with closing(open_pty()) as link, ExitStack() as parts:
                playback = Playback(drive, run, link, network)
                settings = _settings(drive.config, link, map_path, journal)
                daemon = Daemon(OpenedParts(settings, parts, playback.clock_ns, frames=playback, network=network))
                while daemon.turn():
                    playback.pull(daemon.parts.autopilot.vehicle)
                received += playback.received
    then = [(one.time_s, one.message) for one in drive.link if one.message.get_srcComponent() == WE]
    return Replayed(
        drive.name,
        _positions(drive, then, drive.sent),
        _positions(drive, received, list(records_of(journal, FixSent))),
        _frames(drive, drive.used),
        _frames(drive, list(records_of(journal, FrameUsed))),
    )


class Playback:
    """The recorded autopilot and the camera of one run of the daemon: its `Frames`."""

    def __init__(self, drive: RecordedDrive, run: DaemonRun, link: PtyLink, network: PlacedNetwork) -> None:
        self.now_ns = round(run.from_s * 1e9)
        self.received: list[tuple[float, Message]] = []
        """What the daemon sent, and when."""
        self._drive, self._run, self._link = drive, run, link
        self._frames = deque(
            one for one in drive.link if run.from_s <= one.time_s < run.to_s and _is_autopilots(one.message)
        )
        values = (one for one in drive.link if one.message.get_type() == "PARAM_VALUE" and _is_autopilots(one.message))
        self._parameters = {one.message.param_id: one.data for one in values}
        self._exposures_s = deque(run.exposures_s.tolist())
        ours = (one.time_s for one in drive.link if one.message.get_srcComponent() == WE and read_position(one.message))
        self._ours_s = deque(time_s for time_s in ours if run.from_s <= time_s < run.to_s)
        latency_s = max(0.0, drive.latency_s)
        self._camera = TrialCamera(
            self.clock_ns, np.random.default_rng(1), latency_s=(latency_s, latency_s), hole_rate=0.0
        )
        self._camera.network = network
        self._codec = MavlinkCodec(1, mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._answers: deque[tuple[float, bytes]] = deque()
        self._views = _Views(drive)

    def clock_ns(self) -> int:
        """The recorded CLOCK_MONOTONIC."""
        return self.now_ns

    def pull(self, vehicle: Vehicle) -> None:
        """What was sent then moved the recorded autopilot."""
        while self._ours_s and self._ours_s[0] <= self.now_ns / 1e9:
            self._ours_s.popleft()
            vehicle.velocity.has_our_position = True

    def _step(self) -> None:
        self.now_ns += round(STEP_S * 1e9)
        now_s = self.now_ns / 1e9
        for message in self._codec.decode(self._link.receive()):
            self.received.append((now_s, message))
            if message.get_type() == "COMMAND_INT" and message.command == EXTERNAL_POSITION_ESTIMATE:
                accepted = acknowledgement(message.command, mavlink.MAV_RESULT_ACCEPTED, 0, 1, WE)
                self._answers.append((now_s + ANSWERS_S, self._codec.encode(accepted)))
            if message.get_type() == "PARAM_REQUEST_READ" and message.param_id in self._parameters:
                self._answers.append((now_s + ANSWERS_S, self._parameters[message.param_id]))
        while self._frames and self._frames[0].time_s <= now_s:
            self._link.send(self._frames.popleft().data)
        while self._answers and self._answers[0][0] <= now_s:
            self._link.send(self._answers.popleft()[1])
        while self._exposures_s and self._exposures_s[0] <= now_s:
            stamp_s = self._exposures_s.popleft()
            view = self._views.at(stamp_s)
            if abs(view.left_m) <= MOST_LEFT_M:
                self._camera.expose(view, round(stamp_s * 1e9))

    @property
    def health(self) -> CameraHealth:
        """See NewestFrame."""
        return self._camera.health

    @property
    def ended(self) -> bool:
        """See NewestFrame."""
        return self.now_ns / 1e9 >= self._run.to_s

    def take(self, timeout_s: float) -> Frame | None:
        """Let `timeout_s` pass; the newest frame that has arrived meanwhile."""
        for _ in range(max(1, round(timeout_s / STEP_S))):
            self._step()
        return self._camera.take(0.0)

    def close(self) -> None:
        """See NewestFrame."""


def _is_autopilots(message: Message) -> bool:
    is_answer = message.get_type() == "COMMAND_ACK" and message.command == EXTERNAL_POSITION_ESTIMATE
    return message.get_srcComponent() != WE and not is_answer


class _Views:
    """What the camera sees at a moment, where the vehicle truly was."""

    def __init__(self, drive: RecordedDrive) -> None:
        self._drive = drive
        self._scenario = msgspec.structs.replace(drive.scenario, view="front", epoch_ns=None)
        ends_m = 0.0, self._scenario.length_m
        self._way = along(self._scenario, *(ends_m if self._scenario.direction == "forward" else ends_m[::-1]))
        self._heading_rad = np.unwrap(np.radians(drive.truth["heading_deg"]))
        self._along_m: float | None = None

    def at(self, time_s: float) -> View:
        """The view at a moment no earlier than those asked for before."""
        east_m, north_m = self._drive.true_m(time_s).tolist()
        if self._along_m is None:
            self._along_m = float(np.argmin(np.hypot(self._way.east_m - east_m, self._way.north_m - north_m)))
        self._along_m, left_m = self._way.project(east_m, north_m, self._along_m)
        row = int(np.clip(self._along_m, 0, len(self._way.route_m) - 1))
        heading_rad = float(np.interp(time_s, self._drive.truth["mono_s"], self._heading_rad))
        turn_deg = math.degrees(heading_rad - self._way.heading_rad[row])
        rows = np.arange(len(self._way.route_m))
        return View(self._scenario, float(np.interp(self._along_m, rows, self._way.route_m)), left_m, turn_deg)


def _settings(config: Config, link: PtyLink, map_path: Path, journal: Path) -> Config:
    """As recorded, but for the places of files and devices."""
    telemetry = msgspec.structs.replace(
        config.telemetry, connection=f"serial:{link.device}:921600", journal=str(journal), signing_clock=""
    )
    return msgspec.structs.replace(
        config,
        camera=CameraConfig(kind="sim", view=config.camera.view),
        descriptor=DescriptorConfig(keep_statistics_min=0.0),
        map=MapConfig(path=str(map_path)),
        telemetry=telemetry,
        plugins={**config.plugins, "mapping": MappingConfig(), "page": PageConfig(port=0)},
    )


def _build_map(drive: RecordedDrive, path: Path, network: PlacedNetwork, library: RoadLibrary) -> None:
    """The map, whose places have the errors that the journal's positions had."""
    out = map_scenario(drive.scenario)
    route, lane_m = out.drive().route, out.lane_m
    spacing_m = SamplingConfig().spacing_m
    places = np.arange(int(drive.scenario.length_m / spacing_m))
    true = [route.at(place * spacing_m, lane_m) for place in places]
    off_m, first_rows = _map_errors(drive, true)
    with open_builder(path, network) as builder:
        for place in places:
            if place in first_rows:
                builder.begin_segment(f"segment from place {place}", "rear")
                row = 0
            route_m = float(place * spacing_m)
            builder.add(library[out].raw(route_m), place_at(row, route_m, true[place], off_m[place]))
            row += 1
        builder.finish()


def _map_errors(drive: RecordedDrive, true: list[tuple[float, float, float]]) -> tuple[Array, set[int]]:
    """East and north (n, 2) by which each place is wrong, and the first places of segments, by the journal's matches.

    A place that was never matched is as wrong as the nearest one that was.
    """
    known, first_rows = {}, {0}
    for frame in drive.used:
        if frame.place is None or frame.order != "same" or frame.lat_deg is None or frame.lon_deg is None:
            continue
        if frame.map_row is not None and frame.place < len(true):
            first_rows.add(frame.place - frame.map_row)
            # Its position is that of the vehicle, the rig's offset from the place.
            ahead_m = drive.config.rig.ahead_m(frame.direction or "forward", frame.order)
            heading_rad = math.radians(frame.heading_deg or 0.0)
            at = moved(frame.lat_deg, frame.lon_deg, ahead_m * math.sin(heading_rad), ahead_m * math.cos(heading_rad))
            known[frame.place] = np.array(east_north_m(*at)) - true[frame.place][:2]
    places = np.array(sorted(known))
    nearest = places[np.abs(places[None, :] - np.arange(len(true))[:, None]).argmin(axis=1)]
    return np.array([known[place] for place in nearest.tolist()]), first_rows


def _positions(drive: RecordedDrive, messages: list[tuple[float, Message]], sent: list[FixSent]) -> Positions:
    own_sigma_m = {(round(one.lat_deg * 1e7), round(one.lon_deg * 1e7)): one.sigma_m for one in sent}
    found = []
    for sent_s, message in messages:
        position = read_position(message)
        if position is not None:
            *here_m, _, age_s = position
            at = (message.x, message.y) if message.get_type() == "COMMAND_INT" else (message.lat, message.lon)
            off_m = math.dist(here_m, drive.true_m(sent_s - age_s).tolist())
            found.append((sent_s, off_m, own_sigma_m.get(at, math.nan)))
    time_s, error_m, own_m = np.array(found, np.float64).reshape(-1, 3).T
    lost_s, (_, stops_s) = drive.gps_lost_s, drive.moves_s
    moments_s = np.arange(lost_s, stops_s, 0.1)
    last_s = np.r_[-math.inf, time_s][np.searchsorted(time_s, moments_s, side="right")]
    share = float(np.mean(moments_s - last_s <= SENT_WITHIN_S))
    first_s = time_s[time_s >= lost_s][:1]
    way_m = drive.true_m(moments_s)
    driven_m = np.r_[0.0, np.cumsum(np.hypot(*np.diff(way_m, axis=1)))]
    first_m = float(np.interp(first_s[0], moments_s, driven_m)) if len(first_s) else math.nan
    return Positions(time_s, error_m, own_m, share, first_m)


FALSE_M = 25.0
"""Of a believed place from the truth: the lines end up to 20 m off where a stretch begins."""


def _frames(drive: RecordedDrive, used: list[FrameUsed]) -> Frames:
    believed = [frame for frame in used if frame.accepted and frame.lat_deg is not None and frame.lon_deg is not None]
    off_m = [
        math.dist(east_north_m(frame.lat_deg or 0.0, frame.lon_deg or 0.0), drive.true_m(frame.stamp_ns / 1e9).tolist())
        for frame in believed
    ]
    stamp_s = np.array([frame.stamp_ns for frame in used]) / 1e9
    apart_m: Array = np.hypot(*np.diff(drive.true_m(stamp_s[stamp_s >= drive.gps_lost_s]), axis=1))
    return Frames(len(used), len(believed), sum(off > FALSE_M for off in off_m), apart_m)
