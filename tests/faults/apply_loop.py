"""Adds a delta to a copy of a folder of maps again and again, and is killed each time. Run by test_kill_learning.py.

    python apply_loop.py FOLDER DELTA KILLS SEED

A process of its own, since it forks. Prints how many drives are there after each kill, and once the same command has
run again.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
import time
from pathlib import Path

from edge.reference_map import open_map_set
from sim.maps.exchange import apply

LONGEST = 3.0
"""Times what it took unkilled, 23 ms: on a busy computer it takes longer."""


def unkilled_s(folder: Path, delta: Path) -> float:
    copy = Path(shutil.copytree(folder, folder.with_name("whole")))
    began_s = time.monotonic()
    apply(copy, delta)
    took_s = time.monotonic() - began_s
    shutil.rmtree(copy)
    return took_s


def crash(folder: Path, delta: Path, kills: int, seed: int) -> None:
    rng = random.Random(seed)
    longest_s = LONGEST * min(unkilled_s(folder, delta) for _ in range(3))
    for number in range(kills):
        copy = Path(shutil.copytree(folder, folder.with_name(f"copy-{number}")))
        child = os.fork()
        if child == 0:
            apply(copy, delta)
            os._exit(0)
        time.sleep(rng.uniform(0.0, longest_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        found = len(open_map_set(copy).maps)
        apply(copy, delta)
        left = [path.name for path in copy.glob(".*")]
        print(f"{found}/{len(open_map_set(copy).maps)}", *left)
        shutil.rmtree(copy)


if __name__ == "__main__":
    crash(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
