"""Rare events by splitting and Russian roulette: the nearer a drive is to one, the more paths follow it.

Paths that come nearer go on several times, each with less weight, and what follows differs by chance alone; of those
that fall back a few go on, with more weight. The sum of the weights of paths that have reached a level is then the
probability of reaching it, without a bias, whatever the number of paths (Kahn and Harris 1951, "Estimation of particle
transmission by random sampling").
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from tests.localization.route_bench import Bench, Result

LEVELS = np.arange(10, 101) / 100
"""Error as a share of the protection level; the last one is the event."""
MOST_STEPS = 10
"""Fewer paths go on, the more the longer, once all together are so many times as long as the drive."""
Floats = NDArray[np.float64]


class Split(NamedTuple):
    """How many paths are to follow a drive, see `weight`; from `begins` on there are several.

    strength: one over twice the variance of the error as a share of its level; as many paths as that of a normal
    distribution then come to each level.
    """

    strength: float
    begins: float

    def weight(self, near: float) -> float:
        """That a path is to have there."""
        return math.exp(-self.strength * max(0.0, near**2 - self.begins**2))


class Path(Protocol):
    """What may go on several times from the same moment."""

    def begin(self) -> Iterable[Any]:
        """All steps."""

    def advance(self, move: Any) -> None:
        """One step."""


P = TypeVar("P", bound=Path)


def reached(
    path: P,
    split: Split,
    rng: np.random.Generator,
    near: Callable[[P], float],
    other: Callable[[P, np.random.Generator], P],
) -> Floats:
    """Probability (len(LEVELS),) with which a path, from its start, comes as near as each level.

    near: how near it is now. other: the same moment, after which chance is another. `path` itself goes on to the end,
    or to the event.
    """
    moves, found, steps = list(path.begin()), np.zeros(len(LEVELS)), 0
    waiting = [(path, 0, 1.0, 0)]
    while waiting:
        one, number, weight, nearest = waiting.pop()
        for at in range(number, len(moves)):
            one.advance(moves[at])
            steps += 1
            here = near(one)
            now = int((here >= LEVELS).sum())
            found[nearest:now] += weight
            nearest = max(nearest, now)
            if nearest == len(LEVELS):
                break
            wanted = split.weight(here) * max(1.0, steps / (MOST_STEPS * len(moves))) ** 4
            paths = int(weight / wanted)
            if paths > 1:
                weight /= paths
                waiting += [(other(one, rng), at + 1, weight, nearest) for _ in range(paths - 1)]
            elif weight < wanted / 4 and one is not path:  # not at once, since it may come nearer again
                if rng.random() > weight / wanted:
                    break
                weight = wanted
    return found


def reached_by(bench: Bench, split: Split, rng: np.random.Generator) -> Floats:
    """The same for the error of a drive's positions as a share of their protection levels."""
    return reached(bench, split, rng, lambda one: nearness(one.result), other_drive)


def nearness(result: Result) -> float:
    """Error of the newest position as a share of its level, in the direction in which that is more; 0 without one."""
    if not result.bounded:
        return 0.0
    newest = result.bounded[-1]
    return max(newest.along_m / newest.level_along_m, newest.across_m / newest.level_across_m)


def other_drive(bench: Bench, rng: np.random.Generator) -> Bench:
    """The same moment of the same drive, after which chance is another."""
    memo: dict[int, object] = {id(bench.result): Result(bounded=bench.result.bounded[-1:])}
    for shared in (bench.course, bench.line, bench.heading, bench.segments, *in_maps(bench)):
        memo[id(shared)] = shared
    other = copy.deepcopy(bench, memo)
    other.rng.bit_generator.state = np.random.default_rng(rng.integers(2**63)).bit_generator.state
    return other


def in_maps(bench: Bench) -> Sequence[object]:
    """What does not change while a map is used."""
    maps = bench.maps
    return [maps, *vars(maps).values(), *maps.maps, *(value for one in maps.maps for value in vars(one).values())]
