"""Learns and undoes it again and again, and is killed each time. Run by test_kill_learning.py.

    python learn_loop.py FOLDER KILLS SEED

A process of its own, since it forks. Prints how many drives are searched after each kill.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path

from edge.reference_map import Retired, open_map_set
from sim.maps.learning import learn

LONGEST_S = 0.01


def learn_until_killed(folder: Path, drives: dict[str, str], begun: int) -> None:
    while True:
        retired = Retired(folder)
        if retired.drives:
            retired.undo()
        else:
            retired.replace(drives)
        os.write(begun, b".")


def crash(folder: Path, kills: int, seed: int) -> None:
    rng, drives = random.Random(seed), learn(folder, layers=1).retired
    for _ in range(kills):
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            learn_until_killed(folder, drives, write)
        os.read(read, 1)
        time.sleep(rng.uniform(0.0, LONGEST_S))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(read)
        os.close(write)
        print(len(open_map_set(folder).maps))


if __name__ == "__main__":
    crash(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
