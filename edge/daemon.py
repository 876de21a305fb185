"""`lookback run`: opens the parts that the config names and moves frames through them until told to stop.

newest camera frame -> is it a place? -> recognizer -> event -> journal, people
                                                    -> tracker -> position -> autopilot
"""

from __future__ import annotations

import argparse
import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Protocol

import msgspec

from edge.camera import Frame
from edge.camera.newest import CameraHealth, NewestFrame
from edge.config import Config, load_config, naming
from edge.descriptor.network import Network
from edge.feed.recorder import Recorder, run_folder
from edge.feed.sampling import Sampler
from edge.health.monitor import HealthMonitor
from edge.health.service import Supervision, notify, when_told_to_stop
from edge.health.stage_times import StageTimes
from edge.journal.frame_record import observation
from edge.journal.journal import Journal
from edge.localization.place_fix import place_fix, position_of, tracked_fix
from edge.localization.route_tracker import RouteTracker
from edge.page.snapshot import LiveStatus, map_view, open_page
from edge.recognizer import open_recognizer
from edge.reference_map import ExcludedMap, MapSet, Position, Route
from edge.sequence import PlaceMatch
from edge.sequence.place_search import Near
from edge.telemetry.autopilot import AutopilotConnection
from edge.warm_start import WarmStart

TURN_S = 0.02  # at most this long between looks at the MAVLink port
CLOSE_S = 1.5  # a camera that does not let go must not keep the program from ending
CHECK_BYTES = 8 << 20  # of the map, a few milliseconds, in a turn without a frame
SURE_SIGMAS = 3.0
log = logging.getLogger(__name__)


class Stopped(msgspec.Struct, frozen=True, tag_field="event", tag="stopped"):
    """The daemon's last words: what it did, and the median time of each stage in milliseconds."""

    frames_used: int
    events: int
    stages_ms: dict[str, float]
    camera: dict[str, int]


