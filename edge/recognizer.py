"""The place recognizer: one frame in, one answer out. No camera, no link, no file, no clock.

image -> regions -> fc6 -> SequenceMatcher: online NSD -> cost row -> lines through the last L rows -> place belief

    recognizer = open_recognizer(load_config(path))
    match = recognizer.observe(image, stamp_ns)

The same `SequenceMatcher` works on descriptors that were made before, without a network and without images:

    matcher = SequenceMatcher(map_set, config)
    matches = [matcher.push(raw) for raw in descriptors]  # each raw is (R, D) float32
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor.network import Head, Network
from edge.descriptor.normalize import OnlineNormalizer, RunningStatistics
from edge.descriptor.regions import cut_regions
from edge.localization.consensus import ConsensusSettings, PlaceBelief, PlaceConsensus, PlaceVote
from edge.reference_map import Drives, MapSet, ModelKey, open_map_set
from edge.sequence import CostView, PlaceMatch
from edge.sequence.acceptance import HoldOff
from edge.sequence.place_search import Near, PlaceSearch

MAP_COUNTS_AS = 20
"""Frames that the map's statistics count as when the query's begin; after 100 frames they are a sixth."""
MOST_MISSED = 0.5
"""Share of a sequence; if more places than this were passed without a frame, a new sequence begins."""

State = Literal["warming up", "searching", "on the map", "off the map", "standing"]
Stopwatch = Callable[[str], None]


def no_stopwatch(stage: str) -> None:
    """Measure nothing."""


@dataclass(frozen=True)
class _UsedFrame:
    """A raw descriptor (R, D), its exposure, and the odometer then, None where it was not known."""

    raw: NDArray[np.float32]
    stamp_ns: int
    distance_m: float | None

    def driven_since_m(self, before: _UsedFrame) -> float:
        """Meters driven since another frame, NaN where that is not known."""
        if self.distance_m is None or before.distance_m is None:
            return math.nan
        return self.distance_m - before.distance_m


class SequenceMatcher:
    """Raw descriptors in, matches out: online normalization, costs, sequence search, and the place belief."""

    def __init__(self, map_set: MapSet, config: Config, stopwatch: Stopwatch = no_stopwatch) -> None:
        """`stopwatch(stage)` is called after each stage of a frame."""
        self._config = config
        self._stopwatch = stopwatch
        self._normalizer = OnlineNormalizer(
            config.sequence.length,
            renormalize_ring=config.descriptor.renormalize_ring,
            enabled=config.descriptor.normalization == "online",
        )
        self._normalizer.begin_with(_statistics_of(map_set))
        self.use_maps(map_set)

    def use_maps(self, map_set: MapSet) -> None:
        """Search these maps from now on, beginning a new sequence; the normalization's statistics stay."""
        config = self._config
        self.best: PlaceMatch | None = None
        """The best line after the newest frame, wherever the place is believed to be (eq. 3, the paper's answer)."""
        self.map_set = map_set
        self.search = PlaceSearch(map_set, config, self._stopwatch)
        self._drives = Drives(map_set, config.sampling.spacing_m)
        self._settings = ConsensusSettings.of(config, self._drives)
        self._consensus = PlaceConsensus(self._settings, self._drives.positions_m)
        self._normalizer.clear_ring()

    def push(
        self,
        raw: NDArray[np.float32],
        near: Near | None = None,
        missed: int = 0,
        distance_m: float | None = None,
    ) -> PlaceMatch | None:
        """Match one raw descriptor (R, D); None while too few came, or a large map is still being scanned.

        near: where the vehicle may be, which only maps too large to be searched whole make use of. missed: places that
        were passed since the last frame without one. distance_m: the odometer, None where it is not known.
        """
        self._skip(missed)
        change = self._normalizer.push(raw)
        self._stopwatch("normalization")
        odometer_m = distance_m if self._drives.is_metric else None
        match = self.best = self.search.push(change, self._normalizer.rows, near, is_measured=odometer_m is not None)
        self._stopwatch("search")
        belief = self._consensus.update(PlaceVote.of(match, self._drives) if match else None, odometer_m, missed)
        believed = self._believed(match, belief)
        self.search.follow(believed.place_index if believed and believed.accepted else None)
        self._stopwatch("belief")
        return believed

    def _believed(self, match: PlaceMatch | None, belief: PlaceBelief | None) -> PlaceMatch | None:
        """The best line that ends at the place that the recent matches agree on; the match itself if there is none."""
        if match is None or belief is None:
            return match
        first, end = self._drives.places_within(belief.drive, belief.along_m, self._settings.slack_m)
        if not (first <= match.place_index < end and match.direction == belief.direction):
            found = self.search.best_between(first, end, belief.direction)
            if found is None:
                return match
            match = found
        return replace(match, confidence=belief.confidence, accepted=belief.is_believed)

    def reset(self) -> None:
        """Begin a new sequence with the next descriptor; the normalization's statistics stay."""
        self._normalizer.clear_ring()
        self.search.clear()
        self._consensus.reset()

    @property
    def is_scanning(self) -> bool:
        """Whether there are enough frames for a sequence, and it is not known yet which part of the map to search."""
        return self.search.part is None and self._normalizer.is_full

    @property
    def statistics(self) -> RunningStatistics | None:
        """Of all raw descriptors so far, after the map's; None where nothing is normalized."""
        return self._normalizer.statistics

    def begin_with(self, statistics: RunningStatistics) -> None:
        """Start with an earlier run's statistics, of this network and these regions."""
        self._normalizer.begin_with(statistics)

    def _skip(self, missed: int) -> None:
        """Leave room in the ring for places of which there is no frame, or every line would end too far back."""
        if missed > MOST_MISSED * self._config.sequence.length:
            self.reset()
            return
        for _ in range(missed):
            if self._normalizer.skip():
                self.search.skip()


