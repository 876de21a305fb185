"""Stretches of a map that resemble another stretch of it, so that one may be taken for the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.geodesy import east_north
from edge.reference_map import Drives, MapSet

EVERY_M = 10.0
"""Distance between the places of a stretch that are compared."""
MOST_LIKELY = 0.5
"""Share of them that must be mistaken for places of the same other stretch; where all of them are mistaken, of any: a
street that repeats itself has many."""
NEIGHBOR_PLACES = 4
"""A place elsewhere is mistaken for a place if it is more similar to it than the places so many before and after."""
ELSEWHERE_M = 80.0
"""From this distance on, over the ground and along the drive, another place is elsewhere."""


@dataclass(frozen=True)
class SegmentSpan:
    """Meters [from_m, to_m) of a segment."""

    segment: int
    from_m: float
    to_m: float


@dataclass(frozen=True)
class Alias:
    """A stretch, and the one that it resembles."""

    stretch: SegmentSpan
    other: SegmentSpan
    share: float


def aliases(maps: MapSet, drives: Drives, spans: Sequence[SegmentSpan]) -> list[Alias]:
    """Of all stretches, within each map."""
    found = []
    for span in spans:
        rivals = _rivals(maps, drives, span)
        others = Counter(_span_of(maps, drives, row, spans) for row in rivals if row is not None)
        repeats = None not in rivals
        for nowhere in (None, span):
            others.pop(nowhere, None)
        if not others:
            continue
        (other, count), *_ = others.most_common(1)
        if other is not None and (repeats or count >= MOST_LIKELY * len(rivals)):
            found.append(Alias(span, other, count / len(rivals)))
    return found


def _rivals(maps: MapSet, drives: Drives, span: SegmentSpan) -> list[int | None]:
    """For some places of a stretch, the place that each is mistaken for, numbered through all maps."""
    start, end = maps.index.segment(span.segment)
    number = maps.index.map_of(start)
    offset = maps.index.starts[number]
    inside = [row for row in range(start, end) if span.from_m <= drives.along_m(row) < span.to_m]
    steps = inside[:: max(1, round(EVERY_M / drives.spacing_m))]
    rows = [row - offset for row in steps if start + NEIGHBOR_PLACES <= row < end - NEIGHBOR_PLACES]
    found = (_mistaken_for(maps, number, row) for row in rows)
    return [None if row is None else row + offset for row in found]


def _mistaken_for(maps: MapSet, number: int, row: int) -> int | None:
    """The row of a map that is elsewhere, and more similar to one of its rows than the neighbors of that are."""
    own = maps.maps[number]
    costs, places = maps.matchers[number].costs_of_encoded(own.descriptors[:, row : row + 1])[0, 0], own.places
    origin = float(places["lat_deg"][row]), float(places["lon_deg"][row])
    away_m = np.hypot(*east_north(places["lat_deg"], places["lon_deg"], origin).T)
    along_m = np.abs(places["route_m"] - places["route_m"][row])
    elsewhere = np.flatnonzero(np.fmin(away_m, along_m) > ELSEWHERE_M)
    beside = max(int(costs[row - NEIGHBOR_PLACES]), int(costs[row + NEIGHBOR_PLACES]))
    nearest = int(elsewhere[costs[elsewhere].argmin()]) if elsewhere.size else row
    return nearest if elsewhere.size and costs[nearest] <= beside else None


def _span_of(maps: MapSet, drives: Drives, row: int, spans: Sequence[SegmentSpan]) -> SegmentSpan | None:
    segment, along_m = maps.index.segment_of(row), drives.along_m(row)
    return next((one for one in spans if one.segment == segment and one.from_m <= along_m < one.to_m), None)
