"""What is believed on the way home when pictures become worse, and what the daemon says of its camera.

The recognizer has the odometer and the course, and no position. A frame is wrong if its place is over 40 m off.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from itertools import product
from pathlib import Path

from msgspec.structs import replace

from edge import __version__
from edge.feed import Feed, read_feed
from edge.reference_map import MapSet
from sim.evaluation.corruption import KINDS, Corruption
from sim.evaluation.metrics import TOLERANCE_M
from sim.evaluation.recognition import judge, recognize
from sim.research.evaluation import poses
from sim.traverse import config_as_mapped
from sim.world.recording import recorded
from sim.world.scenario import LightName, Scenario

LIGHTS: tuple[LightName, ...] = ("night",)
SEVERITIES, SPACING_M = (3, 5), 2.0


def rows(args: argparse.Namespace) -> Iterator[str]:
    """What is believed on the way home when pictures become worse, and what the daemon says of its camera."""
    cases: list[tuple[LightName, int]] = [*product(LIGHTS, SEVERITIES)]
    yield f"| corruption | {' | '.join(f'{light}, {severity}' for light, severity in cases)} | wrong | camera at 5 |"
    yield "|---" * (len(cases) + 3) + "|"
    roads = {road: Scenario(road, poses.LENGTH_M) for road in args.seeds}
    maps = {road: MapSet.of(poses.mapped(args.cache, made, "rear")) for road, made in roads.items()}
    for name in ("none", *KINDS):
        believed, frames, wrong, said = Counter[object](), Counter[object](), 0, Counter[str]()
        for case, (road, map_set) in product(cases, maps.items()):
            feed = _home(args.cache, road, case[0])
            feed = Corruption(name, case[1]).feed(feed) if name in KINDS else feed
            score = judge(map_set, seen := recognize(map_set, feed, config_as_mapped(map_set.headers[0])), TOLERANCE_M)
            believed[case], frames[case] = believed[case] + int(score.believed.sum()), frames[case] + len(feed.rows)
            wrong += int((score.believed & ~score.answers.correct).sum())
            said += seen.faults if case[1] == SEVERITIES[-1] else Counter()
        shares = ((what.split()[-1], n * len(SEVERITIES) / sum(frames.values())) for what, n in said.most_common())
        words = ", ".join(f"{what} {share:.2f}" for what, share in shares) or "-"
        yield f"| {name} | {' | '.join(f'{believed[case] / frames[case]:.2f}' for case in cases)} | {wrong} | {words} |"
    yield f"\nMade by Lookback {__version__} on the roads {', '.join(map(str, args.seeds))}."


def _home(folder: Path, road: int, light: LightName) -> Feed:
    """The drive home in that light."""
    made = replace(poses.DRIVES["home"][1], seed=road, length_m=poses.LENGTH_M, light=light)
    return read_feed(recorded(made, folder, SPACING_M))
