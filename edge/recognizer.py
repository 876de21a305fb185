"""The place recogniser: one frame in, one answer out. No camera, no link, no clock; `replay` and `run` share it.

image -> regions -> fc6 -> online NSD -> cost row -> ring, lines -> uniqueness -> PlaceMatch
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor.network import Head, Network
from edge.descriptor.normalize import OnlineNormalizer, RunningStatistics
from edge.descriptor.regions import cut_regions
from edge.errors import MapError
from edge.reference_map.costs import COST_ONE
from edge.reference_map.map_set import MapSet
from edge.reference_map.route import Route
from edge.reference_map.store import MapHeader, ModelKey, ReferenceMap
from edge.sequence import CostView, PlaceMatch, SequenceMatch
from edge.sequence.acceptance import HoldOff
from edge.sequence.place_search import Near, PlaceSearch

MOST_MISSED = 0.5
"""Of a sequence: beyond, what was seen before says too little of where the vehicle is."""

WINDOW_PLACES = 60
"""So many places on either side of the match are shown of the cost matrix."""

State = Literal["warming up", "searching", "on the map", "off the map", "standing"]


class PlaceRecognizer:
    """Recognises the places of a reference map, or of a folder of maps, frame by frame."""

    def __init__(
        self,
        network: Network,
        head: Head,
        maps: ReferenceMap | MapSet,
        config: Config,
        stopwatch: Callable[[str], None] = lambda stage: None,
    ) -> None:
        """`stopwatch(stage)` is called after each stage of a frame.

        Maps that do not fit the config are left out; MapError if none does.
        """
        self.atlas = maps if isinstance(maps, MapSet) else MapSet.of(maps)
        for index, (folder, header) in enumerate(zip(self.atlas.folders, self.atlas.headers, strict=True)):
            try:
                _check_fit(model_key(network), folder, header, config)
            except MapError as error:
                self.atlas.leave_out(index, error)
        self._network = network
        self._head = head
        self.config = config
        self._stopwatch = stopwatch
        self.route = Route(self.atlas)
        self.places = PlaceSearch(self.atlas, config, stopwatch)
        self._hold_off = HoldOff(config.acceptance.hold_off_s)
        self._normalizer = OnlineNormalizer(
            config.sequence.length,
            renormalize_ring=config.descriptor.renormalize_ring,
            enabled=config.descriptor.normalization == "online",
        )
        self._last_raw: NDArray[np.float32] | None = None
        self._last_ns: int | None = None
        self.state: State = "warming up"

    def observe(
        self, image: NDArray[np.uint8], stamp_ns: int, near: Near | None = None, missed: int = 0
    ) -> PlaceMatch | None:
        """Take in one frame (H, W, 3) uint8 BGR; None while warming up, searching, and while the vehicle stands.

        stamp_ns: exposure time on any one clock; it only serves to notice gaps and to hold events off. near: where the
        autopilot says that the vehicle is; only maps too large to be searched whole make use of it. missed: places that
        were passed since the last frame without one (`Sampler.missed`).
        """
        descriptor = self.config.descriptor
        regions = cut_regions(image, descriptor.regions, descriptor.region_width)
        self._stopwatch("regions")
        raw = self._network.describe(regions)
        self._stopwatch("network")
        if self._stands_still(raw):
            self.state = "standing"
            return None
        self._forget_across_gap(stamp_ns)
        self._skip(missed)
        normalized = self._normalizer.push(raw)
        self._stopwatch("normalization")
        match = self.places.push(normalized, self._normalizer.rows, near)
        self._stopwatch("search")
        if match is None:
            self.state = "searching" if self.places.part is None and self._normalizer.is_full else "warming up"
            return None
        self.state = "on the map" if match.accepted else "off the map"
        return self._report(match, raw, stamp_ns)

    def verify(self, max_bytes: int, match: PlaceMatch | None = None) -> bool:
        """Check that much more of the maps that are searched now; True when they have been seen to be whole.

        With a match, of the map that it lies in, and of the tiles that its line may have come from: nothing may be told
        of the match before, nor if a map was left out meanwhile because it is damaged. MapError if that is the only
        one, or was the last.
        """
        if match is None:
            return self.atlas.verify(max_bytes)
        numbering = self.atlas.numbering
        line = numbering.widened([(match.place_index, match.place_index + 1)], self.config.sequence.length)
        return self.atlas.verify(max_bytes, numbering.maps_of(line))

    @property
    def statistics(self) -> RunningStatistics | None:
        """Of all raw descriptors so far; None before the first, and where nothing is normalised."""
        return self._normalizer.statistics

    def begin_with(self, statistics: RunningStatistics) -> None:
        """Start with an earlier run's statistics, of this network and this cut."""
        self._normalizer.begin_with(statistics)

    def reset(self) -> None:
        """Begin a new sequence with the next frame (after a blindness); the statistics stay."""
        self._normalizer.clear_ring()
        self.places.clear()
        self._last_raw = self._last_ns = None
        self.state = "warming up"

    def _stands_still(self, raw: NDArray[np.float32]) -> bool:
        """Whether this frame shows what the last used one did: normalised, it would be all zero, or mere noise."""
        last = self._last_raw
        if last is not None:
            cosine = np.vdot(raw, last) / max(float(np.linalg.norm(raw) * np.linalg.norm(last)), 1e-12)
            if 1.0 - cosine <= self.config.descriptor.standing_change:
                return True
        self._last_raw = raw
        return False

    def _forget_across_gap(self, stamp_ns: int) -> None:
        """A line needs frames that follow each other: start a new one after a gap, or when time went back."""
        if self._last_ns is not None and not 0 <= stamp_ns - self._last_ns <= self.config.sequence.max_gap_s * 1e9:
            self._normalizer.clear_ring()
            self.places.clear()
        self._last_ns = stamp_ns

    def _skip(self, missed: int) -> None:
        """Leave room in the ring for places of which there is no frame, or every line would end too far back."""
        if missed > MOST_MISSED * self.config.sequence.length:
            self._normalizer.clear_ring()
            self.places.clear()
            return
        for _ in range(missed):
            if self._normalizer.skip():
                self.places.skip()

    def _report(self, match: SequenceMatch, raw: NDArray[np.float32], stamp_ns: int) -> PlaceMatch:
        event = match.accepted and self._hold_off.passes(stamp_ns)
        name, row = self.atlas.locate(match.place)
        return PlaceMatch(
            place_index=match.place,
            place=row,
            direction=match.direction,
            order=match.order,
            slope=match.slope,
            distance=match.cost / COST_ONE,
            uniqueness=match.uniqueness,
            accepted=match.accepted,
            offset_places=match.beyond,
            half_width_places=match.width,
            map=name,
            event=event,
            category=self._head.categories(raw)[0] if event else None,
        )

    def cost_view(self, match: PlaceMatch | None) -> CostView:
        """The costs that the newest match, if there is one, was found in."""
        part, costs = self.places.part, self.places.newest_costs
        searched = part.places if part is not None else np.zeros(0, dtype=np.intp)
        if costs.shape[1] != len(searched):
            costs, searched = np.zeros((0, 0), np.int32), searched[:0]
        if part is None or match is None:
            return CostView(costs, searched, np.zeros((0, 0), np.int32), 0, COST_ONE)
        at = int(np.searchsorted(part.places, match.place_index))
        first = max(0, at - WINDOW_PLACES)
        window = part.recent_costs(match.direction, match.order)[:, first : at + WINDOW_PLACES + 1]
        return CostView(costs, searched, window, int(part.places[min(first, len(part.places) - 1)]), COST_ONE)


