"""One run in real time: `lookback run` as its own process at the other end of a pty, the drive home as its camera."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import msgspec
import numpy as np
import tomli_w

from edge.config import Config
from edge.errors import LookbackError
from edge.journal.journal import read_journal
from sim.trial.course import CAMERA_FPS, JOURNAL, Course, World
from sim.trial.run import Rules, seeded_autopilot, trial_config
from sim.trial.score import RunScore, judge
from sim.vehicle.pty_link import open_pty
from sim.world.scenario import Scenario

START_S = 8.0  # for the daemon to load its model
LATE_S = 60.0


def drive_home_live(world: World, course: Course, seed: int, folder: Path, rules: Rules) -> RunScore:
    """As `drive_home`, but with a clock on the wall. LookbackError when the daemon does not end as it should."""
    epoch_ns = time.monotonic_ns() + round(START_S * 1e9)
    scenario = msgspec.structs.replace(world.home, epoch_ns=epoch_ns, feed=str(world.feed.path.resolve()))
    drive, epoch_s = scenario.drive(), epoch_ns / 1e9
    journal = folder / JOURNAL
    stop = threading.Event()
    with closing(open_pty()) as link:
        rng = np.random.default_rng([seed, 8])
        autopilot, origin = seeded_autopilot(link, drive, epoch_s, time.monotonic_ns, rng, rules)
        settings = trial_config(world, course, link, journal.resolve(), rules.emit, origin)
        config = _write_config(settings, world, scenario, folder)
        flying = threading.Thread(target=autopilot.run, args=(stop,), name="autopilot")
        with (folder / "daemon.log").open("wb") as log:
            process = subprocess.Popen([sys.executable, "-m", "edge", "run", str(config)], stderr=log)
        flying.start()
        try:
            code = process.wait(START_S + drive.duration_s + LATE_S)
        except subprocess.TimeoutExpired:
            raise LookbackError(f"seed {seed}: the daemon does not end (see {folder / 'daemon.log'})") from None
        finally:
            process.kill()
            process.wait()
            stop.set()
            flying.join()
    if code:
        raise LookbackError(f"seed {seed}: the daemon ended with {code} (see {folder / 'daemon.log'})")
    return judge(seed, world, epoch_s, course, autopilot, list(read_journal(journal)))


def _write_config(settings: Config, world: World, scenario: Scenario, folder: Path) -> Path:
    """The same settings as in simulated time, as a file; the camera is the simulator."""
    device = folder / "scenario.toml"
    device.write_text(tomli_w.dumps(msgspec.structs.asdict(scenario)), encoding="utf-8")
    camera = {"kind": "sim", "device": str(device.resolve()), "view": world.home.view, "fps": CAMERA_FPS}
    size = {"width": world.home.width, "height": world.home.height}
    written = {**msgspec.to_builtins(settings), "camera": {**camera, **size}}
    written["map"]["path"] = str(Path(settings.map.path).resolve())
    path = folder / "lookback.toml"
    path.write_text(tomli_w.dumps(written), encoding="utf-8")
    return path
