"""What `lookback run` does on a drive: the recognizer's own matcher, on a map as `lookback map build` makes it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, CameraConfig, Config, SequenceConfig
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.reference_map import ModelKey
from edge.sequence import MotionPrior, PlaceMatch
from edge_plugins.mapping.builder import NAN, Place
from sim.compare.matching import Matches, OfFrame, gathered, line_ranking, no_match
from sim.compare.plan import Pair
from sim.compare.temporary_map import MappedDrive, temporary_map
from sim.compare.traverses import MethodTraverse

Raw = NDArray[np.float32]


def config_of(pair: Pair, reference: MethodTraverse, query: MethodTraverse, sequence: SequenceConfig) -> Config:
    """The configuration of a vehicle on this pair; places within twice the tolerance are the same place."""
    steps_m = np.diff(reference.distance_m)
    steps_m = steps_m[~np.isnan(steps_m)]
    in_meters = pair.truth in ("positions", "route_m") or not steps_m.size
    window = 2 * pair.tolerance
    return Config(
        camera=CameraConfig(view=query.feed.header.view),
        sampling=query.sampling,
        sequence=sequence,
        acceptance=AcceptanceConfig(
            window_m=window if in_meters else window * float(steps_m.mean()), window_places=max(1, round(window))
        ),
    )


def match_as_run(
    reference: MethodTraverse,
    query: MethodTraverse,
    described: tuple[Raw, Raw],
    config: Config,
    model: ModelKey,
    answer: Literal["belief", "uniqueness"],
) -> Matches:
    """The places that are believed with their confidence, or the best line of each frame with its uniqueness.

    described: raw descriptors (N, R, D) of the reference and (Q, R, D) of the query. Each drive of the query is a new
    sequence; the statistics go on.
    """
    mapped, raw = described
    places = _places(reference)
    drives = [MappedDrive(mapped[one], places[one], reference.feed.header.view) for one in reference.drives()]
    starts = {drive.start for drive in query.drives()}
    travel = [
        MotionPrior(None if np.isnan(distance_m) else distance_m, missed=missed)
        for distance_m, missed in zip(query.distance_m.tolist(), query.missed.tolist(), strict=True)
    ]
    return run_on(drives, raw, travel, starts, config, model, answer)


def run_on(
    drives: Sequence[MappedDrive],
    raw: Raw,
    travel: Sequence[MotionPrior],
    starts: Collection[int],
    config: Config,
    model: ModelKey,
    answer: Literal["belief", "uniqueness"],
) -> Matches:
    """The same on drives of a map. raw: (Q, R, D); travel: of each frame; starts: frames that begin a drive."""
    found = []
    with temporary_map(drives, model) as map_set:
        matcher = SequenceMatcher(map_set, config)
        for frame, moved in enumerate(travel):
            if frame in starts:
                matcher.reset()
            believed = matcher.push(raw[frame], moved)
            match = believed if answer == "belief" else matcher.best
            found.append(_found(matcher, match, answer))
        assert matcher.search.part is not None  # these maps are searched whole
    matches = gathered(found, matcher.search.part.neighborhood)
    return matches if answer == "uniqueness" else replace(matches, ranking=np.zeros((0, 0)))


def _found(matcher: SequenceMatcher, match: PlaceMatch | None, answer: str) -> OfFrame:
    newest = matcher.search.newest_costs.min(axis=0).astype(np.float32)
    part = matcher.search.part
    if match is None or part is None or part.lines is None:
        return no_match(newest)
    confidence = match.confidence if answer == "belief" else match.uniqueness
    return match.place_index, confidence, match.direction == "reverse", newest, line_ranking(part.lines)


def _places(reference: MethodTraverse) -> list[Place]:
    def known(value: float | None) -> float:
        return NAN if value is None else value

    rows = zip(reference.feed_rows(), reference.distance_m.tolist(), strict=True)
    return [
        Place(
            number,
            lat_deg=known(row.lat_deg),
            lon_deg=known(row.lon_deg),
            route_m=distance_m,
            position_sigma_m=known(row.position_sigma_m),
            position_source=row.position_source,
        )
        for number, (row, distance_m) in enumerate(rows)
    ]
