"""The daemon: opens the parts that the config names, and moves frames through them until it is stopped.

camera -> usable, at a new place? -> recognizer -> localization -> event -> journal, people, live page
                                                                -> position -> autopilot

Read `Daemon.turn` first: each step of it is one of the methods below, in the same order.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Protocol

from edge.camera import CameraHealth, Frame
from edge.camera.frozen_picture import FrozenPictureDetector, PictureFault
from edge.camera.newest import NewestFrame
from edge.config import Config
from edge.descriptor.network import Network
from edge.feed.recorder import Recorder, run_folder
from edge.feed.sampling import Sampler
from edge.geodesy import VehiclePosition
from edge.health.monitor import HealthMonitor, Links
from edge.health.service import Supervision, notify
from edge.health.stage_times import StageTimes
from edge.journal.journal import Journal
from edge.journal.records import FrameUsed, MapExcluded, Record, Stopped
from edge.localization.place_fix import frame_used, untracked_fix
from edge.localization.route_filter import RouteFilter
from edge.page import LiveStatus, Sources, map_view, open_page
from edge.recognizer import open_recognizer
from edge.reference_map import ExcludedMap, MapSet, Route
from edge.sequence import PlaceMatch
from edge.sequence.place_search import Near
from edge.telemetry.autopilot import AutopilotConnection
from edge.warm_start import WarmStart

TURN_S = 0.02  # at most this long between reads of the MAVLink port
CLOSE_S = 1.5  # a camera that cannot be closed must not keep the program from ending
CHECK_BYTES = 8 << 20  # of the map, a few milliseconds, in a turn without a frame
SURE_SIGMAS = 3.0
log = logging.getLogger(__name__)


class Frames(Protocol):
    """Where the frames come from: `NewestFrame`, or the trial's, whose time is simulated."""

    @property
    def health(self) -> CameraHealth:
        """State and counts."""

    @property
    def ended(self) -> bool:
        """Whether there is no frame any more."""

    def take(self, timeout_s: float) -> Frame | None:
        """The newest frame that was not taken yet; waits for one up to `timeout_s`."""

    def close(self) -> None:
        """Release the camera."""


