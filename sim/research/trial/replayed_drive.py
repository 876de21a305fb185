"""A recorded drive once more: the whole daemon of today, on the bytes that a real autopilot sent, and on its pictures.

Time is the recorded one. Pictures are rendered where the vehicle truly was, ten a second, and go through the camera's
checks, [sampling] and [motion] as a device's do; the map is made again with the errors that its places had. Where it
gets keypoints, ArduPilot is one whose parameters let it fuse their poses.

It is open loop: nothing that is sent now moves the recorded autopilot, which goes on by the positions of then. Each
position is answered as accepted, and the autopilot's other answers come when they did.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.camera import CameraHealth, Frame
from edge.config import Config
from edge.daemon import Daemon
from edge.errors import FeedError
from edge.geodesy import moved
from edge.journal.records import FrameUsed, PluginFailed
from edge.keypoints.network import KeypointNetwork
from edge.opened_parts import OpenedParts
from edge.telemetry.codec import MavlinkCodec, Message
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE, acknowledgement
from edge.telemetry.firmware import FIRMWARES
from edge_plugins.home import HomeConfig
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.keypoint_rows import MOST_OF_PLACE
from edge_plugins.page import PageConfig
from sim.journal import records_of
from sim.research.trial.course_map import map_errors_m, open_builder, place_at
from sim.research.trial.flight_camera import FlightCamera, Scenes
from sim.research.trial.recorded_drive import WE, DaemonRun, RecordedDrive
from sim.trial.records import Array
from sim.trial.run import JOURNAL, RIG, map_scenario
from sim.trial.simulation import STEP_S
from sim.trial.views import RoadLibrary
from sim.vehicle.position_inputs import east_north_m
from sim.vehicle.pty_link import Cable
from sim.world.scenario import LightName, View

ANSWERS_S = 0.02
"""After which a position, or a set of sources, is accepted."""
ANSWERED = EXTERNAL_POSITION_ESTIMATE, mavlink.MAV_CMD_SET_EKF_SOURCE_SET
DAY: tuple[LightName, int] = ("day", 1)
"""Light and seed of the drive of a map."""


def replay(
    drive: RecordedDrive,
    matched: list[FrameUsed],
    folder: Path,
    library: RoadLibrary,
    *,
    keypoints: bool = False,
    watch: Callable[[Daemon, Playback], object] | None = None,
) -> list[tuple[float, Message]]:
    """Run the daemon on a recorded drive; what it sent, and when. Journal and lists, one of each run, stay in `folder`.

    matched: what was recognized on the drive's map, by whichever drive. keypoints: of a map that has them, unless it
    was made on the way. watch: is called after each turn of the daemon. FeedError where the map was learned, and
    RuntimeError where a plug-in failed.
    """
    if drive.is_learned:
        raise FeedError("its map was learned from several, and it has no record of what they were made of")
    received: list[tuple[float, Message]] = []
    journal = (folder / JOURNAL).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for left in (*folder.glob(f"{journal.stem}.*"), *folder.glob("*.drive")):
        left.unlink()
    with TemporaryDirectory() as scratch, closing(Scenes(library.folder / f"{drive.name}.sqlite")) as scenes:
        map_path = Path(scratch) / "map"
        _build_map(drive, matched, map_path, library, keypoints=keypoints)
        for number, run in enumerate(drive.runs):
            with closing(Cable()) as link, ExitStack() as parts:
                playback = Playback(drive, run, link, scenes, fuses_poses=keypoints)
                recorded = _with_poses(drive) if keypoints else drive.config
                settings = _settings(recorded, link, map_path, journal, journal.with_name(f"{number:02}.drive"))
                opened = OpenedParts(
                    settings,
                    parts,
                    playback.clock_ns,
                    frames=playback,
                    mapping_frames=playback.rear,
                    network=library.network,
                )
                daemon = Daemon(opened)
                while daemon.turn():
                    if watch:
                        watch(daemon, playback)
                if run is drive.runs[-1]:
                    daemon.last_words()
                received += playback.received
    for failed in records_of(journal, PluginFailed):
        raise RuntimeError(f"{drive.name}: plug-in {failed.plugin}: {failed.why}")
    return received


class Playback:
    """The recorded autopilot and the cameras of one run of the daemon: its `Frames`."""

    def __init__(self, drive: RecordedDrive, run: DaemonRun, link: Cable, scenes: Scenes, *, fuses_poses: bool) -> None:
        """fuses_poses: whether ArduPilot's parameters let it, whatever they were."""
        self.now_ns = round(run.from_s * 1e9)
        self.received: list[tuple[float, Message]] = []
        """What the daemon sent, and when."""
        self._run, self._link = run, link
        sent = [one for one in drive.link if one.message.get_srcComponent() != WE]
        self._frames = deque(
            (one.time_s, one.data)
            for one in sent
            if run.from_s <= one.time_s < run.to_s and not _is_answer(one.message)
        )
        self._parameters = {one.message.param_id: one.data for one in sent if one.message.get_type() == "PARAM_VALUE"}
        self._earlier = {one.message.get_msgId(): one.data for one in sent if one.time_s < run.from_s}
        self._front = FlightCamera(drive, run.exposures_s, "front", scenes, self.clock_ns)
        has_rear = isinstance(drive.config.of(MappingConfig).camera, msgspec.Struct)
        self.rear = FlightCamera(drive, run.exposures_s, "rear", scenes, self.clock_ns) if has_rear else None
        """The camera that maps."""
        self._codec = MavlinkCodec(1, mavlink.MAV_COMP_ID_AUTOPILOT1)
        if fuses_poses:
            for one in FIRMWARES[mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA].asks["vision_position"]:
                value = float(one.values[0]), mavlink.MAV_PARAM_TYPE_REAL32, 1, 0
                message = mavlink.MAVLink_param_value_message(one.parameter.encode(), *value)
                self._parameters[one.parameter] = self._codec.encode(message)
        self._answers: deque[tuple[float, bytes]] = deque()

    def clock_ns(self) -> int:
        """The recorded CLOCK_MONOTONIC."""
        return self.now_ns

    def _step(self) -> None:
        self.now_ns += round(STEP_S * 1e9)
        now_s = self.now_ns / 1e9
        for message in self._codec.decode(self._link.receive()):
            self.received.append((now_s, message))
            if answer := self._answer(message):
                self._answers.append((now_s + ANSWERS_S, answer))
        due = b""
        for waiting in (self._frames, self._answers):
            while waiting and waiting[0][0] <= now_s and len(due) + len(waiting[0][1]) <= self._link.room:
                due += waiting.popleft()[1]
        if due:
            self._link.send(due)

    def _answer(self, message: Message) -> bytes | None:
        """To what does not come when it did: a parameter, what was said before this run, and that all is accepted."""
        if message.get_type() == "PARAM_REQUEST_READ":
            return self._parameters.get(message.param_id)
        command = getattr(message, "command", None)
        if command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return self._earlier.get(int(message.param1))
        if command in ANSWERED:
            return self._codec.encode(acknowledgement(command, mavlink.MAV_RESULT_ACCEPTED, 0, 1, WE))
        return None

    @property
    def health(self) -> CameraHealth:
        """See NewestFrame."""
        return self._front.health

    @property
    def ended(self) -> bool:
        """See NewestFrame."""
        return self.now_ns / 1e9 >= self._run.to_s

    def take(self, timeout_s: float) -> Frame | None:
        """Let `timeout_s` pass; the newest frame that has arrived meanwhile."""
        for _ in range(max(1, round(timeout_s / STEP_S))):
            self._step()
        return self._front.take(0.0)

    def close(self) -> None:
        """See NewestFrame."""
        self._front.close()