class PlaceRecognizer:
    """Recognizes the places of a reference map, or of a folder of maps, frame by frame; see `open_recognizer`."""

    def __init__(
        self, network: Network, head: Head, map_set: MapSet, config: Config, stopwatch: Stopwatch = no_stopwatch
    ) -> None:
        """network, map_set: that fit each other and the config."""
        self._network = network
        self._head = head
        self.config = config
        self._stopwatch = stopwatch
        self.matcher = SequenceMatcher(map_set, config, stopwatch)
        self._hold_off = HoldOff(config.acceptance.hold_off_s)
        self._last: _UsedFrame | None = None
        self._unmoved = 0  # frames since then that showed no other place
        self.state: State = "warming up"

    @property
    def map_set(self) -> MapSet:
        """The maps that are searched."""
        return self.matcher.map_set

    def observe(
        self,
        image: NDArray[np.uint8],
        stamp_ns: int,
        near: Near | None = None,
        missed: int = 0,
        distance_m: float | None = None,
    ) -> PlaceMatch | None:
        """Match one frame (H, W, 3) uint8 BGR; None while warming up, searching, and while the vehicle stands.

        stamp_ns: exposure time on any one clock; it only serves to notice gaps and to hold events off. near, missed,
        distance_m: see `SequenceMatcher.push`.
        """
        descriptor = self.config.descriptor
        regions = cut_regions(image, descriptor.regions, descriptor.region_width)
        self._stopwatch("regions")
        raw = self._network.describe(regions)
        self._stopwatch("network")
        frame = _UsedFrame(raw, stamp_ns, distance_m)
        if self._stands_still(frame):
            self.state = "standing"
            return None
        self._reset_after_gap(frame)
        missed, self._last, self._unmoved = missed + self._unmoved, frame, 0
        match = self.matcher.push(raw, near, missed, distance_m)
        if match is None:
            self.state = "searching" if self.matcher.is_scanning else "warming up"
            return None
        self.state = "on the map" if match.accepted else "off the map"
        if not (match.accepted and self._hold_off.passes(stamp_ns)):
            return match
        return replace(match, event=True, category=self._head.categories(raw)[0])

    @property
    def model_name(self) -> str:
        """Name of the network."""
        return self._network.info.name

    def cost_view(self, match: PlaceMatch | None) -> CostView:
        """The costs that the newest match, if there is one, was found in; for people."""
        return self.matcher.search.cost_view(match)

    def use_maps(self, map_set: MapSet) -> None:
        """Search these maps from now on (after one was excluded), beginning a new sequence."""
        self.matcher.use_maps(map_set)
        self.reset()

    def reset(self) -> None:
        """Begin a new sequence with the next frame (after a blindness); the statistics stay."""
        self.matcher.reset()
        self._last, self._unmoved = None, 0
        self.state = "warming up"

    def restart_odometer(self) -> None:
        """The distance driven before cannot be compared with what follows."""
        if self._last is not None:
            self._last = replace(self._last, distance_m=None)

    def _stands_still(self, frame: _UsedFrame) -> bool:
        """Whether this frame shows what the last used one did: normalized, it would be all zero, or mere noise."""
        last = self._last
        if last is None or frame.driven_since_m(last) >= self.config.sampling.spacing_m / 2:
            return False
        cosine = np.vdot(frame.raw, last.raw) / max(float(np.linalg.norm(frame.raw) * np.linalg.norm(last.raw)), 1e-12)
        if 1.0 - cosine > self.config.descriptor.standing_change:
            return False
        # A feed whose every frame is a place has passed one, even if it looks like the last.
        self._unmoved += self.config.sampling.by == "frames"
        return True

    def _reset_after_gap(self, frame: _UsedFrame) -> None:
        """A line needs frames that follow each other: start a new one after a gap, or when time went back.

        Not where the odometer says that hardly anything was passed meanwhile: the vehicle stood.
        """
        if self._last is None or 0 <= frame.stamp_ns - self._last.stamp_ns <= self.config.sequence.max_gap_s * 1e9:
            return
        stood_m = MOST_MISSED * self.config.sequence.length * self.config.sampling.spacing_m
        if not (frame.stamp_ns > self._last.stamp_ns and 0 <= frame.driven_since_m(self._last) <= stood_m):
            self.matcher.reset()


