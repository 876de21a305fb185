"""Whether a confidence of 0.7 is right in 7 of 10 frames: on simulated roads, and on real streets front against rear.

Frames on the map count as much as all frames off it: those where a part of the road is not mapped, and drives over
roads that are on no map. Each `--seeds` is a set of roads. Of real streets each scene is recognized on the map of all
scenes, and on that of all others.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from sim.compare.method_runner import MethodRunner
from sim.compare.plan import NetworkPlan, Pair, TraversePlan, load_plan
from sim.compare.run import Folders, find_plan, open_runner
from sim.compare.scores import joined
from sim.evaluation.metrics import Answers
from sim.research.evaluation.roads import World, foreign_confidence, judge_world, worlds

TENTHS, LEAST_SHOWN = 10, 7
"""What is believed has more than the second."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Confidences:
    """Frames with a confidence (n,), whether they are right, and weights: 1 for all on the map, 1 for all off it."""

    confidence: Floats
    right: NDArray[np.bool_]
    weight: Floats

    @classmethod
    def of(cls, mapped: Answers, foreign: Floats) -> Confidences:
        """mapped: answers over mapped roads. foreign: confidence (n,) of frames whose road is on no map."""
        confidence = np.nan_to_num(np.concatenate([mapped.confidence, foreign]))
        right = np.concatenate([mapped.correct, np.zeros(len(foreign), bool)])
        on_map = np.concatenate([mapped.has_truth, np.zeros(len(foreign), bool)])
        weight = np.where(on_map, 1 / max(1, on_map.sum()), 1 / max(1, (~on_map).sum()))
        return cls(confidence, right, weight)

    def tenths(self) -> Iterator[tuple[int, float, float]]:
        """Of each tenth of confidence: how many frames, the mean of what they claim, and the share that is right."""
        tenth = np.ceil(TENTHS * self.confidence).clip(1, TENTHS).astype(int)
        for one in range(1, TENTHS + 1):
            chosen = (tenth == one) & (self.confidence > 0)
            weight = self.weight[chosen]
            if not chosen.any():
                yield 0, np.nan, np.nan
                continue
            shares = weight / weight.sum()
            yield int(chosen.sum()), float(shares @ self.confidence[chosen]), float(shares @ self.right[chosen])


def of_roads(seen: Sequence[World]) -> Confidences:
    """Each drive over its own road with each part of it mapped, and over every other one's map."""
    mapped = [judged.belief for road, drives in seen for _, judged, _ in judge_world(road, drives)]
    return Confidences.of(joined(mapped), foreign_confidence(seen))


def of_streets(feeds: Path) -> Confidences:
    """The scenes of `real_front_rear` on the map of all of them, and each on the map of all others."""
    path = find_plan(Path("real_front_rear"))
    plan = load_plan(path)
    front, rear = plan.traverses["front"].feeds, plan.traverses["rear"].feeds
    traverses = dict(plan.traverses)
    for scene, seen in zip(front, rear, strict=True):
        traverses[scene] = TraversePlan(feeds=(scene,))
        traverses[f"without {scene}"] = TraversePlan(feeds=tuple(one for one in rear if one != seen))
    plan = msgspec.structs.replace(plan, traverses=traverses, networks={"fc6": NetworkPlan(model="fc6")})
    runner = open_runner(plan, Folders(path.parent, feeds, feeds, feeds))
    mapped = joined([runner.run(pair, "Lookback").answers for pair in plan.pairs])
    foreign = [_elsewhere(runner, pair, scene) for pair in plan.pairs for scene in front]
    return Confidences.of(mapped, np.concatenate(foreign))


def _elsewhere(runner: MethodRunner, pair: Pair, scene: str) -> Floats:
    """Confidence of each frame of a scene on the map of all others, from its first whole sequence on."""
    reference, query, length = runner.traverse(f"without {scene}"), runner.traverse(scene), runner.sequence_length(pair)
    return runner.match(pair, runner.method("Lookback"), reference, query, length).confidence[length - 1 :]


def rows_of(claims: dict[str, Confidences]) -> Iterator[str]:
    """A Markdown table: of each set and upper tenth of confidence, how many frames claim what, and what is right."""
    yield f"| confidence | {' | '.join(f'{name}: frames, claimed, right' for name in claims)} |"
    yield "|" + "---|" * (len(claims) + 1)
    rows = enumerate(zip(*(one.tenths() for one in claims.values()), strict=True))
    for tenth, of_sets in islice(rows, LEAST_SHOWN, None):
        cells = [f"{count}, {claimed:.2f}, {right:.2f}" if count else "-" for count, claimed, right in of_sets]
        yield f"| {tenth / TENTHS:.1f} to {(tenth + 1) / TENTHS:.1f} | {' | '.join(cells)} |"


def rows(args: argparse.Namespace) -> Iterator[str]:
    """Whether a confidence of 0.7 is right in 7 of 10 frames: of each set of roads, and of real streets."""
    claims = {
        f"roads {', '.join(map(str, seeds))}": of_roads(list(worlds(seeds, args.length, args.cache, "fc6")))
        for seeds in args.sets
    }
    if args.feeds:
        claims["real streets"] = of_streets(args.feeds)
    yield from rows_of(claims)
