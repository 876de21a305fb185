"""A recording through the recognizer that the daemon has: its answers, and how good they are by known positions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.camera.preprocessing import preprocessed_feed
from edge.config import Config
from edge.descriptor.network import Network
from edge.errors import FeedError, MapError
from edge.feed import Feed
from edge.geodesy import POSITION_SOURCES, east_north
from edge.journal.records import FrameUsed
from edge.recognition.recognizer import State, open_recognizer
from edge.reference_map import COST_ONE, MapSet
from edge.sequence import KeyframeMatch
from sim.evaluation.metrics import Answers, answers_within, precision_recall, recall_at_precision
from sim.evaluation.replay import config_for_feed, replay
from sim.traverse import check_origins

Value = str | int | float
DRAWN_PLACES = 4000
"""Costs are kept for maps of up to so many places: a matrix of 4,000 x 4,000 takes 64 MB, and no screen shows more."""

COLUMNS = (
    *("recording", "frames", "on the map", "precision", "recall"),
    *("recall at 100 %", "within twice", "error, m", "95 %, m"),
)


@dataclass(frozen=True)
class Recognition:
    """A recording's used frames and what the recognizer answered to each, in order.

    states: of the recognizer, after each frame. costs: (Q, N) cosine distance of each frame from each place, the better
    of the region orders; (Q, 0) where the map has more than DRAWN_PLACES places. keyframes: the keyframe match of each
    frame with the place that is believed, None where it has none or was not verified. faults: frames that show nothing,
    or do not move, by what the daemon says of its camera.
    """

    feed: Feed
    used: list[FrameUsed]
    states: list[State]
    costs: NDArray[np.float32]
    keyframes: Sequence[KeyframeMatch | None] = ()
    faults: Counter[str] = field(default_factory=Counter)

    @property
    def camera(self) -> str:
        """What the daemon says of its camera, each with the share of all frames."""
        return ", ".join(f"{what} {n / len(self.feed.rows):.2f}" for what, n in self.faults.most_common()) or "-"

    @property
    def believed(self) -> NDArray[np.bool_]:
        """(Q,): frames whose place is believed."""
        return np.array([one.accepted for one in self.used], dtype=bool)


def recognize(maps: MapSet, feed: Feed, config: Config, network: Network | None = None) -> Recognition:
    """Recognize one recording as `lookback run` does; the camera's view is the recording's. FeedError, MapError.

    network: instead of the one that the config names.
    """
    feed = preprocessed_feed(feed, config.camera)
    config = config_for_feed(config, feed)
    recognizer = open_recognizer(config, network=network, map_set=maps)
    search, places = recognizer.matcher.search, maps.index.places if maps.index.places <= DRAWN_PLACES else 0
    used: list[FrameUsed] = []
    states: list[State] = []
    keyframes: list[KeyframeMatch | None] = []
    costs, faults = [], Counter[str]()
    for one, match in replay(recognizer, feed, config.sampling, faults):
        used.append(one)
        keyframes.append(match.seen if match is not None and match.accepted else None)
        states.append(recognizer.state)
        newest = search.newest_costs.min(axis=0) / np.float32(COST_ONE)
        costs.append(newest if len(newest) == places else np.full(places, np.nan, np.float32))
    if not used and not faults:
        raise FeedError(f"{feed.path}: none of its pictures can be read")
    return Recognition(feed, used, states, np.array(costs, dtype=np.float32), keyframes, faults)


@dataclass(frozen=True)
class RecognitionScore:
    """A recording's frames that positions judge, of which `rows` are the indices among all used frames.

    Of a frame without a position, and of one whose place has none, nobody knows whether it is right: it is not here.
    believed (Q,) bool; error_m (Q,), NaN where no place was matched. within_twice: see `answers_within`.
    ahead_m: of the median believed place, from the vehicle in the direction of travel; NaN if there is none.
    truth_m (Q, 2), places_m (P, 2): meters east and north of one origin, places those with a position.
    """

    name: str
    rows: NDArray[np.intp]
    answers: Answers
    within_twice: Answers
    believed: NDArray[np.bool_]
    error_m: NDArray[np.float64]
    ahead_m: float
    truth_m: NDArray[np.float64]
    places_m: NDArray[np.float64]

    @property
    def precision(self) -> float:
        """Share of the believed frames that is right, NaN without any."""
        right = self.believed & self.answers.correct
        return float(right.sum() / self.believed.sum()) if self.believed.any() else float("nan")

    @property
    def recall(self) -> float:
        """Share of the frames on the map that is believed and right, NaN without any."""
        on_map = int(self.answers.has_truth.sum())
        return float((self.believed & self.answers.correct).sum() / on_map) if on_map else float("nan")

    def row(self) -> tuple[Value, ...]:
        """One row of COLUMNS."""
        errors_m = self.error_m[self.believed]
        return (
            self.name,
            len(self.believed),
            int(self.answers.has_truth.sum()),
            self.precision,
            self.recall,
            *(recall_at_precision(precision_recall(one), 1.0) for one in (self.answers, self.within_twice)),
            *(float(np.percentile(errors_m, share)) if errors_m.size else float("nan") for share in (50, 95)),
        )


def judge(maps: MapSet, seen: Recognition, tolerance_m: float) -> RecognitionScore:
    """Compare the answers with known positions. FeedError, MapError where there are none."""
    feed = seen.feed
    truth = [(feed.rows[one.frame].lat_deg, feed.rows[one.frame].lon_deg) for one in seen.used]
    if truth and all(lat_deg is None for lat_deg, _ in truth):
        raise FeedError(f"{feed.path}: no frame that is used has lat_deg and lon_deg, so nothing can be judged")
    places_deg = np.column_stack([maps.places["lat_deg"], maps.places["lon_deg"]])
    are_local = bool((maps.places["position_source"] == POSITION_SOURCES.index("local")).any())
    names = [segment.source for header in maps.headers for segment in header.segments]
    check_origins(feed, names, are_local=are_local)
    places_deg = places_deg[~np.isnan(places_deg).any(axis=1)]
    if not places_deg.size:
        raise MapError("no place of the map has a position, so nothing can be judged")
    is_known = [one.place is None or one.lat_deg is not None for one in seen.used]
    rows = np.flatnonzero([here is not None and known for (here, _), known in zip(truth, is_known, strict=True)])
    if truth and not rows.size:
        raise MapError("no place that a frame with a position is matched to has one, so nothing can be judged")
    used = [seen.used[row] for row in rows]
    truth_deg = np.array([truth[row] for row in rows], dtype=float).reshape(-1, 2)
    found_deg = np.array([(one.lat_deg, one.lon_deg) for one in used], dtype=float).reshape(-1, 2)  # None becomes NaN
    east_north_m = east_north(*np.concatenate([truth_deg, found_deg, places_deg]).T)
    truth_m, found_m, places_m = np.split(east_north_m, [len(used), 2 * len(used)])
    on_map = np.array([np.hypot(*(places_m - one).T).min() <= tolerance_m for one in truth_m], dtype=bool)
    error_m = np.hypot(*(found_m - truth_m).T)
    confidence = np.array([one.confidence for one in used], dtype=float)
    believed = seen.believed[rows]
    heading_rad = np.radians(np.array([one.heading_deg for one in used], dtype=float))
    ahead_m = np.einsum("nd,nd->n", found_m - truth_m, np.column_stack([np.sin(heading_rad), np.cos(heading_rad)]))
    return RecognitionScore(
        feed.header.name,
        rows,
        Answers(confidence, on_map & (error_m <= tolerance_m), on_map),
        answers_within(confidence, error_m, on_map, 2 * tolerance_m),
        believed,
        error_m,
        float(np.median(ahead_m[believed])) if believed.any() else float("nan"),
        truth_m,
        places_m,
    )
