"""What the daemon occupies: `lookback run` as its own process, watched from outside until its recording ends."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import tomli_w

from edge.errors import FeedError
from edge.feed import FeedHeader, FeedWriter
from edge.journal.records import Stopped
from edge.reference_map.store import ModelKey
from sim.bench.frames import smooth_picture
from sim.bench.simulated_map import write_simulated_map
from sim.journal import records_of
from sim.research.bench.rows import Row, Section, Target

SIZE_PX = (640, 480)
PERIOD_MS = 50
LIMIT_MB, FLAT_MB = 350, 8
WARM_FRAMES = 60
SAMPLE_S = 0.05
JOURNAL = "memory.jsonl"


@dataclass(frozen=True)
class Resident:
    """One look at a process, in MB: all that is resident, and the part that is pages of files."""

    total: float
    files: float


def measure(folder: Path, places: int, frames: int, model: ModelKey) -> Section:
    """Peak and steady memory with regions on, on a simulated map."""
    write_simulated_map(folder / "memory.map", places, model)
    write_pictures(folder / "memory_feed", WARM_FRAMES + frames, PERIOD_MS)
    looks = watch(start_daemon(folder, folder / "memory_feed", folder / "memory.map", PERIOD_MS))
    steady = looks[round(len(looks) * WARM_FRAMES / (WARM_FRAMES + frames)) :]
    third = max(1, len(steady) // 3)
    peak = max(look.total for look in looks)
    median = statistics.median(look.total for look in steady)
    files = statistics.median(look.files for look in steady)
    early, late = (statistics.median(look.total for look in part) for part in (steady[:third], steady[-third:]))
    rows = [
        Row(f"peak: {peak:.0f} MB", note=f"{_used(folder)} frames of {SIZE_PX[0]}x{SIZE_PX[1]} used"),
        Row(f"steady: {median:.0f} MB", note=f"{files:.0f} MB of it pages of files: the map, and libraries"),
        Row(f"last third of the run against the first: {late - early:+.1f} MB"),
    ]
    value = f"{peak:.0f} MB at most, {late - early:+.1f} MB over the run"
    met = peak <= LIMIT_MB and late - early <= FLAT_MB
    target = Target(f"memory of `lookback run`, {places:,} places, regions on", "350 MB or less, and flat", value, met)
    return Section(f"Memory of `lookback run`, {places:,} places", rows, [target])


def write_pictures(path: Path, frames: int, period_ms: int) -> None:
    """A feed of pictures that all differ, so that each is used."""
    rng = np.random.default_rng(2)
    with FeedWriter(path, FeedHeader(path.name, "front", *SIZE_PX)) as writer:
        for row in range(frames):
            writer.write(smooth_picture(rng, SIZE_PX), row * period_ms * 1_000_000)


def start_daemon(folder: Path, feed: Path, map_path: Path, period_ms: int, page_port: int = 0) -> subprocess.Popen[str]:
    """`lookback run` on a feed, at its own pace, every frame used."""
    config = {
        "camera": {"kind": "feed", "device": str(feed)},
        "sampling": {"by": "time", "interval_s": period_ms / 1000},
        "map": {"path": str(map_path)},
        "telemetry": {"connection": "udp:127.0.0.1:9", "journal": JOURNAL},
        "page": {"port": page_port},
    }
    file = folder / "daemon.toml"
    file.write_text(tomli_w.dumps(config))
    command = [sys.executable, "-m", "edge", "run", str(file)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def _used(folder: Path) -> int:
    """Frames that the daemon used, by its own last words."""
    return next(records_of(folder / JOURNAL, Stopped)).frames_used


def watch(process: subprocess.Popen[str]) -> list[Resident]:
    """Look at the process until it has ended. FeedError if it failed."""
    watched = psutil.Process(process.pid)
    looks = []
    while process.poll() is None:
        try:
            memory = watched.memory_info()
        except psutil.NoSuchProcess:
            break
        if memory.rss:
            looks.append(Resident(memory.rss / 1e6, memory.shared / 1e6))
        time.sleep(SAMPLE_S)
    said = process.communicate()[1]
    if process.returncode or not looks:
        raise FeedError(f"lookback run ended with {process.returncode}: {said.strip()[-300:]}")
    return looks
