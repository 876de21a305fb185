"""How far the place belief can be trusted: simulated worlds, front against rear, all of the road mapped or part of it.

    python -m sim.research.evaluation.belief --seeds 911 923 --cache FOLDER [--page docs/evaluation.md]

Each world is driven once with the rear camera by day (the map), and both ways with the front camera by night, dusk, day
and snow. Descriptors are kept in FOLDER: rendering takes minutes, all that follows seconds. A match lies ahead of the
vehicle by the rig's offset, which is measured on another drive of the same direction (by day; by dusk for the day), as
is the parallax of the lane home.
Believed frames of the other seeds' drives, whose road is on no map, are counted below the table.
--page writes all of it between the marks of a page.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from itertools import permutations, product
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, Config, DescriptorConfig, RigConfig, SamplingConfig
from edge.descriptor.network import Network, pictures_for
from edge.feed import View
from edge.reference_map import MapSet, ModelKey
from edge.sequence import Direction, Travel
from edge.sequence_matcher import SequenceMatcher
from edge_plugins.mapping.builder import NAN, Place
from sim.calibration.sightings import lag_places
from sim.compare.scores import at_threshold, joined
from sim.compare.temporary_map import MappedDrive, temporary_map
from sim.evaluation.metrics import Answers, answers_within, precision_recall, recall_at_precision
from sim.research.evaluation.tables import options, publish
from sim.world.camera import open_renderer
from sim.world.recording import times_by_distance
from sim.world.scenario import LightName, Scenario

LIGHTS: tuple[LightName, ...] = ("night", "dusk", "day", "snow")
DIRECTIONS: tuple[Direction, ...] = ("forward", "reverse")
SPACING_M = 2.0
DEFAULT_SAMPLING = SamplingConfig(spacing_m=SPACING_M)
TOLERANCE_M = 40.0
HOME_LEFT_M = 3.5  # of the map's drive is the lane home
FIRST_FRAME = 16  # the first that can have an answer
Cut = Literal["whole", "first half", "second half", "thirds"]
CUTS: tuple[Cut, ...] = ("whole", "first half", "second half", "thirds")
M_PER_DEG = 110_574.0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Described:
    """A drive: raw descriptors (n, R, D), and of each frame the meters along the route and those driven (n,)."""

    raw: NDArray[np.float32]
    route_m: Floats
    driven_m: Floats


Drives = dict[tuple[LightName, Direction], Described]
World = tuple[Described, Drives]
"""A road as the rear camera saw it by day, and what the front camera saw on it."""


@dataclass(frozen=True)
class Beliefs:
    """Of each frame (n,): where it is believed to be, with which confidence, and the same of its best match alone.

    lag_m: meters by which the left region lags behind the right one, NaN where they do not say.
    """

    along_m: Floats
    confidence: Floats
    match_m: Floats
    uniqueness: Floats
    lag_m: Floats


@cache
def _network() -> Network:
    return Network.load()


def described(
    scenario: Scenario, folder: Path, spacing_m: float = SPACING_M, network: Network | None = None
) -> Described:
    """Render a drive at each spacing_m and describe it, by fc6 unless another is given, unless `folder` has it."""
    road = f"{scenario.seed}_{scenario.length_m:g}m_{spacing_m:g}m"
    name = f"{road}_{scenario.view}_{scenario.direction}_{scenario.light}_{scenario.drive_seed}.npz"
    if network is not None and network.info.sha256 != _network().info.sha256:
        name = f"{network.info.sha256[:12]}_{name}"
    if not (folder / name).exists():
        drive, network = scenario.drive(), network or _network()
        times_s = times_by_distance(drive, spacing_m)
        renderer = open_renderer(scenario, drive)
        images = (renderer.render(drive.pose(time_s, 0.0), time_s) for time_s in times_s)
        raw = np.stack([network.describe(pictures_for(network.info, one, "left-right", 0.4)) for one in images])
        renderer.close()
        route_m, driven_m = [drive.route_m(time_s) for time_s in times_s], [drive.distance_m(t) for t in times_s]
        np.savez(folder / name, raw=raw, route_m=route_m, distance_m=driven_m)
    stored = np.load(folder / name)
    return Described(stored["raw"], stored["route_m"], stored["distance_m"])


def kept(cut: Cut, places: int) -> list[tuple[int, int]]:
    """Which places [start, end) of the map are left."""
    half, third = places // 2, places // 3
    return {
        "whole": [(0, places)],
        "first half": [(0, half)],
        "second half": [(half, places)],
        "thirds": [(0, third), (2 * third, places)],
    }[cut]


@contextmanager
def mapped(road: Described, cut: Cut, view: View = "rear", *, to_north: bool = False) -> Iterator[MapSet]:
    """The map of a part of the road; view: where its camera looked. to_north: along a meridian, else nobody knows."""
    places = [
        Place(row, route_m / M_PER_DEG if to_north else NAN, 0.0 if to_north else NAN, route_m=route_m)
        for row, route_m in enumerate(road.route_m.tolist())
    ]
    drives = [
        MappedDrive(road.raw[start:end].astype(np.float32), places[start:end], view)
        for start, end in kept(cut, len(places))
    ]
    with temporary_map(drives, ModelKey("cached", "0" * 64, "fc6", road.raw.shape[2]), DescriptorConfig()) as maps:
        yield maps


def believe(
    road: Described,
    query: Described,
    cut: Cut,
    odometer_scale: float | None = 1.0,
    *,
    rig: RigConfig | None = None,
    sampling: SamplingConfig = DEFAULT_SAMPLING,
) -> Beliefs:
    """What is believed, frame by frame, on a drive over a road of which a part is mapped.

    odometer_scale: what it reads for each meter, None without one.
    """
    # Without a rig there is no lane, but any parallax, so that it is measured.
    config = Config(rig=rig or RigConfig(parallax=1.0), sampling=sampling)
    found = np.full((len(query.raw), 5), np.nan)
    found[:, 1] = found[:, 3] = 0.0
    with mapped(road, cut) as map_set:
        matcher, route_m = SequenceMatcher(map_set, config), map_set.places["route_m"]
        for frame, (raw, driven_m) in enumerate(zip(query.raw.astype(np.float32), query.driven_m, strict=True)):
            travel = Travel(None if odometer_scale is None else float(driven_m) * odometer_scale)
            match = matcher.push(raw, travel)
            if match is not None and match.confidence > 0:
                found[frame, :2] = route_m[match.place_index], match.confidence
            if match is not None and match.parallax is not None:
                found[frame, 4] = lag_places(match.parallax) * SPACING_M
            if matcher.best is not None and frame >= config.sequence_frames - 1:
                found[frame, 2:4] = route_m[matcher.best.place_index], matcher.best.uniqueness
    return Beliefs(*found.T)


def offset_m(query: Described, whole: Beliefs) -> float:
    """Meters of the route by which unique matches lie beyond the vehicle."""
    unique = whole.uniqueness >= AcceptanceConfig().uniqueness_min
    return float(np.median((whole.match_m - query.route_m)[unique]))


def rig_of(way: Direction, ahead_m: float, whole: Beliefs) -> RigConfig:
    """As `calibrate` would write it; ahead_m: as `offset_m` has it."""
    if way == "forward":
        return RigConfig(ahead_forward_swapped_m=ahead_m)
    is_known = whole.confidence >= AcceptanceConfig().confidence_from
    parallax = float(np.nanmedian(whole.lag_m[is_known])) / HOME_LEFT_M
    return RigConfig(ahead_reverse_same_m=-ahead_m, left_reverse_m=HOME_LEFT_M, parallax=max(0.0, parallax))


@dataclass(frozen=True)
class Judged:
    """Answers by belief and by uniqueness alone, and meters driven on each part of the map before it is believed."""

    belief: Answers
    uniqueness: Answers
    first_m: list[float]


def judge(query: Described, mapped_m: Floats, beliefs: Beliefs, ahead_m: float) -> Judged:
    """Frames beyond the map's end by less than the tolerance count if they are wrong, and not if they are right."""
    true_m = query.route_m + ahead_m
    on_map = np.abs(mapped_m - true_m[:, np.newaxis]).min(axis=1) <= SPACING_M
    right = np.abs(beliefs.along_m - true_m) <= TOLERANCE_M
    believed = right & (beliefs.confidence >= AcceptanceConfig().confidence_from)
    edges = np.flatnonzero(np.diff(on_map, prepend=False, append=False))
    first_m = [
        float(query.driven_m[enter + believed[enter:leave].argmax()] - query.driven_m[enter])
        if believed[enter:leave].any()
        else np.inf
        for enter, leave in zip(edges[::2], edges[1::2], strict=True)
    ]
    belief = _answers(beliefs.confidence, np.abs(beliefs.along_m - true_m), on_map)
    uniqueness = _answers(beliefs.uniqueness, np.abs(beliefs.match_m - true_m), on_map)
    return Judged(belief, uniqueness, first_m)


