"""The parts of the daemon that the config names, opened: links, recognizer, maps, camera, recording and live page."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from uuid import uuid4

from edge.camera import Frame, Frames
from edge.camera.newest import NewestFrame
from edge.camera.picture_check import PictureCheck
from edge.config import Config
from edge.descriptor.network import Network
from edge.descriptor.open_network import open_network
from edge.drive_mapper import DriveMapper
from edge.feed import FeedWriter
from edge.feed.recorder import Recorder, begun_feed
from edge.files import named_by_time
from edge.geodesy import first_known
from edge.health.monitor import HealthMonitor, Links, StageTimes
from edge.journal.journal import Journal, QueuedJournal
from edge.journal.records import Record
from edge.layers import DriveTally, Learner, learn_command
from edge.localization import PositionEstimator
from edge.map_verification import MapVerification
from edge.mission import Start, WayHome, plan_way_home
from edge.motion import CameraMotion
from edge.page import LiveStatus, map_view, open_page
from edge.recognizer import model_key, open_recognizer
from edge.reference_map.store import HEADER
from edge.ros2 import Ros2
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.local_socket import LocalSocket
from edge.warm_start import WarmStart

FEED_WAITS_S, POLL_S = 3.0, 0.02  # heartbeats come each second, and a speed half a second after it is asked for

log = logging.getLogger(__name__)


class OpenedParts:
    """What `Daemon` moves frames through; None: a part that the config does not name."""

    def __init__(
        self,
        config: Config,
        parts: ExitStack,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        *,
        frames: Frames | None = None,
        mapping_frames: Frames | None = None,
        network: Network | None = None,
    ) -> None:
        """Open everything; SetupError if a part cannot be. `parts` closes what was opened, in reverse order.

        frames, mapping_frames, network: instead of those that the config names.
        """
        self.config, self.clock_ns = config, clock_ns
        self.times = StageTimes()
        self.journal: QueuedJournal | None = None
        self.record: Callable[[Record], object] = lambda record: None
        if config.telemetry.journal:
            journal = Journal(Path(config.telemetry.journal), max_bytes=config.telemetry.journal_max_mb * 1e6)
            self.journal = parts.enter_context(closing(QueuedJournal(journal)))
            self.record = self.journal.write
        self.estimator = PositionEstimator(config)
        settings = config.telemetry, clock_ns, self.record, config.gates, config.home
        link = AutopilotConnection(*settings, estimator=self.estimator, motion=config.motion.use)
        self.autopilot = parts.enter_context(closing(link))
        # Before all others, so that it publishes which of them cannot be opened.
        links = Links(link.set_system_status, link.status_text, link.say_now)
        self.monitor = HealthMonitor(links, self.journal, clock_ns)
        with self.monitor.failures():
            self._open_recognizer(parts, network, mapping_frames)
            self._open_camera(parts, frames)
            self._open_page(parts)
            self._open_ros2(parts)
            self._open_home(parts)

    def _open_recognizer(self, parts: ExitStack, network: Network | None, mapping_frames: Frames | None) -> None:
        config = self.config
        network = network or open_network(config.descriptor)
        self.mapper: DriveMapper | None = None
        if config.mapping.folder:
            others = parts, self.autopilot, self.record, self.clock_ns
            self.mapper = DriveMapper(config, model_key(network), *others, frames=mapping_frames)
        self.learner: Learner | None = None
        if config.mapping.folder and config.mapping.layers:
            command = learn_command(Path(config.mapping.folder), config.mapping.layers)
            self.learner = parts.enter_context(closing(Learner(command)))
        newest = self.mapper.live.so_far() if self.mapper else None
        self.recognizer = open_recognizer(config, network=network, newest=newest, stopwatch=self.times.lap)
        maps = self.recognizer.map_set
        log.info("sampling: %s", self.recognizer.matcher.spacing)
        self.verification = MapVerification(maps, self.record, self.autopilot.status_text)
        self.estimator.use_maps(self.verification.as_uncertain(maps))
        self.warm_start = WarmStart(config, self.recognizer)
        self.tally: DriveTally | None = None
        if maps.is_folder and not (maps.path / HEADER).exists():
            self.tally = parts.enter_context(
                closing(DriveTally(maps.path, config.camera.view, time.time(), uuid4().hex))
            )

    def _open_camera(self, parts: ExitStack, frames: Frames | None) -> None:
        config = self.config
        self.device: NewestFrame | None = None
        if frames is None:
            if config.camera.kind == "feed" and config.sampling.by == "distance":
                self._await_speed()
            frames = self.device = NewestFrame.configured(config.camera, self.clock_ns)
        self.pictures = PictureCheck(self.device, config.camera.kind, config.gates.min_speed_mps)
        turned = self.autopilot.vehicle.velocity.turned_rad
        self.motion = CameraMotion(config, self.record, turned) if config.motion.use != "off" else None
        self.camera: Frames = parts.enter_context(closing(frames))
        self.recorder: Recorder | None = None
        if config.recording.folder:
            folder = Path(config.recording.folder)

            def begin(frame: Frame) -> FeedWriter:
                return begun_feed(named_by_time(folder, time.time()), config.camera, frame)

            self.recorder = parts.enter_context(closing(Recorder(begin, config.recording.min_free_mb * 1e6)))

    def _await_speed(self) -> None:
        """A feed waits for nobody, and its frames are chosen by the distance driven: let an autopilot speak first."""
        until_s = time.monotonic() + FEED_WAITS_S
        while self.autopilot.vehicle.motion.speed_mps(self.clock_ns()) is None and time.monotonic() < until_s:
            self.autopilot.poll()
            time.sleep(POLL_S)

    def _open_page(self, parts: ExitStack) -> None:
        self.live_status = LiveStatus(self.recognizer.model_name, self.config.acceptance.confidence_from)
        self.page = open_page(self.config.page, map_view(self.recognizer.map_set))
        if self.page is not None:
            parts.enter_context(closing(self.page))

    def _open_ros2(self, parts: ExitStack) -> None:
        config, places = self.config, self.recognizer.map_set.places
        datum = (config.telemetry.origin[0], config.telemetry.origin[1]) if config.telemetry.origin else None
        datum = datum or first_known(places["lat_deg"], places["lon_deg"])
        self.ros2: Ros2 | None = None
        if config.ros2.domain >= 0:
            self.ros2 = parts.enter_context(closing(Ros2(config, datum, self.clock_ns)))

    def _open_home(self, parts: ExitStack) -> None:
        home, left_m = self.config.home, self.config.rig.left_reverse_m

        def plan(start: Start) -> WayHome:
            maps = self.recognizer.map_set
            if self.mapper is not None:  # with the map of this drive up to the vehicle
                maps, start = maps.with_newest(self.mapper.live.whole()), replace(start, route_m=self.mapper.driven_m())
            return plan_way_home(maps, start, home, left_m)

        self.autopilot.home.plan = plan
        self.home_socket: LocalSocket | None = None
        if home.enabled and home.socket:
            self.home_socket = parts.enter_context(closing(LocalSocket(Path(home.socket))))
