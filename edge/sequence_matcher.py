"""Raw descriptors in, matches out: online normalization, costs, sequence search, and the place belief. No network.

raw descriptor (R, D) -> CameraMatcher: online NSD -> cost row -> best line -> vote -> PlaceConsensus -> belief

A vehicle with two cameras has a `CameraMatcher` for each, since the two see different things: each has statistics, a
ring, and lines of its own. Their votes go into one consensus. What is answered is a line of the first camera.

    matcher = SequenceMatcher(map_set, config)
    matches = [matcher.push(raw) for raw in descriptors]  # each raw is (R, D) float32
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor import RunningStatistics
from edge.descriptor.normalize import OnlineNormalizer
from edge.feed.sampling import Steps, spell_spacing
from edge.localization.consensus import ConsensusSettings, PlaceBelief, PlaceConsensus, PlaceVote
from edge.reference_map import Drives, MapSet
from edge.sequence import NOTHING_KNOWN, PlaceMatch, Travel
from edge.sequence.parallax import parallax_of
from edge.sequence.place_search import PlaceSearch

MAP_COUNTS_AS = 20
"""Frames that the map's statistics count as when the query's begin; after 100 frames they are a sixth."""
PARALLAX_EVERY = 8
"""Frames of which one is matched with each region alone: its neighbors share nearly all their frames."""
SECOND_EVERY = 2
"""Places of which the second camera's frame is matched at one: two cameras then cost about twice what one costs."""
MOST_MISSED = 0.5
"""Share of a sequence; if more of it was driven without a frame, a new sequence begins."""

Stopwatch = Callable[[str], None]


def no_stopwatch(stage: str) -> None:
    """Measure nothing."""


class CameraMatcher:
    """One camera: its online statistics, its ring, and the best line through it."""

    def __init__(self, map_set: MapSet, config: Config, stopwatch: Stopwatch = no_stopwatch) -> None:
        """config: with [camera] view of that camera. `stopwatch(stage)` is called after each stage of a frame."""
        self._config, self._stopwatch = config, stopwatch
        self._normalizer = OnlineNormalizer(
            config.sequence_frames,
            renormalize_ring=config.descriptor.renormalize_ring,
            enabled=config.descriptor.normalization == "online",
        )
        self._frame = 0
        self.use_maps(map_set)
        self.begin_statistics()

    def use_maps(self, map_set: MapSet) -> None:
        """Search these maps from now on, beginning a new sequence; the normalization's statistics stay."""
        self.search = PlaceSearch(map_set, self._config, self._stopwatch)
        self._normalizer.clear_ring()

    def grow(self, map_set: MapSet) -> None:
        """Search a set from now on that has further places after those of the last one; between two frames."""
        self.search.grow(map_set, self._normalizer.rows)

    def begin_statistics(self) -> None:
        """Start with the statistics of the map, with the weight of some frames.

        A mean over the first frames alone would remove most of what they show, since they show the same stretch of
        road.
        """
        places = self.search.map_set.index.places
        if places:
            mean, deviation = self.search.map_set.statistics()
            self.begin_with(RunningStatistics.of_another_run(places, mean, deviation, at_most=MAP_COUNTS_AS))

    def begin_with(self, statistics: RunningStatistics) -> None:
        """Start with an earlier run's statistics, of this network and these regions."""
        self._normalizer.begin_with(statistics)

    @property
    def statistics(self) -> RunningStatistics | None:
        """Of all raw descriptors so far, after the map's; None where nothing is normalized."""
        return self._normalizer.statistics

    @property
    def is_scanning(self) -> bool:
        """Whether there are enough frames for a sequence, and it is not known yet which part of the map to search."""
        return self.search.part is None and self._normalizer.is_full

    @property
    def has_lines(self) -> bool:
        """Whether there are enough frames for an answer, even if it is that no road leads where the vehicle goes."""
        return self.search.part is not None and self.search.part.lines is not None

    def ends_sequence(self, step: float, usual: float) -> bool:
        """Whether a step between two frames is too long for a line to run over; usual: step of this camera's frames."""
        return step > (1 + MOST_MISSED * self._config.sequence_frames) * usual

    def push(
        self,
        raw: NDArray[np.float32],
        travel: Travel,
        step: float,
        usual: float,
        *,
        is_measured: bool,
    ) -> PlaceMatch | None:
        """The best line after one raw descriptor (R, D), wherever it is (eq. 3, the paper's answer).

        step: places that are as far apart as was driven since the last frame; usual: the same from one frame to the
        next. is_measured: whether the odometer is known.
        """
        if self.ends_sequence(step, usual):
            self.reset()
        change = self._normalizer.push(raw)
        self._stopwatch("normalization")
        match = self.search.push(change, self._normalizer.rows, travel, step=step, is_measured=is_measured)
        self._stopwatch("search")
        return match

    def with_parallax(self, match: PlaceMatch | None, drives: Drives) -> PlaceMatch | None:
        """A believed match with its parallax; of neighbors one in PARALLAX_EVERY, to save time."""
        self._frame += 1
        if match is None or not match.accepted or self._frame % PARALLAX_EVERY or not self._shows_parallax(match):
            return match
        return replace(match, parallax=parallax_of(match, self._normalizer.rows, self.search.map_set, drives))

    def reset(self) -> None:
        """Begin a new sequence with the next descriptor; the normalization's statistics stay."""
        self._normalizer.clear_ring()
        self.search.clear()

    def _shows_parallax(self, match: PlaceMatch) -> bool:
        """Whether it is used, and both cameras look the same way: else the two regions see unlike sides of the road."""
        has_regions = (
            self.search.map_set.headers[0].regions.count == 2 and self._config.sequence.region_order != "frame"
        )
        return has_regions and self._config.rig.parallax > 0 and match.order == "same"