def _answers(confidence: Floats, error_m: Floats, on_map: NDArray[np.bool_]) -> Answers:
    counted = slice(FIRST_FRAME, None)
    answered = np.where(confidence > 0, confidence, np.nan)
    return answers_within(answered[counted], error_m[counted], on_map[counted], TOLERANCE_M)


def worlds(seeds: list[int], length_m: float, folder: Path) -> Iterator[World]:
    """The road of each seed as the rear camera saw it, and the drives on it."""
    for seed in seeds:
        scene = partial(Scenario, seed=seed, length_m=length_m)
        drives = {}
        for drive_seed, (light, way) in enumerate(product(LIGHTS, DIRECTIONS), start=2):
            drives[light, way] = described(scene(light=light, direction=way, drive_seed=drive_seed), folder)
        yield described(scene(view="rear", drive_seed=1), folder), drives


def judge_world(road: Described, drives: Drives) -> Iterator[tuple[Cut, Judged]]:
    """Each drive over the road with each part of it mapped."""
    alone = {name: believe(road, drive, "whole") for name, drive in drives.items()}
    for cut, ((light, way), drive) in product(CUTS, drives.items()):
        other: tuple[LightName, Direction] = ("dusk" if light == "day" else "day", way)
        ahead_m = offset_m(drives[other], alone[other])
        beliefs = believe(road, drive, cut, rig=rig_of(way, ahead_m, alone[other]))
        mapped_m = np.concatenate([road.route_m[start:end] for start, end in kept(cut, len(road.raw))])
        yield cut, judge(drive, mapped_m, beliefs, ahead_m)


