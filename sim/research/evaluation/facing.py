"""Two front cameras that face each other: a map made by night, and the way home by day, with a course and without.

The paper's forward night against reverse day, on the roads of `sim.research.evaluation.belief`. GPS is lost where a
drive begins; a course comes from dead reckoning since, and says which way the map is passed. The rig's offset is that
of the way home by night.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from edge.config import AcceptanceConfig, RigConfig
from edge.descriptor.network import Network
from sim.compare.scores import at_threshold, joined
from sim.research.evaluation.belief import wrong_frames
from sim.research.evaluation.roads import TOLERANCE_M, BeliefScore, World, believe, judge, offset_m, worlds


def rows(args: argparse.Namespace) -> Iterator[str]:
    """Two cameras that face each other: right lines, recall by the votes alone and with GPS before; what is wrong."""
    yield from of_worlds(list(worlds(args.seeds, args.length, args.cache, Network.load(Path("grid")))))


def of_worlds(seen: list[World]) -> Iterator[str]:
    """The rows of some roads."""
    yield "| the way along the map | best match right | accepted: by the votes; GPS before | wrong |"
    yield "|---|---|---|---|"
    for words, knows_course in (("not known", False), ("known by the course", True)):
        lines, alone, known = zip(*(_judged(world, knows_course=knows_course) for world in seen), strict=True)
        recalls = "; ".join(f"{_recall(ones):.3f}" for ones in (alone, known))
        wrong = "; ".join(str(sum(map(wrong_frames, ones))) for ones in (alone, known))
        frames = sum(len(one.belief.correct) for one in known)
        yield f"| {words} | {np.mean(lines):.3f} | {recalls} | {wrong} of {frames} |"


def _recall(judged: tuple[BeliefScore, ...]) -> float:
    return at_threshold(joined([one.belief for one in judged]), AcceptanceConfig().confidence_from)[1]


def _judged(world: World, *, knows_course: bool) -> tuple[float, BeliefScore, BeliefScore]:
    """The share of best lines that are right, and the belief by the votes alone and with GPS before."""
    drives = world[1]
    road, query, calibration = drives["night", "forward"], drives["day", "reverse"], drives["night", "reverse"]
    on_road = partial(believe, road, cut="whole", view="front")
    ahead_m = offset_m(calibration, on_road(query=calibration))
    rig = RigConfig(ahead_reverse_swapped_m=-ahead_m)
    beliefs = on_road(query=query, rig=rig, reckoned=query.reckoned(0.0, 0), knows_course=knows_course)
    off_m = np.abs(beliefs.match_m - query.route_m - ahead_m)
    right = float((off_m <= TOLERANCE_M)[np.isfinite(beliefs.match_m)].mean())
    alone, known = (judge(query, road.route_m, one, ahead_m) for one in (beliefs.alone, beliefs))
    return right, alone, known
