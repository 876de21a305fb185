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

from edge.reference_map import LearnedFolder, open_map_set
from sim.maps.learning import Lesson, learn

LONGEST_S = 0.01


def learn_until_killed(folder: Path, lesson: Lesson, begun: int) -> None:
    while True:
        learned = LearnedFolder(folder)
        if learned.newest.retired:
            learned.undo()
        else:
            lesson.keep(learned)
        os.write(begun, b".")


def crash(folder: Path, kills: int, seed: int) -> None:
    rng, lesson = random.Random(seed), learn(folder, layers=1)
    for _ in range(kills):
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            learn_until_killed(folder, lesson, write)
        os.read(read, 1)
        time.sleep(rng.uniform(0.0, LONGEST_S))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(read)
        os.close(write)
        print(len(open_map_set(folder).maps))


if __name__ == "__main__":
    crash(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
