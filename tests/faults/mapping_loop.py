"""Maps a drive as fast as the disk takes it, is killed, and goes on, again and again. Run by test_kill_mapping.py.

    python mapping_loop.py FOLDER KILLS SEED

A process of its own, since it forks. Prints JSON: the places after each kill, and those with keypoints, how many places
were lost by it, and how many times a record was cut off.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.geodesy import VehiclePosition
from edge.reference_map import ModelKey, RegionsKey
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.drive_store import DriveStore
from edge_plugins.mapping.live_map import LiveMap
from edge_plugins.mapping.place_log import OpenLog, files_of, logs_in
from edge_plugins.mapping.place_log_records import LogHeader

MODEL, REGIONS = ModelKey("test", "0" * 64, "fc6", 512), RegionsKey("left-right", 0.4)
GPS = VehiclePosition(0, 47.0, 8.0, 400.0, 0.0, 10.0, 10.0, 0.0, sigma_m=1.5, source="gps")
LONGEST_S = 0.3
WAL_HEAD, WAL_FRAME = 32, 24 + 4096  # https://www.sqlite.org/walformat.html
CHECKED = 50
"""Places that are compared after each kill, the newest ones."""


def raw_of(row: int) -> NDArray[np.float32]:
    """The raw descriptor of a place, by which it is known again."""
    return np.maximum(np.random.default_rng(row).normal(size=(2, 512)), 0).astype(np.float32)


def open_live(folder: Path, later_s: float = 0.0) -> LiveMap:
    """later_s: seconds from now."""
    config = MappingConfig(folder=str(folder / "maps"), min_free_mb=0.0)
    header = LogHeader(MODEL, REGIONS, SamplingConfig())
    return LiveMap(config, DriveStore(config, header, "rear", lambda: time.time() + later_s, fov_deg=80.0))


def map_until_killed(folder: Path, told: int) -> None:
    """The child: says how many places there were when it began, and how many it has handed over."""
    mapped = open_live(folder)
    image = np.random.default_rng(0).integers(0, 255, (96, 128, 3), np.uint8)
    first = row = mapped.status.places
    while True:
        os.pwrite(told, (first + 1).to_bytes(8, "little") + (row + 1).to_bytes(8, "little"), 0)
        position = replace(GPS, lat_deg=47.0 + row * 2 / 110_800)
        mapped.add(raw_of(row), image, position, (row - first) * 2.0)
        mapped.newly_searchable((row - first) * 2.0)
        if row == first:
            mapped.store.keypoints.wait()  # the network is open
        row = mapped.status.places
        while mapped.store.waiting > 3:  # a vehicle is slower than any disk
            time.sleep(0.0002)


def is_cut_off(file: Path) -> bool:
    """Whether SQLite's log ends within a transaction: its last page is not marked as the last one of it."""
    try:
        log = files_of(file)[0].read_bytes()
    except FileNotFoundError:
        return False
    salt, at, is_whole = log[16:24], WAL_HEAD, True
    while log and log[at + 8 : at + 16] == salt:  # else of an earlier use of the file
        is_whole = len(log) >= at + WAL_FRAME and log[at + 4 : at + 8] != bytes(4)
        at += WAL_FRAME
    return not is_whole


def kill_once(folder: Path, told: int, pause_s: float, *, meets_record: bool) -> int:
    """Map for a while, and kill the process; how many places it had handed over.

    meets_record: in the middle of a record, for which it is stopped until it is there.
    """
    os.pwrite(told, bytes(16), 0)
    child = os.fork()
    if child == 0:
        map_until_killed(folder, told)
    while os.pread(told, 8, 0) == bytes(8) or os.pread(told, 8, 0) == os.pread(told, 8, 8):
        time.sleep(0.0005)  # until it has begun: a busy machine lets it wait
    time.sleep(pause_s)
    while meets_record:
        os.kill(child, signal.SIGSTOP)
        os.waitpid(child, os.WUNTRACED)
        (file,) = logs_in(folder / "maps")
        if is_cut_off(file):
            break
        os.kill(child, signal.SIGCONT)
        time.sleep(0.0005)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return int.from_bytes(os.pread(told, 8, 8), "little") - 1


def crash(folder: Path, kills: int, seed: int) -> dict[str, list[int]]:
    """Kill so many mapping processes, each of which goes on with what the one before has left."""
    rng, told = random.Random(seed), os.open(folder / "told", os.O_RDWR | os.O_CREAT)
    found: dict[str, list[int]] = {"places": [], "points": [], "lost": [], "cut": []}
    for number in range(kills):
        handed_over = kill_once(folder, told, rng.uniform(0.0, LONGEST_S), meets_record=number % 4 == 0)
        (file,) = logs_in(folder / "maps")
        is_cut = is_cut_off(file)
        left = OpenLog(file)
        places = len(left.rows)
        for row in range(max(0, places - CHECKED), places):
            np.testing.assert_allclose(left.raw_of(left.place(row)), raw_of(row), rtol=1e-3, atol=1e-6)
            assert left.place(row).place.row == row
        points = sum(left.points(row) is not None for row in range(places))
        found["places"].append(places)
        found["points"].append(points)
        found["lost"].append(handed_over - places)
        found["cut"].append(int(is_cut))
        left.close()
    return found


if __name__ == "__main__":
    print(json.dumps(crash(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))))
