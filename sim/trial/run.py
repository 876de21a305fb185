"""One run of a trial: the settings of its daemon, its seeded autopilot, and the drive home in one of the two times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pymap3d

from edge.config import Config, DescriptorConfig, MapConfig, PageConfig, RigConfig, TelemetryConfig
from edge.descriptor.network import Network
from edge.journal.journal import read_journal
from sim import ORIGIN_ALT_M
from sim.trial.course import CAMERA_FPS, Course, World
from sim.trial.score import RunScore, judge
from sim.vehicle.daemon_drive import JOURNAL, AutopilotSetup, DaemonDrive, simulate_daemon_drive, start_daemon_drive
from sim.world.drive import Drive

Origin = tuple[float, float, float]
DRIFT_PERCENT = 3.0
GPS_S = 8.0
"""Of every drive, before the receiver fails: so the autopilot knows where it begins."""
START_OFF_M = 20.0
"""Standard deviation of where an origin is set, east and north of where the vehicle starts, if it has no GPS at all."""


@dataclass(frozen=True)
class Rules:
    """What all runs of a trial share: the firmware, [telemetry] emit, and whether there is GPS at the start."""

    firmware: str = "ardupilot"
    emit: str = "auto"
    gps_at_start: bool = True


def drive_home(world: World, course: Course, seed: int, network: Network, folder: Path, rules: Rules) -> RunScore:
    """The drive home of one run in simulated time; its journal stays in `folder`."""
    rng = np.random.default_rng([seed, 8])
    setup, origin = seeded_setup(world.home.drive(), rng, rules)
    settings = trial_settings(world, course, rules, origin)
    run = simulate_daemon_drive(f"seed {seed}", world.home, world.feed, folder, settings, setup, network, rng)
    return _judged(run, seed, course)


def drive_home_live(world: World, course: Course, seed: int, folder: Path, rules: Rules) -> RunScore:
    """As `drive_home`, in real time. LookbackError when the daemon does not end as it should."""
    scenario = msgspec.structs.replace(world.home, feed=str(world.feed.path.resolve()))
    setup, origin = seeded_setup(world.home.drive(), np.random.default_rng([seed, 8]), rules)
    settings = trial_settings(world, course, rules, origin)
    with start_daemon_drive(f"seed {seed}", scenario, folder, settings, setup, CAMERA_FPS) as run:
        run.wait_for_end()
    return _judged(run, seed, course)


def _judged(run: DaemonDrive, seed: int, course: Course) -> RunScore:
    return judge(seed, run, course.planted, list(read_journal(run.folder / JOURNAL)))


def seeded_setup(drive: Drive, rng: np.random.Generator, rules: Rules) -> tuple[AutopilotSetup, Origin | None]:
    """Odometry that is wrong by DRIFT_PERCENT of the distance, in a direction of the run's own.

    Where it has no GPS at all, it has no origin either: the second is the one to set, about where it starts.
    """
    direction_rad = rng.uniform(-np.pi, np.pi)
    setup = AutopilotSetup(
        rules.firmware,
        rules.gps_at_start,
        GPS_S,
        DRIFT_PERCENT * float(np.cos(direction_rad)),
        DRIFT_PERCENT * float(np.sin(direction_rad)),
    )
    if rules.gps_at_start:
        return setup, None
    lat_deg, lon_deg = drive.pose(0.0).geodetic()
    east_m, north_m = rng.normal(0.0, START_OFF_M, 2)
    lat_deg, lon_deg, alt_m = pymap3d.enu2geodetic(east_m, north_m, 0.0, lat_deg, lon_deg, ORIGIN_ALT_M)
    return setup, (float(lat_deg), float(lon_deg), float(alt_m))


def trial_settings(world: World, course: Course, rules: Rules, origin: Origin | None) -> Config:
    """The defaults, but for what this vehicle is: it drives home two half lanes beside where it drove out.

    Each run starts with nothing kept from the last.
    """
    return Config(
        descriptor=DescriptorConfig(keep_statistics_min=0.0),
        map=MapConfig(path=str(course.map_path)),
        page=PageConfig(port=0),
        rig=RigConfig(left_reverse_m=2 * world.home.lane_m),
        telemetry=TelemetryConfig(
            emit=rules.emit,  # type: ignore[arg-type]  # the command has checked it
            origin=origin or (),
        ),
    )
