"""One live drive: `lookback run` as its own process, and the simulated autopilot at the other end of a pty."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import pymap3d
import tomli_w

from edge.config import RigConfig
from edge.errors import LookbackError
from edge.journal.frame_record import Observation
from edge.journal.journal import read_journal
from sim import ORIGIN_ALT_M
from sim.vehicle.autopilot import EXTERNAL_POSITION_ESTIMATE, SimulatedAutopilot
from sim.vehicle.pty_link import PtyLink, open_pty
from sim.world.drive import Drive
from sim.world.scenario import Scenario

WITH_GPS_S = 6.0  # of each drive, before the receiver fails: so does the autopilot know where it began
START_S = 6.0  # for the daemon to load its model and the camera to build its world
CAMERA_FPS = 25.0
DRIFT_PERCENT = 3.0


@dataclass(frozen=True)
class ReceivedFix:
    """A position estimate as it arrived at the autopilot.

    time_s, route_m: of the exposure, in seconds and metres of the drive. error_m: distance of the fix from where the
    vehicle then was. age_s: from exposure to arrival. believed_error_m: the autopilot's own error before it came.
    """

    time_s: float
    route_m: float
    error_m: float
    age_s: float
    believed_error_m: float


@dataclass
class LiveDrive:
    """A drive under way, and in the end what the daemon's journal tells of it."""

    name: str
    scenario: Scenario
    drive: Drive
    journal: Path
    epoch_s: float
    autopilot: SimulatedAutopilot
    process: subprocess.Popen[bytes]
    page: str = ""
    fixes: list[ReceivedFix] = field(default_factory=list)
    _heard: int = 0

    def new_fixes(self) -> list[ReceivedFix]:
        """Position estimates that have arrived since the last call."""
        received, self._heard = self.autopilot.received[self._heard :], len(self.autopilot.received)
        new = []
        for item in received:
            command = item.message
            if command.get_type() == "COMMAND_INT" and command.command == EXTERNAL_POSITION_ESTIMATE:
                boot_now_s = self.autopilot.boot_s + item.time_s - time.monotonic_ns() / 1e9
                age_s = boot_now_s - command.param1 + command.param2
                new.append(self._judge(item.time_s - age_s, command.x / 1e7, command.y / 1e7, age_s))
        self.fixes += new
        return new

    def _judge(self, exposure_s: float, lat_deg: float, lon_deg: float, age_s: float) -> ReceivedFix:
        time_s = exposure_s - self.epoch_s
        resets = [reset for reset in self.autopilot.resets if reset.time_s >= exposure_s]
        return ReceivedFix(
            time_s=time_s,
            route_m=self.drive.route_m(time_s),
            error_m=error_m(self.drive, time_s, lat_deg, lon_deg),
            age_s=age_s,
            believed_error_m=resets[0].error_before_m if resets else float("nan"),
        )

    def frames(self) -> list[Observation]:
        """Every frame that the daemon used, from its journal."""
        return [
            msgspec.convert(
                {key: value for key, value in record.items() if key not in ("event", "unix_s")}, Observation
            )
            for record in read_journal(self.journal)
            if record["event"] == "frame"
        ]

    def stages_ms(self) -> dict[str, float]:
        """Median time of each stage, from the daemon's last words."""
        return next(dict(record["stages_ms"]) for record in read_journal(self.journal) if record["event"] == "stopped")


def error_m(drive: Drive, time_s: float, lat_deg: float, lon_deg: float) -> float:
    """Distance of a position from where the vehicle was at `time_s` of its drive."""
    true_lat_deg, true_lon_deg = drive.pose(time_s).geodetic()
    east_m, north_m, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, ORIGIN_ALT_M, true_lat_deg, true_lon_deg, ORIGIN_ALT_M)
    return float((east_m**2 + north_m**2) ** 0.5)


@contextmanager
def start_drive(
    name: str, scenario: Scenario, folder: Path, map_path: Path, rig: RigConfig, page_port: int = 0
) -> Iterator[LiveDrive]:
    """Start daemon and autopilot; leaving the context stops both. It sets off START_S from now; soon GPS fails.

    page_port: of the daemon's live page, 0 for none.
    """
    epoch_ns = time.monotonic_ns() + round(START_S * 1e9)
    scenario = msgspec.structs.replace(scenario, epoch_ns=epoch_ns)
    drive = scenario.drive()
    folder.mkdir(parents=True)
    journal = folder / "journal.jsonl"
    link = open_pty()
    config = _write_config(folder, scenario, map_path, rig, link, journal, page_port)
    epoch_s = epoch_ns / 1e9
    autopilot = SimulatedAutopilot(
        link, lambda now_s: drive.pose(now_s - epoch_s), gps_fails_s=epoch_s + WITH_GPS_S, drift_percent=DRIFT_PERCENT
    )
    stop = threading.Event()
    flying = threading.Thread(target=autopilot.run, args=(stop,), name=f"autopilot {name}")
    with (folder / "daemon.log").open("wb") as log:
        process = subprocess.Popen([sys.executable, "-m", "edge", "run", str(config)], stderr=log)
        flying.start()
        try:
            page = f"http://127.0.0.1:{page_port}/"
            yield LiveDrive(name, scenario, drive, journal, epoch_s, autopilot, process, page)
        finally:
            process.terminate()
            process.wait(10)
            stop.set()
            flying.join()
            link.close()


def check_ended_well(live: LiveDrive) -> None:
    """LookbackError with the daemon's last line when it did not end by itself with exit code 0."""
    if live.process.wait(30) != 0:
        log = live.journal.with_name("daemon.log")
        last = log.read_text(encoding="utf-8").strip().splitlines()[-1:]
        raise LookbackError(
            f"{live.name}: the daemon ended with {live.process.returncode}: {''.join(last)} (see {log})"
        )


def _write_config(
    folder: Path, scenario: Scenario, map_path: Path, rig: RigConfig, link: PtyLink, journal: Path, page_port: int
) -> Path:
    """The scenario for the camera, and the daemon's config; the same file a vehicle would have."""
    world = folder / "scenario.toml"
    world.write_text(tomli_w.dumps(msgspec.structs.asdict(scenario)), encoding="utf-8")
    config = {
        "camera": {
            "kind": "sim",
            "device": str(world.resolve()),
            "view": scenario.view,
            "width": scenario.width,
            "height": scenario.height,
            "fps": CAMERA_FPS,
        },
        "map": {"path": str(map_path.resolve())},
        "page": {"port": page_port},
        "rig": msgspec.structs.asdict(rig),
        "telemetry": {
            "connection": f"serial:{link.device}:921600",
            "emit": "external_position",
            "journal": str(journal.resolve()),
            "journal_frames": True,
        },
    }
    path = folder / "lookback.toml"
    path.write_text(tomli_w.dumps(config), encoding="utf-8")
    return path
