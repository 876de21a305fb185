"""Rare events by multilevel splitting: a drive that comes near to one goes on several times, each with less weight.

What follows differs by chance alone, so that a path reaches the next level far more often than a new drive would, and
the sum of the weights that reach a level is the probability of reaching it, without a bias (RESTART, Villen-Altamirano
and Villen-Altamirano 1991).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from tests.localization.route_bench import Bench, Result

LEVELS = np.arange(6, 21) / 20
"""Error as a share of the protection level; the last one is the event."""
Floats = NDArray[np.float64]


class Split(NamedTuple):
    """How many paths a path becomes at each level that it reaches, from one of them on."""

    factor: int
    begins: float = 0.0


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

    near: how near it is now. other: the same moment,
    after which chance is another. `path` itself goes on to the end, or to the event.
    """
    moves, found = list(path.begin()), np.zeros(len(LEVELS))
    waiting = [(path, 0, 1.0, 0)]
    while waiting:
        one, number, weight, level = waiting.pop()
        for at in range(number, len(moves)):
            one.advance(moves[at])
            now = int((near(one) >= LEVELS).sum())
            if now <= level:
                continue
            found[level:now] += weight
            level = now
            if level == len(LEVELS):
                break
            if LEVELS[level - 1] >= split.begins:
                weight /= split.factor
                waiting += [(other(one, rng), at + 1, weight, level) for _ in range(split.factor - 1)]
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