def _statistics_of(map_set: MapSet) -> RunningStatistics:
    """What the query's statistics begin with: those of the map, with the weight of some frames.

    A mean over the first frames alone would remove most of what they show, since they show the same stretch of road.
    """
    mean, deviation = map_set.statistics()
    return RunningStatistics.of_another_run(map_set.index.places, mean, deviation, at_most=MAP_COUNTS_AS)


def open_recognizer(
    config: Config,
    *,
    network: Network | None = None,
    map_set: MapSet | None = None,
    stopwatch: Stopwatch = no_stopwatch,
) -> PlaceRecognizer:
    """Open the model and the maps that the config names. SetupError names what cannot be used.

    network, map_set: instead of those. Maps that do not fit the network and the config are excluded with their reason
    in `PlaceRecognizer.map_set.excluded`; MapError if none fits.
    """
    network = network or Network.load(Path(config.descriptor.model) if config.descriptor.model else None)
    head = Head.load(network)
    if map_set is None:
        key = config.map.require_signature_by
        map_set = open_map_set(Path(config.map.path), require_signature_by=Path(key) if key else None)
    map_set = map_set.fitting(model_key(network), config.descriptor)
    return PlaceRecognizer(network, head, map_set, config, stopwatch)


def model_key(network: Network) -> ModelKey:
    """What a map keeps of the network that described it."""
    info = network.info
    return ModelKey(info.name, info.sha256, info.tap, info.dimensions)
