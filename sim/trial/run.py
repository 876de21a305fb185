"""One run in simulated time: the daemon and the autopilot take turns on the two ends of a pty."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pymap3d

from edge.camera import Frame
from edge.camera.newest import CameraHealth
from edge.config import CameraConfig, Config, DescriptorConfig, MapConfig, PageConfig, RigConfig, TelemetryConfig
from edge.daemon import Daemon
from edge.feed import Feed, FeedImages
from edge.journal.journal import read_journal
from sim import ORIGIN_ALT_M
from sim.trial.course import CAMERA_FPS, JOURNAL, Course, RememberingNetwork, World
from sim.trial.score import RunScore, judge
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import PtyLink, open_pty
from sim.world.drive import Drive

Origin = tuple[float, float, float]
STEP_NS = 10_000_000
DRIFT_PERCENT = 3.0
WITH_GPS_S = 8.0
"""Of every drive, before the receiver fails: so does the autopilot know where it begins."""
LONGEST_LATENCY_S = 0.25
HOLES, LONGEST_HOLE_S = 20, 1.5
"""Times on each drive at which no picture comes for a while, as on a computer that is busy with something else."""
START_OFF_M = 20.0
"""Standard deviation of where an origin is set, east and north of where the vehicle starts, if it has no GPS at all."""


@dataclass(frozen=True)
class Rules:
    """What all runs of a trial share: the firmware, [telemetry] emit, and whether there is GPS at the start."""

    firmware: str = "ardupilot"
    emit: str = "auto"
    gps_at_start: bool = True


@dataclass
class SimulatedClock:
    """Nanoseconds that only the trial moves."""

    now_ns: int = 1_000_000_000_000

    def __call__(self) -> int:
        """The time."""
        return self.now_ns


class PlayedFrames:
    """A feed as a camera whose pictures arrive some time after their exposure, or not; taking one moves all time on."""

    def __init__(
        self, feed: Feed, clock: SimulatedClock, autopilot: SimulatedAutopilot, rng: np.random.Generator
    ) -> None:
        self._images = FeedImages(feed)
        self._feed = feed
        self._clock = clock
        self._autopilot = autopilot
        self._epoch_ns = clock.now_ns
        self._latencies_ns = (rng.uniform(0.03, LONGEST_LATENCY_S, len(feed.rows)) * 1e9).astype(int).tolist()
        lost = np.zeros(len(feed.rows), dtype=bool)
        for at in rng.integers(len(feed.rows), size=HOLES):
            lost[at : at + round(rng.uniform(0.0, LONGEST_HOLE_S) * CAMERA_FPS)] = True
        self._rows = np.flatnonzero(~lost).tolist()
        self._next = 0

    @property
    def health(self) -> CameraHealth:
        """See NewestFrame."""
        return CameraHealth("running", "", self._epoch_ns, delivered=self._next)

    @property
    def ended(self) -> bool:
        """See NewestFrame."""
        return self._next >= len(self._rows)

    def take(self, timeout_s: float) -> Frame | None:
        """Let `timeout_s` pass, for the autopilot as well; the frame that has arrived meanwhile."""
        for _ in range(round(timeout_s * 1e9) // STEP_NS):
            self._clock.now_ns += STEP_NS
            self._autopilot.step()
        if self.ended:
            return None
        row = self._rows[self._next]
        stamp_ns = self._epoch_ns + self._feed.rows[row].stamp_ns
        if stamp_ns + self._latencies_ns[row] > self._clock.now_ns:
            return None
        self._next += 1
        return Frame(self._images.read(row), stamp_ns, row)

    def close(self) -> None:
        """See NewestFrame."""
        self._images.close()


def drive_home(
    world: World, course: Course, seed: int, network: RememberingNetwork, folder: Path, rules: Rules
) -> RunScore:
    """The drive home of one run; its journal stays in `folder`."""
    rng = np.random.default_rng([seed, 8])
    clock, drive = SimulatedClock(), world.home.drive()
    epoch_s = clock.now_ns / 1e9
    journal = folder / JOURNAL
    with ExitStack() as parts:
        link = parts.enter_context(closing(open_pty()))
        autopilot, origin = seeded_autopilot(link, drive, epoch_s, clock, rng, rules)
        frames = PlayedFrames(world.feed, clock, autopilot, rng)
        config = trial_config(world, course, link, journal, rules.emit, origin)
        daemon = Daemon(config, parts, clock, frames=frames, network=network)
        while daemon.turn():
            pass
        daemon.last_words()
    return judge(seed, world, epoch_s, course, autopilot, list(read_journal(journal)))


def seeded_autopilot(
    link: PtyLink, drive: Drive, epoch_s: float, clock_ns: Callable[[], int], rng: np.random.Generator, rules: Rules
) -> tuple[SimulatedAutopilot, Origin | None]:
    """Odometry that is wrong by DRIFT_PERCENT of the distance, in a direction of the run's own.

    Where it has no GPS at all, it knows no origin either: the second is the one to set, about where it starts.
    """
    direction_rad = rng.uniform(-np.pi, np.pi)
    autopilot = SimulatedAutopilot(
        link,
        lambda now_s: drive.pose(now_s - epoch_s),
        clock_ns,
        firmware=rules.firmware,
        gps=rules.gps_at_start,
        gps_fails_s=epoch_s + WITH_GPS_S,
        has_origin=rules.gps_at_start,
        drift_percent=DRIFT_PERCENT * float(np.cos(direction_rad)),
        drift_sideways_percent=DRIFT_PERCENT * float(np.sin(direction_rad)),
    )
    if rules.gps_at_start:
        return autopilot, None
    lat_deg, lon_deg = drive.pose(0.0).geodetic()
    east_m, north_m = rng.normal(0.0, START_OFF_M, 2)
    lat_deg, lon_deg, alt_m = pymap3d.enu2geodetic(east_m, north_m, 0.0, lat_deg, lon_deg, ORIGIN_ALT_M)
    return autopilot, (float(lat_deg), float(lon_deg), float(alt_m))


def trial_config(
    world: World, course: Course, link: PtyLink, journal: Path, emit: str, origin: Origin | None
) -> Config:
    """The defaults, but for what this vehicle is: where it drives home is two half lanes from where it drove out.

    Each run starts with nothing kept from the last.
    """
    return Config(
        descriptor=DescriptorConfig(keep_statistics_min=0.0),
        camera=CameraConfig(kind="feed", device=str(world.feed.path), view="front"),
        map=MapConfig(path=str(course.map_path)),
        page=PageConfig(port=0),
        rig=RigConfig(left_reverse_m=2 * world.home.lane_m),
        telemetry=TelemetryConfig(
            connection=f"serial:{link.device}:921600",
            emit=emit,  # type: ignore[arg-type]  # the command has checked it
            origin=origin or (),
            journal=str(journal),
        ),
    )
