"""Kills a writer again and again, at random moments, and looks at what it has left. Run by test_kill.py.

    python crash_loop.py map|state|journal|clock FOLDER KILLS SEED

A process of its own, since it forks. Prints JSON: kills, how many hit a write that had not ended, and what was found
to be old, new, or neither.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from edge.config import SamplingConfig
from edge.descriptor import RunningStatistics
from edge.errors import LookbackError
from edge.files import PersistentFile
from edge.journal.journal import Journal
from edge.journal.records import StateChanged
from edge.recognition.warm_start import PersistentTime, StateFile, StateKey
from edge.reference_map.store import ModelKey, RegionsKey, open_map
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.signing import EPOCH_S, TICKS_PER_S, Signer, SigningClock
from edge_plugins.mapping.builder import MapBuilder, Place
from sim.journal import records_of

NOW = PersistentTime(1000.0, "boot", 10.0)
SHAPE = (2, 4096)
MEASURED = 5
"""Writes whose time is taken first, since a busy machine takes longer: kills come within two of the slowest."""


def write_map(folder: Path, version: int) -> None:
    """Replace the map by one of `version` + 2 places."""
    rng = np.random.default_rng(version)
    model, regions = ModelKey("made-up", "0" * 64, "fc6", 64), RegionsKey("left-right", 0.4)
    with MapBuilder(folder / "map", model, regions, SamplingConfig(), replace=True) as builder:
        builder.begin_segment(str(version), "rear")
        for row in range(version % 50 + 2):
            builder.add(rng.random((2, 64), np.float32), Place(row, thumbnail=b"x" * 500))
        builder.finish()


def read_map(folder: Path) -> int:
    """The map's version, after every checksum has been checked."""
    return int(open_map(folder / "map", every_file=True).header.segments[0].source)


def state_file(folder: Path) -> StateFile:
    return StateFile(folder / "events.state", StateKey("m", "fc6", "left-right", 0.4, "h"), SHAPE)


def write_state(folder: Path, version: int) -> None:
    values, file = np.full(SHAPE, float(version)), state_file(folder)
    file.write(RunningStatistics.of_another_run(version, values, values, at_most=version), NOW)


def read_state(folder: Path) -> int:
    kept = state_file(folder).read(NOW, 60)
    if kept is None or not (kept.mean == kept.mean[0, 0]).all():
        raise LookbackError("unreadable")
    return int(kept.mean[0, 0])


def write_journal(folder: Path, version: int) -> None:
    journal = Journal(folder / "events.jsonl")
    journal.write(StateChanged(str(version), "x" * 300))
    journal.close()


def read_last_line(folder: Path) -> int:
    """The newest version; every older one must be there as well, in order."""
    versions = [int(record.state) for record in records_of(folder / "events.jsonl", StateChanged)]
    if versions != list(range(1, len(versions) + 1)):
        raise LookbackError(f"lines are missing: {versions[-5:]}")
    return int(versions[-1])


def write_clock(folder: Path, version: int) -> None:
    """The signing clock, of a link that has come to rest so many seconds after MAVLink's epoch."""
    MavlinkCodec(1, 191, Signer(bytes(32), folder / "clock.0", 0, lambda: EPOCH_S + version)).store_timestamps()


def read_clock(folder: Path) -> int:
    kept = PersistentFile(folder / "clock.0", SigningClock, "").read()
    if kept is None:
        raise LookbackError("unreadable")
    return kept.ours // TICKS_PER_S


WORK: dict[str, tuple[Callable[[Path, int], None], Callable[[Path], int]]] = {
    "map": (write_map, read_map),
    "state": (write_state, read_state),
    "journal": (write_journal, read_last_line),
    "clock": (write_clock, read_clock),
}


def write_until_killed(write: Callable[[Path, int], None], folder: Path, version: int, told: int) -> None:
    """The child: says which version is begun, and which is done."""
    while True:
        version += 1
        os.pwrite(told, version.to_bytes(8, "little"), 0)
        write(folder, version)
        os.pwrite(told, version.to_bytes(8, "little"), 8)


def crash(what: str, folder: Path, kills: int, seed: int) -> dict[str, int]:
    """Kill so many writers, each of which goes on from what the one before has left."""
    write, read = WORK[what]
    rng, found = random.Random(seed), Counter[str]()
    told = os.open(folder / "told", os.O_RDWR | os.O_CREAT)
    longest_s = 0.0
    for version in range(1, MEASURED + 1):
        began_s = time.monotonic()
        write(folder, version)
        longest_s = max(longest_s, 2 * (time.monotonic() - began_s))
    for _ in range(kills):
        os.pwrite(told, version.to_bytes(8, "little") * 2, 0)
        child = os.fork()
        if child == 0:
            write_until_killed(write, folder, version, told)
        while os.pread(told, 8, 0) == os.pread(told, 8, 8):
            time.sleep(0.0005)  # until it has begun: a busy machine lets it wait
        time.sleep(rng.uniform(0.0, longest_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        begun, done = (int.from_bytes(os.pread(told, 8, at), "little") for at in (0, 8))
        found["in the middle of a write"] += begun > done
        try:
            version = read(folder)
            found["new" if version == begun else "old" if version == done else "neither"] += 1
        except (LookbackError, IndexError) as error:
            print(error, file=sys.stderr)
            found["unreadable"] += 1
            break
    found["left over"] = len([path for path in folder.iterdir() if path.name.endswith((".building", ".new"))])
    return {"kills": kills, "versions": version, **found}


if __name__ == "__main__":
    print(json.dumps(crash(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))))
