"""One drive of the daemon beside a simulated autopilot, which are joined by a pseudo-terminal.

`lookback run` is a process of its own, as on a vehicle, and its camera renders the scenario. `sim.trial.run`
has drives in simulated time.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
import tomli_w

from edge.config import CameraConfig, Config
from edge.errors import LookbackError
from sim.vehicle.autopilot import EXTERNAL_POSITION_ESTIMATE, SimulatedAutopilot
from sim.vehicle.estimator import AS_FLOWN
from sim.vehicle.protection import availability, protection_levels
from sim.vehicle.pty_link import PtyLink, open_pty
from sim.world.drive import Drive
from sim.world.scenario import Scenario

GPS_S, CAMERA_FPS = 6.0, 25.0
JOURNAL, LOG = "journal.jsonl", "daemon.log"
START_S = 7.0  # for the daemon to load its model and the camera to build its world
LATE_S = 60.0  # after the drive, at most, the daemon ends


@dataclass(frozen=True)
class ReceivedFix:
    """A position estimate as it arrived at the autopilot.

    time_s, route_m: of the exposure, in seconds and meters of the drive. error_m: distance of the fix from where the
    vehicle then was. age_s: from exposure to arrival. believed_error_m: the autopilot's own error before it came.
    """

    time_s: float
    route_m: float
    error_m: float
    age_s: float
    believed_error_m: float


@dataclass
class DaemonDrive:
    """A drive under way, or over. epoch_s: when the vehicle sets off, on the clock of the autopilot."""

    name: str
    scenario: Scenario
    drive: Drive
    epoch_s: float
    folder: Path
    autopilot: SimulatedAutopilot
    process: subprocess.Popen[bytes] | None = None
    fixes: list[ReceivedFix] = field(default_factory=list)
    _read: int = 0

    @property
    def journal(self) -> Path:
        """The daemon's journal."""
        return self.folder / JOURNAL

    @property
    def is_running(self) -> bool:
        """Whether the daemon's process has not ended yet."""
        return self.process is not None and self.process.poll() is None

    def new_fixes(self) -> list[ReceivedFix]:
        """Position estimates that have arrived since the last call; `fixes` has all."""
        received, self._read = self.autopilot.received[self._read :], len(self.autopilot.received)
        new = []
        for item in received:
            command = item.message
            if command.get_type() == "COMMAND_INT" and command.command == EXTERNAL_POSITION_ESTIMATE:
                age_s = item.time_s - self.autopilot.booted_s - command.param1 + command.param2
                new.append(self._judge(item.time_s - age_s, command.x / 1e7, command.y / 1e7, age_s))
        self.fixes += new
        return new

    @property
    def available(self) -> float:
        """Share of the drive without GPS in which a position had protection levels below 15 m."""
        levels = protection_levels(self.autopilot.received)
        levels[:, 0] -= self.epoch_s
        return availability(levels, np.arange(GPS_S, self.drive.duration_s, 0.1))

    def _judge(self, exposure_s: float, lat_deg: float, lon_deg: float, age_s: float) -> ReceivedFix:
        time_s = exposure_s - self.epoch_s
        resets = [reset for reset in self.autopilot.resets if reset.time_s >= exposure_s]
        return ReceivedFix(
            time_s=time_s,
            route_m=self.drive.route_m(time_s),
            error_m=self.drive.error_m(time_s, lat_deg, lon_deg),
            age_s=age_s,
            believed_error_m=resets[0].error_before_m if resets else float("nan"),
        )

    def wait_for_end(self) -> None:
        """Block until the daemon ends; LookbackError with its last line unless it ends in time and with exit code 0."""
        assert self.process is not None
        log = self.folder / LOG
        end_s = self.epoch_s + self.drive.duration_s + LATE_S
        try:
            code = self.process.wait(max(0.0, end_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            raise LookbackError(f"{self.name}: the daemon does not end (see {log})") from None
        if code != 0:
            last = log.read_text(encoding="utf-8").strip().splitlines()[-1:]
            raise LookbackError(f"{self.name}: the daemon ended with {code}: {''.join(last)} (see {log})")


@contextmanager
def start_daemon_drive(name: str, scenario: Scenario, folder: Path, settings: Config) -> Iterator[DaemonDrive]:
    """A drive in real time, which sets off START_S from now; leaving the context stops both processes.

    GPS fails after GPS_S. settings: the daemon's, but for the camera, the connection and the journal. `folder` gets the
    daemon's config, log and journal, and the scenario that its camera renders.
    """
    epoch_ns = time.monotonic_ns() + round(START_S * 1e9)
    scenario = msgspec.structs.replace(scenario, epoch_ns=epoch_ns)
    drive, epoch_s = scenario.drive(), epoch_ns / 1e9
    folder.mkdir(parents=True, exist_ok=True)
    stop = threading.Event()
    with closing(open_pty()) as link:
        autopilot = SimulatedAutopilot(
            link, lambda now_s: drive.pose(now_s - epoch_s), gps_fails_s=epoch_s + GPS_S, errors=AS_FLOWN
        )
        config = _write_config(folder, scenario, connected(settings, link, folder))
        thread = threading.Thread(target=autopilot.run, args=(stop,), name=f"autopilot {name}")
        with (folder / LOG).open("wb") as log:
            process = subprocess.Popen([sys.executable, "-m", "edge", "run", str(config)], stderr=log)
        thread.start()
        try:
            yield DaemonDrive(name, scenario, drive, epoch_s, folder, autopilot, process)
        finally:
            _end(process)
            stop.set()
            thread.join()


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def connected(settings: Config, link: PtyLink, folder: Path) -> Config:
    """The settings with the pseudo-terminal as connection and the journal in `folder`, its paths absolute."""
    telemetry = msgspec.structs.replace(
        settings.telemetry,
        connection=f"serial:{link.device}:921600",
        journal=str((folder / JOURNAL).resolve()),
    )
    map_config = msgspec.structs.replace(settings.map, path=str(Path(settings.map.path).resolve()))
    return msgspec.structs.replace(settings, telemetry=telemetry, map=map_config)


def _write_config(folder: Path, scenario: Scenario, settings: Config) -> Path:
    """The scenario for the camera, and the daemon's config; the same file a vehicle would have."""
    device = folder / "scenario.toml"
    device.write_text(tomli_w.dumps(msgspec.structs.asdict(scenario)), encoding="utf-8")
    camera = CameraConfig(
        kind="sim",
        device=str(device.resolve()),
        view=scenario.view,
        width=scenario.width,
        height=scenario.height,
        fps=CAMERA_FPS,
    )
    path = folder / "lookback.toml"
    config = msgspec.to_builtins(msgspec.structs.replace(settings, camera=camera))
    path.write_text(tomli_w.dumps(config), encoding="utf-8")
    return path
