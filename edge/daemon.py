"""`lookback run`: opens the parts that the config names and moves frames through them until told to stop.

newest camera frame -> is it a place? -> recognizer -> event -> journal, people
                                                    -> tracker -> position -> autopilot
"""

from __future__ import annotations

import argparse
import logging
import signal
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Protocol

import msgspec

from edge.camera import Frame, open_camera
from edge.camera.newest import CameraHealth, NewestFrame
from edge.config import Config, load_config
from edge.descriptor.network import Head, Network
from edge.live_status import LiveStatus, open_page
from edge.observation import observation
from edge.recognizer import PlaceMatch, PlaceRecognizer, State
from edge.reference_map.route import Route
from edge.reference_map.store import open_map
from edge.sampling import Sampler
from edge.service import notify
from edge.stage_times import StageTimes
from edge.telemetry import PlaceFix
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.journal import Journal
from edge.tracking import RouteTracker, TrackedPosition

TURN_S = 0.02  # at most this long between looks at the MAVLink port
log = logging.getLogger(__name__)


class StateChanged(msgspec.Struct, frozen=True, tag_field="event", tag="state"):
    """The recogniser's state, or the camera's, changed."""

    state: str
    why: str = ""


class Stopped(msgspec.Struct, frozen=True, tag_field="event", tag="stopped"):
    """The daemon's last words: what it did, and the median time of each stage in milliseconds."""

    frames_used: int
    events: int
    stages_ms: dict[str, float]
    camera: dict[str, int]


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
        self._times = StageTimes()
        network = network or Network.load(Path(config.descriptor.model) if config.descriptor.model else None)
        reference_map = open_map(Path(config.map.path))
        self._map_rows: list[int] = reference_map.places["row"].tolist()
        self._recognizer = PlaceRecognizer(network, Head.load(network), reference_map, config, self._times.lap)
        self._sampler = Sampler(config.sampling)
        self._record: Callable[[msgspec.Struct], object] = lambda record: None
        self._journal: Journal | None = None
        if config.telemetry.journal:
            self._journal = parts.enter_context(closing(Journal(Path(config.telemetry.journal))))
            self._record = self._journal.write
        self._autopilot = parts.enter_context(
            closing(AutopilotConnection(config.telemetry, clock_ns, self._record, config.gates))
        )
        self._tracker = RouteTracker(Route(reference_map), config.tracking, config.rig)
        self._newest: PlaceMatch | None = None
        self._clock_ns = clock_ns
        self._camera: Frames = parts.enter_context(
            closing(frames or NewestFrame(lambda: open_camera(config.camera), clock_ns=clock_ns))
        )
        self._watch = LiveStatus(
            config,
            reference_map,
            network.info.name,
            self._recognizer,
            self._times,
            lambda: self._camera.health,
            self._autopilot,
            self._journal,
            clock_ns,
        )
        self._page = open_page(config.page, reference_map)
        if self._page is not None:
            parts.enter_context(closing(self._page))
        self._state: State | str = ""
        self._why = ""
        self._frames_used = 0
        self._events = 0

    def turn(self) -> bool:
        """One turn of the loop; False when the camera has come to its end (a feed or the simulator)."""
        self._autopilot.poll()
        frame = self._camera.take(TURN_S)
        if frame is not None:
            distance_m = self._autopilot.vehicle.distance_m(frame.stamp_ns)
            if self._sampler.take(frame.stamp_ns, distance_m):
                self._use(frame, distance_m)
        self._tell_position()
        health = self._camera.health
        if health.state == "lost":
            self._tell_state("camera lost", health.reason)
        if self._page is not None and self._page.wanted:
            self._page.show(self._watch.snapshot(self._state, self._why))
        notify("WATCHDOG=1")
        return not self._camera.ended

    def _use(self, frame: Frame, distance_m: float | None) -> None:
        self._times.start()
        self._frames_used += 1
        match = self._recognizer.observe(frame.image, frame.stamp_ns)
        self._tell_state(self._recognizer.state)
        self._tracker.see(match, frame.stamp_ns, distance_m)
        self._watch.note(frame, match)
        if self._journal and self._config.telemetry.journal_frames:
            seen = observation(frame.index, frame.stamp_ns, match, self._map_rows)
            self._journal.write({"event": "frame", **msgspec.to_builtins(seen)})
        if match is not None and match.accepted:
            self._newest = match
            if match.event:
                self._events += 1
                self._tell_place(match, frame.stamp_ns)
        self._times.lap("telemetry")

    def _tell_place(self, match: PlaceMatch, stamp_ns: int) -> None:
        """An event, for people and the journal: with the tracked position, or with the place's own."""
        tracked = self._tracker.at_exposure()
        if tracked is not None and tracked.stamp_ns == stamp_ns:
            fix = _fix(match, tracked)
        else:
            rig = self._config.rig
            fix = PlaceFix(
                stamp_ns=stamp_ns,
                place=match.place,
                lat_deg=match.lat_deg,
                lon_deg=match.lon_deg,
                heading_deg=match.heading_deg,
                sigma_along_m=rig.sigma_along_m,
                sigma_across_m=rig.sigma_across_m,
                direction=match.direction,
                order=match.order,
                uniqueness=round(match.uniqueness, 4),
                category=match.category or "",
            )
        self._record(fix)
        self._autopilot.tell_place(fix)

    def _tell_position(self) -> None:
        """A fix for the autopilot, while the vehicle is on the map and if one is due."""
        moment = self._autopilot.position_wanted()
        if moment is None or self._newest is None:
            return
        if moment == "exposure":
            tracked = self._tracker.at_exposure()
        else:
            now_ns = self._clock_ns()
            tracked = self._tracker.at(now_ns, self._autopilot.vehicle.distance_m(now_ns))
        if tracked is not None:
            self._autopilot.send_position(_fix(self._newest, tracked))

    def _tell_state(self, state: str, why: str = "") -> None:
        if state == self._state:
            return
        self._state, self._why = state, why
        log.info("%s %s", state, why)
        self._record(StateChanged(state, why))
        notify(f"STATUS={state} {why}".rstrip())

    def last_words(self) -> Stopped:
        """What was done, for the journal."""
        health = self._camera.health
        counts = {"delivered": health.delivered, "overwritten": health.overwritten, "bad": health.bad}
        stopped = Stopped(self._frames_used, self._events, self._times.medians_ms(), counts)
        self._record(stopped)
        return stopped


def _fix(match: PlaceMatch, tracked: TrackedPosition) -> PlaceFix:
    """What is told of a tracked position; `match` is the newest that was accepted."""
    return PlaceFix(
        stamp_ns=tracked.stamp_ns,
        place=tracked.place,
        lat_deg=tracked.lat_deg,
        lon_deg=tracked.lon_deg,
        heading_deg=tracked.heading_deg,
        sigma_along_m=round(tracked.sigma_along_m, 2),
        sigma_across_m=tracked.sigma_across_m,
        direction=tracked.direction,
        order=match.order,
        uniqueness=round(match.uniqueness, 4),
        category=match.category or "",
        matches=tracked.matches,
    )


def run(config: Config, stop: threading.Event) -> Stopped:
    """Run until `stop` is set or the camera comes to its end."""
    with ExitStack() as parts:
        daemon = Daemon(config, parts)
        notify("READY=1")
        while not stop.is_set() and daemon.turn():
            pass
        notify("STOPPING=1")
        return daemon.last_words()


def _run(args: argparse.Namespace) -> int:
    config = load_config(args.config)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    stopped = run(config, stop)
    log.info("stopped: %d frames used, %d events", stopped.frames_used, stopped.events)
    return 0
