"""The keypoints of one picture, and two pictures compared by them, beside the grid's description of one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from edge.descriptor.network import Network, pictures_for
from edge.keypoints.matching import verify
from edge.keypoints.network import KeypointNetwork
from sim.bench.frames import SIZE_PX, smooth_picture
from sim.bench.timing import race
from sim.research.bench.rows import Section, against

GRID, STEP_PX = "grid: one picture described, 640x480", 12
"""STEP_PX: by how much what one picture shows lies aside in the next one of the same place."""


def measure(rounds: int) -> Section:
    """400 points a picture; two pictures of one place have most in common, those of two places nothing."""
    network, grid = KeypointNetwork(), Network.load(Path("grid"))
    one, other = (smooth_picture(np.random.default_rng(seed), SIZE_PX) for seed in (0, 1))
    here, near, elsewhere = (network.extract(image) for image in (one, np.roll(one, STEP_PX, axis=1), other))
    racers = {
        "keypoints of one picture, 640x480": lambda: network.extract(one),
        "verify, the same place": lambda: verify(here, near),
        "verify, another place": lambda: verify(here, elsewhere),
        GRID: lambda: grid.describe(pictures_for(grid.info, one, "left-right", 0.4)),
    }
    times = race(racers, rounds)
    return Section("Keypoints", [against(name, name, times, GRID) for name in racers], [])