class SequenceMatcher:
    """The matcher of each camera, and the place that their votes agree on."""

    _drives: Drives

    def __init__(self, map_set: MapSet, config: Config, stopwatch: Stopwatch = no_stopwatch) -> None:
        """`stopwatch(stage)` is called after each stage of a frame."""
        self._config, self._stopwatch = config, stopwatch
        self.first = CameraMatcher(map_set, config, stopwatch)
        """Whose lines are answered."""
        self._passed = SECOND_EVERY - 1  # places since a frame of the second camera was matched
        self._second = CameraMatcher(map_set, _as_second(config), stopwatch) if config.mapping.recognize else None
        self._steps = Steps(config.sampling)
        self._use(map_set)

    def use_maps(self, map_set: MapSet) -> None:
        """Search these maps from now on, beginning a new sequence; the normalization's statistics stay."""
        for camera in self._cameras:
            camera.use_maps(map_set)
        self._use(map_set)

    def grow(self, map_set: MapSet) -> None:
        """Search a set from now on that has further places after those of the last one; between two frames."""
        before = self._drives
        for camera in self._cameras:
            camera.grow(map_set)
        self._drives = Drives(map_set, self._config.sampling.spacing_m)
        if self._drives.is_metric != before.is_metric:  # lengths have another unit
            self._begin_consensus()

    def _use(self, map_set: MapSet) -> None:
        self.best: PlaceMatch | None = None
        """The best line after the newest frame, wherever the place is believed to be (eq. 3, the paper's answer)."""
        self._drives = Drives(map_set, self._config.sampling.spacing_m)
        self._unmeasured: int | None = 0  # frames of this sequence, as long as none had a known distance
        self._begin_consensus()

    def _begin_consensus(self) -> None:
        settings = ConsensusSettings.of(self._config, self._drives, self._usual_step)
        self._consensus = PlaceConsensus(settings, self._positions_m, cameras=len(self._cameras))

    @property
    def map_set(self) -> MapSet:
        """The maps that are searched."""
        return self.first.search.map_set

    @property
    def _usual_step(self) -> float:
        return self._steps.usual(self._drives.spacing_m)

    @property
    def _cameras(self) -> tuple[CameraMatcher, ...]:
        return (self.first,) if self._second is None else (self.first, self._second)

    def _positions_m(self, drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._drives.positions_m(drives, along_m)

    def push(self, raw: NDArray[np.float32], travel: Travel = NOTHING_KNOWN) -> PlaceMatch | None:
        """Match one raw descriptor (R, D); None while too few came, or a large map is still being scanned."""
        odometer_m = travel.distance_m if self._drives.is_metric else None
        if odometer_m is not None:
            self._unmeasured = None
        elif self._unmeasured is not None:
            self._unmeasured += 1
        if odometer_m is None and self.needs_odometer:
            self.best = None
            return None
        step, usual = self._steps.next(odometer_m, travel.missed, self._drives.spacing_m), self._usual_step
        if self.first.ends_sequence(step, usual):
            self.reset()
        measured = odometer_m is not None
        match = self.best = self.first.push(raw, travel, step, usual, is_measured=measured)
        some_excluded = self.first.search.part is not None and self.first.search.part.excludes
        self._consensus.settings = ConsensusSettings.of(self._config, self._drives, usual, some_excluded=some_excluded)
        vote = PlaceVote.of(match, self._drives) if match else None
        believed = self._believed(match, self._consensus.update(vote, odometer_m, step))
        for camera in self._cameras:
            camera.search.follow(believed.place_index if believed and believed.accepted else None)
        believed = self.first.with_parallax(believed, self._drives)
        self._stopwatch("belief")
        return believed

    @property
    def needs_odometer(self) -> bool:
        """Whether frames without a known distance are not matched: sampled by time meanwhile, and not as the map was.

        Their line ended elsewhere: while a link was silent, on five simulated roads, 58 of 419 places that were
        believed were over 20 m off.
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

    def push_second(self, raw: NDArray[np.float32], travel: Travel) -> PlaceMatch | None:
        """Match a frame of the second camera, one of SECOND_EVERY, and let it vote.

        The belief follows with the first camera's next frame. Returns the best line of the second camera; None where
        there is none, or the distance driven is not known.
        """
        if self._second is None or travel.distance_m is None:
            return None
        self._passed += 1 + travel.missed
        if self._passed < SECOND_EVERY:
            return None
        step, usual = self._passed * self._usual_step, SECOND_EVERY * self._usual_step
        self._passed = 0
        measured = self._drives.is_metric
        match = self._second.push(raw, travel, step, usual, is_measured=measured)
        vote = self._vote_of_second(match) if match is not None else None
        if vote is not None:
            self._consensus.add(vote, travel.distance_m)
        self._stopwatch("belief")
        return match

    def _vote_of_second(self, match: PlaceMatch) -> PlaceVote | None:
        """For the place where a line of the first camera would end; None where the first camera sees better.

        Of two cameras that look in opposite directions, one sees a place as the map's camera did, and the other from
        behind, which is hardly ever recognized. The second one votes where it is the one that does. The first one's
        place is then that of a swapped line, as far ahead as [rig] says.
        """
        if match.order != "same" or not self._drives.is_metric:
            return None
        vote, rig = PlaceVote.of(match, self._drives), self._config.rig
        ahead_m = rig.ahead_m(match.direction, "swapped") + rig.ahead_m(match.direction, "same")
        along_m = vote.along_m + (ahead_m if match.direction == "forward" else -ahead_m)
        return replace(vote, along_m=along_m, camera=1)

    def _believed(self, match: PlaceMatch | None, belief: PlaceBelief | None) -> PlaceMatch | None:
        """The best line that ends at the place that the recent matches agree on; the match itself if there is none."""
        if match is None or belief is None:
            return match
        first, end = self._drives.places_within(belief.drive, belief.along_m, self._consensus.settings.slack_m)
        if not (first <= match.place_index < end and match.direction == belief.direction):
            found = self.first.search.best_between(first, end, belief.direction)
            if found is None:
                return match
            match = found
        return replace(match, confidence=belief.confidence, accepted=belief.is_believed)

    def begin_way_back(self) -> None:
        """The vehicle has turned around: the light and the side of the road are other ones, and no line goes on.

        What follows is normalized by the map's statistics at first, as when the drive began.
        """
        self.reset()
        for camera in self._cameras:
            camera.begin_statistics()

    def reset(self) -> None:
        """Begin a new sequence with the next descriptors; the normalization's statistics stay."""
        for camera in self._cameras:
            camera.reset()
        self._consensus.reset()
        self._unmeasured = 0


def _as_second(config: Config) -> Config:
    """The config with the second camera as its only one. Its ring is not normalized again, to save time.

    Its lines are as long as the first camera's, with one of SECOND_EVERY frames.
    It looks as the map's camera did, so that the map's statistics, with which its own begin, are nearly right for it.
    """
    camera = config.mapping.camera
    assert camera is not UNSET
    descriptor = msgspec.structs.replace(config.descriptor, renormalize_ring=False)
    sequence = msgspec.structs.replace(config.sequence, length=max(2, config.sequence_frames // SECOND_EVERY))
    return msgspec.structs.replace(config, camera=camera, descriptor=descriptor, sequence=sequence)
