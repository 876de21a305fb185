"""That splitting counts rare events as often as they are, and that the paths share nothing."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.localization.level_course import CLASSES, course
from tests.localization.splitting import LEVELS, BoundedDrive, begun, drawn_of, reached
from tests.localization.splitting import Path as Followed

STEPS, LONGEST_STEP, WALKS, GROUPS = 50, 0.045, 50, 60
SPLITS = 1  # the seed of a drive that comes near to a level


class Walk:
    """A random walk; how far it comes is how near the event is."""

    def __init__(self, seed: int) -> None:
        self.rng, self.at = np.random.default_rng(seed), 0.0

    def begin(self) -> Iterable[int]:
        return range(STEPS)

    def advance(self, move: int) -> None:
        self.at += self.rng.normal(0.0, LONGEST_STEP)

    def nearness(self) -> float:
        return self.at

    def other(self, rng: np.random.Generator) -> Walk:
        other = copy.copy(self)
        other.rng = np.random.default_rng(rng.integers(2**63))
        return other


def excursions(walks: NDArray[np.float64], begins: float) -> NDArray[np.float64]:
    """How far walks (n, steps) came, each time they came to `begins`, until they fell back."""
    farthest, found = np.zeros(len(walks)), []
    for at in (*walks.T, np.zeros(len(walks))):
        found.append(farthest[(at < begins) & (farthest > 0)])
        farthest = np.where(at < begins, 0.0, np.maximum(farthest, at))
    return np.concatenate(found)


def test_as_often_as_whole_walks_come_to_each_level() -> None:
    walks = np.random.default_rng(1).normal(0.0, LONGEST_STEP, (100_000, STEPS)).cumsum(axis=1)
    came = excursions(walks, LEVELS[0])
    truth = (came[:, np.newaxis] >= LEVELS).sum(axis=0) / len(walks)
    assert 1e-3 < truth[-1] < 3e-3
    found, rng = [], np.random.default_rng(2)
    for group in range(GROUPS):
        seeds = range(group * WALKS, (group + 1) * WALKS)
        # Every other walk counts three times as much: weights change nothing on average.
        weighted = [(Walk(seed), (1.5 if seed % 2 else 0.5) / WALKS) for seed in seeds]
        found.append(reached([one for walk, weight in weighted for one in begun(walk, weight, rng)], 60, rng))
    sigma = np.hypot(np.std(found, axis=0) / GROUPS**0.5, truth**0.5 / len(walks) ** 0.5)
    assert sigma[-1] < 0.3 * truth[-1]
    assert np.abs(np.mean(found, axis=0) - truth)[::2] / sigma[::2] == pytest.approx(0.0, abs=3.0)


def test_paths_of_little_weight_go_on_as_well() -> None:
    light, heavy = Followed(Walk(1), [], 0, 0.01), Followed(Walk(2), [], 0, 1.0)
    weights = [one.weight for one in drawn_of([light, heavy], 60, np.random.default_rng(1))]
    assert sum(weights) == pytest.approx(1.01, rel=0.05)
    assert sum(weight < 0.01 for weight in weights) == pytest.approx(len(weights) / 11, abs=1)


def test_a_drive_is_the_same_whether_others_begin_on_its_way_or_not(tmp_path: Path) -> None:
    drawn, _ = course(SPLITS, CLASSES["by 8 to 40 m"])
    alone, split = (BoundedDrive(drawn, SPLITS, tmp_path) for _ in range(2))
    assert begun(split, 1.0, np.random.default_rng(1))
    assert split.result.bounded == alone.run().bounded


def test_what_follows_differs(tmp_path: Path) -> None:
    drawn, _ = course(SPLITS, CLASSES["right"])
    bench, rng = BoundedDrive(drawn, SPLITS, tmp_path), np.random.default_rng(1)
    moves = list(bench.begin())
    for move in moves[:300]:
        bench.advance(move)
    one, two = bench.other(rng), bench.other(rng)
    assert one.own.tolist() == two.own.tolist()
    for move in moves[300:310]:
        one.advance(move)
        two.advance(move)
    assert one.right_m != two.right_m
    assert one.estimator is not two.estimator
    assert one.maps is two.maps
