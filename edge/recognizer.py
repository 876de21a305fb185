"""The place recogniser: one frame in, one answer out. Pure: no camera, no link, no clock; `replay` and `run` share it.

image -> regions -> fc6 -> online NSD -> cost row -> ring, lines -> uniqueness -> PlaceMatch
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor.network import Head, Network
from edge.descriptor.normalize import OnlineNormalizer
from edge.descriptor.regions import cut_regions
from edge.errors import MapError
from edge.reference_map.costs import COST_ONE, CostMatcher
from edge.reference_map.route import Route
from edge.reference_map.store import MapHeader, ModelKey, ReferenceMap
from edge.sequence import ORDERS, VIEWS_ALIKE, VIEWS_OPPOSED, Direction, Order, Plane, SequenceMatch
from edge.sequence.acceptance import HoldOff, Neighbourhood, best_match
from edge.sequence.search import SequenceSearch, slopes_around_diagonal

State = Literal["warming up", "on the map", "off the map", "standing"]


@dataclass(frozen=True)
class PlaceMatch:
    """What one used frame says.

    place: row of the map that looks most like here, even where it is not believed.
    lat_deg, lon_deg, heading_deg: of the vehicle (the place moved by the rig's offset), None where the map has none.
    slope: places passed a frame. distance: mean cosine distance along the line. uniqueness: 1 is ambiguous, see `edge.sequence`.
    accepted: the place is believed; False is the answer "off the map". event: accepted, and not held off.
    category: what kind of place the frame shows, told for events only.
    """

    place: int
    lat_deg: float | None
    lon_deg: float | None
    heading_deg: float | None
    direction: Direction
    order: Order
    slope: float
    distance: float
    uniqueness: float
    accepted: bool
    event: bool
    category: str | None


class PlaceRecognizer:
    """Recognises the places of one reference map, frame by frame."""

    def __init__(
        self,
        network: Network,
        head: Head,
        reference_map: ReferenceMap,
        config: Config,
        stopwatch: Callable[[str], None] = lambda stage: None,
    ) -> None:
        """`stopwatch(stage)` is called after each stage of a frame. MapError if the map does not fit the config."""
        _check_fit(model_key(network), reference_map, config)
        self._network = network
        self._head = head
        self._config = config
        self._stopwatch = stopwatch
        self._route = Route(reference_map)
        header = reference_map.header
        self._matcher = CostMatcher(reference_map.descriptors, reference_map.places["norm_sq"], header.regions.count)
        sequence = config.sequence
        self._per_frame_order = sequence.region_order == "frame"
        self._search = open_search(header, config)
        self._neighbourhood = neighbourhood(self._route, config)
        self._hold_off = HoldOff(config.acceptance.hold_off_s)
        self._normalizer = OnlineNormalizer(
            sequence.length,
            renormalize_ring=config.descriptor.renormalize_ring,
            enabled=config.descriptor.normalization == "online",
        )
        self._last_raw: NDArray[np.float32] | None = None
        self._last_ns: int | None = None
        self.state: State = "warming up"
        self.newest_costs: NDArray[np.int32] = np.zeros((self._matcher.orders, header.places), dtype=np.int32)
        """Cost row (orders, N) of the last used frame, in units of COST_ONE, for those who draw it."""

    def observe(self, image: NDArray[np.uint8], stamp_ns: int) -> PlaceMatch | None:
        """Take in one frame (H, W, 3) uint8 BGR; None while warming up and while the vehicle stands.

        stamp_ns: exposure time on any one clock; it only serves to notice gaps and to hold events off.
        """
        descriptor = self._config.descriptor
        regions = cut_regions(image, descriptor.regions, descriptor.region_width)
        self._stopwatch("regions")
        raw = self._network.describe(regions)
        self._stopwatch("network")
        if self._stands_still(raw):
            self.state = "standing"
            return None
        self._forget_across_gap(stamp_ns)
        self._push(raw)
        self._stopwatch("matching")
        lines = self._search.lines()
        match = best_match(self._search, lines, self._neighbourhood, self._config.acceptance) if lines else None
        self._stopwatch("search")
        if match is None:
            self.state = "warming up"
            return None
        self.state = "on the map" if match.accepted else "off the map"
        return self._report(match, raw, stamp_ns)

    def _stands_still(self, raw: NDArray[np.float32]) -> bool:
        """Whether this frame shows what the last used one did: normalised, it would be all zero, or mere noise."""
        last = self._last_raw
        if last is not None:
            cosine = np.vdot(raw, last) / max(float(np.linalg.norm(raw) * np.linalg.norm(last)), 1e-12)
            if 1.0 - cosine <= self._config.descriptor.standing_change:
                return True
        self._last_raw = raw
        return False

    def _forget_across_gap(self, stamp_ns: int) -> None:
        """A line needs frames that follow each other: start a new one after a gap, or when time went back."""
        if self._last_ns is not None and not 0 <= stamp_ns - self._last_ns <= self._config.sequence.max_gap_s * 1e9:
            self._normalizer.clear_ring()
            self._search.clear()
        self._last_ns = stamp_ns

    def _push(self, raw: NDArray[np.float32]) -> None:
        """Normalise and match the frame; its cost row (orders, N) goes into the search, or a whole new ring does."""
        normalized = self._normalizer.push(raw)
        costs = self._matcher.costs(normalized.rows)
        searched = costs.min(axis=1, keepdims=True) if self._per_frame_order else costs
        if normalized.replaces_ring:
            self._search.refill(searched)
        else:
            self._search.push(searched[-1])
        self.newest_costs = costs[-1]

    def _report(self, match: SequenceMatch, raw: NDArray[np.float32], stamp_ns: int) -> PlaceMatch:
        order = ORDERS[int(self.newest_costs[:, match.place].argmin())] if self._per_frame_order else match.order
        forward = match.direction == "forward"
        ahead_m = self._config.rig.ahead_m(match.direction, order)
        # The place lies ahead of the vehicle; on the way back "ahead" is towards the start of the map's drive.
        position = self._route.position(match.place, -ahead_m if forward else ahead_m)
        event = match.accepted and self._hold_off.passes(stamp_ns)
        return PlaceMatch(
            place=match.place,
            lat_deg=position.lat_deg if position else None,
            lon_deg=position.lon_deg if position else None,
            heading_deg=(position.heading_deg + (0 if forward else 180)) % 360 if position else None,
            direction=match.direction,
            order=order,
            slope=match.slope,
            distance=match.cost / COST_ONE,
            uniqueness=match.uniqueness,
            accepted=match.accepted,
            event=event,
            category=self._head.categories(raw)[0] if event else None,
        )


def open_search(header: MapHeader, config: Config) -> SequenceSearch:
    """The search of a map's places that the config asks for, its ring still empty."""
    sequence = config.sequence
    planes, possible = _planes(header, config)
    return SequenceSearch(
        [(segment.start, segment.end) for segment in header.segments],
        planes,
        sequence.length,
        slopes_around_diagonal(sequence.slope_limit_rad, sequence.slopes),
        possible,
    )


def neighbourhood(route: Route, config: Config) -> Neighbourhood:
    """Which places of a map count as one when a match is accepted."""
    return Neighbourhood(route.east_north_m, route.route_m, route.segment_of, config.acceptance)


def _planes(header: MapHeader, config: Config) -> tuple[list[Plane], NDArray[np.bool_]]:
    """The directions and region orders to search in, and where in the map (planes, N) each of them is possible."""
    sequence = config.sequence
    # One region has no order; and where the better order of each frame counts, the search sees but one.
    orders = ORDERS if header.regions.count == 2 and sequence.region_order != "frame" else ORDERS[:1]
    directions: tuple[Direction, ...] = ("forward", "reverse")
    planes = [
        (direction, order) for direction in directions for order in orders if sequence.directions in ("both", direction)
    ]
    possible = np.ones((len(planes), header.places), dtype=bool)
    if sequence.region_order == "rig" and len(orders) == 2:
        for segment in header.segments:
            allowed = VIEWS_ALIKE if segment.view == config.camera.view else VIEWS_OPPOSED
            possible[:, segment.start : segment.end] = np.array([plane in allowed for plane in planes])[:, np.newaxis]
    used = np.flatnonzero(possible.any(axis=1))
    return [planes[index] for index in used], possible[used]


def model_key(network: Network) -> ModelKey:
    """What a map keeps of the network that described it."""
    info = network.info
    return ModelKey(info.name, info.sha256, info.tap, info.dimensions)


def _check_fit(model: ModelKey, reference_map: ReferenceMap, config: Config) -> None:
    """Refuse a map whose descriptors this network and this cut cannot be compared with."""
    header, wanted = reference_map.header, config.descriptor
    if header.model.sha256 != model.sha256 or header.model.tap != model.tap:
        raise MapError(
            f"{reference_map.path}: made with model {_spell_model(header.model)}, but the model here is"
            f" {_spell_model(model)}; build the map again with this one"
        )
    normalized = "set" if wanted.normalization == "online" else "none"
    ours = (wanted.regions, wanted.region_width if wanted.regions == "left-right" else header.regions.width, normalized)
    theirs = (header.regions.kind, header.regions.width, header.regions.normalization)
    if ours != theirs:
        raise MapError(
            f"{reference_map.path}: made with regions {_spell_regions(*theirs)},"
            f" but [descriptor] asks for {_spell_regions(*ours)}; change the one or build the map again"
        )


def _spell_model(model: ModelKey) -> str:
    return f"{model.name} ({model.sha256[:12]}, {model.tap})"


def _spell_regions(kind: str, width: float, normalization: str) -> str:
    return f"{kind} of width {width:g}, normalization {normalization}"
