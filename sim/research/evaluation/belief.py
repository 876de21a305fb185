"""How far the place belief can be trusted: simulated roads, front against rear, all of the road mapped or part of it.

A rear camera maps each road by day. A front camera drives it the same way by dusk, night, rain and snow, home by dusk
and night, and both ways by day, which only gives the rig's offset. The course is known. GPS was lost where the drive
begins: dead reckoning since is off by a random share of the distance, 5 % to one standard deviation in each
direction, and says so; each drive is driven with some such errors.
The second table has what is believed off the map, on a drive over the next seed's road as if it lay beside the mapped
one, crossed it or left it, with GPS now and 500 m after it was lost; and on the mapped road itself, as if it were a
twin of it 25 m beside, where only dead reckoning can say that it is not.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from edge.config import AcceptanceConfig
from edge.sequence import Direction
from sim.compare.scores import at_threshold, joined
from sim.research.evaluation.roads import (
    CUTS,
    FIRST_FRAME,
    LIGHTS,
    SPACING_M,
    TOLERANCE_M,
    BeliefScore,
    Case,
    Cut,
    DriveDescriptors,
    Floats,
    World,
    believe,
    judge_world,
    worlds,
)
from sim.world.scenario import LightName

GROUPS: Sequence[tuple[str, Direction, tuple[LightName, ...]]] = (
    ("the same way at dusk, night and in rain", "forward", ("dusk", "night", "rain")),
    ("the same way in snow", "forward", ("snow",)),
    ("home at dusk and night", "reverse", ("dusk", "night")),
)
GPS = {"GPS now": -1.0, "GPS 500 m before": 500.0}
CAR_PARK_M = 15.0
"""Radius of the rounds that are driven on it."""
FORK_RAD = 0.5
OFF_MAP = slice(FIRST_FRAME, None)
SHOWN: tuple[Cut, ...] = ("whole", "second half", "thirds")
"""Parts of the road that have a row."""
Layout = Callable[[Floats, DriveDescriptors, DriveDescriptors], tuple[DriveDescriptors, slice]]
"""A drive, and its frames that are on no mapped road: of a mapped road (n, 2), meters east and north in the direction
of travel, a drive over it, and a drive over another road."""


def _along(line_m: Floats, driven_m: Floats, beside_m: float = 0.0) -> Floats:
    """Along the road, or beside it to the left."""
    ahead = np.gradient(line_m, axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.hypot(*ahead.T)[:, np.newaxis]
    at_m = np.arange(len(line_m)) * SPACING_M
    return np.column_stack([np.interp(driven_m, at_m, one) for one in (line_m + beside_m * left).T])


def _onward(line_m: Floats, driven_m: Floats, turn_rad: float, before_m: float) -> Floats:
    """Straight on through the middle of the road at an angle to it, from so far before it."""
    middle_m, after_m = _along(line_m, np.array([len(line_m) * SPACING_M / 2, len(line_m) * SPACING_M / 2 + 1]))
    east, north = after_m - middle_m
    onward = np.array(
        [east * np.cos(turn_rad) - north * np.sin(turn_rad), east * np.sin(turn_rad) + north * np.cos(turn_rad)]
    )
    return np.asarray(middle_m + np.outer(driven_m - before_m, onward))


def _parked(line_m: Floats, driven_m: Floats) -> Floats:
    """Round and round on a car park 30 m beside the middle of the road."""
    center_m = _along(line_m, np.array([len(line_m) * SPACING_M / 2]), 2 * CAR_PARK_M)
    angle = driven_m / CAR_PARK_M
    return np.asarray(center_m + CAR_PARK_M * np.column_stack([np.cos(angle), np.sin(angle)]))


def _forked(line_m: Floats, own: DriveDescriptors, other: DriveDescriptors) -> tuple[DriveDescriptors, slice]:
    """The first half of a drive on the map, and a road that leaves it there; and what lies beyond the tolerance."""
    half, rest = len(own.raw) // 2, len(other.raw) // 2
    driven_m = np.append(own.driven_m[:half], own.driven_m[half] + other.driven_m[rest:] - other.driven_m[rest])
    where_m = _onward(line_m, driven_m, FORK_RAD, float(driven_m[half]))
    where_m[:half] = _along(line_m, driven_m[:half])
    raw = np.concatenate([own.raw[:half], other.raw[rest:]])
    beyond = half + int(TOLERANCE_M / np.sin(FORK_RAD) / SPACING_M)
    return DriveDescriptors(raw, driven_m, driven_m, where_m), slice(beyond, None)


def _elsewhere(where_of: Callable[[Floats, Floats], Floats]) -> Layout:
    """The whole drive over the other road, laid where it is after meters driven (m,)."""
    return lambda line_m, own, other: (replace(other, east_north_m=where_of(line_m, other.driven_m)), OFF_MAP)


LAYOUTS: dict[str, Sequence[Layout]] = {
    "beside it by 20, 50 or 100 m, or across it": (
        _elsewhere(lambda line_m, driven_m: _along(line_m, driven_m, 20.0)),
        _elsewhere(lambda line_m, driven_m: _along(line_m, driven_m, 50.0)),
        _elsewhere(lambda line_m, driven_m: _along(line_m, driven_m, 100.0)),
        _elsewhere(lambda line_m, driven_m: _onward(line_m, driven_m, np.pi / 2, float(driven_m[-1]) / 2)),
    ),
    "a car park beside it": (_elsewhere(_parked),),
    "a fork": (_forked,),
    "its twin, 25 m beside": (
        lambda line_m, own, other: (replace(own, east_north_m=_along(line_m, own.driven_m, 25.0)), OFF_MAP),
    ),
}
"""Where the other road lies; those of one name share a row."""


def rows(args: argparse.Namespace) -> Iterator[str]:
    """How far the place belief can be trusted: parts of the roads mapped, then roads that are on no map."""
    roads = args.seeds, args.length, args.cache
    seen = {name: list(worlds(*roads, name)) for name in args.networks}
    yield "| network, drive | mapped | recall, votes alone | with GPS | first place, votes alone | with GPS | lowest |"
    yield "|---|---|---|---|---|---|---|"
    wrong = []
    for name, of_network in seen.items():
        judged: dict[Case, list[tuple[BeliefScore, list[BeliefScore]]]] = {}
        for road, drives in of_network:
            for case, alone, drawn in judge_world(road, drives, args.draws):
                judged.setdefault(case, []).append((alone, drawn))
        yield from _rows(name, judged)
        found = [one for of_case in judged.values() for one in of_case]
        of_votes, answers = [alone for alone, _ in found], [one for _, drawn in found for one in drawn]
        words = " and ".join(
            f"{sum(map(wrong_frames, ones))} of {sum(len(one.belief.correct) for one in ones)} frames"
            for ones in (of_votes, answers)
        )
        wrong.append(f"- {name}: {words} are accepted and wrong, by the votes alone and with GPS before.")
    of_networks = [f"{name}: {', '.join(('the votes alone', *GPS))}" for name in seen]
    yield from ["", *wrong, "", f"| a road that is not mapped | frames | {' | '.join(of_networks)} |"]
    yield "|---|---|" + "---|" * len(seen)
    least = AcceptanceConfig().confidence_from
    for where, layouts in LAYOUTS.items():
        cells, frames = [], 0
        for of_network in seen.values():
            off_map = [_off_map(of_network, layouts, lost_m) for lost_m in GPS.values()]
            confidences, frames = [off_map[0][0], *(both for _, both in off_map)], len(off_map[0][0])
            counts = ", ".join(str((one >= least).sum()) for one in confidences)
            cells.append(f"{counts}; at most {max(one.max() for one in confidences):.3f}")
        yield f"| {where} | {frames} | {' | '.join(cells)} |"


def wrong_frames(judged: BeliefScore) -> int:
    """Frames that are believed, and not where they are believed."""
    believed = np.nan_to_num(judged.belief.confidence) >= AcceptanceConfig().confidence_from
    return int((believed & ~judged.belief.correct).sum())


def _rows(name: str, judged: dict[Case, list[tuple[BeliefScore, list[BeliefScore]]]]) -> Iterator[str]:
    for words, way, lights in GROUPS:
        drives = [
            one for light in lights for cut in CUTS for _, of_drive in judged[way, light, cut] for one in of_drive
        ]
        lowest = min(map(_recall, drives))
        for cut in SHOWN:
            found = [one for light in lights for one in judged[way, light, cut]]
            alone, drawn = [one for one, _ in found], [one for _, of_drive in found for one in of_drive]
            recalls = f"{_recall_of(alone):.3f} | {_recall_of(drawn):.3f}"
            first = f"{_first_m(alone)} m | {_first_m(drawn)} m"
            yield f"| {name}, {words} | {cut} | {recalls} | {first} | {lowest:.2f} |"


def _recall(judged: BeliefScore) -> float:
    return at_threshold(judged.belief, AcceptanceConfig().confidence_from)[1]


def _recall_of(judged: Sequence[BeliefScore]) -> float:
    return at_threshold(joined([one.belief for one in judged]), AcceptanceConfig().confidence_from)[1]


def _first_m(judged: Sequence[BeliefScore]) -> str:
    """The median meters to the first right belief on each part of the map."""
    parts = max(len(one.first_m) for one in judged)
    first_m = [np.median([one.first_m[part] for one in judged if len(one.first_m) > part]) for part in range(parts)]
    return ", ".join(f"{one:.0f}" for one in first_m)


def _off_map(seen: Sequence[World], layouts: Sequence[Layout], lost_m: float) -> tuple[Floats, Floats]:
    """The confidence of each frame off the map, by the votes alone and with dead reckoning."""
    alone, both = [], []
    for layout, ((road, own), (_, others)) in product(layouts, zip(seen, [*seen[1:], *seen[:1]], strict=True)):
        for way, lights in LIGHTS.items():
            line_m = road.east_north_m[:: 1 if way == "forward" else -1]
            for light in lights:
                drive, is_off = layout(line_m, own[light, way], others[light, way])
                found = believe(road, drive, "whole", reckoned=drive.reckoned(lost_m, len(drive.raw)))
                alone.append(found.by_votes[is_off])
                both.append(found.confidence[is_off])
    return np.concatenate(alone), np.concatenate(both)