def _is_answer(message: Message) -> bool:
    return message.get_type() == "COMMAND_ACK" and message.command in ANSWERED


def _settings(config: Config, link: Cable, map_path: Path, journal: Path, events: Path) -> Config:
    """As recorded, but for the places of files and devices. events: gets the list of the run."""
    replaced, port = msgspec.structs.replace, f"serial:{link.device}:921600"
    telemetry = replaced(config.telemetry, connection=port, journal=str(journal), signing_clock="", drive=str(events))
    plugins = {**config.plugins, "page": PageConfig(port=0), "home": config.of(HomeConfig)}
    if config.of(MappingConfig).folder:
        plugins["mapping"] = replaced(config.of(MappingConfig), folder=str(map_path))
    return replaced(config, map=replaced(config.map, path=str(map_path)), plugins=plugins, telemetry=telemetry)


def _with_poses(drive: RecordedDrive) -> Config:
    """The drive's config with the camera's view and place, which keypoint poses need: it is at the antenna."""
    replaced, config = msgspec.structs.replace, drive.config
    camera = replaced(config.camera, fov_deg=drive.scenario.fov_deg)
    telemetry = replaced(config.telemetry, emit="auto")
    return replaced(config, camera=camera, telemetry=telemetry, rig=replaced(config.rig, look_sigma_m=RIG.look_sigma_m))


