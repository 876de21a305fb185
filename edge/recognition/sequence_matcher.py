"""Raw descriptors in, matches out: online normalization, costs, sequence search, and the place belief.

raw descriptor (R, D) -> online NSD -> cost row -> best match -> vote -> PlaceConsensus -> belief
                            also of half a sequence, with a dead reckoning position on the map
picture, of a map with keypoints ----> candidates ---------------> KeyframeMatcher -----> belief

    matcher = SequenceMatcher(map_set, config)
    matches = [matcher.push(raw) for raw in descriptors]  # each raw is (R, D) float32
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor import RunningStatistics
from edge.descriptor.normalize import OnlineNormalizer
from edge.feed.sampling import Steps, spell_spacing
from edge.reference_map import Drives, MapSet
from edge.sequence import NOTHING_KNOWN, Correspondences, DeadReckoningPosition, MotionPrior, PlaceMatch
from edge.sequence.consensus import AwayOf, ConsensusSettings, PlaceBelief, PlaceConsensus, PlaceVote
from edge.sequence.place_search import NearestOf, PlaceSearch
from edge.sequence.prior import Prior

if TYPE_CHECKING:
    from edge.keypoints.intrinsics import CameraDifference
    from edge.keypoints.network import KeypointNetwork
    from edge.recognition.keyframe_matcher import KeyframeMatcher
    from edge.recognition.structure_matcher import StructureMatcher

PriorOf: TypeAlias = Callable[[int, float], float]
"""The odds of being at a point along a drive."""
MAP_COUNTS_AS = 20
"""Frames that the map's statistics count as when the query's begin; after 100 frames they are a sixth."""
WAY_OUT_COUNTS_AS = 50
"""Frames that the way out's statistics count as on the way back, at most. In 40 starts on each of four simulated roads,
11 % more of the first 120 frames were believed than with the map's statistics, and none wrong; with 100 frames 13 %.
Where the light changed at the turn, 2 % more were (two roads); with 100 frames fewer positions came in the trial."""
MOST_MISSED = 0.5
"""Share of a sequence; if more of it was driven without a frame, a new sequence begins."""

Stopwatch = Callable[[str], None]


def no_stopwatch(stage: str) -> None:
    """Measure nothing."""


class SequenceMatcher:
    """The online statistics, the ring, its best sequence match, and the place that the matches agree on."""

    _drives: Drives

    def __init__(self, map_set: MapSet, config: Config, stopwatch: Stopwatch = no_stopwatch) -> None:
        """`stopwatch(stage)` is called after each stage of a frame."""
        self._config, self._stopwatch = config, stopwatch
        self._normalizer = OnlineNormalizer(config.sequence_frames)
        self._steps = Steps(config.sampling)
        self._keypoints: KeypointNetwork | None = None
        self.use_maps(map_set)
        self._begin_statistics()

    def use_maps(self, map_set: MapSet) -> None:
        """Search these maps from now on, beginning a new sequence; the normalization's statistics stay."""
        self.search = PlaceSearch(map_set, self._config, self._stopwatch)
        self._normalizer.clear_ring()
        self.best: PlaceMatch | None = None
        """The best sequence match of the newest frame, wherever the place is believed (eq. 3, the paper's answer)."""
        self._drives = Drives(map_set, self._config.sampling.spacing_m)
        self._unmeasured: int | None = 0  # frames of this sequence, as long as none had a known distance
        self._begin_consensus()
        self._keyframes = self._open_keyframes(map_set)
        self._structure = self._open_structure(map_set)

    def _open_structure(self, map_set: MapSet) -> StructureMatcher | None:
        if not self._config.sequence.structure or self._keyframes is None:
            return None
        from edge.recognition.structure_matcher import StructureMatcher

        keyframes = self._keyframes
        return StructureMatcher(map_set, self._config, lambda: keyframes.verification.network)

    def _open_keyframes(self, map_set: MapSet) -> KeyframeMatcher | None:
        """None where no map has keypoints, which needs none of their code."""
        if all(header.keypoints_key is None for header in map_set.headers):
            return None
        from edge.recognition.keyframe_matcher import KeyframeMatcher

        return KeyframeMatcher(map_set, self._drives, self._config, self._keypoints)

    def grow(self, map_set: MapSet) -> None:
        """Search a set from now on that has further places after those of the last one; between two frames."""
        was_metric = self._drives.is_metric
        self.search.grow(map_set, self._normalizer.rows)
        self._drives = Drives(map_set, self._config.sampling.spacing_m)
        if self._keyframes is not None:
            self._keyframes.grow(map_set, self._drives)
        else:  # the map of this drive has its first places
            self._keyframes = self._open_keyframes(map_set)
        self._structure = self._structure or self._open_structure(map_set)
        if self._structure is not None:
            self._structure.grow(map_set)
        if self._drives.is_metric != was_metric:  # lengths have another unit
            self._begin_consensus()

    def _begin_consensus(self) -> None:
        settings = ConsensusSettings.of(self._config, self._drives, self._usual_step)
        self._consensus = PlaceConsensus(settings, self._positions_m)
        self._of_halves = PlaceConsensus(settings.of_halves(), self._positions_m)

    def _begin_statistics(self) -> None:
        """Start with the statistics of the map, with the weight of some frames.

        A mean over the first frames alone would remove most of what they show, since they show the same piece of road.
        """
        places = self.map_set.index.places
        if places:
            mean, deviation = self.map_set.statistics()
            self.begin_with(RunningStatistics.of_another_run(places, mean, deviation, at_most=MAP_COUNTS_AS))

    def begin_with(self, statistics: RunningStatistics) -> None:
        """Start with an earlier run's statistics, of this network and these regions."""
        self._normalizer.begin_with(statistics)

    @property
    def statistics(self) -> RunningStatistics | None:
        """Of all raw descriptors so far, after the map's; None before the first."""
        return self._normalizer.statistics

    @property
    def is_scanning(self) -> bool:
        """Whether there are enough frames for a sequence, and it is not known yet which part of the map to search."""
        return self.search.part is None and self._normalizer.is_full

    @property
    def has_lines(self) -> bool:
        """Whether there are enough frames for an answer, even if it is that no road leads where the vehicle goes."""
        return self.search.part is not None and self.search.part.lines is not None

    @property
    def map_set(self) -> MapSet:
        """The maps that are searched."""
        return self.search.map_set

    @property
    def _usual_step(self) -> float:
        return self._steps.usual(self._drives.spacing_m)

    def _positions_m(self, drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._drives.positions_m(drives, along_m)

    def push(
        self, raw: NDArray[np.float32], travel: MotionPrior = NOTHING_KNOWN, image: NDArray[np.uint8] | None = None
    ) -> PlaceMatch | None:
        """Match one raw descriptor (R, D); None while too few came, or a large map is still being scanned.

        image: (H, W, 3) uint8 BGR, where what its keypoints say counts as well.
        """
        if image is not None and self._keyframes is not None:
            self._keyframes.verification.lens.add(image)
        odometer_m = travel.distance_m if self._drives.is_metric else None
        if travel.distance_m is not None:  # also of a map that knows no meters, as before its first place
            self._unmeasured = None
        elif self._unmeasured is not None:
            self._unmeasured += 1
        if odometer_m is None and self.needs_odometer:
            self.best = None
            return None
        step, usual = self._steps.next(odometer_m, travel.missed, self._drives.spacing_m), self._usual_step
        if step > (1 + MOST_MISSED * self._config.sequence_frames) * usual:  # too long for one sequence
            self.reset()
        self.best = self._best_line(raw, travel, step, usual, is_measured=odometer_m is not None)
        some_excluded = self.search.part is not None and self.search.part.excludes
        settings = ConsensusSettings.of(self._config, self._drives, usual, some_excluded=some_excluded)
        self._consensus.settings, self._of_halves.settings = settings, settings.of_halves()
        prior = self._prior(travel.dead_reckoning)
        structure = None
        if self._structure is not None and image is not None:
            structure = self._vote(self._structure.add(image, travel.moved_m))
            self._stopwatch("structure")
        belief = self._consensus.update(self._vote(self.best), odometer_m, step, *(prior or ()), structure=structure)
        both = belief, self._belief_of_halves(odometer_m, step, prior)
        belief = max(filter(None, both), key=lambda one: one.confidence, default=None)
        if image is not None and self._keyframes is not None and self._keyframes.is_due(self._consensus.driven_m):
            self._verify(image, travel, self.search.nearest)
        believed = self._believed(self.best, belief, prior)
        self._follow(believed)
        self._stopwatch("belief")
        if self._structure is not None and image is not None:
            matched = self._structure.match(believed)
            self._stopwatch("structure")
            believed = believed and replace(believed, structure=matched)
        return believed

    def _belief_of_halves(
        self, odometer_m: float | None, step: float, prior: tuple[Prior, AwayOf] | None
    ) -> PlaceBelief | None:
        """By the votes of half sequences, which count only with a prior by dead reckoning; else none is searched."""
        if prior is None:
            self._of_halves.reset()
            return None
        return self._of_halves.update(self._vote(self.search.shorter), odometer_m, step, *prior)

    def _vote(self, line: PlaceMatch | None) -> PlaceVote | None:
        return PlaceVote.of(line, self._drives, self._config.rig) if line else None

    def verify_again(
        self, image: NDArray[np.uint8], raw: NDArray[np.float32], travel: MotionPrior
    ) -> PlaceMatch | None:
        """A further picture (H, W, 3) uint8 BGR from where the newest frame was, for its keypoints alone.

        raw: its descriptor (R, D), by which places to try are chosen: what stood before the camera may be gone.
        """
        self._verify(image, travel, partial(self.search.nearest, row=self._normalizer.normalized(raw)))
        believed = self._believed(None, None, self._prior(travel.dead_reckoning))
        self._follow(believed)
        return believed

    def _verify(self, image: NDArray[np.uint8], travel: MotionPrior, nearest: NearestOf) -> None:
        if self._keyframes is not None:
            driven = self._consensus.driven_m, self._consensus.uncertain_m
            self._keyframes.verify(image, nearest, travel, *driven)
            self._stopwatch("keypoints")

    @property
    def lens(self) -> str:
        """What is wrong with the camera by its pictures, "" if nothing is known to be; of a map with keypoints."""
        return "" if self._keyframes is None else self._keyframes.verification.lens.word

    @property
    def was_carried(self) -> bool:
        """See `KeyframeMatcher`; until the next reset."""
        return self._keyframes is not None and self._keyframes.was_carried

    @property
    def may_verify(self) -> bool:
        """Whether the maps have keypoints that compare with those of a picture."""
        return self._keyframes is not None and self._keyframes.verification.is_possible

    @property
    def correspondences(self) -> Correspondences | None:
        """The points by which the newest frame shows a place; None where it does not, or was not verified."""
        return None if self._keyframes is None else self._keyframes.correspondences

    @property
    def camera(self) -> CameraDifference | None:
        """What keypoints said of the vehicle's camera, once they are enough."""
        return None if self._keyframes is None else self._keyframes.verification.camera

    def use_keypoints(self, network: KeypointNetwork) -> None:
        """Find keypoints by this network, not by one of its own."""
        self._keypoints = network
        if self._keyframes is not None:
            self._keyframes.verification.network = network

    def _best_line(
        self, raw: NDArray[np.float32], travel: MotionPrior, step: float, usual: float, *, is_measured: bool
    ) -> PlaceMatch | None:
        """The best sequence match after one raw descriptor (R, D), wherever it is (eq. 3, the paper's answer).

        step, usual, is_measured: see `PlaceSearch.push`.
        """
        change = self._normalizer.push(raw)
        self._stopwatch("normalization")
        ring = self._normalizer.rows
        match = self.search.push(change, ring, travel, step=step, usual=usual, is_measured=is_measured)
        self._stopwatch("search")
        return match

    def _prior(self, reckoned: DeadReckoningPosition | None) -> tuple[Prior, AwayOf] | None:
        """What is known of where the vehicle is without any place."""
        part = self.search.part
        if reckoned is None or part is None:
            return None
        from_deg = reckoned.lat_deg, reckoned.lon_deg
        return Prior(reckoned.sigma_m, part.squares_m2(*from_deg)), partial(self._drives.away_m, from_deg=from_deg)

    def _believed(
        self, match: PlaceMatch | None, votes: PlaceBelief | None, prior: tuple[Prior, AwayOf] | None
    ) -> PlaceMatch | None:
        """The match at the place that is believed, with what pictures and odometer say alone.

        match, votes: the best sequence match, and the votes' belief with the prior; None where there is none yet.
        """
        by_votes = None if match is None else self._consensus.by_votes
        alone = self._answer(by_votes, None, match)
        if votes is by_votes and (prior is None or self._keyframes is None):
            return alone
        both = self._answer(votes, None if prior is None else partial(_odds, *prior), match, alone)
        if both is None:
            return alone
        return replace(both, by_votes=alone or replace(both, confidence=0.0, accepted=False, seen=None))

    def _answer(
        self, votes: PlaceBelief | None, prior_of: PriorOf | None, *lines: PlaceMatch | None
    ) -> PlaceMatch | None:
        """The match at the place that votes and keyframe matches together make most probable."""
        if self._keyframes is None:
            return self._match_of(votes, *lines)
        answer = self._keyframes.answer(votes, prior_of, self._consensus.driven_m, self._consensus.settings.slack_m)
        found = answer.match or self._match_of(answer.votes, *lines)
        return found if found is None or answer.seen is None else replace(found, seen=answer.seen)

    def _follow(self, believed: PlaceMatch | None) -> None:
        """Search and verify around the believed place from the next frame on; None or unbelieved: anywhere."""
        at = believed if believed is not None and believed.accepted else None
        self.search.follow(at.place_index if at else None)
        if self._keyframes is not None:
            driven = self._consensus.driven_m, self._consensus.uncertain_m
            self._keyframes.follow(at, *driven, self._consensus.settings.slack_m)

    def _match_of(self, belief: PlaceBelief | None, *lines: PlaceMatch | None) -> PlaceMatch | None:
        """A match that ends at the place that the recent ones agree on: the first of some, else the best of all.

        Where nothing is believed, or none ends there, the first of them as it is.
        """
        if belief is None or lines[0] is None:
            return lines[0]
        first, end = self._drives.places_within(belief.drive, belief.along_m, self._consensus.settings.slack_m)
        there = (one for one in lines if one and first <= one.place_index < end and one.direction == belief.direction)
        found = next(there, None) or self.search.best_between(first, end, belief.direction)
        return replace(found, confidence=belief.confidence, accepted=belief.is_believed) if found else lines[0]

    @property
    def needs_odometer(self) -> bool:
        """Whether frames without a known distance are not matched: sampled by time meanwhile, and not as the map was.

        Their sequence matches ended elsewhere: while a link was silent, on five simulated roads, 58 of 419 places that
        were believed were over 20 m off.
        """
        return self._drives.is_metric and self._config.sampling.by == "distance"

    @property
    def lacks_odometer(self) -> bool:
        """Whether frames of a whole sequence came without a known distance."""
        return (self._unmeasured or 0) >= self._config.sequence_frames

    @property
    def spacing(self) -> str:
        """How far frames and places are apart, in words."""
        return spell_spacing(self._config.sampling, self._drives.spacing_m if self._drives.is_metric else None)

    def begin_way_back(self) -> None:
        """The vehicle has turned around: the side of the road is another one, and no sequence goes on.

        What follows is normalized by the way out's statistics at first.
        """
        self.reset()
        if (out := self.statistics) is not None:
            self.begin_with(
                RunningStatistics.of_another_run(out.count, out.mean, out.deviation, at_most=WAY_OUT_COUNTS_AS)
            )

    def reset(self) -> None:
        """Begin a new sequence with the next descriptor; the normalization's statistics stay."""
        self._normalizer.clear_ring()
        self.search.clear()
        if self._keyframes is not None:
            self._keyframes.reset()
        if self._structure is not None:
            self._structure.reset()
        self._consensus.reset()
        self._of_halves.reset()
        self._unmeasured = 0


def _odds(prior: Prior, away_of: AwayOf, drive: int, along_m: float) -> float:
    """Of being at a point along a drive."""
    return float(prior.odds(away_of(np.array([drive]), np.array([along_m])))[0])