class MapExcluded(msgspec.Struct, frozen=True, tag_field="event", tag="map_excluded"):
    """A map of the folder that cannot be used, and why; the others are."""

    map: str
    why: str


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `lookback run` to the command line."""
    parser = commands.add_parser("run", help="recognise places and tell the autopilot, until stopped")
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.set_defaults(run=_run)


class Frames(Protocol):
    """Where the frames come from: `NewestFrame`, or the trial's, whose time is simulated."""

    @property
    def health(self) -> CameraHealth:
        """State and counts."""

    @property
    def ended(self) -> bool:
        """Whether there is no frame any more."""

    def take(self, timeout_s: float) -> Frame | None:
        """The newest frame that nobody took yet; waits for one up to `timeout_s`."""

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
        self._config = config
        self._clock_ns = clock_ns
        self._times = StageTimes()
        self._record: Callable[[msgspec.Struct], object] = lambda record: None
        self._journal: Journal | None = None
        self._newest: PlaceMatch | None = None
        if config.telemetry.journal:
            self._journal = parts.enter_context(closing(Journal(Path(config.telemetry.journal))))
            self._record = self._journal.write
        self._autopilot = parts.enter_context(
            closing(AutopilotConnection(config.telemetry, clock_ns, self._record, config.gates))
        )
        # Opened first, so that whatever else cannot be opened is told.
        self.condition = HealthMonitor(self._autopilot, self._journal, clock_ns, config.gates.min_speed_mps)
        with self.condition.failures():
            self._open(parts, network, frames)

    def _open(self, parts: ExitStack, network: Network | None, frames: Frames | None) -> None:
        config = self._config
        self._recognizer = open_recognizer(config, network=network, stopwatch=self._times.lap)
        maps = self._recognizer.map_set
        for excluded in maps.excluded:
            self._tell_excluded(excluded)
        self._checksums = maps.checksum_schedule()
        self._memory = WarmStart(config, self._recognizer)
        self._sampler = Sampler(config.sampling)
        self._follow(maps)
        self._own_camera: NewestFrame | None = None
        if frames is None:
            frames = self._own_camera = NewestFrame.configured(config.camera, self._clock_ns, CLOSE_S)
        self._camera: Frames = parts.enter_context(closing(frames))
        self._watch = LiveStatus(
            config,
            self._recognizer.model_name,
            self._recognizer,
            self._times,
            lambda: self._camera.health,
            self._autopilot,
            self._journal,
            self._clock_ns,
        )
        self._page = open_page(config.page, maps)
        if self._page is not None:
            parts.enter_context(closing(self._page))
        self._recorder: Recorder | None = None
        if config.recording.folder:
            folder = Path(config.recording.folder)
            recorder = Recorder(lambda: run_folder(folder), config.camera, config.recording.min_free_mb * 1e6)
            self._recorder = parts.enter_context(closing(recorder))
        self._frames_used = 0
        self._events = 0
        self._supervision = Supervision()

    def turn(self) -> bool:
        """One turn of the loop; False when the camera has come to its end (a feed or the simulator)."""
        self._autopilot.poll()
        frame = self._camera.take(TURN_S)
        if frame is not None and self.condition.see(frame, self._own_camera):
            distance_m = self._autopilot.vehicle.distance_m(frame.stamp_ns)
            if self._sampler.is_place(frame.stamp_ns, distance_m):
                self._use(frame, distance_m)
        else:
            self._check_maps(self._recognizer.matcher.search.folders_in_use)
        hang = self._own_camera.hang(self._clock_ns()) if self._own_camera else ""
        if self.condition.update(self._recognizer.state, self._camera.health, hang):
            self._forget()
        self._tell_position()
        if self._page is not None and self._page.wanted:
            health = self.condition.health
            self._page.show(self._watch.snapshot(health.state, health.why))
        self._tell_manager()
        return not self._camera.ended

    def _forget(self) -> None:
        """Nothing is told that rests on what was seen before a blindness."""
        self._recognizer.reset()
        self._tracker.forget()
        self._newest = None

    def _tell_manager(self) -> None:
        """This thread moves all but the camera: had it hung anywhere, it would not come here."""
        self._supervision.tell(self._autopilot.state != "closed", self.condition.hangs, self._clock_ns())

    def _use(self, frame: Frame, distance_m: float | None) -> None:
        self._times.start()
        began_ns = self._clock_ns()
        self._frames_used += 1
        missed = self._sampler.missed
        match = self._recognizer.observe(frame.image, frame.stamp_ns, self._near(), missed)
        if match is not None and match.accepted and not self._is_whole(match):
            match = None
        self._tracker.see(match, frame.stamp_ns, distance_m, missed)
        position = position_of(match, self._route, self._config.rig) if match is not None else None
        self._watch.note(frame, match, position)
        if self._recorder is not None:
            self._recorder.record(frame, self._autopilot.vehicle.position(began_ns), distance_m)
        if self._journal and self._config.telemetry.journal_frames:
            map_row = int(self._recognizer.map_set.places["row"][match.place_index]) if match is not None else None
            seen = observation(frame.index, frame.stamp_ns, match, position, map_row, missed)
            self._journal.write({"event": "frame", **msgspec.to_builtins(seen)})
        if match is not None and match.accepted:
            self._newest = match
            if match.event:
                self._events += 1
                self._tell_place(match, frame.stamp_ns, position)
        self._times.lap("telemetry")
        now_ns = self._clock_ns()
        self.condition.used((now_ns - began_ns) / 1e9)
        self._memory.keep_if_due(now_ns, self.condition.health.state, self._newest)

    def _near(self) -> Near | None:
        """Where the autopilot may be, None where it does not know or nobody knows how well."""
        position = self._autopilot.vehicle.position(self._clock_ns())
        sigma_m = self._autopilot.uncertainty_m
        if position is None or sigma_m is None:
            return None
        radius_m = max(self._config.map.search_radius_m, SURE_SIGMAS * sigma_m)
        return Near(position.lat_deg, position.lon_deg, radius_m)

    def _is_whole(self, match: PlaceMatch) -> bool:
        """Nothing is told of a map before every checksum of it holds; False if one had to be excluded."""
        behind = self._recognizer.map_set.folders_behind(match.place_index, self._config.sequence.length)
        while not self._checksums.is_verified(behind):
            if not self._check_maps(behind):
                return False
            self._tell_manager()
        return True

    def _check_maps(self, first: Sequence[Path]) -> bool:
        """Check a further piece of the maps, some of them first; False if one is damaged, and excluded from now on."""
        damage = self._checksums.step(CHECK_BYTES, first)
        if damage is None:
            return True
        maps = self._recognizer.map_set.without({damage.path: damage.why})
        self._tell_excluded(maps.excluded[-1])
        self._recognizer.use_maps(maps)
        self._follow(maps)
        if self._page is not None:
            self._page.show_map(map_view(maps))
        return False

    def _follow(self, maps: MapSet) -> None:
        """Follow the vehicle along the drives of these maps from now on."""
        config = self._config
        self._route = Route(maps)
        self._tracker = RouteTracker(self._route, config.tracking, config.rig, config.sequence.length)
        self._newest = None

    def _tell_excluded(self, excluded: ExcludedMap) -> None:
        excluded.log()
        self._record(MapExcluded(excluded.name, excluded.why))

    def _tell_place(self, match: PlaceMatch, stamp_ns: int, position: Position | None) -> None:
        """An event, for people and the journal: with the tracked position, or with the place's own."""
        tracked = self._tracker.at_exposure()
        if tracked is not None and tracked.stamp_ns == stamp_ns:
            fix = tracked_fix(match, tracked, self._recognizer.map_set)
        else:
            fix = place_fix(match, stamp_ns, position, self._config.rig)
        self._record(fix)
        self._autopilot.tell_place(fix)

    def _tell_position(self) -> None:
        """A fix for the autopilot, while the vehicle is on the map and if one is due."""
        moment = self._autopilot.position_wanted()
        if moment is None or self._newest is None or not self.condition.sees:
            return
        if moment == "exposure":
            tracked = self._tracker.at_exposure()
        else:
            now_ns = self._clock_ns()
            tracked = self._tracker.at(now_ns, self._autopilot.vehicle.distance_m(now_ns))
        if tracked is not None:
            self._autopilot.send_position(tracked_fix(self._newest, tracked, self._recognizer.map_set))

    def last_words(self) -> Stopped:
        """What was done, for the journal."""
        health = self._camera.health
        counts = {"delivered": health.delivered, "overwritten": health.overwritten, "bad": health.bad}
        stopped = Stopped(self._frames_used, self._events, self._times.medians_ms(), counts)
        self._record(stopped)
        self._memory.keep(self.condition.health.state, self._newest)
        return stopped


def run(config: Config, stop: threading.Event, opened: Callable[[], object] = lambda: None) -> Stopped:
    """Run until `stop` is set or the camera comes to its end; `opened` is called when all parts are open."""
    with ExitStack() as parts:
        daemon = Daemon(config, parts)
        opened()
        with daemon.condition.failures():
            while not stop.is_set() and daemon.turn():
                pass
        notify("STOPPING=1")
        return daemon.last_words()


def _run(args: argparse.Namespace) -> int:
    config = load_config(args.config)
    stop, opened = threading.Event(), threading.Event()

    def told_to_stop() -> None:
        stop.set()
        if not opened.is_set():
            raise SystemExit(0)  # opening a camera may take long, and nothing is to be saved yet

    with when_told_to_stop(told_to_stop), naming(args.config):
        stopped = run(config, stop, opened.set)
    log.info("stopped: %d frames used, %d events", stopped.frames_used, stopped.events)
    return 0
