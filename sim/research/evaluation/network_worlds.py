"""Networks side by side on simulated roads, as `lookback run` matches and believes: what `belief` measures, by light.

    python -m sim.research.evaluation.network_worlds --seeds 6113 6221 7109 7213 --networks fc6 grid --cache FOLDER \\
        [--page docs/networks.md]

A rear camera maps each road by day. A front camera drives it the same way by dusk, night, rain and snow, home by dusk
and night, and both ways by day, which only gives the rig's offset. Each network has a map, an offset and a process of
its own; all else is the same. Drives over the other roads, which are on no map, are counted below the table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from edge.config import AcceptanceConfig
from edge.descriptor.network import Network
from edge.sequence import Direction
from sim.compare.scores import at_threshold, joined
from sim.research.evaluation.belief import (
    DIRECTIONS,
    Cut,
    Described,
    Floats,
    Judged,
    World,
    believe,
    described,
    foreign_confidence,
    judge,
    kept,
    offset_m,
    rig_of,
)
from sim.research.evaluation.tables import options, publish
from sim.world.scenario import LightName, Scenario

CALIBRATION: LightName = "day"
LIGHTS: Mapping[Direction, tuple[LightName, ...]] = {
    "forward": ("dusk", "night", "rain", "snow"),
    "reverse": ("dusk", "night"),
}
CUTS: tuple[Cut, ...] = ("whole", "first half")
WAYS: Mapping[Direction, str] = {"forward": "same way", "reverse": "home"}
Case = tuple[Direction, Cut, LightName]


def world(seed: int, length_m: float, folder: Path, network: Network) -> World:
    """A road as the rear camera saw it by day, and what the front camera saw in each light and direction."""
    scene = partial(Scenario, seed=seed, length_m=length_m)
    drives = {
        (light, way): described(scene(light=light, direction=way, drive_seed=drive_seed), folder, network=network)
        for drive_seed, (light, way) in enumerate(product((CALIBRATION, *LIGHTS["forward"]), DIRECTIONS), start=2)
        if light in (CALIBRATION, *LIGHTS[way])
    }
    return described(scene(view="rear", drive_seed=1), folder, network=network), drives


def judged_world(seen: World) -> Iterator[tuple[Case, Judged]]:
    """Each drive on the whole map and on half of it."""
    road, drives = seen
    for way in DIRECTIONS:
        calibration = drives[CALIBRATION, way]
        alone = believe(road, calibration, "whole")
        ahead_m = offset_m(calibration, alone)
        for cut, light in product(CUTS, LIGHTS[way]):
            beliefs = believe(road, drives[light, way], cut, rig=rig_of(way, ahead_m, alone))
            yield (way, cut, light), judge(drives[light, way], _mapped_m(road, cut), beliefs, ahead_m)


def _mapped_m(road: Described, cut: Cut) -> Floats:
    return np.concatenate([road.route_m[start:end] for start, end in kept(cut, len(road.raw))])


def cell(judged: Sequence[Judged]) -> str:
    """Recall of each road at the default threshold, and the first belief, median."""
    recalls = [at_threshold(one.belief, AcceptanceConfig().confidence_from)[1] for one in judged]
    first_m = float(np.median([one.first_m[0] for one in judged]))
    return f"{', '.join(f'{recall:.2f}' for recall in recalls)}; {first_m:.0f} m"


@dataclass(frozen=True)
class Roads:
    """What one network is measured on: the roads of these seeds, whose descriptors `folder` keeps."""

    network: str
    seeds: tuple[int, ...]
    length_m: float
    folder: Path

    def seen(self) -> list[World]:
        """Each road, and the drives on it."""
        network = Network.load(Path(self.network))
        return [world(seed, self.length_m, self.folder, network) for seed in self.seeds]

    def judged(self) -> list[dict[Case, Judged]]:
        """Of each road."""
        return [dict(judged_world(one)) for one in self.seen()]

    def foreign(self) -> Floats:
        """The confidence of each frame of each drive on the map of every other road."""
        return foreign_confidence(self.seen())


def rows(networks: Sequence[Roads]) -> Iterator[str]:
    """A table with a column for each network, and what each believes on roads that are on no map."""
    with ProcessPoolExecutor(len(networks), mp_context=get_context("spawn")) as pool:
        found, foreign = pool.map(Roads.judged, networks), pool.map(Roads.foreign, networks)
        roads = dict(zip([one.network for one in networks], found, strict=True))
        yield f"| drive, part of the road mapped | {' | '.join(roads)} |"
        yield "|" + "---|" * (len(roads) + 1)
        for way, cut in product(DIRECTIONS, CUTS):
            for light in LIGHTS[way]:
                cells = [cell([one[way, cut, light] for one in of_network]) for of_network in roads.values()]
                yield f"| {WAYS[way]}, {light}, {cut} | {' | '.join(cells)} |"
        yield ""
        for (name, of_network), confidence in zip(roads.items(), foreign, strict=True):
            answers = joined([judged.belief for one in of_network for judged in one.values()])
            precision, _ = at_threshold(answers, AcceptanceConfig().confidence_from)
            believed = int((confidence >= AcceptanceConfig().confidence_from).sum())
            yield (
                f"- {name}: precision {precision:.4f}; on roads that are on no map {believed} of {len(confidence)}"
                f" frames are believed, the highest confidence is {confidence.max(initial=0.0):.3f}."
            )


def main() -> None:
    """Print the table, or write it into a page."""
    parser = options(__doc__, 1000.0)
    parser.add_argument("--networks", nargs="+", default=["fc6", "grid"], help="names, files or folders of networks")
    args = parser.parse_args()
    networks = [Roads(name, tuple(args.seeds), args.length, args.cache) for name in args.networks]
    publish("worlds", rows(networks), args.page)


if __name__ == "__main__":
    main()
