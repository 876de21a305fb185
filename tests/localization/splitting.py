"""Rare events by splitting and Russian roulette: the nearer a drive is to one, the more paths follow it.

Whenever a drive comes near, paths follow it from there until they fall back. Those that come nearer go on several
times, each with less weight, and what follows differs by chance alone. Of those that come less near a few go on, with
more weight. The sum of the weights of paths that have reached a level is then how often it is reached, without a bias
(Kahn and Harris 1951, "Estimation of particle transmission by random sampling").

The drive itself goes on as if no path had followed it (Villen-Altamirano 1991, "RESTART"). If it were split and thinned
again at each of its many approaches, chance would soon leave none of its paths, or many.
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
MOST_PATHS = 300
"""In all of one approach, after which paths go on without being split: a drive that stays near would take hours."""
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
    """How often (len(LEVELS),) a path, from its start, is to be expected to come as near as each level.

    It counts once until it falls back behind `split.begins`. near: how near it is now. other: the same moment, after
    which chance is another.
    """
    moves, found, is_near = list(path.begin()), np.zeros(len(LEVELS)), False
    for at, move in enumerate(moves):
        path.advance(move)
        was_near, is_near = is_near, near(path) >= split.begins
        if is_near and not was_near:
            found += followed(path, moves[at + 1 :], split, rng, near, other)
    return found


def followed(
    path: P,
    moves: Sequence[Any],
    split: Split,
    rng: np.random.Generator,
    near: Callable[[P], float],
    other: Callable[[P, np.random.Generator], P],
) -> Floats:
    """Probability (len(LEVELS),) with which a path comes as near as each level before it falls back."""
    found, paths = np.zeros(len(LEVELS)), 1
    waiting = [(other(path, rng), 0, 1.0, 0)]
    while waiting:
        one, at, weight, nearest = waiting.pop()
        while True:
            here = near(one)
            now = int((here >= LEVELS).sum())
            found[nearest:now] += weight
            nearest = max(nearest, now)
            if here < split.begins or nearest == len(LEVELS):
                break
            wanted = split.weight(here)
            more = min(int(weight / wanted) - 1, MOST_PATHS - paths)
            if more > 0:
                weight /= 1 + more
                paths += more
                waiting += [(other(one, rng), at, weight, nearest) for _ in range(more)]
            elif weight < wanted / 4:  # not at once, since it may come nearer again
                if rng.random() > weight / wanted:
                    break
                weight = wanted
            if at == len(moves):
                break
            one.advance(moves[at])
            at += 1
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
