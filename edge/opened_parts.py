"""The parts of the daemon that the config names, opened: links, recognizer, maps, camera and plug-ins."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

from edge.camera import Frames
from edge.camera.checks import open_picture_check
from edge.camera.newest import NewestFrame
from edge.config import Config
from edge.descriptor.network import Network
from edge.descriptor.open_network import open_network
from edge.files import wait_for_writes
from edge.health.monitor import HealthMonitor, Links, StageTimes
from edge.journal.journal import Journal, QueuedJournal
from edge.journal.records import Record
from edge.localization import Entry, MapUpdate, PositionEstimator
from edge.map_verification import MapVerification
from edge.plugin import Parts, Plugins, RecognizerView
from edge.recognition.recognizer import network_for, open_recognizer
from edge.recognition.warm_start import WarmStart
from edge.telemetry.autopilot import AutopilotConnection

if TYPE_CHECKING:
    from edge.telemetry.shadow import Shadow

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
        self.frames_used, self.events = 0, 0
        self.times = StageTimes()
        self.journal: QueuedJournal | None = None
        self.record: Callable[[Record], object] = lambda record: None
        if config.telemetry.journal:
            journal = Journal(Path(config.telemetry.journal), max_bytes=config.telemetry.journal_max_mb * 1e6)
            self.journal = parts.enter_context(closing(QueuedJournal(journal)))
            self.record = self.journal.write
        parts.callback(wait_for_writes)  # which begin while the others close
        listeners: list[Callable[[int, Entry], object]] = []
        if config.telemetry.drive:
            from edge.localization.drive_file import DriveFile  # which few vehicles need

            listeners.append(parts.enter_context(closing(DriveFile(Path(config.telemetry.drive), config))).write)
        self.shadow: Shadow | None = None
        if config.telemetry.emit == "report" and self.journal:
            from edge.telemetry.shadow import Shadow  # which no vehicle needs whose positions are used

            self.shadow = Shadow(config, self.record)
            listeners.append(self.shadow.update)
        self.drive = PositionEstimator(config, *listeners)
        link = AutopilotConnection(config.telemetry, clock_ns, self.record, config.gates, self.drive)
        self.autopilot = parts.enter_context(closing(link))
        # Before all others, so that it publishes which of them cannot be opened.
        links = Links(link.set_system_status, link.status_text, link.say_now)
        self.monitor = HealthMonitor(links, self.journal, clock_ns)
        self.plugins = parts.enter_context(closing(Plugins(link)))
        with self.monitor.failures():
            network = network or open_network(network_for(config))
            own = config, clock_ns, self.record, link, self.drive, network, self.times
            shared = Parts(*own, lambda: self.monitor.health, self._lost, self.plugins, mapping_frames)
            self.plugins.open(shared)
            self._open_recognizer(network)
            self._open_camera(parts, frames)
            shared.recognizer = RecognizerView(self.recognizer)
            shared.pictures, shared.camera = self.pictures, self.camera
            self.plugins.start()

    def _lost(self) -> int:
        return self.journal.lost if self.journal else 0

    def _open_recognizer(self, network: Network) -> None:
        config, newest = self.config, self.plugins.newest_map()
        self.recognizer = open_recognizer(config, network=network, newest=newest, stopwatch=self.times.lap)
        maps = self.recognizer.map_set
        log.info("sampling: %s", self.recognizer.matcher.spacing)
        self.verification = MapVerification(maps, self.record)
        self.drive.update(self.clock_ns(), MapUpdate(maps))
        self.warm_start = WarmStart(config, self.recognizer)

    def _open_camera(self, parts: ExitStack, frames: Frames | None) -> None:
        config = self.config
        self.device: NewestFrame | None = None
        if frames is None:
            if config.camera.kind == "feed" and config.sampling.by == "distance":
                from edge.feed_start import open_feed

                self.device = open_feed(config.camera, self.autopilot)
            frames = self.device = self.device or NewestFrame.configured(config.camera, self.clock_ns)
        self.pictures = open_picture_check(self.device, config.camera.kind, config.gates.min_speed_mps)
        self.camera: Frames = parts.enter_context(closing(frames))
