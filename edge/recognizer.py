"""The place recognizer: one frame in, one answer out. No camera, no link, no file, no clock.

image -> regions -> fc6 -> SequenceMatcher: online NSD -> cost row -> lines through the last L rows -> uniqueness

    recognizer = open_recognizer(load_config(path))
    match = recognizer.observe(image, stamp_ns)

The same `SequenceMatcher` works on descriptors that were made before, without a network and without images:

    matcher = SequenceMatcher(map_set, config)
    matches = [matcher.push(raw) for raw in descriptors]  # each raw is (R, D) float32
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor.network import Head, Network
from edge.descriptor.normalize import OnlineNormalizer, RunningStatistics
from edge.descriptor.regions import cut_regions
from edge.reference_map import MapSet, ModelKey, open_map_set
from edge.sequence import CostView, PlaceMatch
from edge.sequence.acceptance import HoldOff
from edge.sequence.place_search import Near, PlaceSearch

MOST_MISSED = 0.5
"""Share of a sequence; if more places than this were passed without a frame, a new sequence begins."""

State = Literal["warming up", "searching", "on the map", "off the map", "standing"]
Stopwatch = Callable[[str], None]


def no_stopwatch(stage: str) -> None:
    """Measure nothing."""


class SequenceMatcher:
    """Raw descriptors in, matches out: online normalization, costs, sequence search, and acceptance."""

    def __init__(self, map_set: MapSet, config: Config, stopwatch: Stopwatch = no_stopwatch) -> None:
        """`stopwatch(stage)` is called after each stage of a frame."""
        self._config = config
        self._stopwatch = stopwatch
        self._normalizer = OnlineNormalizer(
            config.sequence.length,
            renormalize_ring=config.descriptor.renormalize_ring,
            enabled=config.descriptor.normalization == "online",
        )
        self.use_maps(map_set)

    def use_maps(self, map_set: MapSet) -> None:
        """Search these maps from now on, beginning a new sequence; the normalization's statistics stay."""
        self.map_set = map_set
        self.search = PlaceSearch(map_set, self._config, self._stopwatch)
        self._normalizer.clear_ring()

    def push(self, raw: NDArray[np.float32], near: Near | None = None, missed: int = 0) -> PlaceMatch | None:
        """Match one raw descriptor (R, D); None while too few came, or a large map is still being scanned.

        near: where the vehicle may be, which only maps too large to be searched whole make use of. missed: places that
        were passed since the last frame without one.
        """
        self._skip(missed)
        change = self._normalizer.push(raw)
        self._stopwatch("normalization")
        match = self.search.push(change, self._normalizer.rows, near)
        self._stopwatch("search")
        return match

    def reset(self) -> None:
        """Begin a new sequence with the next descriptor; the normalization's statistics stay."""
        self._normalizer.clear_ring()
        self.search.clear()

    @property
    def is_scanning(self) -> bool:
        """Whether there are enough frames for a sequence, and it is not known yet which part of the map to search."""
        return self.search.part is None and self._normalizer.is_full

    @property
    def statistics(self) -> RunningStatistics | None:
        """Of all raw descriptors so far; None before the first, and where nothing is normalized."""
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
        self._last_raw: NDArray[np.float32] | None = None
        self._last_ns: int | None = None
        self.state: State = "warming up"

    @property
    def map_set(self) -> MapSet:
        """The maps that are searched."""
        return self.matcher.map_set

    def observe(
        self, image: NDArray[np.uint8], stamp_ns: int, near: Near | None = None, missed: int = 0
    ) -> PlaceMatch | None:
        """Match one frame (H, W, 3) uint8 BGR; None while warming up, searching, and while the vehicle stands.

        stamp_ns: exposure time on any one clock; it only serves to notice gaps and to hold events off. near, missed:
        see `SequenceMatcher.push`.
        """
        descriptor = self.config.descriptor
        regions = cut_regions(image, descriptor.regions, descriptor.region_width)
        self._stopwatch("regions")
        raw = self._network.describe(regions)
        self._stopwatch("network")
        if self._stands_still(raw):
            self.state = "standing"
            return None
        self._reset_after_gap(stamp_ns)
        match = self.matcher.push(raw, near, missed)
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
        self._last_raw = self._last_ns = None
        self.state = "warming up"

    def _stands_still(self, raw: NDArray[np.float32]) -> bool:
        """Whether this frame shows what the last used one did: normalized, it would be all zero, or mere noise."""
        last = self._last_raw
        if last is not None:
            cosine = np.vdot(raw, last) / max(float(np.linalg.norm(raw) * np.linalg.norm(last)), 1e-12)
            if 1.0 - cosine <= self.config.descriptor.standing_change:
                return True
        self._last_raw = raw
        return False

    def _reset_after_gap(self, stamp_ns: int) -> None:
        """A line needs frames that follow each other: start a new one after a gap, or when time went back."""
        if self._last_ns is not None and not 0 <= stamp_ns - self._last_ns <= self.config.sequence.max_gap_s * 1e9:
            self.matcher.reset()
        self._last_ns = stamp_ns


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
