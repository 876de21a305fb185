"""Stretches of a map that resemble another stretch of it, so that one may be taken for the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from edge.reference_map import NEIGHBOR_PLACES, Drives, MapSet, rival

EVERY_M = 10.0
"""Distance between the places of a stretch that are compared."""
MOST_LIKELY = 0.5
"""Share of them that must be mistaken for places of the same other stretch."""


@dataclass(frozen=True)
class Span:
    """Meters [from_m, to_m) of a segment."""

    segment: int
    from_m: float
    to_m: float


@dataclass(frozen=True)
class Alias:
    """A stretch, and the one that it resembles."""

    stretch: Span
    other: Span
    share: float


def aliases(maps: MapSet, drives: Drives, spans: Sequence[Span]) -> list[Alias]:
    """Of all stretches, within each map."""
    found = []
    for span in spans:
        rivals = _rivals(maps, drives, span)
        others = Counter(_span_of(maps, drives, row, spans) for row in rivals if row is not None)
        others.pop(None, None)
        if not others:
            continue
        (other, count), *_ = others.most_common(1)
        if other is not None and other != span and count >= MOST_LIKELY * len(rivals):
            found.append(Alias(span, other, count / len(rivals)))
    return found


def _rivals(maps: MapSet, drives: Drives, span: Span) -> list[int | None]:
    """For some places of a stretch, the place that each is mistaken for, numbered through all maps."""
    start, end = maps.index.segment(span.segment)
    number = maps.index.map_of(start)
    own, offset = maps.maps[number], maps.index.starts[number]
    inside = [row for row in range(start, end) if span.from_m <= drives.along_m(row) < span.to_m]
    found: list[int | None] = []
    for row in inside[:: max(1, round(EVERY_M / drives.spacing_m))]:
        if start + NEIGHBOR_PLACES <= row < end - NEIGHBOR_PLACES:
            one = rival(maps.matchers[number], own.descriptors, own.places, row - offset)
            found.append(one.row + offset if one is not None and one.is_mistaken else None)
    return found


def _span_of(maps: MapSet, drives: Drives, row: int, spans: Sequence[Span]) -> Span | None:
    segment, along_m = maps.index.segment_of(row), drives.along_m(row)
    return next((one for one in spans if one.segment == segment and one.from_m <= along_m < one.to_m), None)
