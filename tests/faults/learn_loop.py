"""Learns and undoes it again and again, and is killed each time. Run by test_kill_learning.py.

    python learn_loop.py FOLDER KILLS SEED

A process of its own, since it forks. Prints how many drives are searched after each kill, and of how many of them the
positions are newer.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from msgspec import structs

from edge.reference_map import open_map_set
from edge.reference_map.learned import LearnedFolder, Newer, checksum
from sim.maps.learning import Lesson, learn

LONGEST_S = 0.01
NORTH_DEG = 60.0


def learn_until_killed(folder: Path, lesson: Lesson, begun: int) -> None:
    while True:
        learned = LearnedFolder(folder)
        if learned.newest.retired:
            learned.undo()
        else:
            lesson.keep(learned)
        os.write(begun, b".")


def moved_north(lesson: Lesson) -> Lesson:
    """With newer positions for all drives."""
    rows = {
        drive.header.header_sha256: np.full((3, drive.header.places), NORTH_DEG + 1 + number)
        for number, drive in enumerate(lesson.drives)
    }
    newer = {sha256: Newer(checksum(one)) for sha256, one in rows.items()}
    return replace(lesson, learned=structs.replace(lesson.learned, newer=newer), positions=rows)


def crash(folder: Path, kills: int, seed: int) -> None:
    rng, lesson = random.Random(seed), moved_north(learn(folder, layers=1))
    for _ in range(kills):
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            learn_until_killed(folder, lesson, write)
        for _ in range(rng.choice((1, 2))):  # on a slow disk nothing else decides between learning and undoing
            os.read(read, 1)
        time.sleep(rng.uniform(0.0, LONGEST_S))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(read)
        os.close(write)
        maps = open_map_set(folder).maps
        print(f"{len(maps)}/{sum(bool(one.places['lat_deg'][0] > NORTH_DEG) for one in maps)}")


if __name__ == "__main__":
    crash(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
