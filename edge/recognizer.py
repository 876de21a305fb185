"""The place recognizer: one frame in, one answer out. No camera, no link, no file, no clock.

image -> regions -> descriptor -> SequenceMatcher: online NSD -> cost row -> lines through the last rows -> belief

    recognizer = open_recognizer(load_config(path))
    match = recognizer.observe(image, stamp_ns)

The same `SequenceMatcher` works on descriptors that were made before, without a network and without images:

    matcher = SequenceMatcher(map_set, config)
    matches = [matcher.push(raw) for raw in descriptors]  # each raw is (R, D) float32
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor import RunningStatistics
from edge.descriptor.network import Head, Network
from edge.descriptor.normalize import OnlineNormalizer
from edge.descriptor.open_network import open_network
from edge.descriptor.regions import cut_regions
from edge.localization.consensus import ConsensusSettings, PlaceBelief, PlaceConsensus, PlaceVote
from edge.reference_map import Drives, MapSet, MapSoFar, ModelKey, open_map_set
from edge.sequence import PARALLAX_ROWS, CostView, PlaceMatch
from edge.sequence.evidence import HoldOff
from edge.sequence.parallax import REACH, regions_apart, rows_of_line
from edge.sequence.place_search import Near, PlaceSearch

MAP_COUNTS_AS = 20
"""Frames that the map's statistics count as when the query's begin; after 100 frames they are a sixth."""
PARALLAX_EVERY = 2
"""Frames of which one is matched with each region alone: its neighbors share nearly all their frames."""
STOOD_NS = 3_000_000_000
"""From so long a halt on, the next frame is compared with the last one."""
CARRIED, FEWEST_CHANGES, KEPT_CHANGES = 2.5, 20, 100
"""How many times more than usual the picture must have changed over a halt for the vehicle to have been carried. Frames
2 m apart are up to 2.6 times as far apart as their median, 95 % up to 1.8; of frames 100 m apart 95 % more than 2.8."""
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

    def change_to(self, other: _UsedFrame) -> float:
        """Cosine distance of the raw descriptors."""
        lengths = float(np.linalg.norm(self.raw) * np.linalg.norm(other.raw))
        return 1.0 - float(np.vdot(self.raw, other.raw)) / max(lengths, 1e-12)

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
        self._frame = 0
        self.use_maps(map_set)
        self._begin_statistics()

    def use_maps(self, map_set: MapSet) -> None:
        """Search these maps from now on, beginning a new sequence; the normalization's statistics stay."""
        config = self._config
        self.best: PlaceMatch | None = None
        """The best line after the newest frame, wherever the place is believed to be (eq. 3, the paper's answer)."""
        self.map_set = map_set
        self.search = PlaceSearch(map_set, config, self._stopwatch)
        self._drives = Drives(map_set, config.sampling.spacing_m)
        self._settings = ConsensusSettings.of(config, self._drives)
        self._consensus = PlaceConsensus(self._settings, self._positions_m)
        self._normalizer.clear_ring()

    def grow(self, map_set: MapSet) -> None:
        """Search a set from now on that has further places after those of the last one; between two frames."""
        was_metric, self.map_set = self._drives.is_metric, map_set
        self.search.grow(map_set, self._normalizer.rows)
        self._drives = Drives(map_set, self._config.sampling.spacing_m)
        if self._drives.is_metric != was_metric:  # lengths have another unit
            self._settings = ConsensusSettings.of(self._config, self._drives)
            self._consensus = PlaceConsensus(self._settings, self._positions_m)

    def _positions_m(self, drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._drives.positions_m(drives, along_m)

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
        believed = self._with_parallax(believed)
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

    def begin_way_back(self) -> None:
        """The vehicle has turned around: the light and the side of the road are other ones, and no line goes on.

        What follows is normalized by the map's statistics at first, as when the drive began.
        """
        self.reset()
        self._begin_statistics()

    def _begin_statistics(self) -> None:
        if self.map_set.index.places:
            self._normalizer.begin_with(_statistics_of(self.map_set))

    def _with_parallax(self, match: PlaceMatch | None) -> PlaceMatch | None:
        """A believed match with its parallax; of neighbors one in PARALLAX_EVERY, to save time."""
        self._frame += 1
        if match is None or self._frame % PARALLAX_EVERY or not (match.accepted and self._shows_parallax(match)):
            return match
        rows = self._normalizer.rows(PARALLAX_ROWS)
        ages = np.flatnonzero(~np.isnan(rows[::-1, 0, 0]))  # a place without a frame is NaN throughout
        sign = 1 if match.direction == "forward" else -1
        places = rows_of_line(match.place_index, match.slope, sign, ages)
        segment = self.map_set.index.segment(self.map_set.index.segment_of(match.place_index))
        own = self.map_set.index.rows[self.map_set.index.map_of(match.place_index)]
        first = max(segment[0], own[0], int(places.min()) - REACH)
        end = min(segment[1], own[1], int(places.max()) + REACH + 1)
        costs = self.map_set.region_costs(rows[::-1][ages], first, end)
        return replace(match, parallax=regions_apart(costs, places, first, sign))

    def _shows_parallax(self, match: PlaceMatch) -> bool:
        """Whether both cameras look the same way: else the two regions do not see the same side of the road."""
        has_regions = self.map_set.headers[0].regions.count == 2
        return has_regions and match.order == "same" and self._config.sequence.region_order != "frame"

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
        self, network: Network, head: Head | None, map_set: MapSet, config: Config, stopwatch: Stopwatch = no_stopwatch
    ) -> None:
        """network, map_set: that fit each other and the config. head: None for a network without categories."""
        self._network = network
        self._head = head
        self.config = config
        self._stopwatch = stopwatch
        self.matcher = SequenceMatcher(map_set, config, stopwatch)
        self._hold_off = HoldOff(config.acceptance.hold_off_s)
        self._last: _UsedFrame | None = None
        self._unmoved = 0  # frames since then that showed no other place
        self._changes: deque[float] = deque(maxlen=KEPT_CHANGES)  # from each used frame to the next
        self.was_carried = False
        """Whether the vehicle was moved without its wheels before the newest frame, so that nothing before counts."""
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
        raw = self.describe(image)
        frame = _UsedFrame(raw, stamp_ns, distance_m)
        self.was_carried = False
        if self._stands_still(frame):
            self.state = "standing"
            return None
        self.was_carried = self._is_carried(frame)
        self._reset_after_gap(frame)
        missed, self._last, self._unmoved = missed + self._unmoved, frame, 0
        match = self.matcher.push(raw, near, missed, distance_m)
        if match is None:
            self.state = "searching" if self.matcher.is_scanning else "warming up"
            return None
        self.state = "on the map" if match.accepted else "off the map"
        if not (match.accepted and self._hold_off.passes(stamp_ns)):
            return match
        return replace(match, event=True, category=self._head.categories(raw)[0] if self._head else "")

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The raw descriptor (R, D) of an image (H, W, 3) uint8 BGR."""
        descriptor = self.config.descriptor
        regions = cut_regions(image, descriptor.regions, descriptor.region_width, self._network.info.size)
        self._stopwatch("regions")
        raw = self._network.describe(regions)
        self._stopwatch("network")
        return raw

    def raw_of(self, stamp_ns: int) -> NDArray[np.float32] | None:
        """The raw descriptor (R, D) of the newest frame, None if it showed the same place as the one before it."""
        return self._last.raw if self._last is not None and self._last.stamp_ns == stamp_ns else None

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

    def grow_maps(self, map_set: MapSet) -> None:
        """Search further places after those of the maps so far, without beginning a new sequence."""
        self.matcher.grow(map_set)

    def reset(self) -> None:
        """Begin a new sequence with the next frame (after a blindness); the statistics stay."""
        self.matcher.reset()
        self._last, self._unmoved = None, 0
        self.state = "warming up"

    def begin_way_back(self) -> None:
        """The vehicle has turned around; see `SequenceMatcher.begin_way_back`."""
        self.matcher.begin_way_back()

    def restart_odometer(self) -> None:
        """The distance driven before cannot be compared with what follows."""
        if self._last is not None:
            self._last = replace(self._last, distance_m=None)

    def _stands_still(self, frame: _UsedFrame) -> bool:
        """Whether this frame shows what the last used one did: normalized, it would be all zero, or mere noise."""
        last = self._last
        if last is None or frame.driven_since_m(last) >= self.config.sampling.spacing_m / 2:
            return False
        if last.change_to(frame) > self.config.descriptor.standing_change:
            return False
        # A feed whose every frame is a place has passed one, even if it looks like the last.
        self._unmoved += self.config.sampling.by == "frames"
        return True

    def _is_carried(self, frame: _UsedFrame) -> bool:
        """Whether the first frame after a halt shows another place than the last one before: on a tow, or a ferry."""
        last = self._last
        if last is None:
            return False
        change = last.change_to(frame)
        stood = frame.stamp_ns - last.stamp_ns >= STOOD_NS
        if stood and frame.driven_since_m(last) <= 2 * self.config.sampling.spacing_m:
            return len(self._changes) >= FEWEST_CHANGES and change > CARRIED * float(np.median(self._changes))
        self._changes.append(change)
        return False

    def _reset_after_gap(self, frame: _UsedFrame) -> None:
        """A line needs frames that follow each other: start a new one after a gap, or when time went back.

        Not where the odometer says that hardly anything was passed meanwhile: the vehicle stood.
        """
        if self.was_carried:
            self.matcher.reset()
            return
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
    newest: MapSoFar | None = None,
    stopwatch: Stopwatch = no_stopwatch,
) -> PlaceRecognizer:
    """Open the model and the maps that the config names. SetupError names what cannot be used.

    network, map_set: instead of those. newest: the map of this drive, searched as well, even if it is the only one.
    Maps that do not fit the network and the config are excluded with their reason in
    `PlaceRecognizer.map_set.excluded`; MapError if none fits.
    """
    network = network or open_network(config.descriptor)
    head = Head.load(network) if network.info.labels else None
    if map_set is None:
        key = config.map.require_signature_by
        map_set = open_map_set(Path(config.map.path), require_signature_by=Path(key) if key else None, newest=newest)
    map_set = map_set.fitting(model_key(network), config.descriptor)
    return PlaceRecognizer(network, head, map_set, config, stopwatch)


def model_key(network: Network) -> ModelKey:
    """What a map keeps of the network that described it."""
    info = network.info
    return ModelKey(info.name, info.sha256, info.output, info.dimensions, network.provider)