def _row(cut: Cut, judged: list[Judged]) -> str:
    cells = []
    acceptance = AcceptanceConfig()
    for kind, threshold in (("uniqueness", acceptance.uniqueness_min), ("belief", acceptance.confidence_from)):
        answers: list[Answers] = [getattr(one, kind) for one in judged]
        at_100 = np.mean([recall_at_precision(precision_recall(one), 1.0) for one in answers])
        precision, recall = at_threshold(joined(answers), threshold)
        cells.append(f"{at_100:.2f} / {precision:.4f} / {recall:.2f}")
    first_m, again_m = ([one.first_m[part] for one in judged if len(one.first_m) > part] for part in (0, 1))
    again = f"{np.median(again_m):.0f} m" if again_m else "-"
    return f"| {cut} | {' | '.join(cells)} | {np.median(first_m):.0f} m | {again} |"


def main() -> None:
    """Print a table for the seeds: R@P100, precision and recall at the default, and the first belief."""
    args = options(__doc__, 1000.0).parse_args()
    publish("belief", tables(list(worlds(args.seeds, args.length, args.cache))), args.page)


def tables(seen: Sequence[World]) -> Iterator[str]:
    """Each part of the roads mapped, and drives over roads that are on no map."""
    judged: dict[Cut, list[Judged]] = {cut: [] for cut in CUTS}
    for road, drives in seen:
        for cut, one in judge_world(road, drives):
            judged[cut].append(one)
    yield "| mapped | uniqueness: R@P100 / precision / recall | belief: the same | first belief | on the second part |"
    yield "|---|---|---|---|---|"
    yield from (_row(cut, judged[cut]) for cut in CUTS)
    foreign = foreign_confidence(seen)
    believed, most = foreign >= AcceptanceConfig().confidence_from, foreign.max(initial=0.0)
    km = (len(seen) - 1) * sum(drive.driven_m[-1] for _, drives in seen for drive in drives.values()) / 1000
    what = f"{believed.sum()} of {len(foreign)} frames are believed, at most by {most:.3f}"
    yield f"\nOn {km:.0f} km of other roads {what}."


def foreign_confidence(seen: Sequence[World]) -> Floats:
    """The confidence of each frame of each drive on the map of every other road."""
    found = [
        believe(road, drive, "whole").confidence
        for (road, _), (_, drives) in permutations(seen, 2)
        for drive in drives.values()
    ]
    return np.concatenate([np.zeros(0), *found])


if __name__ == "__main__":
    main()
