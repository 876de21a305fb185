"""An hour of drives as a vehicle has them: a process of its own, two cameras at ten pictures a second, an autopilot.

There and back along one road, again and again: with GPS and mapping for a third of the time, without both after it. The
page is read each second; the journal with its frames and the list of the drive are written.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from msgspec import structs

from edge.config import DescriptorConfig, SamplingConfig
from edge.feed import read_feed
from edge.journal.records import FixSent, FrameUsed, PlaceFix
from sim.journal import records_of
from sim.maps.command import build_map
from sim.trial.run import RIG
from sim.world.recording import record_drive
from sim.world.scenario import Scenario, View
from tests.udp_port import free_port

pytestmark = pytest.mark.soak

FPS = 10.0
HOUR_S = int(os.environ.get("LOOKBACK_HOUR_S", "3600"))
"""Less to try the test itself."""
LENGTH_M = 500.0
GROWN_BYTES = 2_000_000
"""Of anonymous memory from the middle to the end; a leak of one picture a minute is 7 MB."""


def there_and_back(folder: Path, view: View) -> Path:
    """A feed of an hour: the road there, and back, over and over, as it looks at dusk."""
    feed, rows, laps = folder / f"hour_{view}", [], []
    for direction in ("forward", "reverse"):
        one = folder / f"{direction}_{view}"
        record_drive(Scenario(seed=31, length_m=LENGTH_M, direction=direction, light="dusk", view=view), one, fps=FPS)
        (folder / feed.name / direction).parent.mkdir(exist_ok=True)
        (one / "frames").rename(feed / direction)
        _, *lines = (one / "frames.csv").read_text().splitlines()
        # Only pictures and positions: the distance would begin anew with each drive.
        laps += [
            [direction + cells[0].removeprefix("frames"), *cells[2:5]] for cells in (line.split(",") for line in lines)
        ]
    (feed / "feed.toml").write_text((one / "feed.toml").read_text())
    for number in range(int((HOUR_S + 600) * FPS)):
        file, *at = laps[number % len(laps)]
        rows.append(",".join([file, str(round(number * 1e9 / FPS)), *at]))
    (feed / "frames.csv").write_text("\n".join(["file,stamp_ns,lat_deg,lon_deg,alt_m", *rows, ""]))
    return feed


def anonymous_bytes(pid: int) -> int:
    """Resident memory that is no file's: mapped maps are read as they are needed."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("RssAnon:"))


def test_an_hour_of_drives(
    start: Callable[..., Any], proc: Any, tmp_path: Path, figures: Callable[[str], None]
) -> None:
    front, rear = (there_and_back(tmp_path, view) for view in ("front", "rear"))
    by_day = tmp_path / "by_day"
    record_drive(Scenario(seed=31, length_m=LENGTH_M, view="rear"), by_day)
    build_map([read_feed(by_day)], tmp_path / "maps" / "day", DescriptorConfig(model="grid"), SamplingConfig())
    link, page = free_port(), free_port(socket.SOCK_STREAM)
    settings = {
        "camera": {"kind": "feed", "device": str(front), "fov_deg": Scenario().fov_deg},
        "map": {"path": "maps"},
        "rig": structs.asdict(RIG),
        "motion": {"use": "report"},
        "mapping": {"folder": "maps", "camera": {"kind": "feed", "view": "rear", "device": str(rear)}},
        "telemetry": {
            "connection": f"udpin:127.0.0.1:{link}",
            "emit": "auto",
            "journal": "events.jsonl",
            "journal_frames": True,
            "drive": "hour.drive",
        },
        "page": {"port": page},
    }
    config = tmp_path / "lookback.toml"
    config.write_text(tomli_w.dumps(settings))
    process = start(config)
    command = [sys.executable, "-m", "edge", "dev", "sim", "autopilot", "--udp", f"127.0.0.1:{link}"]
    vehicle = subprocess.Popen(
        [*command, "--follow", str(front), "--gps-lost-after", str(HOUR_S / 3)], stdout=subprocess.DEVNULL
    )
    try:
        process.wait_for_word("READY=1")
        began_s, said, busy, rows = time.monotonic(), 0, 0, []
        while (now_s := time.monotonic() - began_s) < HOUR_S:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{page}/status.json", timeout=60) as answer:
                    answer.read()
            except urllib.error.HTTPError as error:  # 503: no turn of the daemon ended in time on a busy machine
                assert error.code == 503, error
                busy += 1
            while process.word(0.001) is not None:
                said += 1
            assert process.popen.poll() is None, process.told()
            pid = process.popen.pid
            threads = len(list(Path(f"/proc/{pid}/task").iterdir()))
            rows.append((now_s, proc.resident_bytes(pid), anonymous_bytes(pid), proc.open_descriptors(pid), threads))
            time.sleep(1.0)
        code, _ = process.end()
    finally:
        vehicle.terminate()
        vehicle.wait()
    numbers = np.array(rows)
    # A minute each: after the first tenth, around the middle, and at the end.
    parts = [numbers[np.abs(numbers[:, 0] - at_s) <= HOUR_S / 60] for at_s in np.array([0.1, 0.5, 0.98]) * HOUR_S]
    medians = np.array([np.median(part, axis=0) for part in parts])
    scaled = medians[:, 1:] / [1e6, 1e6, 1, 1]
    journal = tmp_path / "events.jsonl"
    counts = [len(list(records_of(journal, kind))) for kind in (FrameUsed, PlaceFix, FixSent)]
    told = [", ".join(f"{one:.0f}" for one in each) for each in scaled.T]
    figures(
        f"{HOUR_S} s, {said} words to the service manager, the page answered {len(rows) - busy} of {len(rows)} times:"
        f" {counts[0]} frames used, {counts[1]} places, {counts[2]} positions; at a tenth, half and all of it RSS"
        f" {told[0]} MB, of which no file's {told[1]} MB; descriptors {told[2]}; threads {told[3]}"
    )
    assert code == 0, process.told()
    assert "Traceback" not in process.told()
    assert counts[1] > HOUR_S / 10
    assert medians[2, 2] - medians[1, 2] < GROWN_BYTES
    assert medians[2, 3] <= medians[1, 3]
    assert medians[2, 4] <= medians[1, 4]