class Daemon:
    """The running parts; `turn` moves at most one frame from the camera to the autopilot."""

    def __init__(
        self,
        config: Config,
        parts: ExitStack,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        *,
        frames: Frames | None = None,
        network: Network | None = None,
    ) -> None:
        """Open everything; SetupError if a part cannot be. `parts` closes what was opened, in reverse order.

        frames, network: instead of those that the config names.
        """
        self._config, self._clock_ns = config, clock_ns
        self._times = StageTimes()
        self._journal: Journal | None = None
        self._newest: PlaceMatch | None = None  # that was accepted
        self._record: Callable[[Record], object] = lambda record: None
        if config.telemetry.journal:
            journal = Journal(Path(config.telemetry.journal), max_bytes=config.telemetry.journal_max_mb * 1e6)
            self._journal = parts.enter_context(closing(journal))
            self._record = self._journal.write
        link = AutopilotConnection(config.telemetry, clock_ns, self._record, config.gates)
        self._autopilot = parts.enter_context(closing(link))
        # Before all others, so that it publishes which of them cannot be opened.
        links = Links(link.set_system_status, link.status_text, link.say_now)
        self.monitor = HealthMonitor(links, self._journal, clock_ns)
        with self.monitor.failures():
            self._open_recognizer(network)
            self._open_camera(parts, frames)
            self._open_page(parts)
        self._frames_used = self._events = self._distance_gaps = 0
        self._frame_s = 0.0  # what the last one took
        self._supervision = Supervision()

    def _open_recognizer(self, network: Network | None) -> None:
        config = self._config
        self._recognizer = open_recognizer(config, network=network, stopwatch=self._times.lap)
        maps = self._recognizer.map_set
        for excluded in maps.excluded:
            self._publish_excluded(excluded)
        self._checksums = maps.checksum_schedule()
        self._warm_start = WarmStart(config, self._recognizer)
        self._sampler = Sampler(config.sampling)
        self._follow(maps)

    def _follow(self, maps: MapSet) -> None:
        """Follow the vehicle along the drives of these maps from now on."""
        config = self._config
        self._route = Route(maps)
        self._filter = RouteFilter(self._route, config.tracking, config.rig, config.sequence.length)
        self._newest = None

    def _open_camera(self, parts: ExitStack, frames: Frames | None) -> None:
        config = self._config
        self._device: NewestFrame | None = None
        if frames is None:
            frames = self._device = NewestFrame.configured(config.camera, self._clock_ns, CLOSE_S)
        self._camera: Frames = parts.enter_context(closing(frames))
        self._frozen_pictures = FrozenPictureDetector()
        self._picture_fault: PictureFault | None = None
        self._recorder: Recorder | None = None
        if config.recording.folder:
            folder = Path(config.recording.folder)
            recorder = Recorder(lambda: run_folder(folder), config.camera, config.recording.min_free_mb * 1e6)
            self._recorder = parts.enter_context(closing(recorder))

    def _open_page(self, parts: ExitStack) -> None:
        config, maps = self._config, self._recognizer.map_set
        sources = Sources(
            map_name=lambda: f"{Path(config.map.path).name}, {self._recognizer.map_set}",
            costs=self._recognizer.cost_view,
            camera=lambda: self._camera.health,
            link=self._autopilot.status,
            stages_ms=self._times.medians_ms,
            journal_lost=lambda: self._journal.lost if self._journal else 0,
            clock_ns=self._clock_ns,
        )
        self._live_status = LiveStatus(self._recognizer.model_name, config.acceptance.confidence_min, sources)
        self._page = open_page(config.page, map_view(maps))
        if self._page is not None:
            parts.enter_context(closing(self._page))

    def turn(self) -> bool:
        """One turn of the loop; False when the camera has come to its end (a feed or the simulator)."""
        self._autopilot.poll()
        frame = self._camera.take(TURN_S)
        if frame is not None and self._is_usable(frame):
            distance_m = self._autopilot.distance_m(frame.stamp_ns)
            if self._sampler.is_place(frame.stamp_ns, distance_m):
                self._process_frame(frame, distance_m)
        elif not self._checksums.is_done:
            self._check_maps(self._recognizer.matcher.search.folders_in_use)
        if self._update_health():
            self._reset()
        self._publish_position()
        self._update_page()
        self._feed_watchdog()
        return not self._camera.ended

    def _is_usable(self, frame: Frame) -> bool:
        """Whether a frame may be used; a camera that gives frozen pictures is opened again where that may help."""
        speed_mps = self._autopilot.speed_mps()
        moves = None if speed_mps is None else speed_mps >= self._config.gates.min_speed_mps
        fault = self._picture_fault = self._frozen_pictures.check(frame.image, frame.stamp_ns, moves)
        if fault and fault.reopen and self._device is not None:
            self._device.reopen(fault.what)
        return fault is None and not (self._device and self.monitor.is_first_after_gap(self._device.health))

    def _process_frame(self, frame: Frame, distance_m: float | None) -> None:
        """Recognize the place of a frame, follow the vehicle, and publish both."""
        self._times.start()
        began_ns, missed = self._clock_ns(), self._sampler.missed
        if self._distance_gaps != self._autopilot.distance_gaps:
            self._distance_gaps = self._autopilot.distance_gaps
            self._recognizer.restart_odometer()
        match = self._recognizer.observe(frame.image, frame.stamp_ns, self._search_area(), missed, distance_m)
        if match is not None and match.accepted and not self._is_verified(match):
            match = None
        self._filter.update(match, frame.stamp_ns, self._autopilot.displacement(frame.stamp_ns), missed)
        used = frame_used(frame.index, frame.stamp_ns, match, self._route, self._config.rig, missed)
        position = self._autopilot.position()
        self._publish_frame(frame, match, used, position)
        if self._recorder is not None:
            self._recorder.record(frame, position, distance_m)
        if match is not None and match.accepted:
            self._newest = match
            if match.event:
                self._publish_place(match, frame.stamp_ns)
        self._times.lap("telemetry")
        self._frames_used += 1
        now_ns = self._clock_ns()
        self._frame_s = (now_ns - began_ns) / 1e9
        # Only here: a file that is written anew while nothing is seen would make old statistics look fresh.
        self._warm_start.keep_if_due(now_ns, self.monitor.health.state, self._newest)

    def _search_area(self) -> Near | None:
        """Where the autopilot may be, None where it does not know or nobody knows how well."""
        position = self._autopilot.position()
        sigma_m = self._autopilot.uncertainty_m
        if position is None or sigma_m is None:
            return None
        radius_m = max(self._config.map.search_radius_m, SURE_SIGMAS * sigma_m)
        return Near(position.lat_deg, position.lon_deg, radius_m)

    def _is_verified(self, match: PlaceMatch) -> bool:
        """Check the maps behind a match before anything is published of it; False if one had to be excluded."""
        behind = self._recognizer.map_set.folders_behind(match.place_index, self._config.sequence.length)
        while not self._checksums.is_verified(behind):
            if not self._check_maps(behind):
                return False
            self._feed_watchdog()
        return True

    def _check_maps(self, first: Sequence[Path]) -> bool:
        """Check a further piece of the maps, some of them first; False if one is damaged, and excluded from now on."""
        damage = self._checksums.step(CHECK_BYTES, first)
        if damage is None:
            return True
        maps = self._recognizer.map_set.without({damage.path: damage.why})
        self._publish_excluded(maps.excluded[-1])
        self._recognizer.use_maps(maps)
        self._follow(maps)
        if self._page is not None:
            self._page.show_map(map_view(maps))
        return False

    def _publish_frame(
        self, frame: Frame, match: PlaceMatch | None, used: FrameUsed, position: VehiclePosition | None
    ) -> None:
        """To the live page, and to the journal where it is to have every frame."""
        self._live_status.add(frame, match, used, (position.lat_deg, position.lon_deg) if position else None)
        if self._config.telemetry.journal_frames:
            self._record(used)

    def _publish_place(self, match: PlaceMatch, stamp_ns: int) -> None:
        """An event, to people and the journal: with the tracked position, or with the place's own."""
        fix = self._filter.at_exposure()
        if fix is None or fix.stamp_ns != stamp_ns:
            fix = untracked_fix(match, stamp_ns, self._route, self._config.rig)
        self._events += 1
        self._record(fix)
        self._autopilot.publish_place(fix)

    def _publish_excluded(self, excluded: ExcludedMap) -> None:
        excluded.log()
        self._record(MapExcluded(excluded.name, excluded.why))

    def _update_health(self) -> bool:
        """Publish the daemon's state; True when what was recognized so far must be dropped."""
        fault = self._picture_fault
        return self.monitor.update(
            self._recognizer.state,
            self._frames_used,
            self._frame_s,
            self._camera.health,
            link=(self._autopilot.state, self._autopilot.why_closed),
            picture_fault=fault.what if fault and fault.sure else "",
            hang=self._device.hang(self._clock_ns()) if self._device else "",
        )

    def _reset(self) -> None:
        """Begin anew: nothing is published that rests on frames from before a blindness."""
        self._recognizer.reset()
        self._filter.reset()
        self._newest = None

    def _publish_position(self) -> None:
        """A fix for the autopilot, while the vehicle is on the map and if one is due."""
        if self.monitor.health.able != "on the map":
            self._autopilot.withdraw_position()
            return
        time_base = self._autopilot.position_due()
        if time_base is None or self._newest is None or self._picture_fault is not None:
            return
        if time_base == "exposure":
            fix = self._filter.at_exposure()
        else:
            now_ns = self._clock_ns()
            fix = self._filter.at(now_ns, self._autopilot.displacement(now_ns))
        if fix is not None:
            self._autopilot.send_position(fix)

    def _update_page(self) -> None:
        if self._page is not None and self._page.wanted:
            health = self.monitor.health
            self._page.show(self._live_status.snapshot(health.state, health.why))

    def _feed_watchdog(self) -> None:
        """This thread moves all but the camera: had it hung anywhere, it would not come here."""
        self._supervision.publish(self.monitor.hangs, self._clock_ns())

    def last_words(self) -> Stopped:
        """What was done, for the journal."""
        self._autopilot.restore_sources()
        health = self._camera.health
        counts = {"delivered": health.delivered, "overwritten": health.overwritten, "bad": health.bad}
        stopped = Stopped(self._frames_used, self._events, self._times.medians_ms(), counts)
        self._record(stopped)
        self._warm_start.keep(self.monitor.health.state, self._newest)
        return stopped


def run(config: Config, stop: threading.Event, opened: Callable[[], object] = lambda: None) -> Stopped:
    """Run until `stop` is set or the camera comes to its end; `opened` is called when all parts are open."""
    with ExitStack() as parts:
        daemon = Daemon(config, parts)
        opened()
        with daemon.monitor.failures():
            while not stop.is_set() and daemon.turn():
                pass
        notify("STOPPING=1")
        return daemon.last_words()