def model_key(network: Network) -> ModelKey:
    """What a map keeps of the network that described it."""
    info = network.info
    return ModelKey(info.name, info.sha256, info.tap, info.dimensions)


def _check_fit(model: ModelKey, path: Path, header: MapHeader, config: Config) -> None:
    """Refuse a map whose descriptors this network and this cut cannot be compared with."""
    wanted = config.descriptor
    if header.model.sha256 != model.sha256 or header.model.tap != model.tap:
        raise MapError(
            f"{path}: made with model {_spell_model(header.model)}, but the model here is"
            f" {_spell_model(model)}; build the map again with this one"
        )
    normalized = "set" if wanted.normalization == "online" else "none"
    ours = (wanted.regions, wanted.region_width if wanted.regions == "left-right" else header.regions.width, normalized)
    theirs = (header.regions.kind, header.regions.width, header.regions.normalization)
    if ours != theirs:
        raise MapError(
            f"{path}: made with regions {_spell_regions(*theirs)},"
            f" but [descriptor] asks for {_spell_regions(*ours)}; change the one or build the map again"
        )


def _spell_model(model: ModelKey) -> str:
    return f"{model.name} ({model.sha256[:12]}, {model.tap})"


def _spell_regions(kind: str, width: float, normalization: str) -> str:
    return f"{kind} of width {width:g}, normalization {normalization}"