def _build_map(
    drive: RecordedDrive, matched: list[FrameUsed], path: Path, library: RoadLibrary, *, keypoints: bool
) -> None:
    """The map before the drive, whose places have the errors that the journals' positions had; none if it was made on
    the way."""
    if drive.config.of(MappingConfig).folder:
        path.mkdir()
        return
    out = map_scenario(drive.scenario, (_view(matched), *DAY))
    route, lane_m = out.drive().route, out.lane_m
    spacing_m = drive.config.sampling.spacing_m
    places = np.arange(int(drive.scenario.length_m / spacing_m))
    true = [route.at(place * spacing_m, lane_m) for place in places]
    off_m, first_rows = _map_errors(drive, matched, true)
    finder = KeypointNetwork() if keypoints else None
    with open_builder(path, library.network, keypoints=keypoints) as builder:
        for place in places:
            if place in first_rows:
                builder.begin_segment(f"segment from place {place}", out.view, has_odometer=True, whole_sigma_m=0.0)
                row = 0
            route_m = float(place * spacing_m)
            builder.add(library[out].raw(route_m), place_at(row, route_m, true[place], off_m[place]))
            if builder.keypoints and finder:
                builder.keypoints.add(finder.extract(library[out].picture(route_m), MOST_OF_PLACE))
            row += 1
        builder.finish()


def _view(matched: list[FrameUsed]) -> View:
    """Of the camera that made the map: a front camera sees its places as it did if it goes the same way."""
    ways = Counter(frame.direction for frame in matched if frame.accepted and frame.order == "same")
    return "front" if ways["forward"] > ways["reverse"] else "rear"


def _map_errors(
    drive: RecordedDrive, matched: list[FrameUsed], true: list[tuple[float, float, float]]
) -> tuple[Array, set[int]]:
    """East and north (n, 2) by which each place is wrong, and the first places of segments, by what was matched.

    A place that was never matched is as wrong as the nearest one that was; where none was, each as its accuracy says.
    """
    known, first_rows = {}, {0}
    for frame in matched:
        if frame.place is None or frame.order != "same" or frame.lat_deg is None or frame.lon_deg is None:
            continue
        if frame.map_row is not None and frame.place < len(true):
            first_rows.add(frame.place - frame.map_row)
            # Its position is that of the vehicle, the rig's offset from the place.
            ahead_m = drive.config.rig.ahead_m(frame.direction or "forward", frame.order)
            heading_rad = math.radians(frame.heading_deg or 0.0)
            at = moved(frame.lat_deg, frame.lon_deg, ahead_m * math.sin(heading_rad), ahead_m * math.cos(heading_rad))
            known[frame.place] = np.array(east_north_m(*at)) - true[frame.place][:2]
    if not known:
        places_m = (drive.config.sampling.spacing_m * np.arange(len(true))).tolist()
        return map_errors_m(places_m, np.random.default_rng(drive.scenario.seed)), first_rows
    places = np.array(sorted(known))
    nearest = places[np.abs(places[None, :] - np.arange(len(true))[:, None]).argmin(axis=1)]
    return np.array([known[place] for place in nearest.tolist()]), first_rows
